"""Jitter of the frame times from stored velocities: found with its size, not found in sound seas."""

import numpy as np
import pytest
import xarray as xr
from test_step_continuity import cube_of
from test_stored_values import sea

from wavefield.quality.frame_jitter import frame_jitter
from wavefield.quality.quality_limits import RECORD_LIMITS
from wavefield.quality.step_continuity import StepFactors, patch_means, step_factors
from wavefield.quality.stored_values import jitter_of, step_factors_of
from wavefield.variables import PATH_WEIGHTS


def stored(seed, jitter, path_frames, steps, rate=20.0):
    """Velocities as paths of so many frames give them, with jitter in intervals."""
    fields = sea(seed, steps + 4, rate=rate)
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
    return frame_jitter(step_factors(np.array([patch_means(one, measured) for one in velocity])), path_frames)


@pytest.mark.parametrize("rate", [12.0, 20.0])  # waves turn by up to 1.8 rad from step to step
@pytest.mark.parametrize("path_frames", [4, 6])
def test_jitter_is_found_with_its_size_and_sound_seas_have_none(path_frames, rate):
    sizes = []
    for seed in range(6):
        assert found(stored(seed, 0.0, path_frames, 8, rate), path_frames) is None
        sizes.append(found(stored(seed, 0.03, path_frames, 30, rate), path_frames).intervals)
    assert np.mean(sizes) == pytest.approx(0.03, rel=0.25)


def test_a_few_steps_and_holes_suffice():
    holes = np.random.default_rng(0).random((40, 50)) < 0.8
    hits = [found(stored(seed, 0.03, 4, 8), 4, holes) for seed in range(12)]
    assert sum(hit is not None for hit in hits) >= 10
    assert 0.027 < np.median([hit.intervals for hit in hits if hit]) < 0.06, "rather too large than too small"


@pytest.mark.parametrize("steps", [8, 40])
def test_one_bad_step_is_left_out_where_others_can_be_compared(steps):
    """In eight steps, of which four can be compared, it may as well be jitter."""
    rng = np.random.default_rng(steps)
    factor = 1.0 + 1e-3 * rng.standard_normal(steps)
    factor[[0, 1, -2, -1]], factor[3] = np.nan, 1.5
    weights = np.tile([1 / 6, -2 / 3, 1.0, -2 / 3, 1 / 6], (steps, 1))
    even, unknown = np.full(steps, 1e-6), np.full(steps, np.nan)
    factors = StepFactors(factor, even, weights, unknown, unknown, unknown)
    assert factors.discontinuous(RECORD_LIMITS.discontinuity).tolist() == [3]
    shown = jitter_of(cube_of(np.array(stored(0, 0.0, 4, steps)), 1e-3), factors)
    assert (shown is None) == (steps == 40)


def test_a_record_without_measured_steps_in_its_middle_has_jitter_all_the_same():
    velocity = np.array(stored(1, 0.05, 4, 100))
    cube = cube_of(velocity, 1e-3)
    hidden = (np.arange(100) > 12) & (np.arange(100) < 88)
    cube["quality"] = cube.quality.where(~xr.DataArray(hidden, dims="time"), 0).astype(np.uint8)
    shown = jitter_of(cube, step_factors_of(cube))
    assert shown is not None
    assert np.isfinite(shown[1])
