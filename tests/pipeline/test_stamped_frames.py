import json

import numpy as np
import pytest
import xarray as xr
from cube_cases import FRAMES, different

from wavefield.errors import StoreError
from wavefield.grid import Grid
from wavefield.pipeline import Workflow, open_cube, reconstruct, run
from wavefield.rig import Rig

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
