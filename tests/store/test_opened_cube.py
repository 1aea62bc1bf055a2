"""A cube as xarray opens it: variables in order, names of cameras, gains apart, `cube.wavefield`."""

import numpy as np
import pytest
import xarray as xr

import wavefield as wf
from wavefield.errors import StoreError
from wavefield.variables import CUBE_FIELDS, Quality


def test_variables_come_in_the_order_of_the_table_and_gains_are_no_variables(reference):
    cube = wf.open_cube(reference)
    assert [name for name in cube.data_vars if name in CUBE_FIELDS] == list(CUBE_FIELDS)
    assert list(cube.data_vars)[:5] == ["z", "z_t", "u", "v", "w"]
    assert not [name for name in cube.data_vars if str(name).startswith("gain_")]
    assert set(cube.wavefield.gain.data_vars) == {"gain_z", "gain_u", "gain_v", "gain_w"}
    assert set(cube[["z", "u"]].dims) == {"time", "y", "x"}


def test_cameras_are_selected_by_name(reference):
    cube = wf.open_cube(reference)
    assert list(cube.camera.values) == cube.attrs["cameras"]
    assert cube.frame_fault.sel(camera="cam2").dims == ("frame",)


@pytest.mark.parametrize("chunks", [None, {}])
def test_the_engine_opens_a_cube(reference, chunks):
    cube = xr.open_dataset(reference, engine="wavefield", chunks=chunks)
    own = wf.open_cube(reference)
    xr.testing.assert_identical(cube.isel(time=slice(2)).load(), own.isel(time=slice(2)).load())
    assert cube.z.chunks == (own.z.chunks if chunks is not None else None)
    assert "z" not in xr.open_dataset(reference, engine="wavefield", drop_variables="z")


@pytest.mark.parametrize("read", [
    wf.open_cube, wf.open_run, wf.status, wf.verify, lambda path: xr.open_dataset(path, engine="wavefield"),
])  # fmt: skip
def test_the_folder_of_an_experiment_stands_for_the_cube_in_it(reference, read):
    assert read(reference.parent) is not None


def test_stock_readers_see_the_same_values(reference):
    cube, plain = wf.open_cube(reference).load(), xr.open_zarr(reference).load()
    for name in CUBE_FIELDS:
        np.testing.assert_array_equal(cube[name], plain[name])


def test_the_engine_refuses_what_is_no_cube(tmp_path):
    with pytest.raises(StoreError, match="no such store"):
        xr.open_dataset(tmp_path / "absent.zarr", engine="wavefield")
    with pytest.raises(StoreError, match="a folder without a cube"):
        xr.open_dataset(tmp_path, engine="wavefield")
    with pytest.raises(StoreError, match=r"no such wave store; write one with `wavefield analyze CUBE`"):
        wf.open_waves(tmp_path / "waves.zarr")


def test_a_cube_states_its_flags_rig_and_recipe(reference):
    cube = wf.open_cube(reference)
    filled = cube.wavefield.flagged("filled")
    np.testing.assert_array_equal(filled, (cube.quality.values & int(Quality.FILLED)) > 0)
    with pytest.raises(ValueError, match="has no flag 'good'; it has measured, filled"):
        cube.wavefield.flagged("good")
    assert list(cube.wavefield.rig) == cube.attrs["cameras"]
    assert cube.wavefield.recipe["experiment"] == "small-tank"
    assert xr.Dataset().wavefield.recipe == {}


def test_a_rig_in_a_notebook_is_a_short_table(reference):
    rig = wf.open_cube(reference).wavefield.rig
    assert repr(rig) == "Rig(cam1, cam2, cam3)"
    assert rig._repr_html_().count("<tr>") == 4


def test_units_go_to_pint_and_names_to_cf_xarray(reference):
    pytest.importorskip("cf_xarray")
    units = pytest.importorskip("cf_xarray.units").units
    cube = wf.open_cube(reference)
    elevation = cube.cf["water_surface_height_above_reference_datum"]
    assert elevation.name == "z"
    assert cube.cf["X"].name == "x"
    assert units.Quantity(1.0, elevation.units).to("mm").magnitude == pytest.approx(1000)
    assert units.Quantity(1.0, cube.w.units).to("cm/s").magnitude == pytest.approx(100)


def test_a_plot_of_a_step_is_titled_by_its_time_alone(reference, undrawn):
    assert wf.open_cube(reference).z[3].plot().axes.get_title() == "time = 0.175 [s]"
    assert (
        set(wf.open_cube(reference).z.coords) == {"time", "y", "x"} == set(xr.open_zarr(reference).z.coords)
    )


def test_a_field_keeps_its_path_and_water_for_estimators(reference):
    cube = wf.open_cube(reference)
    assert (cube.w.attrs["path_frames"], cube.w.attrs["water_depth"]) == (int(cube.path_frames), 0.7)
    found = wf.komega((cube.w - cube.w.mean("time")).load(), segment=8)
    assert (int(found.path_frames), float(found.water_depth)) == (int(cube.path_frames), 0.7)
