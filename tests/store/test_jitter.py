"""Jitter of the frame times that a cube states is contained in the uncertainties that are read."""

import numpy as np
import pytest
import zarr

from wavefield.store.layout import StoreLayout, create_store
from wavefield.store.read import open_cube, open_without_jitter
from wavefield.store.recipe import Recipe
from wavefield.store.relabel import relabel, state_jitter
from wavefield.store.verify import verify

VALUES = {
    "u": 0.3,
    "v": -0.1,
    "w": 0.2,
    "z_t": 0.15,
    "u_std": 3e-3,
    "v_std": 3e-3,
    "w_std": 4e-3,
    "z_std": 1e-4,
}
FOUND = {"elevation_jitter": 0.02, "velocity_jitter": 0.05, "jitter_ms": 1.2}


@pytest.fixture(params=["float32", "int16"])
def store(request, tmp_path):
    path = tmp_path / "cube.zarr"
    recipe = Recipe("basin", {}, (0, 4), 20.0, {}, {}, {}, packing=request.param)
    create_store(path, recipe, np.arange(4) * 0.1, np.arange(3) * 0.1, StoreLayout(4, 2, ("a", "b"), 0), {})
    return path


def stated(path):
    return {name for name in ("elevation_jitter", "velocity_jitter") if name in open_cube(path).attrs}


def test_the_uncertainties_of_a_cube_contain_the_jitter_that_it_states(monkeypatch, store):
    state_jitter(store, FOUND)
    cube = open_without_jitter(store).load()
    for name, value in VALUES.items():
        cube[name][:] = value
    monkeypatch.setattr("wavefield.store.read.open_without_jitter", lambda path, chunks: cube)
    found = open_cube(store)
    for name in ("u", "v", "w"):
        expected = np.hypot(VALUES[f"{name}_std"], 0.05 * VALUES[name])
        np.testing.assert_allclose(found[f"{name}_std"], expected, rtol=1e-6)
    np.testing.assert_allclose(found["z_std"], np.hypot(1e-4, 0.02 / 20.0 * 0.15), rtol=1e-6)
    assert found.z_std.dtype == np.float32
    assert found.z_std.attrs["units"] == "m"
    np.testing.assert_array_equal(found["u"], cube["u"])


def test_what_is_stated_is_replaced_and_taken_back_and_the_store_stays_whole(store):
    state_jitter(store, FOUND)
    assert stated(store) == {"elevation_jitter", "velocity_jitter"}
    assert zarr.open_group(store, mode="r").metadata.consolidated_metadata is not None
    packing = "int16" if open_cube(store).z.encoding.get("dtype") == "int16" else "float32"
    recipe = Recipe("another name", {}, (0, 4), 20.0, {}, {}, {}, packing=packing)
    relabel(store, recipe, {})
    assert len(stated(store)) == 2, "labels change, what was found stays"
    state_jitter(store, {})
    assert stated(store) == set()
    state_jitter(store, {})
    assert verify(store).sound
