"""Where to start: whole-pixel search of the largest correlation of locally normalised images."""

from __future__ import annotations

import cv2
import numpy as np

from wavefield.compiled import compiled
from wavefield.matching.block_lattice import F, filtered, replace_outliers, smoothed, window_weights
from wavefield.matching.matching_kernels import BLOCK, shift_sums
from wavefield.matching.matching_settings import MatchSettings
from wavefield.matching.prepared import Level
from wavefield.parabola import parabola_vertex

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
    u, v = _peaks(score, border, x_range[0], y_range[0])
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


def _peaks(score: np.ndarray, border: int, first_x: int, first_y: int) -> tuple[np.ndarray, np.ndarray]:
    """Shift of the largest score of each block, (ny, nx), with parabolas through its neighbours.
    score (rows of shifts, ny, columns of shifts, nx + 2 border) begins with the shift first_x, first_y.
    """
    rows, ny, n, width = score.shape
    best = np.empty((ny, width - 2 * border), np.int32)
    _largest(score, border, best)
    y, x = np.divmod(best, n)
    j, i = np.indices(best.shape)

    def at(dy: int, dx: int) -> np.ndarray:
        row, column = np.clip(y + dy, 0, rows - 1), np.clip(x + dx, 0, n - 1)
        return np.asarray(score[row, j, column, border + i])

    dx = np.clip(parabola_vertex(at(0, -1), at(0, 0), at(0, 1)), -0.5, 0.5)
    dy = np.clip(parabola_vertex(at(-1, 0), at(0, 0), at(1, 0)), -0.5, 0.5)
    inside_x, inside_y = (x > 0) & (x < n - 1), (y > 0) & (y < rows - 1)
    u, v = (x + first_x).astype(np.float32), (y + first_y).astype(np.float32)
    return u + np.where(inside_x, dx, F(0)), v + np.where(inside_y, dy, F(0))
