"""Cubes of other programs: what their velocities are is declared, and their spectra follow."""

import numpy as np
import pytest
import xarray as xr
from waves_cases import axes, fused_spectra, linear_cube, random_waves

import wavefield as wf
from wavefield import waves as wv
from wavefield.errors import CubeError

DIMS = ("time", "y", "x")


def instantaneous(waves, steps=400, ny=32, nx=36, dt=0.05, dx=0.02):
    """Exact fields at mid-time, linear kinematics: w is the rate of rise."""
    t, y, x = axes(steps, ny, nx, dt, dx)
    fields = waves.on_grid(t, y, x, "z", "z_t", "u", "v")
    fields["w"] = fields["z_t"]
    return {name: xr.DataArray(values, {"time": t, "y": y, "x": x}, DIMS) for name, values in fields.items()}


def of(fields, **more):
    return wf.cube(*(fields[name] for name in "zuvw"), **{"velocity": "instantaneous"} | more)


def test_the_elevation_from_instantaneous_velocities_is_that_of_the_elevation_itself():
    waves = random_waves(101, n=60, lowest=1.0, highest=5.5, power=3)
    fields = instantaneous(waves)
    found = fused_spectra(of(fields, depth=0.7), segment=128)
    truth = wv.E_omega(wv.komega(fields["z"], segment=128)).E.values
    lines = (found.frequency.values > 1.3) & (found.frequency.values < 5)
    for name in ("w", "cross", "stereo"):
        energy = found.Ez.sel(source=name).values
        ratio = energy[lines].sum() / truth[lines].sum()
        high = (found.frequency.values > 4) & (found.frequency.values < 5)
        at_high = energy[high].sum() / truth[high].sum()
        assert abs(ratio - 1) < 0.02, name
        assert abs(at_high - 1) < 0.02, name


def test_a_cube_states_what_its_velocities_are_or_displacements_are_assumed():
    fields = instantaneous(random_waves(105, n=30), steps=160, ny=20, nx=24)
    declared = of(fields, depth=0.7)
    bare = declared.drop_vars("path_frames")
    del bare.attrs["velocity"]
    given = bare.assign_attrs(velocity="instantaneous")
    stated, given, assumed = (wf.analyze(cube, segment=32) for cube in (declared, given, bare))
    np.testing.assert_array_equal(stated["spectra"].Ez, given["spectra"].Ez)
    assert "does not state what its velocities are" in assumed.attrs["notes"]
    assert "does not state" not in stated.attrs["notes"] + given.attrs["notes"]
    with pytest.raises(CubeError, match="state one of"):
        wf.analyze(bare.assign_attrs(velocity="eulerian"))


def test_units_and_dates_are_converted_and_the_order_of_dimensions_is_free():
    fields = instantaneous(random_waves(106, n=10), steps=40, ny=10, nx=12)
    plain = of(fields)
    z = (1000 * fields["z"]).assign_attrs(units="mm").transpose("y", "x", "time")
    start = np.datetime64("2024-05-01T12:00:00")
    steps = (1e9 * (z.time.values - z.time.values[0])).round().astype("timedelta64[ns]")
    dated = {name: field.assign_coords(time=start + steps) for name, field in (fields | {"z": z}).items()}
    found = of(dated, depth=0.7)
    np.testing.assert_allclose(found.z.transpose(*DIMS), plain.z, atol=1e-9)
    assert found.attrs["frame_rate"] == pytest.approx(20.0)
    assert (found.attrs["water_depth"], found.w.attrs["units"]) == (0.7, "m s-1")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: {"z": f["z"].values}, "'z' is a ndarray"),
        (lambda f: {"z": f["z"].rename(y="row")}, "'y' is missing"),
        (lambda f: {"z": f["z"].assign_attrs(units="kg")}, "convert it first"),
        (lambda f: {"w": f["w"].isel(x=slice(3, None))}, "'w' and 'z' differ in 'x'"),
        (lambda f: {"w": f["w"].assign_coords(time=f["w"].time + 0.025)}, "'w' and 'z' differ in 'time'"),
        (lambda f: {"z": f["z"].where(f["z"].time != f["z"].time[4])}, "z has gaps"),
        (lambda f: {"z": f["z"].isel(time=[0, 1, 2, 4, 5])}, "unequal"),
    ],
)
def test_fields_that_do_not_go_together_are_refused(change, message):
    fields = instantaneous(random_waves(107, n=10), steps=40, ny=10, nx=12)
    with pytest.raises(CubeError, match=message):
        of(fields | change(fields))


def test_displacements_need_the_rise_over_the_same_step():
    measured = linear_cube(random_waves(108, n=10), 40, 10, 12)
    fields = {name: measured[name] for name in "zuvw"}
    with pytest.raises(CubeError, match="give z_t"):
        of(fields, velocity="displacement")
    found = of(fields, velocity="displacement", z_t=measured.z_t)
    assert int(found.path_frames) == 2


def test_a_cube_offers_the_estimators_as_methods():
    made = linear_cube(random_waves(n=20), 96, 16, 20, dx=0.03)
    cube = wf.cube(made.z, z_t=made.z_t, u=made.u, v=made.v, w=made.w, velocity="displacement")
    xr.testing.assert_identical(cube.waves.komega("w", segment=32), wf.komega(cube.w, segment=32))
    xr.testing.assert_identical(cube.waves.coherence(segment=32), wf.coherence(cube, segment=32))
    assert float(cube.waves.statistics().significant_height) > 0
    methods = [name for name in dir(cube.waves) if not name.startswith("_")]
    assert {"directions", "fit_dispersion", "kinematics", "spectrum", "analyze"} <= {*methods}
    assert all(getattr(cube.waves, name).__doc__ for name in methods)
