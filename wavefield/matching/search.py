"""Where to start: whole-pixel search of the largest correlation of locally normalised images."""

from __future__ import annotations

import cv2
import numpy as np

from wavefield.compiled import compiled
from wavefield.matching.block_lattice import F, filtered, replace_outliers, smoothed, window_weights
from wavefield.matching.matching_kernels import BLOCK, shift_sums
from wavefield.matching.matching_settings import MatchSettings
from wavefield.matching.prepared import Level

njit = compiled(error_model="numpy")

NORMALIZATION_SIDE = 41  # px of the level: side of the box of its local normalisation


def search(
    a: Level, b: Level, x_range: tuple[int, int], y_range: tuple[int, int], settings: MatchSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement of every block to the best of all whole-pixel shifts, refined by parabolas.
    Returns u, v (ny, nx), px of this level.
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
    border = len(weights) // 2
    n = x_range[1] - x_range[0] + 1
    score = np.empty((y_range[1] - y_range[0] + 1, ny, n, nx + 2 * border), np.float32)
    row = np.empty(w, np.float32)
    for dy, scores in enumerate(score, y_range[0]):
        shift_sums(first, second, margin, x_range[0], dy, row, scores)
        side_by_side = scores.reshape(ny, -1)
        filtered(side_by_side, weights, side_by_side)
    best, (u, v) = np.empty((ny, nx), np.int32), np.empty((2, ny, nx), np.float32)
    _largest(score, border, best)
    _refine(score, best, border, (x_range[0], y_range[0]), u, v)
    for _ in range(2):
        replace_outliers(u, v, 2.0)
    return smoothed(u, 1.0, 1), smoothed(v, 1.0, 1)


def _locally_normalized(image: np.ndarray) -> np.ndarray:
    def mean(f: np.ndarray) -> np.ndarray:
        return cv2.blur(f, (NORMALIZATION_SIDE, NORMALIZATION_SIDE), borderType=cv2.BORDER_REPLICATE)

    image = image - mean(image)
    variance = mean(image * image)
    out: np.ndarray = image / np.sqrt(variance + F(0.01) * F(variance.mean()) + F(1e-12))
    return out


@njit
def _largest(score: np.ndarray, border: int, best: np.ndarray) -> None:
    """Number of the shift with the largest score of each block, the first of equals, into best (ny, nx)."""
    rows, ny, n, width = score.shape
    nx = width - 2 * border
    top = np.empty(nx, np.float32)
    for j in range(ny):
        for i in range(nx):  # copied as a slice, it takes five seconds more to compile
            top[i], best[j, i] = score[0, j, 0, border + i], np.int32(0)
        for dy in range(rows):
            for k in range(n):
                middle = score[dy, j, k, border : border + nx]
                for i in range(nx):
                    larger = middle[i] > top[i]
                    best[j, i] = np.int32(dy * n + k) if larger else best[j, i]
                    top[i] = middle[i] if larger else top[i]


@njit
def _vertex(before: F, middle: F, after: F) -> F:
    """As `parabola_vertex`, at most half a sample away."""
    bend = before - F(2) * middle + after
    return min(max(F(0.5) * (before - after) / bend, F(-0.5)), F(0.5)) if bend < F(0) else F(0)


@njit
def _refine(
    score: np.ndarray, best: np.ndarray, border: int, first: tuple[int, int], u: np.ndarray, v: np.ndarray
) -> None:
    """Fill u, v (ny, nx) with the shifts of the largest scores, refined by parabolas through neighbours."""
    rows, ny, n, width = score.shape
    for j in range(ny):
        for i in range(width - 2 * border):
            y, x, at = best[j, i] // n, best[j, i] % n, border + i
            middle = score[y, j, x, at]
            u[j, i], v[j, i] = F(first[0] + x), F(first[1] + y)
            if 0 < x < n - 1:
                u[j, i] += _vertex(score[y, j, x - 1, at], middle, score[y, j, x + 1, at])
            if 0 < y < rows - 1:
                v[j, i] += _vertex(score[y - 1, j, x, at], middle, score[y + 1, j, x, at])
