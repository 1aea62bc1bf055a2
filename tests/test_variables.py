"""The table of variables: units that other libraries read, and the check of input."""

import numpy as np
import pytest
import xarray as xr

from wavefield.errors import CubeError
from wavefield.variables import TABLE, factor, validate

# spectra of several quantities state the unit of velocities, and that of z after it
UNITS = sorted({part for row in TABLE.values() if row.units for part in row.units.split("; z: ")})


def field(dtype="f4", units="m", dims=("time", "y", "x")):
    return xr.DataArray(np.ones((2, 3, 4), dtype), dims=dims, attrs={"units": units})


@pytest.fixture(scope="module")
def registries():
    """The unit registries of cf-xarray and of pint."""
    pint = pytest.importorskip("pint")
    cf = pytest.importorskip("cf_xarray.units").units
    return cf, pint.UnitRegistry(preprocessors=cf.preprocessors)


@pytest.mark.parametrize("units", UNITS)
def test_units_are_those_of_pint_and_cf_xarray(registries, units):
    for registry in registries:
        parsed = registry.Unit(units)
        assert factor(units, units) == 1
        if units == "pixel":  # not the pixel of style sheets, which is a length
            assert not parsed.is_compatible_with("m")
        elif units == "m3 s-2":
            assert parsed.is_compatible_with(registry.Unit("N m-1") / registry.Unit("kg m-3"))


def test_a_cube_in_other_units_is_converted_and_one_of_another_kind_refused():
    cube = xr.Dataset({"z": field(units="mm"), "w": field(units="cm/s")}, {"x": ("x", np.arange(4.0))})
    cube["x"].attrs["units"] = "cm"
    out = validate(cube, "z", "w")
    assert float(out.z.max()) == pytest.approx(1e-3)
    assert float(out.w.max()) == pytest.approx(1e-2)
    assert out.w.attrs["units"] == "m s-1"
    np.testing.assert_allclose(out.x, np.arange(4) / 100)
    with pytest.raises(CubeError, match="'z' is in 'kg'"):
        validate(xr.Dataset({"z": field(units="kg")}), "z")


def test_fields_leave_the_door_in_one_order_and_one_type():
    cube = xr.Dataset({"z": field("f4"), "w": field("f8", "m s-1"), "quality": field("u1", "1")})
    out = validate(cube.transpose("x", "time", "y"), "z", "w", "quality")
    assert out.z.dims == ("time", "y", "x")
    assert {name: str(out[name].dtype) for name in out} == {
        "z": "float64",
        "w": "float64",
        "quality": "uint8",
    }
    assert validate(cube[["z"]], "z").z.dtype == np.float32


def test_what_does_not_fit_is_refused_by_name():
    with pytest.raises(CubeError, match="no 'z_t'"):
        validate(xr.Dataset({"z": field()}), "z", "z_t")
    with pytest.raises(CubeError, match="'z' has dimensions"):
        validate(xr.Dataset({"z": field(dims=("time", "row", "x"))}), "z")
    with pytest.raises(CubeError, match="'quality' has type"):
        validate(xr.Dataset({"quality": field("f4", "1")}), "quality")
