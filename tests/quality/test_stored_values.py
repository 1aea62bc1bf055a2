"""The checks on stored values: sound seas raise nothing, fields that contradict each other do."""

import numpy as np
import pytest

from wavefield.quality.quality_limits import RECORD_LIMITS
from wavefield.quality.stored_values import (
    continuity,
    discontinuous,
    kinematic_misfit,
)

STEP, RATE = 0.01, 20.0
NAMES = ("u", "v", "w")


def sea(seed, steps=16, shape=(40, 50), noise=0.004):
    """A random linear sea of 12 cm to 1.5 m on a current, with noise of the stated uncertainty, m/s."""
    rng = np.random.default_rng(seed)
    k, angle, phase = rng.uniform(4, 50, 40), rng.uniform(-np.pi, np.pi, 40), rng.uniform(0, 2 * np.pi, 40)
    slope = rng.uniform(0.02, 0.15) / np.sqrt(20.0)
    current = rng.uniform(-0.3, 0.3, 2)
    t, y, x = np.meshgrid(
        np.arange(steps) / RATE, np.arange(shape[0]) * STEP, np.arange(shape[1]) * STEP, indexing="ij"
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
    out["z_std"] = np.full(t.shape, 0.5 * noise / RATE)
    return out


def continuities(w, measured, noise=0.001):
    std = np.broadcast_to(np.reshape(noise, (-1, 1, 1)), w.shape)
    near = (slice(k - 2, k + 3) for k in range(2, len(w) - 2))
    inner = [continuity(w[five], measured[five], std[five]) for five in near]
    return np.array([np.nan, np.nan, *inner, np.nan, np.nan])


@pytest.mark.parametrize("seed", range(12))
def test_sound_seas_raise_no_alarm(seed):
    fields = sea(seed)
    measured = np.random.default_rng(seed).random(fields["z"].shape) < 0.9
    assert np.nanmedian(kinematic_misfit(fields, measured, STEP, RATE)) < RECORD_LIMITS.kinematic_misfit
    assert discontinuous(continuities(fields["w"], measured)).size == 0


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


@pytest.mark.parametrize("seed", range(4))
def test_a_step_without_motion_or_of_two_intervals_is_named(seed):
    w = sea(seed, noise=0.001)["w"]
    everywhere = np.ones(w.shape, bool)
    duplicated = np.concatenate([w[:8], 0 * w[:1], w[8:-1]])
    assert 8 in discontinuous(continuities(duplicated, everywhere))
    lost = np.concatenate([w[:7], w[7:8] + w[8:9], w[9:]])
    assert 7 in discontinuous(continuities(lost, np.ones(lost.shape, bool)))
    contradicting = np.full(len(lost), 0.001)
    contradicting[6:9] = 0.5 * np.std(w)  # paths through the step contradict each other
    assert 7 in discontinuous(continuities(lost, np.ones(lost.shape, bool), contradicting))


@pytest.mark.parametrize("noise", [0.1, 0.3, 0.4])
@pytest.mark.parametrize("turn", [0.7, 0.8, 0.9])
def test_a_lost_frame_shows_among_eight_steps_of_short_waves(turn, noise):
    rng = np.random.default_rng(3)
    lattice = np.exp(1j * np.cumsum(rng.uniform(0.0, 1.0, (30, 40)), axis=1))
    w = np.sqrt(2) * np.array([(lattice * np.exp(-1j * turn * k)).real for k in range(9)])
    w = w + noise * rng.standard_normal(w.shape)
    everywhere = np.ones((8, *w.shape[1:]), bool)
    lost = np.concatenate([w[:3], w[3:4] + w[4:5], w[5:]])
    assert 3 in discontinuous(continuities(lost, everywhere, noise))
    assert discontinuous(continuities(w[:8], everywhere, noise)).size == 0


@pytest.mark.parametrize("seed", range(4))
def test_steps_of_much_noise_are_not_compared(seed):
    size = float(np.std(sea(seed, noise=0.0)["w"]))
    for noise in (0.5, 0.7, 1.0, 1.5):
        w = sea(seed, noise=noise * size)["w"]
        assert discontinuous(continuities(w, np.ones(w.shape, bool), noise * size)).size == 0


def test_steps_with_few_measured_nodes_are_not_checked():
    fields = sea(2)
    nothing = np.zeros(fields["z"].shape, bool)
    assert np.isnan(kinematic_misfit(fields, nothing, STEP, RATE)).all()
    assert discontinuous(continuities(fields["w"], nothing)).size == 0
