"""What a run found of the frame times when it ended is contained in what is read of its cube."""

import numpy as np
import pytest
import xarray as xr
import zarr
from hypothesis import given
from hypothesis import strategies as st

from wavefield.quality.stored_values import steps_left_out
from wavefield.store.layout import StoreLayout, create_store
from wavefield.store.read import open_as_measured, open_cube
from wavefield.store.recipe import Recipe
from wavefield.store.relabel import relabel, state_findings
from wavefield.store.verify import verify
from wavefield.store.write_cube import write_chunk
from wavefield.variables import CUBE_FIELDS

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
FOUND = {"elevation_jitter": 0.02, "velocity_jitter": 0.05, "jitter_ms": 1.2, "discontinuous_steps": [1, 2]}
STATED = {"elevation_jitter", "velocity_jitter", "discontinuous_steps"}


@pytest.fixture(params=["float32", "int16"])
def store(request, tmp_path):
    path = tmp_path / "cube.zarr"
    recipe = Recipe("basin", {}, (0, 4), 20.0, {}, {}, {}, packing=request.param)
    create_store(path, recipe, np.arange(4) * 0.1, np.arange(3) * 0.1, StoreLayout(4, 2, ("a", "b"), 0), {})
    return path


def stated(path):
    return STATED & set(open_cube(path).attrs)


def test_the_uncertainties_of_a_cube_contain_the_jitter_that_it_states(monkeypatch, store):
    state_findings(store, FOUND)
    cube = open_as_measured(store).load()
    for name, value in VALUES.items():
        cube[name][:] = value
    monkeypatch.setattr("wavefield.store.read.open_as_measured", lambda path, chunks: cube)
    found = open_cube(store)
    for name in ("u", "v", "w"):
        expected = np.hypot(VALUES[f"{name}_std"], 0.05 * VALUES[name])
        np.testing.assert_allclose(found[f"{name}_std"], expected, rtol=1e-6)
    np.testing.assert_allclose(found["z_std"], np.hypot(1e-4, 0.02 / 20.0 * 0.15), rtol=1e-6)
    assert found.z_std.dtype == np.float32
    assert found.z_std.attrs["units"] == "m"
    np.testing.assert_array_equal(found["u"], cube["u"])


@pytest.mark.parametrize(
    "reader", [open_cube, lambda path: xr.open_dataset(path, engine="wavefield", chunks={})]
)
def test_discontinuous_steps_are_left_out_once_they_are_measured(store, reader):
    fields = {name: np.full((2, 3, 4), 1 if name == "quality" else 0.01) for name in CUBE_FIELDS}
    write_chunk(store, 0, fields, np.array([1, 2]), {})
    state_findings(store, {"discontinuous_steps": [1, 2]})
    cube, measured = reader(store), open_as_measured(store)
    assert cube.frame_status.values.tolist() == [1, 4, 0, 0], "what is not measured stays so"
    for name in CUBE_FIELDS:
        assert cube[name].dtype == measured[name].dtype
        assert cube[name].attrs == measured[name].attrs
        assert measured[name][:2].notnull().all()
        np.testing.assert_array_equal(cube[name][0], measured[name][0])
        np.testing.assert_array_equal(cube[name][1], 0 if name == "quality" else np.nan)


@given(st.integers(5, 60), st.lists(st.integers(2, 57), unique=True, max_size=12))
def test_steps_whose_frames_lie_on_both_sides_are_left_out_unless_they_are_most_of_the_record(steps, places):
    places = np.array(sorted(k for k in places if k < steps - 2), int)
    reached = [k for k in range(steps) if (abs(k - places) <= 2).any()]
    found = steps_left_out(places, steps).tolist()
    assert found == (reached if places.size == 1 or len(reached) <= steps / 2 else [])


def test_what_is_stated_is_replaced_and_taken_back_and_the_store_stays_whole(store):
    state_findings(store, FOUND)
    assert stated(store) == STATED
    assert zarr.open_group(store, mode="r").metadata.consolidated_metadata is not None
    packing = "int16" if open_cube(store).z.encoding.get("dtype") == "int16" else "float32"
    recipe = Recipe("another name", {}, (0, 4), 20.0, {}, {}, {}, packing=packing)
    relabel(store, recipe, {})
    assert stated(store) == STATED, "labels change, what was found stays"
    state_findings(store, {})
    assert stated(store) == set()
    state_findings(store, {})
    assert verify(store).sound
