"""Correlation of windows by Fourier transform: the reference for the fast matcher, and a fallback."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import scipy.fft

from wavefield.compiled import compiled
from wavefield.matching.assess import assess
from wavefield.matching.block_lattice import (
    block_weights,
    filtered,
    replace_outliers,
    sample,
    smoothed,
    window_weights,
)
from wavefield.matching.displacement import Displacement
from wavefield.matching.gauss_newton import Initial, initial_fields, last_sums, prepared_pair
from wavefield.matching.matching_kernels import BLOCK, F, scratch, spline_image
from wavefield.matching.matching_settings import MatchSettings
from wavefield.matching.prepared import PreparedImage

_STRIDE = 2  # blocks between correlation windows
_REFINE = 4  # px: reach of the search once the images are deformed
_PASSES = 4  # at the final window size, after the first one at twice that size
_SMOOTHING = 1.0  # windows: of the displacement that deforms b; less, and the passes do not settle

njit = compiled(fastmath=True, error_model="numpy")


def correlate(
    a: np.ndarray | PreparedImage,
    b: np.ndarray | PreparedImage,
    settings: MatchSettings | None = None,
    mask: np.ndarray | None = None,
    initial: Initial = None,
) -> Displacement:
    """Find where each block of image a went in image b, by correlation of windows.

    Tens of times slower than `match`, and it sees less of waves of a few windows' length; for data that
    gradient methods do not like, and as a reference.

    Parameters
    ----------
    a, b, mask, initial
        As for `match`.
    settings : Settings, optional
        As for `match`; uses the window, the search ranges (16 px each way where there are none), the
        normalisation and the limits of validity.

    Returns
    -------
    Displacement
        On the same lattice as `match` gives.

    Raises
    ------
    FrameError, ValueError
        As for `match`.

    Notes
    -----
    Multi-pass with window deformation: top-hat windows of an odd number of px (so that their centre is a
    pixel), one pass at twice the final size, then passes on b read through the displacement found so far; the
    peak by a Gauss fit through three points. Scarano (2002), Meas. Sci. Technol. 13, R1.

    Examples
    --------
    >>> import numpy as np, cv2
    >>> noise = np.random.default_rng(1).normal(128, 40, (120, 140)).astype(np.float32)
    >>> image = cv2.GaussianBlur(noise, (0, 0), 1.2)
    >>> d = correlate(image, np.roll(image, (2, 3), (0, 1)))
    >>> round(float(np.median(d.u[d.valid])), 1), round(float(np.median(d.v[d.valid])), 1)
    (3.0, 2.0)
    """
    settings = MatchSettings.piv() if settings is None else settings
    a, b = prepared_pair(a, b, settings, mask)
    first, second = a.levels[0], b.levels[0]
    ny, nx = first.blocks
    rows, columns = np.arange(0, ny, _STRIDE), np.arange(0, nx, _STRIDE)
    size = int(settings.window) // 2 * 2
    planes = np.empty((3, *first.shape), np.float32)
    spline_image(first.padded, np.empty((2, first.shape[1] + 4), np.float32), planes)
    smooth = planes[0]
    if initial is None:
        u, v = (np.zeros((len(rows), len(columns)), np.float32) for _ in range(2))
        reach_x, reach_y = settings.search_x or (-16.0, 16.0), settings.search_y or (-16.0, 16.0)
        furthest = max(abs(q) for q in (*reach_x, *reach_y))
        sizes = [scipy.fft.next_fast_len(int(max(2 * size, 2 * furthest + size)))] + [size] * _PASSES
    else:
        u, v = (np.ascontiguousarray(f[::_STRIDE, ::_STRIDE]) for f in initial_fields(initial, (ny, nx)))
        sizes = [size] * _PASSES
    for number, side in enumerate(sizes):
        wide = initial is None and number == 0
        if wide:
            ranges = reach_x, reach_y
        else:
            ranges = (-_REFINE, _REFINE), (-_REFINE, _REFINE)
            u, v = smoothed(u, _SMOOTHING, 2), smoothed(v, _SMOOTHING, 2)
        warped = _deformed(second.padded, u, v, smooth.shape)
        du, dv = _peaks(smooth, warped, side, rows * BLOCK + 2, columns * BLOCK + 2, ranges)
        u, v = u + du, v + dv
        outlier = replace_outliers(u, v, settings.max_deviation * (2 if wide else 1))
    row, column = np.meshgrid(np.arange(ny) / _STRIDE, np.arange(nx) / _STRIDE, indexing="ij")
    wrong = cv2.resize(
        outlier.astype(np.uint8), (len(columns) * _STRIDE, len(rows) * _STRIDE), interpolation=0
    )
    u, v = sample(u, column, row), sample(v, column, row)
    return _assessed(first, second, u, v, wrong[:ny, :nx] > 0, settings)


def _assessed(
    first: Any, second: Any, u: np.ndarray, v: np.ndarray, outlier: np.ndarray, settings: MatchSettings
) -> Displacement:
    """Correlation, uncertainty and validity as `match` finds them."""
    work = scratch(u.shape[1])
    sums = last_sums(first, second, u, v, work)
    weight = np.empty(u.shape, np.float32)
    height, width = second.shape
    block_weights(first.good, second.good, u, v, height, width, weight)
    sums *= weight
    weights = window_weights(settings.window)
    windowed = np.stack([filtered(field, weights) for field in sums])
    share = filtered(weight, weights)
    still = np.zeros(u.shape, np.float32)
    return assess(first, second, u, v, sums, windowed, share, (still, still), outlier, settings)


def _deformed(padded: np.ndarray, u: np.ndarray, v: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """b(x + u, y + v), smoothed by the quintic B-spline as a is, at every pixel of a."""
    out = np.empty(shape, np.float32)
    h, w = shape
    at_x = ((np.arange(w) - 2) / (_STRIDE * BLOCK)).astype(np.float32)
    at_y = ((np.arange(h) - 2) / (_STRIDE * BLOCK)).astype(np.float32)
    x, y = np.meshgrid(at_x, at_y)
    _spline_read(padded, sample(u, x, y), sample(v, x, y), (padded.shape[0] - h) // 2, out)
    return out


@njit
def _spline_taps(f: np.float32) -> tuple[np.float32, ...]:
    g = F(1) - f
    f2, g2 = f * f, g * g
    f3, g3 = f2 * f, g2 * g
    return (
        g2 * g3 / F(120),
        (F(1) + F(5) * (g + g3 * (g - g2)) + F(10) * (g2 + g3)) / F(120),
        (F(66) - F(60) * f2 + F(30) * f2 * f2 - F(10) * f2 * f3) / F(120),
        (F(66) - F(60) * g2 + F(30) * g2 * g2 - F(10) * g2 * g3) / F(120),
        (F(1) + F(5) * (f + f3 * (f - f2)) + F(10) * (f2 + f3)) / F(120),
        f2 * f3 / F(120),
    )


@njit
def _spline_read(padded: np.ndarray, u: np.ndarray, v: np.ndarray, pad: int, out: np.ndarray) -> None:
    height, width = padded.shape
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            px = min(max(F(x + pad) + u[y, x], F(2)), F(width - 4))
            py = min(max(F(y + pad) + v[y, x], F(2)), F(height - 4))
            i, j = int(px), int(py)
            wx, wy = _spline_taps(px - F(i)), _spline_taps(py - F(j))
            total = F(0)
            for n in range(6):
                row = padded[j - 2 + n]
                line = F(0)
                for m in range(6):
                    line += wx[m] * row[i - 2 + m]
                total += wy[n] * line
            out[y, x] = total


def _peaks(
    a: np.ndarray,
    b: np.ndarray,
    side: int,
    rows: np.ndarray,
    columns: np.ndarray,
    ranges: tuple[tuple[float, float], tuple[float, float]],
) -> tuple[np.ndarray, np.ndarray]:
    """Place of the correlation peak of every window inside the ranges, px.

    Windows are side - 1 px wide, centred on the pixels (rows, columns).
    """
    half = side // 2
    a, b = (cv2.copyMakeBorder(q, half, half, half, half, cv2.BORDER_CONSTANT, value=0.0) for q in (a, b))
    windows_a, windows_b = (np.lib.stride_tricks.sliding_window_view(q, (side, side)) for q in (a, b))
    top_hat = np.ones((side, side), np.float32)
    top_hat[0] = top_hat[:, 0] = 0  # an odd number of pixels: the centre is a pixel
    shift_x, shift_y = (np.arange(int(np.floor(lo)) - 1, int(np.ceil(hi)) + 2) for lo, hi in ranges)
    u, v = np.empty((2, len(rows), len(columns)), np.float32)
    for number, row in enumerate(rows):
        wa, wb = (_centred(q[row, columns], top_hat) for q in (windows_a, windows_b))
        spectrum = np.conj(scipy.fft.rfft2(wa)) * scipy.fft.rfft2(wb)
        plane = scipy.fft.irfft2(spectrum, s=(side, side))[:, shift_y % side][:, :, shift_x % side]
        u[number], v[number] = _gauss_peak(plane, shift_x, shift_y)
    return u, v


def _centred(windows: np.ndarray, top_hat: np.ndarray) -> np.ndarray:
    windows = windows * top_hat
    out: np.ndarray = (windows - windows.sum((1, 2), keepdims=True) / top_hat.sum()) * top_hat
    return out


def _gauss_peak(plane: np.ndarray, shift_x: np.ndarray, shift_y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Largest inner value of each plane and the Gauss fit through it and its two neighbours each way."""
    inner = plane[:, 1:-1, 1:-1]
    j, i = np.divmod(inner.reshape(len(inner), -1).argmax(1), inner.shape[2])
    n = np.arange(len(plane))
    floor = 1e-6 * np.abs(plane).max((1, 2)) + 1e-30

    def log(dj: int, di: int) -> np.ndarray:
        out: np.ndarray = np.log(np.maximum(plane[n, j + 1 + dj, i + 1 + di], floor))
        return out

    def offset(before: np.ndarray, after: np.ndarray) -> np.ndarray:
        curvature = before - 2 * log(0, 0) + after
        sharp = curvature < -1e-9
        return np.where(sharp, np.clip((before - after) / (2 * np.where(sharp, curvature, -1)), -1, 1), 0)

    return shift_x[i + 1] + offset(log(0, -1), log(0, 1)), shift_y[j + 1] + offset(log(-1, 0), log(1, 0))
