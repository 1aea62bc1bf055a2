"""Where to start: whole-pixel search of the largest normalised correlation."""

from __future__ import annotations

import cv2
import numpy as np

from wavefield.matching.kernels import BLOCK, shift_sums
from wavefield.matching.lattice import F, filtered, replace_outliers, smoothed, window_weights
from wavefield.matching.prepared import Level

_LOCAL = 12.0  # px of the level: standard deviation of its local normalisation


def search(
    a: Level, b: Level, x_range: tuple[int, int], y_range: tuple[int, int], window: float
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement of every block to the best of all whole-pixel shifts, refined by parabolas.

    Parameters
    ----------
    a, b : Level
        The same level of two images.
    x_range, y_range : (int, int)
        Smallest and largest shift, px of this level.
    window : float
        Side of the square with the area of the Gaussian window, px of this level.

    Returns
    -------
    u, v : (ny, nx) float32
        Displacement, px of this level.
    """
    ny, nx = a.blocks
    h, w = ny * BLOCK, nx * BLOCK
    margin = max(abs(n) for n in (*x_range, *y_range)) + 1
    first, second = _locally_normalized(a), _locally_normalized(b)
    second = cv2.copyMakeBorder(second, margin, margin, margin, margin, cv2.BORDER_CONSTANT, value=0)
    weights = window_weights(window)
    xs, ys = np.arange(x_range[0], x_range[1] + 1), np.arange(y_range[0], y_range[1] + 1)
    score = np.empty((len(ys), len(xs), ny, nx), np.float32)
    sums, row = np.empty((2, ny, nx), np.float32), np.empty((2, w), np.float32)
    energy = cv2.resize(first[:h, :w] ** 2, (nx, ny), interpolation=cv2.INTER_AREA) * F(BLOCK * BLOCK)
    energy_a = filtered(energy, weights)
    least = F(0.05) * F(energy_a.mean()) + F(1e-12)
    for j, dy in enumerate(ys):
        for i, dx in enumerate(xs):
            shift_sums(first, second, margin, dx, dy, row, sums)
            energy_b = filtered(sums[1], weights)
            score[j, i] = filtered(sums[0], weights) / np.sqrt((energy_a + least) * (energy_b + least))
    u, v = _peak(score, xs, ys)
    for _ in range(2):
        u, v, _outlier = replace_outliers(u, v, 2.0)
    return smoothed(u, 1.0, 1), smoothed(v, 1.0, 1)


def _locally_normalized(level: Level) -> np.ndarray:
    image = np.ascontiguousarray(level.image)

    def blur(f: np.ndarray) -> np.ndarray:
        return cv2.GaussianBlur(f, (0, 0), _LOCAL, borderType=cv2.BORDER_REPLICATE)

    image = image - blur(image)
    variance = blur(image * image)
    return image / np.sqrt(variance + F(0.01) * F(variance.mean()) + F(1e-12))


def _peak(score: np.ndarray, xs: np.ndarray, ys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Place of the maximum over the first two axes, with a parabola through its neighbours."""
    shape = score.shape[2:]
    flat = score.reshape(len(ys), len(xs), -1)
    best = flat.reshape(-1, flat.shape[2]).argmax(0)
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
