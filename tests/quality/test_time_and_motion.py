"""Lost, doubled and late frames are found by the kinematics of the surface; sound seas give no remark."""

import numpy as np
import pytest
import xarray as xr

from wavefield.quality.record import (
    MAX_MISFIT,
    discontinuous_steps,
    remark_on_kinematics,
    rise_ratios,
    steps_to_leave_out,
)
from wavefield.store.cube import open_cube
from wavefield.store.layout import StoreLayout, create_store
from wavefield.store.recipe import Recipe
from wavefield.store.verify import verify
from wavefield.store.write_cube import clear_steps, write_chunk
from wavefield.variables import CUBE_FIELDS, FrameStatus, Quality

SHAPE, NODE, NOISE, RATE = (30, 40), 0.01, 0.004, 20.0
EVEN = np.arange(13.0)


def sea(seed, frames=EVEN, rate=RATE, std=NOISE, node=NODE):
    """A cube of a random linear sea (12 cm to 1.5 m) on a current; frame times in frame intervals."""
    rng = np.random.default_rng(seed)
    k, angle, phase = rng.uniform(4, 50, 30), rng.uniform(-np.pi, np.pi, 30), rng.uniform(0, 2 * np.pi, 30)
    kx, ky, sigma = k * np.cos(angle), k * np.sin(angle), np.sqrt(9.81 * k)
    amplitude, current = rng.uniform(0.02, 0.15) / np.sqrt(15.0) / k, rng.uniform(-0.3, 0.3, 2)
    omega = sigma + kx * current[0] + ky * current[1]
    y, x = (v.ravel() * node for v in np.indices(SHAPE))
    space = np.exp(1j * (np.outer(x, kx) + np.outer(y, ky) + phase)).astype(np.complex64)
    turn = np.exp(-1j * np.outer(omega, np.asarray(frames) / rate))
    before, after = turn[:, :-1], turn[:, 1:]
    intervals = np.diff(frames)[:, None, None]
    parts = {
        "z": amplitude[:, None] * 0.5 * (before + after),
        "z_t": amplitude[:, None] * (after - before) * rate,
    }
    for name, factor in (("u", kx / k), ("v", ky / k), ("w", -1j)):
        parts[name] = (factor * amplitude * sigma / (-1j * omega))[:, None] * (after - before) * rate
    fields = {n: (space @ p.astype(np.complex64)).real.T.reshape(-1, *SHAPE) for n, p in parts.items()}
    fields["u"], fields["v"] = fields["u"] + current[0] * intervals, fields["v"] + current[1] * intervals
    for name in ("u", "v", "w"):
        fields[name] = fields[name] + NOISE * rng.standard_normal(fields[name].shape)
    fields["z"] = fields["z"] + 0.5 * NOISE / rate * rng.standard_normal(fields["z"].shape)
    fields |= {f"{name}_std": np.full(fields["z"].shape, std) for name in "uvw"}
    fields["z_std"] = np.full(fields["z"].shape, 0.5 * std / rate)
    fields["quality"] = np.full(fields["z"].shape, int(Quality.MEASURED), np.uint16)
    cube = xr.Dataset({name: (("time", "y", "x"), one) for name, one in fields.items()})
    coordinates = {"x": np.arange(SHAPE[1]) * node, "y": np.arange(SHAPE[0]) * node}
    return cube.assign_coords(coordinates).assign_attrs(frame_rate=rate).chunk(time=5)


@pytest.mark.parametrize("rate", [8.0, 12.0, 20.0, 60.0])  # waves turn by up to 2.8 rad from step to step
@pytest.mark.parametrize("seed", range(2))
def test_sound_seas_raise_no_alarm(seed, rate):
    ratio, variance = rise_ratios(sea(seed, rate=rate))
    assert discontinuous_steps(ratio, variance).size == 0
    assert np.isfinite(ratio[1:-1]).all() == (rate >= 20), "not judged where waves turn too fast"


@pytest.mark.parametrize("rate", [20.0, 60.0])
@pytest.mark.parametrize("seed", range(2))
def test_a_lost_doubled_or_late_frame_is_found_where_it_is(seed, rate):
    lost, late = np.delete(np.arange(14.0), 7), EVEN + 0.5 * (EVEN == 6)
    doubled = np.insert(np.arange(12.0), 6, 5.0)
    assert discontinuous_steps(*rise_ratios(sea(seed, doubled, rate))).tolist() == [5]
    assert discontinuous_steps(*rise_ratios(sea(seed, late, rate))).tolist() in ([5], [6])
    assert discontinuous_steps(*rise_ratios(sea(seed, lost, rate))).tolist() == [6]


def test_water_that_rises_otherwise_than_its_surface_is_remarked_upon():
    cube = sea(1)
    assert list(remark_on_kinematics(cube)) == []
    (still,) = remark_on_kinematics(cube.assign(w=0 * cube.w))
    (slow,) = remark_on_kinematics(cube.assign({name: 0.9 * cube[name] for name in "uvw"}))
    assert (still.weight, slow.weight) == ("grave", "remark")
    assert still.values["kinematic_misfit"] > 2 * MAX_MISFIT


@pytest.mark.parametrize("places", [[], [6], [2, 12], [3, 7, 10, 14, 19]])
def test_steps_with_frames_on_both_sides_are_left_out_unless_they_are_most_of_the_record(places):
    found = steps_to_leave_out(np.array(places, int), 24).tolist()
    near = [k for k in range(24) if any(abs(k - place) <= 2 for place in places)]
    assert found == (near if len(places) < 4 else [])


def test_cleared_steps_are_nan_for_every_reader_and_the_store_stays_whole(tmp_path):
    path = tmp_path / "cube.zarr"
    recipe = Recipe("basin", {}, (0, 4), 20.0, {}, {}, {}, packing="int16")
    create_store(path, recipe, np.arange(4) * 0.1, np.arange(3) * 0.1, StoreLayout(4, 2, ("a", "b"), 0), {})
    fields = {name: np.full((2, 3, 4), 1 if name == "quality" else 0.01) for name in CUBE_FIELDS}
    write_chunk(path, 0, fields, np.array([1, 2]), {})
    write_chunk(path, 2, fields, np.array([3, 1]), {})
    for _ in range(2):
        clear_steps(path, [1, 2])
        for cube in (open_cube(path), xr.open_zarr(path), xr.open_dataset(path, engine="wavefield")):
            assert cube.frame_status.values.tolist() == [1, FrameStatus.DISCONTINUOUS, 3, 1]
            for name in CUBE_FIELDS:
                kept = cube[name].notnull() & (cube[name] != 0)
                assert kept.all(("y", "x")).values.tolist() == [True, False, True, True], name
        assert verify(path).sound
