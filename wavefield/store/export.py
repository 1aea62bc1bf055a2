"""The cube as one NetCDF file, for programs that do not read Zarr."""

import warnings
from pathlib import Path

import numpy as np

from wavefield.errors import StoreError
from wavefield.store.ledger import unfinished_note
from wavefield.store.read import open_cube
from wavefield.variables import TABLE
from wavefield.whole_files import whole

ENDINGS = (".nc", ".nc4", ".cdf", ".h5")


def export_netcdf(store: str | Path, path: str | Path) -> None:
    """Write a cube as one NetCDF-4 file that follows the CF conventions (MATLAB, Panoply, ncview).

    Parameters
    ----------
    store : path
        Cube written by `run`.
    path : path
        File to write, ``.nc``; it appears when it is whole.

    Raises
    ------
    StoreError
        If the cube is not there, or the file cannot be written or has another program's ending.

    Warns
    -----
    UserWarning
        If steps of the cube are missing.

    Notes
    -----
    Values are unpacked float32, compressed. Goes through the cube one block at a time.
    """
    path = Path(path)
    if path.suffix.lower() not in ENDINGS:
        raise StoreError(f"{path} is written as NetCDF: let its name end in {' or '.join(ENDINGS)}")
    if note := unfinished_note(store):
        warnings.warn(note, stacklevel=2)
    cube = open_cube(store)
    cube.attrs = {
        name: " ".join(value) if isinstance(value, list) else value for name, value in cube.attrs.items()
    }
    for name, variable in cube.variables.items():
        variable.encoding = {}
        for flags in ("flag_masks", "flag_values"):  # CF: of the same type as the variable
            if flags in variable.attrs:
                variable.attrs[flags] = np.asarray(variable.attrs[flags], variable.dtype)
        if name in TABLE and variable.dtype.kind == "f":
            variable.encoding["_FillValue"] = np.array(np.nan, variable.dtype) if variable.ndim == 3 else None
        if variable.ndim == 3:
            chunks = (min(8, variable.shape[0]), *variable.shape[1:])
            variable.encoding |= {"zlib": True, "complevel": 4, "shuffle": True, "chunksizes": chunks}
    with whole(path) as draft:
        cube.to_netcdf(draft, engine="h5netcdf", format="NETCDF4")
