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

    With x_range, y_range (int, int); returns u, v (ny, nx): Displacement, px of this level.
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
    u, v = np.empty((ny, nx), np.float32), np.empty((ny, nx), np.float32)
    _peaks(score, border, x_range[0], y_range[0], np.empty(nx, np.float32), np.empty(nx, np.int32), u, v)
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
def _largest(score: np.ndarray, j: int, border: int, top: np.ndarray, best: np.ndarray) -> None:
    """Which of all shifts has the largest score, the first of equals, for each block of row j."""
    rows, _, n, _ = score.shape
    nx = len(top)
    for i in range(nx):  # copied as a slice, it takes five seconds more to compile
        top[i], best[i] = score[0, j, 0, border + i], np.int32(0)
    for dy in range(rows):
        for k in range(n):
            middle = score[dy, j, k, border : border + nx]
            for i in range(nx):
                larger = middle[i] > top[i]
                best[i] = np.int32(dy * n + k) if larger else best[i]
                top[i] = middle[i] if larger else top[i]


@njit
def _vertex(before: np.float32, middle: np.float32, after: np.float32) -> np.float32:
    """Where the parabola through three neighbours is highest, at most half a step from the middle one."""
    curvature = before - F(2) * middle + after
    if curvature >= F(-1e-6):
        return F(0)
    return min(max((before - after) / (F(2) * curvature), F(-0.5)), F(0.5))


@njit
def _peaks(
    score: np.ndarray,
    border: int,
    first_x: int,
    first_y: int,
    top: np.ndarray,
    best: np.ndarray,
    u: np.ndarray,
    v: np.ndarray,
) -> None:
    """Shift of the largest score of each block, with a parabola through its neighbours.

    score (rows of shifts, ny, columns of shifts, nx + 2 border) begins with the shift first_x, first_y; top,
    best (nx,) are work space, u, v (ny, nx) output.
    """
    rows, ny, n, _ = score.shape
    for j in range(ny):
        _largest(score, j, border, top, best)
        for i in range(len(top)):
            y, x = divmod(best[i], n)
            u[j, i], v[j, i] = first_x + x, first_y + y
            if 0 < x < n - 1:
                u[j, i] += _vertex(score[y, j, x - 1, border + i], top[i], score[y, j, x + 1, border + i])
            if 0 < y < rows - 1:
                v[j, i] += _vertex(score[y - 1, j, x, border + i], top[i], score[y + 1, j, x, border + i])
