"""The checks on stored values: sound seas raise nothing, fields that contradict each other do."""

import numpy as np
import pytest

from wavefield.quality.quality_limits import RECORD_LIMITS
from wavefield.quality.stored_values import kinematic_misfit

STEP, RATE = 0.01, 20.0
NAMES = ("u", "v", "w")


def sea(seed, steps=16, shape=(40, 50), noise=0.004, rate=RATE):
    """A random linear sea of 12 cm to 1.5 m on a current, with noise of the stated uncertainty, m/s."""
    rng = np.random.default_rng(seed)
    k, angle, phase = rng.uniform(4, 50, 40), rng.uniform(-np.pi, np.pi, 40), rng.uniform(0, 2 * np.pi, 40)
    slope = rng.uniform(0.02, 0.15) / np.sqrt(20.0)
    current = rng.uniform(-0.3, 0.3, 2)
    t, y, x = np.meshgrid(
        np.arange(steps) / rate, np.arange(shape[0]) * STEP, np.arange(shape[1]) * STEP, indexing="ij"
    )
    out = {name: np.zeros(t.shape) for name in ("z", "z_t", "u", "v", "w")}
    z_x, z_y = np.zeros(t.shape), np.zeros(t.shape)
    for kn, a, p in zip(k, angle, phase):
        kx, ky, sigma = kn * np.cos(a), kn * np.sin(a), np.sqrt(9.81 * kn)
        turn = kx * x + ky * y - (sigma + kx * current[0] + ky * current[1]) * t + p
        amplitude = slope / kn
        out["z"] += amplitude * np.cos(turn)
        out["u"] += amplitude * sigma * np.cos(a) * np.cos(turn)
        out["v"] += amplitude * sigma * np.sin(a) * np.cos(turn)
        out["w"] += amplitude * sigma * np.sin(turn)
        z_x -= amplitude * kx * np.sin(turn)
        z_y -= amplitude * ky * np.sin(turn)
    out["u"] += current[0]
    out["v"] += current[1]
    out["z_t"] = out["w"] - out["u"] * z_x - out["v"] * z_y
    for name in NAMES:
        out[name] = out[name] + noise * rng.standard_normal(t.shape)
        out[f"{name}_std"] = np.full(t.shape, noise)
    out["z_std"] = np.full(t.shape, 0.5 * noise / rate)
    return out


@pytest.mark.parametrize("seed", range(12))
def test_sound_seas_raise_no_alarm(seed):
    fields = sea(seed)
    measured = np.random.default_rng(seed).random(fields["z"].shape) < 0.9
    assert np.nanmedian(kinematic_misfit(fields, measured, STEP, RATE)) < RECORD_LIMITS.kinematic_misfit


@pytest.mark.parametrize("seed", range(4))
def test_noise_of_the_surface_is_no_misfit_of_its_rise(seed):
    """Calm water in frames that follow each other fast: of z_t most is noise."""
    fields, rng = sea(seed), np.random.default_rng(seed)
    shape = fields["z"].shape
    z_std, repeated = 4.0 * 0.004 / RATE, 0.8
    frames = rng.standard_normal((shape[0] + 1, *shape[1:]))
    for k in range(shape[0]):
        frames[k + 1] = repeated * frames[k] + np.sqrt(1.0 - repeated**2) * frames[k + 1]
    fields["z_t"] = fields["z_t"] + z_std * RATE * np.diff(frames, axis=0)
    fields["z_std"] = np.full(shape, z_std)
    everywhere = np.ones(shape, bool)
    assert np.nanmedian(kinematic_misfit(fields, everywhere, STEP, RATE)) < RECORD_LIMITS.kinematic_misfit
    still = fields | {"w": 0 * fields["w"]}
    assert np.nanmedian(kinematic_misfit(still, everywhere, STEP, RATE)) > RECORD_LIMITS.kinematic_misfit


def test_water_that_rises_otherwise_than_its_surface_is_found():
    fields = sea(1)
    everywhere = np.ones(fields["z"].shape, bool)
    still = fields | {"w": 0 * fields["w"]}
    assert (
        np.nanmedian(kinematic_misfit(still, everywhere, STEP, RATE)) > RECORD_LIMITS.kinematic_misfit_grave
    )
    other_rate = fields | {name: 1.3 * fields[name] for name in NAMES}
    assert np.nanmedian(kinematic_misfit(other_rate, everywhere, STEP, RATE)) > RECORD_LIMITS.kinematic_misfit


def test_steps_with_few_measured_nodes_are_not_checked():
    fields = sea(2)
    nothing = np.zeros(fields["z"].shape, bool)
    assert np.isnan(kinematic_misfit(fields, nothing, STEP, RATE)).all()
