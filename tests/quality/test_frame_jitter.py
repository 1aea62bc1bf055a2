"""Jitter of the frame times from stored velocities: found with its size, not found in sound seas."""

import numpy as np
import pytest
from test_stored_values import sea

from wavefield.quality.frame_jitter import _gains, frame_jitter, step_factor
from wavefield.variables import PATH_WEIGHTS


def stored(seed, jitter, path_frames, steps):
    """Velocities as paths of so many frames give them, and how late the frames were, intervals."""
    fields = sea(seed, steps + 4)
    rng = np.random.default_rng(seed + 1000)
    late = rng.normal(0, jitter, steps + 5)
    exact = np.stack([fields[name] for name in "uvw"], axis=1)
    shift = 0.5 * (late[1:] + late[:-1])[:, None, None, None]
    moved = (exact + shift * np.gradient(exact, axis=0)) * (1 + np.diff(late))[:, None, None, None]
    half = PATH_WEIGHTS[path_frames]
    weights = np.zeros(5)
    weights[3 - len(half) : 2 + len(half)] = [*half[:0:-1], *half]
    return [np.tensordot(weights, moved[k : k + 5], 1) for k in range(steps)]


def found(velocity, path_frames, measured=None):
    measured = np.ones(velocity[0].shape[1:], bool) if measured is None else measured
    parts = [step_factor(velocity[k - 2 : k + 3], [measured] * 5) for k in range(2, len(velocity) - 2)]
    factors, variances = np.array([part or (np.nan, np.nan) for part in parts]).T
    return frame_jitter(factors, variances, path_frames)


@pytest.mark.parametrize("path_frames", [4, 6])
def test_jitter_is_found_with_its_size_and_sound_seas_have_none(path_frames):
    sizes = []
    for seed in range(6):
        assert found(stored(seed, 0.0, path_frames, 8), path_frames) is None
        sizes.append(found(stored(seed, 0.03, path_frames, 30), path_frames).intervals)
    assert np.mean(sizes) == pytest.approx(0.03, rel=0.25)


def test_a_few_steps_and_holes_suffice():
    holes = np.random.default_rng(0).random((40, 50)) < 0.8
    hits = [found(stored(seed, 0.03, 4, 8), 4, holes) for seed in range(6)]
    assert sum(hit is not None for hit in hits) >= 5
    assert step_factor([np.zeros((3, 2, 2))] * 5, [np.ones((2, 2), bool)] * 5) is None
    assert step_factor([np.zeros((3, 40, 40))] * 5, [np.ones((40, 40), bool)] * 5) is None, "still water"


def test_the_gains_are_those_of_frames_that_are_late_by_chance():
    late = np.random.default_rng(1).normal(size=400_000)
    velocity, factor = _gains(4)
    d = np.diff(late)
    v = (26 * d[1:-1] - d[:-2] - d[2:]) / 24
    assert np.var(v) == pytest.approx(velocity, rel=0.02)
    rest = v[2:-2] - (4 * (v[1:-3] + v[3:-1]) - v[:-4] - v[4:]) / 6
    assert np.var(rest) == pytest.approx(factor, rel=0.02)
