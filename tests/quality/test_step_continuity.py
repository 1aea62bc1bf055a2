"""Steps that do not continue their neighbours are found, whatever the waves' phase; sound seas have none."""

import numpy as np
import pytest
import xarray as xr
from test_stored_values import NAMES, sea

from wavefield.quality.quality_limits import RECORD_LIMITS
from wavefield.quality.step_continuity import patch_means, step_factors
from wavefield.quality.stored_values import step_factors_of
from wavefield.variables import Quality

LIMIT = RECORD_LIMITS.discontinuity


def velocities(seed, steps=16, noise=0.004, rate=20.0):
    fields = sea(seed, steps, noise=noise, rate=rate)
    return np.stack([fields[name] for name in NAMES], axis=1)


def factors(velocity, measured=None):
    measured = np.ones((len(velocity), *velocity.shape[2:]), bool) if measured is None else measured
    return step_factors(np.array([patch_means(one, there) for one, there in zip(velocity, measured)]))


def cube_of(velocity, std):
    """A cube of velocities (n, 3, ny, nx) in chunks, all measured, with even standard uncertainties."""
    shape = (len(velocity), *velocity.shape[2:])
    fields = {name: velocity[:, k] for k, name in enumerate(NAMES)}
    fields |= {f"{name}_std": np.full(shape, std) for name in (*NAMES, "z")}
    fields["quality"] = np.full(shape, int(Quality.MEASURED), np.uint8)
    cube = xr.Dataset({name: (("time", "y", "x"), one) for name, one in fields.items()})
    return cube.assign_attrs(frame_rate=20.0).assign(path_frames=4).chunk(time=5)


@pytest.mark.parametrize("rate", [8.0, 12.0, 20.0, 60.0])  # waves turn by up to 2.8 rad from step to step
@pytest.mark.parametrize("seed", range(6))
def test_steps_of_sound_seas_continue_each_other(seed, rate):
    velocity = velocities(seed, rate=rate)
    measured = np.random.default_rng(seed).random((len(velocity), 40, 50)) < 0.9
    for steps in (8, 16):
        found = factors(velocity[:steps], measured[:steps])
        assert np.isfinite(found.factor[2:-2]).all()
        assert found.discontinuous(LIMIT).size == 0


@pytest.mark.parametrize("rate", [12.0, 20.0, 60.0])
@pytest.mark.parametrize("seed", range(6))
def test_a_step_without_motion_or_of_two_intervals_is_found_and_those_beside_it_are_not(seed, rate):
    velocity = velocities(seed, 18, 0.001, rate)
    repeated = np.concatenate([velocity[:8], 0 * velocity[:1], velocity[8:-1]])
    assert factors(repeated).discontinuous(LIMIT).tolist() == [8]
    lost = np.concatenate([velocity[:7], velocity[7:8] + velocity[8:9], velocity[9:]])
    few = slice(3, 11)  # eight steps
    for found in (factors(lost).discontinuous(LIMIT), factors(lost[few]).discontinuous(LIMIT) + few.start):
        assert found.tolist() in ([6], [7], [8]), "one place"


@pytest.mark.parametrize("turn", [1.0, 1.5, 1.8, 2.0, 2.2])  # where neighbours predict a step badly
@pytest.mark.parametrize("seed", range(4))
def test_a_lost_frame_shows_among_eight_steps_whatever_the_phase_of_the_waves(turn, seed):
    rng = np.random.default_rng([seed, int(10 * turn)])
    lattice = np.exp(1j * np.cumsum(rng.uniform(0.0, 1.0, (30, 40)), axis=1))
    slower = 0.6 * np.exp(1j * np.cumsum(rng.uniform(0.0, 0.7, (30, 40)), axis=0))
    waves = ((lattice, turn), (slower, 0.8 * turn))
    w = np.array([sum((each * np.exp(-1j * p * k)).real for each, p in waves) for k in range(9)])
    velocity = w[:, None] + 0.1 * rng.standard_normal((9, 3, 30, 40))
    assert factors(velocity[:8]).discontinuous(LIMIT).size == 0
    for step in (2, 3, 4, 5):
        both = velocity[step : step + 1] + velocity[step + 1 : step + 2]
        lost = np.concatenate([velocity[:step], both, velocity[step + 2 :]])
        assert step in factors(lost).discontinuous(LIMIT)


@pytest.mark.parametrize("length", [0.35, 0.6, 1.0, 4.0])  # of the field's
@pytest.mark.parametrize("turn", np.arange(0.1, 2.3, 0.3))
def test_one_wave_is_predicted_whatever_its_phase(turn, length):
    phase = 2 * np.pi * np.arange(60) / 60 / length + 1.0
    wave = np.cos(phase - turn * np.arange(8)[:, None])
    velocity = np.broadcast_to(wave[:, None, None, :], (8, 3, 40, 60))
    on_current = velocity + np.array([5.0, 2.0, 0.0])[:, None, None]
    for fields in (velocity, on_current):
        assert factors(fields).factor[2:-2] == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("noise", [0.1, 0.3, 0.4])
@pytest.mark.parametrize("turn", [0.7, 0.8, 0.9])
def test_a_lost_frame_shows_among_eight_noisy_steps_whose_paths_contradict_each_other(turn, noise):
    rng = np.random.default_rng(3)
    lattice = np.exp(1j * np.cumsum(rng.uniform(0.0, 1.0, (30, 40)), axis=1))
    w = np.sqrt(2) * np.array([(lattice * np.exp(-1j * turn * k)).real for k in range(9)])
    velocity = w[:, None] + noise * rng.standard_normal((9, 3, 30, 40))
    lost = cube_of(np.concatenate([velocity[:3], velocity[3:4] + velocity[4:5], velocity[5:]]), noise)
    lost["w_std"] = lost.w_std * xr.DataArray(np.where(abs(np.arange(8) - 3) < 2, 3.0, 1.0), dims="time")
    assert 3 in step_factors_of(lost).discontinuous(LIMIT)
    assert step_factors_of(cube_of(velocity[:8], noise)).discontinuous(LIMIT).size == 0


def test_chunks_of_a_cube_and_noise_change_nothing_but_what_is_compared():
    velocity = velocities(3, noise=0.0)
    size = float(np.sqrt(np.mean(np.square(velocity))))
    found = step_factors_of(cube_of(velocity, 0.01 * size))
    np.testing.assert_array_equal(found.factor, factors(velocity).factor)
    for seed, noise in enumerate((0.5, 0.7, 1.0, 1.5)):  # of which most is noise
        noisy = velocity + noise * size * np.random.default_rng(seed).standard_normal(velocity.shape)
        assert step_factors_of(cube_of(noisy, noise * size)).discontinuous(LIMIT).size == 0


def test_fields_with_few_measured_nodes_are_not_compared():
    velocity = velocities(2)
    nothing = np.zeros((len(velocity), 40, 50), bool)
    assert np.isnan(factors(velocity, nothing).factor).all()
    assert np.isnan(factors(velocity[..., :2, :2]).factor).all()
    assert np.isnan(factors(0 * velocity).factor).all(), "still water"
    for steps in (1, 2, 4):
        assert np.isnan(step_factors_of(cube_of(velocity[:steps], 0.01)).factor).all()
