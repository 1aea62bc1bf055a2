"""Where to start: whole-pixel search of the largest correlation of locally normalised images."""

from __future__ import annotations

from typing import Any

import cv2
import numba as nb
import numpy as np

from wavefield.matching.kernels import BLOCK, shift_sums
from wavefield.matching.lattice import F, filtered, replace_outliers, smoothed, window_weights
from wavefield.matching.prepared import Level
from wavefield.matching.settings import Settings

njit: Any = nb.njit(error_model="numpy", nogil=True, cache=True)

_LOCAL = 41  # px of the level: side of the box of its local normalisation


def search(
    a: Level, b: Level, x_range: tuple[int, int], y_range: tuple[int, int], settings: Settings
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement of every block to the best of all whole-pixel shifts, refined by parabolas.

    Parameters
    ----------
    a, b : Level
        The same level of two images.
    x_range, y_range : (int, int)
        Smallest and largest shift, px of this level.
    settings : Settings
        Its window; images that are not normalised are normalised here.

    Returns
    -------
    u, v : (ny, nx) float32
        Displacement, px of this level.
    """
    ny, nx = a.blocks
    w = nx * BLOCK
    margin = max(abs(n) for n in (*x_range, *y_range)) + 1
    first, second = (
        level.image if settings.normalization > 0 else _locally_normalized(level.image) for level in (a, b)
    )
    first = np.ascontiguousarray(first)
    second = cv2.copyMakeBorder(second, margin, margin, margin, margin, cv2.BORDER_CONSTANT, value=0)
    weights = window_weights(settings.search_window)
    xs, ys = np.arange(x_range[0], x_range[1] + 1), np.arange(y_range[0], y_range[1] + 1)
    score = np.empty((len(ys), len(xs), ny, nx), np.float32)
    row = np.empty(w, np.float32)
    for dy, scores in zip(ys, score):
        shift_sums(first, second, margin, xs[0], dy, row, scores)
        for field in scores:
            filtered(field, weights, field)
    u, v = _peak(score, xs, ys)
    for _ in range(2):
        replace_outliers(u, v, 2.0)
    return smoothed(u, 1.0, 1), smoothed(v, 1.0, 1)


def _locally_normalized(image: np.ndarray) -> np.ndarray:
    def mean(f: np.ndarray) -> np.ndarray:
        return cv2.blur(f, (_LOCAL, _LOCAL), borderType=cv2.BORDER_REPLICATE)

    image = image - mean(image)
    variance = mean(image * image)
    return image / np.sqrt(variance + F(0.01) * F(variance.mean()) + F(1e-12))


@njit
def _largest(values, top, best):
    """Where along the first axis the largest value is, the first of equals; top starts as the first row."""
    for k in range(1, len(values)):
        row = values[k]
        for i in range(len(row)):
            larger = row[i] > top[i]
            best[i] = np.int32(k) if larger else best[i]
            top[i] = row[i] if larger else top[i]


def _peak(score: np.ndarray, xs: np.ndarray, ys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Place of the maximum over the first two axes, with a parabola through its neighbours."""
    shape = score.shape[2:]
    flat = score.reshape(len(ys), len(xs), -1)
    best = np.zeros(flat.shape[2], np.int32)
    _largest(flat.reshape(-1, flat.shape[2]), flat[0, 0].copy(), best)
    j, i = np.divmod(best, len(xs))
    block = np.arange(flat.shape[2])
    here = flat[j, i, block]

    def offset(before: np.ndarray, after: np.ndarray, inside: np.ndarray) -> np.ndarray:
        curvature = before - 2 * here + after
        good = inside & (curvature < -1e-6)
        return np.where(good, (before - after) / (2 * np.where(good, curvature, -1.0)), 0.0)

    du = offset(
        flat[j, np.maximum(i - 1, 0), block],
        flat[j, np.minimum(i + 1, len(xs) - 1), block],
        (i > 0) & (i < len(xs) - 1),
    )
    dv = offset(
        flat[np.maximum(j - 1, 0), i, block],
        flat[np.minimum(j + 1, len(ys) - 1), i, block],
        (j > 0) & (j < len(ys) - 1),
    )
    u = (xs[i] + np.clip(du, -0.5, 0.5)).astype(np.float32)
    v = (ys[j] + np.clip(dv, -0.5, 0.5)).astype(np.float32)
    return u.reshape(shape), v.reshape(shape)
