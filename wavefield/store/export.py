"""Export a cube to NetCDF, MATLAB or UVMAT."""

import io
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wavefield.atomic_write import Product, atomic, check_writable
from wavefield.errors import StoreError
from wavefield.store.cube import open_cube
from wavefield.store.ledger import unfinished_note
from wavefield.store.recipe import recipe_of, source_of
from wavefield.variables import CUBE_DIMS, TABLE, Quality

if TYPE_CHECKING:
    import xarray as xr

KNOWN = ".nc (NetCDF), .mat (MATLAB) or .uvmat (a folder for UVMAT)"
_AT_ONCE = 16  # steps in memory at a time
_MATLAB_BYTES = 2**31  # limit per variable: a MAT-file of version 7 stores sizes in 32 bits
_UVMAT_ROLES = {  # variable of the cube: name and role in UVMAT
    "u": ("U", "vector_x"),
    "v": ("V", "vector_y"),
    "w": ("W", "vector_z"),
    "z": ("Z", "scalar"),
    "z_t": ("Z_t", "scalar"),
    "eps_piv": ("Error", "ancillary"),
}


class _Hdf5File(io.FileIO):
    """A file object that keeps the first write error in `failure` instead of raising an exception.
    An exception would crash the HDF5 library."""

    failure: OSError | None = None

    def write(self, data: Any) -> int:
        """Write `data` and return its size in bytes; after a write error, return the size without writing."""
        left = memoryview(data).cast("B")
        size = len(left)
        while left and self.failure is None:
            try:
                left = left[super().write(left) or 0 :]
            except OSError as error:
                self.failure = error
        return size

    def truncate(self, size: int | None = None) -> int:
        """Change the file's size to `size` bytes, and return this size."""
        try:
            return super().truncate(size)
        except OSError as error:
            self.failure = self.failure or error
            return size or 0


def _write_hdf5(cube: "xr.Dataset", path: Path) -> None:
    """Write a Dataset as a NetCDF-4 file; raise the first OSError that occurred while writing."""
    with _Hdf5File(path, "w+") as file:
        try:
            cube.to_netcdf(file, engine="h5netcdf", format="NETCDF4")
        except Exception:
            if file.failure is None:
                raise
    if file.failure is not None:
        raise file.failure


