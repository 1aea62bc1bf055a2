"""`reconstruct`: lazy, few tasks, the same values as the run."""

import json

import dask
import numpy as np
import pytest
import xarray as xr
from cube_cases import different

import wavefield as wf
from wavefield.errors import ExperimentError, RigError
from wavefield.pipeline import reconstruct
from wavefield.rig import common_field
from wavefield.series import Experiment
from wavefield.variables import CUBE_FIELDS, Quality, validate

GAINS = tuple(f"gain_{name}" for name in "zuvw")


@pytest.fixture(scope="module")
def note(tank):
    return Experiment.load(tank)


@pytest.fixture(scope="module")
def rig(note):
    return note.load_rig()


@pytest.fixture(scope="module")
def grid(note, rig):
    return note.choose_grid(rig)


@pytest.fixture
def frames(tank):
    return xr.open_datatree(tank, engine="wavefield")


def no_compute(dsk, keys, **kwargs):
    raise AssertionError("something was computed")


def test_nothing_is_computed_before_it_is_asked_for(tank, rig, grid):
    with dask.config.set(scheduler=no_compute):
        frames = xr.open_datatree(tank, engine="wavefield", chunks={})
        cube = wf.reconstruct(frames, rig, grid)
        repr(cube)
        cube.w.isel(time=3).mean("x")
        repr(wf.kinematics(cube))
        named = wf.reconstruct(frames, rig, {"x": grid.x, "y": grid.y, "step": grid.step})
        assert named.z.shape == cube.z.shape
        with pytest.raises(ExperimentError, match="grid: give x and y"):
            wf.reconstruct(frames, rig, {"x": grid.x, "spacing": 0.01})
    assert set(cube.data_vars) == {*CUBE_FIELDS, "z_level_std", "frame_status"}
    assert set(GAINS) <= set(cube.coords)
    validate(cube, *CUBE_FIELDS, "frame_status", "time", "x", "y")
    with pytest.raises(AssertionError, match="something was computed"), dask.config.set(scheduler=no_compute):
        cube.z.compute()


def test_a_rig_may_be_its_file_and_the_grid_what_all_cameras_see(tank, frames, rig):
    cube = wf.reconstruct(frames, tank.with_name("rig.yaml"))
    own = common_field(rig.cameras.values())
    np.testing.assert_allclose(cube.x, own.x_nodes)
    np.testing.assert_allclose(cube.y, own.y_nodes)
    with pytest.raises(RigError, match="no such rig file"):
        wf.reconstruct(frames, tank.with_name("absent.yaml"))


def test_a_long_series_takes_few_tasks(rig, grid):
    steps = 12_000
    frames = {
        name: xr.DataArray(
            np.broadcast_to(np.zeros((), np.uint8), (steps + 1, *rig[name].size[::-1])),
            dims=("time", "row", "column"),
            coords={"time": np.arange(steps + 1) / 20.0},
        )
        for name in rig
    }
    cube = reconstruct(frames, rig, grid)
    assert cube.sizes["time"] == steps
    assert len(cube.__dask_graph__()) <= steps


def test_values_are_those_of_the_run_whatever_the_block(frames, rig, grid, reference):
    cube = reconstruct(frames, rig, grid, steps_per_block=7)
    part = cube.isel(time=slice(0, 8)).compute(scheduler="sync")
    assert different(part, wf.open_cube(reference), slice(0, 8)) == []
    assert (
        int(part.path_frames)
        == int(wf.open_cube(reference).path_frames)
        == record_of(reference)["path_frames"]
    )
    assert 0 < float(part.z_level_std) == float(wf.open_cube(reference).z_level_std)
    for name in GAINS:
        lazy = part[name].reset_coords(["path_frames", "water_depth"], drop=True)  # attributes in a store
        xr.testing.assert_identical(lazy, wf.open_cube(reference)[name].compute())
    np.testing.assert_allclose(cube.time, (np.arange(16) + 0.5) / 20.0)
    assert cube.attrs == {
        "frame_rate": 20.0,
        "experiment": "small-tank",
        "water_depth": 0.7,
        "pixel_size": pytest.approx(wf.open_cube(reference).attrs["pixel_size"]),
    }


def record_of(reference):
    return json.loads(wf.open_cube(reference).attrs["recipe"])["record"]


def test_chunked_and_plain_arrays_give_the_same(tank, frames, rig, grid, reference):
    chunked = xr.open_datatree(tank, engine="wavefield", chunks={}).isel(time=slice(0, 6))
    arrays = {name: frames[name].image.isel(time=slice(0, 6)).load() for name in frames.children}
    for some in (chunked, arrays):
        cube = reconstruct(some, rig, grid, record=record_of(reference)).compute(scheduler="sync")
        # the last two steps of a record have not two frames after them
        assert different(cube.isel(time=slice(0, 3)), wf.open_cube(reference).isel(time=slice(0, 3))) == []
        assert (cube.quality[4].values & Quality.TWO_FRAME_MEAN).all()


def test_frames_that_do_not_fit_are_refused(frames, rig, grid):
    tree = frames.isel(time=slice(0, 5))
    two = {name: tree[name].image for name in ("cam1", "cam2")}
    with pytest.raises(ExperimentError, match="the frames lack cam3"):
        reconstruct(two, rig, grid)
    with pytest.raises(ExperimentError, match="not evenly spaced at 20 Hz; select them without a stride"):
        reconstruct(frames.isel(time=[0, 1, 3, 4]), rig, grid)
    with pytest.raises(ExperimentError, match="there are 1 frames; a step needs two"):
        reconstruct(frames.isel(time=slice(0, 1)), rig, grid)
    images = {name: tree[name].image for name in tree.children}
    with pytest.raises(RigError, match="images of cam2 of 123 x 123 px, but these have 60 x 123"):
        reconstruct({**images, "cam2": images["cam2"][:, :, :60]}, rig, grid)
    with pytest.raises(ExperimentError, match="need the same `time`"):
        reconstruct({**images, "cam2": frames["cam2"].image.isel(time=slice(1, 6))}, rig, grid)


def test_a_mask_beside_the_images_is_heeded(frames, rig, grid, reference):
    tree = frames.copy()
    for name in rig:
        camera = tree[name].to_dataset()
        X, Y = rig[name].project(0.0, 0.0, 0.0)
        rows, columns = np.indices(camera.image.shape[1:])
        near = np.hypot(columns - float(X), rows - float(Y)) < 12
        tree[name] = xr.DataTree(camera.assign(mask=(("row", "column"), near)))
    cube = reconstruct(tree, rig, grid, record=record_of(reference))
    step = cube[["w", "quality"]].isel(time=slice(0, 1)).compute(scheduler="sync")
    masked = (step.quality.values & int(Quality.MASKED)) != 0
    assert masked[0, 6, 4]
    assert masked.mean() < 0.5
    np.testing.assert_array_equal(np.isnan(step.w.values), masked)


def test_a_record_of_other_cameras_is_refused_in_one_sentence(frames, rig, grid, reference):
    record = record_of(reference)
    name, *_ = record["displacement"]
    other = record | {"displacement": {k: v for k, v in record["displacement"].items() if k != name}}
    with pytest.raises(ExperimentError, match=f"was learned without {name}"):
        reconstruct(frames, rig, grid, record=other)
