"""`wf.smooth`: better fields with true uncertainties where waves are free, the measured ones elsewhere."""

import numpy as np
import pytest
import xarray as xr
from scipy.ndimage import gaussian_filter

import wavefield as wf
from wavefield.errors import CubeError
from wavefield.tank.scene_parts import RandomSea
from wavefield.variables import FrameStatus, Quality

DIMS, STEP = ("time", "y", "x"), 0.02
SPECTRUM = {"kind": "power", "peak": 1.5, "exponent": 6}
STD = {"z": 5e-5, "u": 1e-3, "v": 1e-3, "w": 1.2e-3}


def exact(seed, steps=9, rate=20.0, shape=(20, 26), **sea):
    """Fields of a random sea of first order."""
    described = {"rms": 0.006, "spectrum": SPECTRUM, "shortest": 0.12, "period": 3.0, **sea}
    made = RandomSea(kind="random", **described).build(seed)
    y, x = (STEP * np.arange(n) for n in shape)
    at = [made.on_grid(x, y, t) for t in np.arange(steps) / rate]
    fields = {name: (DIMS, np.array([one[name] for one in at])) for name in "zuvw"}
    depth = described.get("depth", 0.7)
    return xr.Dataset(fields, {"time": np.arange(steps) / rate, "y": y, "x": x}, {"water_depth": depth})


def measured(truth, seed, noise=1.0):
    """The fields with white noise, and what is stated of it."""
    rng = np.random.default_rng(seed)
    cube = truth.copy()
    for name, std in STD.items():
        cube[name] = truth[name] + noise * std * rng.standard_normal(truth[name].shape)
        cube[f"{name}_std"] = xr.full_like(truth[name], std)
    return cube.assign(quality=(DIMS, np.full(truth.z.shape, int(Quality.MEASURED), np.uint16)))


def judge(found, cube, truth, where=True):
    """Per field: rms error over that of the cube, and the shares of errors within one and two std."""
    out = {}
    for name in STD:
        error = (found[name] - truth[name]).where(where)
        before = (cube[name] - truth[name]).where(where)
        size = abs(error) / found[f"{name}_std"]
        valid = size.notnull()
        ratio = float(np.sqrt((error**2).mean() / (before**2).mean()))
        out[name] = ratio, *(float((size <= n).where(valid).mean()) for n in (1, 2))
    return out


def test_a_sea_of_any_depth_and_current_is_better_and_the_uncertainties_true():
    seed = 0
    rng = np.random.default_rng([41, seed])
    current = tuple(rng.uniform(-0.3, 0.3, 2))
    water = {"depth": float(rng.uniform(0.08, 1.0)), "current": current}
    truth = exact(seed, steps=60, rate=float(rng.uniform(12, 30)), **water)
    cube = measured(truth, seed)
    found = wf.smooth(cube)
    for name, (ratio, one, two) in judge(found, cube, truth).items():
        assert ratio < 0.6, name
        assert one > 0.55, name
        assert two > 0.87, name


def with_eddies(truth, seed):
    """Still water with eddies of 10 cm that last."""
    rng = np.random.default_rng([seed, 7])
    _, ny, nx = truth.z.shape
    flow = gaussian_filter(rng.standard_normal((ny + 40, nx + 40)), 2)
    along_y, along_x = (np.broadcast_to(one[20:-20, 20:-20], truth.z.shape) for one in np.gradient(flow))
    scale = 0.015 / along_y.std()
    still_water = {name: (DIMS, np.zeros(truth.z.shape)) for name in "zw"}
    return truth.assign({**still_water, "u": (DIMS, -scale * along_y), "v": (DIMS, scale * along_x)})


WRONG = {
    "steep": lambda seed: exact(seed, order=2, interacting=500, period=1.5, shortest=0.2, rms=0.01),
    "eddies": lambda seed: with_eddies(exact(seed), seed),
}


@pytest.mark.parametrize("model", WRONG)
def test_what_free_waves_do_not_explain_stays_as_measured(model):
    seed = 5
    truth = WRONG[model](seed)
    cube = measured(truth, seed)
    for name, (ratio, one, two) in judge(wf.smooth(cube), cube, truth).items():
        assert ratio < 1.03, name
        assert one > 0.6, name
        assert two > 0.9, name


def test_a_wrong_depth_does_no_harm():
    truth = exact(3)
    cube = measured(truth, 3)
    for name, (ratio, one, _) in judge(wf.smooth(cube, depth=0.03), cube, truth).items():
        assert ratio < 1.03, name
        assert one > 0.6, name


def test_gaps_and_lost_steps_keep_the_cubes_own_values_and_mislead_no_neighbours():
    truth = exact(2, steps=12)
    cube = measured(truth, 2)
    gap = np.zeros(truth.z.shape, bool)
    gap[:, 4:8, 5:9] = gap[7, 11:15, 14:19] = gap[2] = True
    bad = cube.assign(quality=(DIMS, np.where(gap, Quality.FILLED, Quality.MEASURED).astype(np.uint16)))
    filled = measured(truth, 12, noise=3.0)
    for name in STD:
        bad[name] = bad[name].where(~gap, filled[name])
    found = wf.smooth(bad)
    np.testing.assert_array_equal(found.z.values[gap], filled.z.values.astype(np.float32)[gap])
    for name, (ratio, one, two) in judge(found, cube, truth, xr.DataArray(~gap, dims=DIMS)).items():
        assert ratio < 0.7, name
        assert one > 0.6, name
        assert two > 0.9, name


def test_steps_beside_a_jump_of_time_keep_the_cubes_own_values():
    cube = measured(exact(0, steps=14), 0)
    status = xr.DataArray(np.full(14, FrameStatus.DONE, np.uint8), dims="time")
    status[9] = FrameStatus.DISCONTINUOUS
    there = status == FrameStatus.DONE
    cube = cube.where(there).assign(quality=cube.quality.where(there, 0), frame_status=status)
    same = (wf.smooth(cube).u == cube.u.astype(np.float32)).all(("y", "x")).values
    assert same[[7, 8, 10, 11]].all()
    assert not same[2:7].any()


def test_results_do_not_depend_on_chunks():
    cube = measured(exact(1, shape=(14, 16)), 1)
    whole = wf.smooth(cube)
    lazy = wf.smooth(cube.chunk(time=4, x=7))
    assert lazy.u.chunks
    for name in STD:
        np.testing.assert_array_equal(lazy[name].values, whole[name].values)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda cube: cube.isel(time=slice(4)), "4 steps"),
        (lambda cube: cube.drop_vars("w_std"), "w_std"),
        (lambda cube: cube.isel(x=slice(7)), "nodes"),
        (lambda cube: cube.assign(quality=cube.quality * 0), "measured"),
    ],
)
def test_what_smooth_cannot_help_is_refused_in_one_line(change, words):
    with pytest.raises(CubeError, match=words) as raised:
        wf.smooth(change(measured(exact(0, shape=(12, 12)), 0)))
    assert "\n" not in str(raised.value)