def export(store: str | Path, path: str | Path, steps: slice | None = None) -> None:
    """Write a cube for other programs; the ending of `path` chooses the format.

    Parameters
    ----------
    store : path
        Cube written by `run`.
    path : path
        With the ending ``.nc``, one NetCDF-4 file that follows the CF conventions. With ``.mat``, a file of
        MATLAB 7, with variables below 2 GB. With ``.uvmat``, a folder with one NetCDF file per step. The
        output appears when it is complete. Values are unpacked to float32.
    steps : slice, optional
        Indices of the steps to export; by default all.

    Raises
    ------
    StoreError
        If the cube does not exist or has no such steps, or if the output has another ending or cannot be
        written. Of existing outputs only an unchanged ``.nc`` export of the same cube is replaced.

    Warns
    -----
    UserWarning
        If steps of the cube are not measured yet, or could not be measured.

    Examples
    --------
    >>> import wavefield as wf
    >>> import xarray as xr
    >>> wf.export("cube.zarr", "cube.nc")
    >>> with xr.open_dataset("cube.nc", engine="h5netcdf") as cube:
    ...     cube.z.shape, cube.z.units
    ((10, 3, 4), 'm')
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise StoreError(f"{path} is not a supported output format: let its name end in {KNOWN}")
    cube = open_cube(store)
    product = _product(cube) if ending == ".nc" else None
    check_writable(path, product, inputs=[cube.encoding["source"]])
    if note := unfinished_note(store):
        warnings.warn(note, stacklevel=2)
    count = cube.sizes["time"]
    if steps is not None:
        cube = cube.isel(time=steps)
    if not cube.sizes["time"]:
        raise StoreError(f"{store} has no steps in the given range: it has {count} steps")
    ENDINGS[ending](cube, path)


def _product(cube: "xr.Dataset") -> Product:
    """Return the kind and source recorded in a NetCDF export, so that a later export may replace it."""
    return Product("netcdf export", source_of(cube))


def write_netcdf(cube: "xr.Dataset", path: Path) -> None:
    """Write a cube as a NetCDF-4 file with CF attributes; the attributes of `cube` are changed in place.
    StoreError if `path` exists and is not an unchanged export of the same cube."""
    product = _product(cube)
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
    with atomic(path, product) as draft:
        _write_hdf5(cube, draft)


def _write_matlab(cube: "xr.Dataset", path: Path) -> None:
    """Write a cube as a MAT-file with the fields, (y, x, time), and the attributes that are text.
    The structs `units` and `long_name` hold one text per variable. StoreError if a variable is over 2 GB."""
    from scipy.io import savemat

    numbers = {name: one for name, one in cube.variables.items() if one.dtype.kind not in "UOTM"}
    largest = max(numbers.values(), key=lambda one: one.nbytes)
    if largest.nbytes >= _MATLAB_BYTES:
        raise StoreError(
            f"{path}: a variable of {largest.nbytes / 1e9:.1f} GB does not fit into a MAT-file, which holds "
            "2 GB; write a file that ends in .nc, which MATLAB reads with `ncread`, or fewer --steps"
        )
    texts = {
        key: {name: str(one.attrs.get(key, "")) for name, one in numbers.items()}
        for key in ("units", "long_name")
    }
    attributes = {name: value for name, value in cube.attrs.items() if isinstance(value, str) and value}
    with atomic(path) as draft, draft.open("wb") as file:
        for name, one in numbers.items():  # one in memory at a time
            values = one.transpose("y", "x", "time") if one.dims == CUBE_DIMS else one
            savemat(file, {name: np.asarray(values)}, do_compression=True, oned_as="column")
        savemat(file, texts | attributes, long_field_names=True)


def _write_uvmat(cube: "xr.Dataset", path: Path) -> None:
    """Write a folder with one NetCDF 3 file per step for the program UVMAT; coordinates are in metres.
    Variables are named as by UVMAT's `struct2nc`; its flag ``FF`` is 0 at nodes that were measured."""
    names = {name: theirs for name, (theirs, _) in _UVMAT_ROLES.items() if name in cube}
    out = cube[[*names, "quality"]].reset_coords(drop=True)
    measured = (out.quality & int(Quality.MEASURED)) != 0
    out["quality"] = out.quality.clip(1).where(~measured, 0).astype("int16")
    out = out.rename({"x": "coord_x", "y": "coord_y", "quality": "FF", **names})
    roles = {"coord_y": "coord_y", "coord_x": "coord_x", "FF": "errorflag", **dict(_UVMAT_ROLES.values())}
    for name, one in out.variables.items():
        one.attrs = {"Role": roles.get(str(name), ""), "units": one.attrs.get("units", "")}
        one.encoding = {"_FillValue": None}
    dt = 1.0 / float(recipe_of(cube.attrs)["frame_rate"])
    out.attrs = {"Conventions": "uvmat", "Program": "wavefield", "CoordUnit": "m", "TimeUnit": "s", "Dt": dt}
    with atomic(path) as draft:
        draft.mkdir()
        for start in range(0, out.sizes["time"], _AT_ONCE):
            chunk = out.isel(time=slice(start, start + _AT_ONCE)).load()
            for k, time in enumerate(chunk.time.values):
                step = chunk.isel(time=k, drop=True).assign_attrs(Time=float(time))
                file = draft / f"{path.stem}_{start + k + 1}.nc"
                step.to_netcdf(file, engine="scipy", format="NETCDF3_64BIT")


ENDINGS: dict[str, Callable[[Any, Path], None]] = {
    ".nc": write_netcdf,
    ".mat": _write_matlab,
    ".uvmat": _write_uvmat,
}
