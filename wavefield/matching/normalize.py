"""Local normalisation of an image: zero mean and unit variance over its surroundings, in two passes.

The first takes sums over square cells, the second writes the image with mean and scale interpolated between
the cells; between them work is done on the small fields. As in `matching_kernels` loops run along rows.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from wavefield.compiled import compiled

F = np.float32

MAX_CELL_SIDE = 8  # px: side of the cells
MIN_RELATIVE_CONTRAST = F(0.05)  # of the image's median local standard deviation: less is not amplified
MIN_USABLE_SHARE = F(1e-3)  # of the pixels around a cell
NO_MASK = np.empty((0, 0), np.uint8)

# pixels that are not finite must reach the sums as they are: no fast-math but fused multiply-adds
njit = compiled(fastmath={"contract"}, error_model="numpy")


@njit
def _fold(row: np.ndarray, count: int, side: int, out: np.ndarray) -> None:
    """Sum `side` neighbours of the first `count` elements of `row`; the rest is added to the last."""
    n = len(out)
    if side == 8:  # the usual one: a loop that becomes vector code
        for i in range(n):
            left = (row[8 * i] + row[8 * i + 1]) + (row[8 * i + 2] + row[8 * i + 3])
            out[i] = left + ((row[8 * i + 4] + row[8 * i + 5]) + (row[8 * i + 6] + row[8 * i + 7]))
    else:
        for i in range(n):
            total = row[i * side]
            for k in range(1, side):
                total += row[i * side + k]
            out[i] = total
    for x in range(n * side, count):
        out[n - 1] += row[x]


@njit
def _add_row(row: np.ndarray, s: np.ndarray, t: np.ndarray, top: np.ndarray) -> None:
    for x in range(len(row)):
        v = F(row[x])
        s[x] += v
        t[x] += v * v
        top[x] = max(top[x], v)


@njit
def _add_masked_row(
    row: np.ndarray, usable: np.ndarray, s: np.ndarray, t: np.ndarray, top: np.ndarray
) -> None:
    for x in range(len(row)):
        v = F(row[x]) if usable[x] != 0 else F(0)
        s[x] += v
        t[x] += v * v
        top[x] = max(top[x], v)


@njit
def _cell_sums(image: np.ndarray, usable: np.ndarray, side: int, rows: np.ndarray, out: np.ndarray) -> None:
    h, w = image.shape
    ny = out.shape[1]
    s, t, top = rows[0], rows[1], rows[2]
    top[:] = F(0)
    for j in range(ny):
        s[:] = F(0)
        t[:] = F(0)
        for y in range(j * side, j * side + side if j < ny - 1 else h):
            if usable.size > 0:
                _add_masked_row(image[y], usable[y], s, t, top)
            else:
                _add_row(image[y], s, t, top)
        _fold(s, w, side, out[0, j])
        _fold(t, w, side, out[1, j])


@njit
def _normalize_row(
    row: np.ndarray,
    m0: np.ndarray,
    m1: np.ndarray,
    s0: np.ndarray,
    s1: np.ndarray,
    t: np.float32,
    out: np.ndarray,
) -> None:
    for x in range(len(row)):
        mean = m0[x] + t * (m1[x] - m0[x])
        scale = s0[x] + t * (s1[x] - s0[x])
        out[x] = (F(row[x]) - mean) * scale


@njit
def _clear_row(usable: np.ndarray, out: np.ndarray) -> None:
    for x in range(len(out)):
        out[x] = out[x] if usable[x] != 0 else F(0)


@njit
def _normalize(
    image: np.ndarray, usable: np.ndarray, mean: np.ndarray, scale: np.ndarray, side: int, out: np.ndarray
) -> None:
    ny, (h, w) = len(mean), image.shape
    border = (len(out) - h) // 2
    for y in range(h):
        place = min(max((F(y) + F(0.5)) / F(side) - F(0.5), F(0)), F(ny - 1))
        j = int(place)
        k = min(j + 1, ny - 1)
        to = out[border + y][border : border + w]  # contiguous, which rows of a cut array are not
        _normalize_row(image[y], mean[j], mean[k], scale[j], scale[k], place - F(j), to)
        if usable.size > 0:
            _clear_row(usable[y], to)


class NormalizationCells:
    """Sums over the cells of one image (h, w) for surroundings of a width, px."""

    def __init__(self, image: np.ndarray, width: float, usable: np.ndarray | None = None) -> None:
        self.image, self.width = np.ascontiguousarray(image), max(width, 1.0)
        self.usable = NO_MASK if usable is None else usable
        h, w = self.image.shape
        self.side = _side(h, w, self.width)
        self.sums = np.empty((2, h // self.side, w // self.side), F)
        rows = np.empty((3, w + (48 - w) % 256), F)  # never a page apart, as in `work_space`
        _cell_sums(self.image, self.usable, self.side, rows, self.sums)
        top = rows[2, :w]
        self.largest = float(top.max())
        self.brightest = np.flatnonzero(top == self.largest)
        self.finite = bool(np.isfinite(self.sums[0].sum()))

    def local(self, number: int) -> np.ndarray:
        """(ny, nx) float32: values (0) or squares (1) of usable pixels, averaged over the surroundings."""
        mean = self.sums[number] * _inverse_area(self.image.shape, self.side)
        # averages over cells (variance 1/12), read linearly between them (1/6), are blurred already
        sigma = np.sqrt((self.width / self.side) ** 2 - 0.25)
        out: np.ndarray = cv2.GaussianBlur(mean, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
        return out

    def normalized(self, share: np.ndarray | None, out: np.ndarray) -> None:
        """Write the normalised image, inside any border of `out`; pixels that are not usable become 0."""
        mean, square = self.local(0), self.local(1)
        if share is not None:
            mean /= share
            square /= share
        std = np.sqrt(np.maximum(square - mean * mean, 0))
        # neighbouring cells hardly differ: one of four suffices
        every_second = std[::2, ::2]
        if share is not None:
            every_second = every_second[share[::2, ::2] > 0.5]
        typical = F(np.median(every_second)) if every_second.size else F(0)
        scale = F(1) / np.maximum(std, max(MIN_RELATIVE_CONTRAST * typical, F(1e-6)))
        _normalize(self.image, self.usable, self._spread(mean), self._spread(scale), self.side, out)

    def filled(self, share: np.ndarray, out: np.ndarray) -> None:
        """Write the image, its pixels that are not usable replaced by the mean of their surroundings."""
        h, w = out.shape
        np.copyto(out, self.image, casting="unsafe")
        mean = cv2.resize(self.local(0) / share, (w, h), interpolation=cv2.INTER_LINEAR)
        np.copyto(out, mean, where=self.usable == 0)

    def _spread(self, field: np.ndarray) -> np.ndarray:
        """(ny, w) float32: a field of cells interpolated along its rows."""
        if self.side == 1:
            return field
        ny, nx = field.shape
        out = np.empty((ny, self.image.shape[1]), F)
        n = nx * self.side
        cv2.resize(field, (n, ny), dst=out[:, :n], interpolation=cv2.INTER_LINEAR)
        out[:, n:] = out[:, n - 1 : n]
        return out


def usable_share(usable: np.ndarray, width: float) -> np.ndarray:
    """(ny, nx) float32: share of usable pixels around each cell, never quite 0."""
    out: np.ndarray = np.maximum(NormalizationCells(usable, width).local(0), MIN_USABLE_SHARE)
    return out


def _side(h: int, w: int, width: float) -> int:
    """Side of the cells: small against the width and the image."""
    side = MAX_CELL_SIDE
    while side > 1 and (width < side or min(h, w) < 8 * side):
        side //= 2
    return side


@lru_cache(maxsize=16)
def _inverse_area(shape: tuple[int, int], side: int) -> np.ndarray:
    """(ny, nx) float32: one over the number of pixels of each cell."""
    counts = []
    for n in shape:
        count = np.full(n // side, side, F)
        count[-1] += n % side
        counts.append(count)
    return F(1) / (counts[0][:, None] * counts[1])
