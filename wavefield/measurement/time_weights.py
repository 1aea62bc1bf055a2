"""Weights by which frames are interpolated to mid-time, and the gain and noise that follow from them."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from wavefield.variables import PATH_WEIGHTS

Float = NDArray[np.floating]

# Weight of each of six frames in z at mid-time, by the number of frames that are used.
ELEVATION_WEIGHTS = {
    6: np.array([3, -25, 150, 150, -25, 3], np.float32) / np.float32(256),
    4: np.array([0, -1, 9, 9, -1, 0], np.float32) / np.float32(16),
    3: np.array([0, 0, 3, 6, -1, 0], np.float32)
    / np.float32(8),  # reversed where the frame before is present
    2: np.array([0, 0, 1, 1, 0, 0], np.float32) / np.float32(2),
}
# Correlation of the noise of successive displacements. They share a frame: were that all, it would be -1/2;
# what the beads' places make in every pair of frames has none. By errors of chords and of paths through four
# and six places at 80 frames/s it is -0.14 to -0.21 in good light.
_NOISE_CORRELATION = -0.2


def elevation_gain(phase: Float, frames: int) -> Float:
    """Fraction of a wave's elevation that 2, 4 or 6 frames give at mid-time; phase per step, rad."""
    weights = {2: (1.0,), 4: (9 / 8, -1 / 8), 6: (150 / 128, -25 / 128, 3 / 128)}[frames]
    return np.asarray(sum(w * np.cos((n + 0.5) * phase) for n, w in enumerate(weights)))


def path_gain(phase: Float, frames: int) -> Float:
    """Fraction of a wave's velocity that paths give at mid-time, by `path_frames`; phase per step, rad."""
    own, *neighbours = PATH_WEIGHTS[frames]
    path = own + 2.0 * sum(w * np.cos(n * phase) for n, w in enumerate(neighbours, 1))
    return np.asarray(np.sinc(phase / (2.0 * np.pi)) * path)


def noise_weights(frames: int) -> tuple[float, ...]:
    """Weights of the noise variances of displacements in that at mid-time: its step, then neighbours."""
    half = PATH_WEIGHTS[frames]
    w = np.array([0.0, *half[:0:-1], *half, 0.0])
    out = w[1:-1] * (w[1:-1] + _NOISE_CORRELATION * (w[:-2] + w[2:]))
    return tuple(float(part) for part in out[len(half) - 1 :])


def uneven_weights(
    times: Float, frames: Sequence[int], smooth: bool = False, at: Float | float = 0.0
) -> tuple[Float, Float]:
    """Weights (6, ...) of six frames in a value and in its rate, by the polynomial through ``frames`` alone.
    Times (6,) and at are intervals from mid-time. A smooth rate is exact to degree four only, but less noisy.
    """
    used = list(frames)
    powers = np.vander(times[used], increasing=True).T
    shape, count = np.shape(at), len(used)
    now = np.vander(np.ravel(at), count, increasing=True).T
    change = np.zeros_like(now)
    change[1:] = now[:-1] * np.arange(1, count)[:, None]
    value, rate = np.zeros((2, 6, now.shape[1]))
    value[used], rate[used] = np.linalg.solve(powers, now), np.linalg.solve(powers, change)
    if smooth:
        even = place_weights(6)[1]
        rate = even[:, None] + np.linalg.pinv(powers[:5]) @ (change[:5] - (powers[:5] @ even)[:, None])
    return value.reshape(6, *shape), rate.reshape(6, *shape)


def noise_of_displacements(weights: Float) -> Float:
    """As `noise_weights`, of any weights (5, ...) of five successive displacements."""
    padded = np.pad(weights, [(1, 1), *[(0, 0)] * (weights.ndim - 1)])
    return np.asarray(weights * (weights + _NOISE_CORRELATION * (padded[:-2] + padded[2:])))


def place_weights(frames: int) -> tuple[Float, Float]:
    """Times of a path's places, steps from mid-time, and their weights in the displacement at mid-time."""
    later = -np.diff(PATH_WEIGHTS[frames], append=0.0)
    t = np.arange(2 * len(later)) - len(later) + 0.5
    return t, np.concatenate([-later[::-1], later])
