"""Rectify images to the plane z = 0, and bin the images of cameras with finer pixels.

An image is first resampled to a grid twice as fine, by quintic B-splines without prefilter, and then read by
linear interpolation. The bias is 0.002 px; plain cubic interpolation of the image has 0.04 px.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numba import float32, int64, uint8, uint16, void
from numpy.typing import NDArray

from wavefield.compiled import compiled
from wavefield.rig import Camera

Float = NDArray[Any]

_ROWS_AT_ONCE = 128  # rows of a rectified image: the part of the fine grid they are read from fits the cache


@compiled(
    [
        void(uint8[:, ::1], int64, float32, float32[:, ::1], uint16[:, ::1]),
        void(uint16[:, ::1], int64, float32, float32[:, ::1], uint16[:, ::1]),
        void(float32[:, ::1], int64, float32, float32[:, ::1], float32[:, ::1]),
    ],
    fastmath=True,
    error_model="numpy",
)
def _double(
    image: NDArray[Any], first: int, scale: np.float32, rows: NDArray[Any], out: NDArray[Any]
) -> None:
    """Write an image, smoothed by the quintic B-spline and times `scale`, at whole and half pixels to `out`.
    `out` has two rows for each row of the image from row `first` on; `rows` (2, w + 8) is working memory."""
    h, w = image.shape
    # values of the spline at distances 0, 1, 2 (a) and 1/2, 3/2, 5/2 (b)
    a0, a1, a2 = np.float32(66 / 120), np.float32(26 / 120), np.float32(1 / 120)
    b0, b1, b2 = np.float32(1682 / 3840), np.float32(237 / 3840), np.float32(1 / 3840)
    half = np.float32(0.5)
    for n in range(len(out) // 2):
        y = first + n
        r0, r1, r2 = image[max(y - 2, 0)], image[max(y - 1, 0)], image[y]
        r3, r4, r5 = image[min(y + 1, h - 1)], image[min(y + 2, h - 1)], image[min(y + 3, h - 1)]
        e, g = rows[0], rows[1]
        for x in range(w):
            e[x + 2] = scale * (
                a0 * np.float32(r2[x])
                + a1 * (np.float32(r1[x]) + np.float32(r3[x]))
                + a2 * (np.float32(r0[x]) + np.float32(r4[x]))
            )
        for x in range(w):
            g[x + 2] = scale * (
                b0 * (np.float32(r2[x]) + np.float32(r3[x]))
                + b1 * (np.float32(r1[x]) + np.float32(r4[x]))
                + b2 * (np.float32(r0[x]) + np.float32(r5[x]))
            )
        for j in range(2):
            q, o = rows[j], out[2 * n + j]
            q[0] = q[1] = q[2]
            q[w + 2] = q[w + 3] = q[w + 4] = q[w + 1]
            if out.itemsize == 2:
                for x in range(w):
                    o[2 * x] = np.uint16(
                        np.int32(a0 * q[x + 2] + a1 * (q[x + 1] + q[x + 3]) + a2 * (q[x] + q[x + 4]) + half)
                    )
                    o[2 * x + 1] = np.uint16(
                        np.int32(
                            b0 * (q[x + 2] + q[x + 3])
                            + b1 * (q[x + 1] + q[x + 4])
                            + b2 * (q[x] + q[x + 5])
                            + half
                        )
                    )
            else:
                for x in range(w):
                    o[2 * x] = a0 * q[x + 2] + a1 * (q[x + 1] + q[x + 3]) + a2 * (q[x] + q[x + 4])
                    o[2 * x + 1] = (
                        b0 * (q[x + 2] + q[x + 3]) + b1 * (q[x + 1] + q[x + 4]) + b2 * (q[x] + q[x + 5])
                    )


def bin_pixels(image: NDArray[Any], count: int) -> NDArray[Any]:
    """Reduce each square of count x count px to a weighted mean; 8-bit images become 16-bit, times 64.
    If `count` is 1, pixels stay as they are."""
    if image.dtype not in (np.uint8, np.uint16):
        image = image.astype(np.float32)
    if count == 1:
        return image
    h, w = image.shape[0] // count, image.shape[1] // count
    image = image[: h * count, : w * count]
    scale = np.float32(64 if image.dtype == np.uint8 else 1)
    out = np.empty((h, w), np.float32 if image.dtype == np.float32 else np.uint16)
    # a Gaussian of half the square's side comes first: a plain mean does not depend on where in the square a
    # sharp bead lies
    _bin(
        np.ascontiguousarray(image),
        _weights(count) * np.sqrt(scale),
        count,
        np.float32(out.dtype.kind == "u") / 2,
        out,
    )
    return out


@lru_cache(maxsize=8)
def _weights(count: int) -> NDArray[np.float32]:
    """Return the weights (3 count,) along one axis: a Gaussian of sigma count / 2, averaged over count px."""
    x = np.arange(-count, count + 1)
    out = np.convolve(np.exp(-2.0 * np.square(x / count)), np.ones(count))
    return np.asarray(out / out.sum(), np.float32)


@compiled()
def _in(y: Any, h: int) -> Any:
    """Return the row number y, limited to the rows 0 to h - 1 of an image."""
    return min(max(y, 0), h - 1)


@compiled(error_model="numpy", fastmath={"contract", "reassoc"})
def _bin(image: NDArray[Any], weights: NDArray[Any], count: int, half: np.float32, out: NDArray[Any]) -> None:
    """Write to `out`, for every square of count x count px, the sum of pixels weighted along x and y.
    The `weights` (3 count,) reach over the neighbouring squares; `half` (0.5 or 0) is added for rounding."""
    h, w = image.shape
    reach, wide = np.int64(count), np.int64(out.shape[1])
    line = np.empty(w + 2 * reach, np.float32)
    total = np.empty(wide, np.float32)
    for j in range(out.shape[0]):
        middle = line[reach : reach + w]
        middle[:] = np.float32(0)
        for i in range(0, weights.size, 3):
            p, q, r = weights[i], weights[i + 1], weights[i + 2]
            first = j * count + i - reach
            a, b, c = image[_in(first, h)], image[_in(first + 1, h)], image[_in(first + 2, h)]
            for x in range(w):
                middle[x] += p * np.float32(a[x]) + q * np.float32(b[x]) + r * np.float32(c[x])
        line[:reach] = middle[0]
        line[reach + w :] = middle[w - 1]
        total[:] = half
        for i in range(0, weights.size, 3):
            p, q, r = weights[i], weights[i + 1], weights[i + 2]
            part = line[i:]
            for x in range(wide):
                total[x] += p * part[x * count] + q * part[x * count + 1] + r * part[x * count + 2]
        for x in range(wide):
            out[j, x] = total[x]


def binned(camera: Camera, count: int) -> Camera:
    """Return the camera with its size and calibration changed to those of images from `bin_pixels`."""
    width, height = camera.size
    return replace(camera.scaled(1.0 / count), size=(width // count, height // count))


def _type_of_double(image: NDArray[Any]) -> np.dtype[Any]:
    """Return the data type of `_doubled` images: uint16 for integer images up to 16 bits, else float32."""
    return np.dtype(np.uint16 if image.dtype in (np.uint8, np.uint16) else np.float32)


def _doubled(image: NDArray[Any], rows: Sequence[tuple[int, int]]) -> Iterator[NDArray[Any]]:
    """Yield parts of an image on a grid twice as fine; `rows` holds the (first, last) row of each part.
    All parts share the same memory; `last` is excluded."""
    if image.dtype not in (np.uint8, np.uint16):
        image = image.astype(np.float32, copy=False)
    image = np.ascontiguousarray(image)
    w = image.shape[1]
    # 256 * 255 = 65280 fits 16 bits
    scale = np.float32(256.0 if image.dtype == np.uint8 else 1.0)
    memory = np.empty((2 * max(last - first for first, last in rows), 2 * w), _type_of_double(image))
    for first, last in rows:
        out = memory[: 2 * (last - first)]
        _double(image, first, scale, np.empty((2, w + 8), np.float32), out)
        yield out


def sight_map(camera: Camera, x: NDArray[Any], y: NDArray[Any]) -> tuple[Float, Float, NDArray[np.bool_]]:
    """Return a tuple (X, Y, mask), each (ny, nx): where a camera sees points x (nx,), y (ny,), m, on z = 0.
    X and Y are in half pixels. The mask is True at least three pixels (the reach of the spline) inside the
    image; elsewhere X is negative."""
    X, Y = camera.project(x[None, :], y[:, None], 0.0)
    w, h = camera.size
    margin = 3.0
    with np.errstate(invalid="ignore"):
        seen = (X >= margin) & (X <= w - 1 - margin) & (Y >= margin) & (Y <= h - 1 - margin)
    X, Y = np.where(seen, X, -4.0), np.clip(np.nan_to_num(Y), margin, h - 1 - margin)
    return (2.0 * X).astype(np.float32), (2.0 * Y).astype(np.float32), seen


def rectify(image: NDArray[Any], X: Float, Y: Float) -> NDArray[Any]:
    """Return an image read at the positions X, Y (ny, nx), in half pixels; 0 where X is negative."""
    out = np.empty(X.shape, _type_of_double(image))
    parts = [np.s_[row : row + _ROWS_AT_ONCE] for row in range(0, len(X), _ROWS_AT_ONCE)]
    rows = [(int(Y[part].min()) // 2, min(int(Y[part].max()) // 2 + 2, len(image))) for part in parts]
    for part, (first, _), fine in zip(parts, rows, _doubled(image, rows), strict=True):
        y = Y[part] - np.float32(2 * first)
        cv2.remap(fine, X[part], y, cv2.INTER_LINEAR, out[part], borderMode=cv2.BORDER_CONSTANT)
    return out


def widen(image: NDArray[Any], x: float, y: float) -> NDArray[Any]:
    """Blur an image by a Gaussian with the standard deviations x and y, px, along x and y."""
    sides = tuple(2 * int(np.ceil(2.5 * sigma)) + 1 if sigma >= 0.3 else 1 for sigma in (x, y))
    if sides == (1, 1):
        return image
    # several times faster than sepFilter2D of a 16-bit image
    return cv2.GaussianBlur(
        image.astype(np.float32, copy=False), sides, x, sigmaY=y, borderType=cv2.BORDER_REPLICATE
    )
