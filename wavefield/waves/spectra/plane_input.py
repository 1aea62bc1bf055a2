"""Spectra over the plane of wave vectors, from what estimators of the dispersion relation are given."""

from typing import Any

import xarray as xr

from wavefield.errors import CubeError
from wavefield.waves.estimation.inputs import Convert, described, is_cube, is_field, stated_water
from wavefield.waves.spectra.field_spectra import spectrum

PLANE = {"omega", "ky", "kx"}


def plane_of(field: str, independent: bool = False, segment: int | None = None) -> Convert:
    """Converter to E(omega, ky, kx): as given, in the Dataset of `spectrum`, of a field, or of a cube's.
    Degrees of freedom are those of the segments as they are, or of independent ones.
    """

    def convert(given: Any, name: str) -> tuple[xr.DataArray, dict[str, Any]]:
        water: dict[str, Any] = stated_water(given) if isinstance(given, xr.DataArray | xr.Dataset) else {}
        if isinstance(given, xr.DataArray) and set(given.dims) == PLANE:
            return given, water
        if is_cube(given):
            if field not in given:
                raise CubeError(f"the cube has no {field!r}, of whose spectrum {name} is made")
            given = spectrum(given[field], segment=segment).compute()
        elif is_field(given):
            given = spectrum(given, segment=segment).compute()
        if isinstance(given, xr.Dataset) and "E" in given and set(given["E"].dims) == PLANE:
            dof = given.attrs.get("degrees_of_freedom") if independent else given.get("dof")
            return given["E"], water | ({} if dof is None else {"dof": float(dof)})
        raise CubeError(
            f"{name} needs a spectrum over omega, ky and kx (`wavefield.spectrum`), a cube, or a field over"
            f" time, y and x, got {described(given)}"
        )

    return convert
