"""A cube for UVMAT: one NetCDF file per step, with the roles that it requires."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import xarray as xr
from scipy.io import netcdf_file

from wavefield.variables import Quality

_ROLES = {  # name here: name and role there
    "u": ("U", "vector_x"),
    "v": ("V", "vector_y"),
    "w": ("W", "vector_z"),
    "z": ("Z", "scalar"),
    "z_t": ("Z_t", "scalar"),
    "eps_piv": ("Error", "ancillary"),
}


def write_uvmat(steps: Iterator[xr.Dataset], draft: Path, stem: str, dt: float) -> None:
    """Write every step as a NetCDF 3 file as UVMAT's `struct2nc` does: metres, y upwards.
    ``FF`` (UVMAT's flag of false vectors) is 0 where the node was measured, else the bits of ``quality``.
    """
    draft.mkdir()
    for number, step in enumerate(steps, 1):
        _write_step(draft / f"{stem}_{number}.nc", step, dt)


def _write_step(path: Path, step: xr.Dataset, dt: float) -> None:
    with netcdf_file(str(path), "w", version=2) as file:
        file.Conventions, file.Program = "uvmat", "wavefield"
        file.CoordUnit, file.TimeUnit = "m", "s"
        file.Time, file.Dt = float(step.time), dt
        for axis in ("y", "x"):
            file.createDimension(f"coord_{axis}", step.sizes[axis])
            values = file.createVariable(f"coord_{axis}", "f8", (f"coord_{axis}",))
            values[:] = np.asarray(step[axis])
            values.Role, values.units = f"coord_{axis}", "m"
        for name, (theirs, role) in _ROLES.items():
            if name in step:
                values = file.createVariable(theirs, "f4", ("coord_y", "coord_x"))
                values[:] = np.asarray(step[name], np.float32)
                values.Role, values.units = role, str(step[name].attrs.get("units", ""))
        flag = file.createVariable("FF", "i2", ("coord_y", "coord_x"))
        quality = np.asarray(step.quality)
        good = (quality & np.uint8(Quality.MEASURED)) != 0
        flag[:] = np.where(good, 0, np.maximum(quality, 1)).astype(np.int16)
        flag.Role = "errorflag"
