"""A sea of natural texture as two cameras on a platform see it, with its exact elevation."""

from functools import cache

import numpy as np
from rendering import camera_at
from scipy import ndimage


@cache
def sea_rig():
    """Two cameras 2 m apart that look down at 55 degrees to the vertical, as from a platform."""
    return {
        name: camera_at((480, 360), 55.0, turn, roll, 12.0, 800.0, k1=-0.05)
        for name, turn, roll in (("left", 175.0, 1.0), ("right", 185.0, -1.0))
    }


@cache
def texture(seed=0):
    """Foam-like texture of the water, grains of many sizes, 10 cm the smallest."""
    rng = np.random.default_rng(seed)
    out = sum(s * ndimage.gaussian_filter(rng.normal(size=(700, 700)), s) for s in (1.0, 2.0, 4.0, 8.0))
    return ndimage.spline_filter(out / out.std(), 3)


def waves(x, y, phase):
    """Elevation, m."""
    return 0.08 * np.sin(1.5 * x + 0.7 * y + phase) + 0.05 * np.sin(0.4 * x - 1.9 * y + 2.3 * phase)


LINES = {}  # sight lines of cameras, by where they stand


def sight_lines(camera):
    """Where the sight line of each pixel meets the water at rest, and how it moves with height."""
    w, h = camera.size
    stands = camera.T.tobytes()
    if stands not in LINES:
        X, Y = np.meshgrid(np.arange(w, dtype=float), np.arange(h, dtype=float))
        x0, y0 = camera.unproject(X, Y)
        LINES[stands] = x0, y0, *np.subtract(camera.unproject(X, Y, 1.0), (x0, y0))  # it is straight
    return LINES[stands]


def photograph(camera, grains, phase, seed, noise=1.5):
    """The sea at a moment: each pixel's sight line meets the waves after a few steps."""
    x0, y0, dx, dy = sight_lines(camera)
    z = np.zeros_like(x0)
    for _ in range(12):
        x, y = x0 + z * dx, y0 + z * dy
        z = waves(x, y, phase)
    where = [np.clip(v / 0.05 + 350, 1, 698) for v in (y, x)]
    grey = 120 + 35 * ndimage.map_coordinates(grains, where, order=3, prefilter=False)
    return np.clip(grey + np.random.default_rng(seed).normal(0, noise, grey.shape), 0, 255).astype(np.uint8)
