"""Runs of masked water, of small grids, and of frames with time stamps."""

import json
import re

import numpy as np
import pytest
import xarray as xr
from cube_cases import FRAMES, HERE, different

from wavefield.errors import RigError, StoreError
from wavefield.grid import Grid
from wavefield.pipeline import Workflow, open_cube, reconstruct, run
from wavefield.rig import Rig
from wavefield.variables import Quality

RATE = 20.0


def stamp(experiment, seed, jitter=2e-3):
    """The same frames with times that jitter."""
    times = np.arange(FRAMES) / RATE + np.random.default_rng(seed).normal(0, jitter, FRAMES)
    (experiment.parent / "times.txt").write_text("\n".join(f"{t:.6f}" for t in times))
    text = experiment.read_text()
    if "times:" not in text:
        experiment.write_text(text.replace('.tif"}', '.tif", times: times.txt}'))


def chunks_of(size):
    return Workflow(cluster="none", steps_per_block=size)


def test_stamps_change_the_values_whatever_the_chunks_and_belong_to_the_recipe(own_tank, reference, tmp_path):
    stamp(own_tank, 1)
    cube = run(own_tank, workflow=chunks_of(16)).store
    assert different(run(own_tank, tmp_path / "by_3.zarr", workflow=chunks_of(3)).store, cube) == []
    assert {"z", "u", "v", "w", "z_t"} <= set(different(cube, reference))
    stamp(own_tank, 2)
    with pytest.raises(StoreError, match=r"another recipe \(departures"):
        run(own_tank, workflow=chunks_of(16))


def test_a_lazy_cube_of_stamped_frames_is_that_of_the_run(own_tank):
    stamp(own_tank, 1)
    cube = open_cube(run(own_tank, workflow=chunks_of(16)).store)
    frames = xr.open_datatree(own_tank, engine="wavefield")
    record = json.loads(cube.attrs["recipe"])["record"]
    rig, grid = Rig.load(own_tank.parent / "rig.yaml"), Grid((-0.04, 0.04), (-0.06, 0.06), 0.01)
    part = frames.isel(time=slice(4, 12))
    lazy = reconstruct(part, rig, grid, record=record)
    for name in ("z", "u", "z_t"):
        np.testing.assert_array_equal(lazy[name][2:5], cube[name][6:9])


MASK = "mask: {water: {polygon: [[-0.015, -0.015], [0.015, -0.015], [0.0, 0.015]]}}\n"
MASKED = int(Quality.MASKED)


@pytest.fixture
def masked(own_tank):
    own_tank.write_text(own_tank.read_text() + MASK + "frames: {first: 0, last: 4}\n")
    return own_tank


def test_masked_nodes_stay_empty_in_the_cube_and_the_recipe_holds_what_was_masked(masked, tmp_path):
    out = tmp_path / "cube.zarr"
    status = run(masked, out=out, workflow=HERE)
    assert status.complete
    cube = open_cube(out)
    hidden = (cube.quality.values & MASKED) != 0
    assert 0 < hidden[0].sum() < 0.5 * hidden[0].size
    for name in ("z", "z_t", "u", "v", "w"):
        np.testing.assert_array_equal(np.isnan(cube[name].values), hidden, err_msg=name)
    assert json.loads(cube.attrs["recipe"])["mask"]["water"][0]["polygon"][2] == [0.0, 0.015]
    assert "masked" in cube.quality.attrs["flag_meanings"]


def with_grid(note, x, y):
    text = re.sub(r"(?m)^grid:.*\n", "", note.read_text())
    note.write_text(
        f"{text}grid: {{x: [{-x}, {x}], y: [{-y}, {y}], step: 0.003}}\nframes: {{first: 0, last: 5}}\n"
        "settings: {z_range: [-0.03, 0.03]}\nsurface: {pairs: [[cam1, cam2]]}\n"
        "velocity: {cameras: [cam1, cam2]}\n"
    )


def test_a_grid_narrower_than_a_patch_is_measured(own_tank, tmp_path):
    with_grid(own_tank, 0.01, 0.06)
    cube = open_cube(run(own_tank, out=tmp_path / "cube.zarr", workflow=HERE).store)
    assert cube.z.notnull().mean() > 0.9


@pytest.mark.parametrize(
    ("x", "y", "words"),
    [
        (0.06, 0.01, r"too small: .* matching needs [\d.]+ mm along each side; enlarge `grid`"),
        (0.004, 0.004, r"too small: .* matching needs"),
        (0.002, 0.06, "2 x 41 nodes, and slopes need 3 along each side: enlarge `grid`, or lower"),
    ],
)
def test_a_grid_that_cannot_be_measured_is_refused_with_its_size(own_tank, tmp_path, x, y, words):
    with_grid(own_tank, x, y)
    with pytest.raises(RigError, match=words):
        run(own_tank, out=tmp_path / "cube.zarr", workflow=HERE)
