"""The cube as files of other programs: NetCDF, MATLAB, UVMAT."""

import io
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wavefield.atomic_write import Product, atomic, check_writable
from wavefield.errors import StoreError
from wavefield.store.ledger import unfinished_note
from wavefield.store.read import open_cube
from wavefield.store.recipe import recipe_of, source_of
from wavefield.variables import TABLE

if TYPE_CHECKING:
    import xarray as xr

NETCDF = (".nc", ".nc4", ".cdf", ".h5")
ENDINGS = {**dict.fromkeys(NETCDF, "netcdf"), ".mat": "matlab", ".uvmat": "uvmat"}
KNOWN = ".nc (NetCDF), .mat (MATLAB) or .uvmat (a folder for UVMAT)"
_AT_ONCE = 16  # steps in memory


class _Hdf5File(io.FileIO):
    """A file for the HDF5 library, which crashes where a write fails: the first error is kept for the end."""

    failure: OSError | None = None

    def write(self, data: Any) -> int:
        """Write all of the data, or keep the error."""
        left = memoryview(data).cast("B")
        size = len(left)
        while left and self.failure is None:
            try:
                left = left[super().write(left) or 0 :]
            except OSError as error:
                self.failure = error
        return size

    def truncate(self, size: int | None = None) -> int:
        """Change the size, or keep the error."""
        try:
            return super().truncate(size)
        except OSError as error:
            self.failure = self.failure or error
            return size or 0


@contextmanager
def _hdf5_file(path: Path) -> Iterator[_Hdf5File]:
    """A file for the HDF5 library; raises the first error of writing it."""
    with _Hdf5File(path, "w+") as file:
        try:
            yield file
        except Exception:
            if file.failure is None:
                raise
    if file.failure is not None:
        raise file.failure


def export(store: str | Path, path: str | Path, steps: slice | None = None) -> None:
    """Write a cube for other programs; the suffix of the name chooses the format.

    Parameters
    ----------
    store : path
        Cube written by `run`.
    path : path
        ``.nc``: one NetCDF-4 file that follows the CF conventions; ``.mat``: MATLAB 7.3;
        ``.uvmat``: a folder of one NetCDF file per step. It appears when it is complete.
    steps : slice, optional
        Some of the steps; by default all.

    Raises
    ------
    StoreError
        If the cube is not there, has no such steps, or the file cannot be written or has another program's
        ending.

    Warns
    -----
    UserWarning
        If steps of the cube are missing.

    Notes
    -----
    Values are unpacked float32. Goes through the cube a few steps at a time.

    Examples
    --------
    A store of two steps as a NetCDF file.

    >>> import tempfile
    >>> import xarray as xr
    >>> from wavefield.store.layout import StoreLayout, create_store
    >>> from wavefield.store.recipe import Recipe
    >>> from wavefield.store.write_cube import write_chunk
    >>> from wavefield.variables import CUBE_FIELDS, FrameStatus
    >>> recipe, layout = Recipe("basin", {}, (0, 2), 20.0, {}, {}, {}), StoreLayout(2, 2, ("left",
    ... "right"), 0)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     store, file = Path(folder) / "cube.zarr", Path(folder) / "cube.nc"
    ...     create_store(store, recipe, np.arange(4) * 0.1, np.arange(3) * 0.1, layout, {})
    ...     fields = {name: np.ones((2, 3, 4), np.float32) for name in CUBE_FIELDS}
    ...     write_chunk(store, 0, fields, np.full(2, FrameStatus.DONE), {})
    ...     export(store, file)
    ...     with xr.open_dataset(file, engine="h5netcdf") as cube:
    ...         written = cube.z.shape, cube.z.attrs["units"]
    >>> written
    ((2, 3, 4), 'm')
    """
    path = Path(path)
    kind = ENDINGS.get(path.suffix.lower())
    if kind is None:
        raise StoreError(f"{path} is not a supported output format: let its name end in {KNOWN}")
    cube = open_cube(store)
    check_writable(path, _product(kind, cube), inputs=[cube.encoding["source"]])
    if note := unfinished_note(store):
        warnings.warn(note, stacklevel=2)
    count = cube.sizes["time"]
    if steps is not None:
        cube = cube.isel(time=steps)
    if not cube.sizes["time"]:
        raise StoreError(f"{store} has no such steps: it holds {count}")
    _WRITERS[kind](cube, path)


def _steps_of(cube: "xr.Dataset") -> Iterator["xr.Dataset"]:
    """One step of a cube after the other, loaded."""
    for start in range(0, cube.sizes["time"], _AT_ONCE):
        chunk = cube.isel(time=slice(start, start + _AT_ONCE)).load()
        yield from (chunk.isel(time=k) for k in range(chunk.sizes["time"]))


def _product(kind: str, cube: "xr.Dataset") -> Product | None:
    """A file is replaced by that of the same cube, a folder for UVMAT never."""
    return None if kind == "uvmat" else Product(f"{kind} export", source_of(cube))


def write_netcdf(cube: "xr.Dataset", path: Path) -> None:
    """Write a cube, or averages of one, as NetCDF (CF)."""
    product = _product("netcdf", cube)
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
    with atomic(path, product) as draft, _hdf5_file(draft) as file:
        cube.to_netcdf(file, engine="h5netcdf", format="NETCDF4")


def _matlab(cube: "xr.Dataset", path: Path) -> None:
    from wavefield.store.export_matlab import write_matlab

    with atomic(path, _product("matlab", cube)) as draft, _hdf5_file(draft) as file:
        write_matlab(cube, _steps_of(cube), file)


def _uvmat(cube: "xr.Dataset", path: Path) -> None:
    from wavefield.store.export_uvmat import write_uvmat

    dt = 1.0 / float(recipe_of(cube.attrs)["frame_rate"])
    with atomic(path) as draft:
        write_uvmat(_steps_of(cube), draft, path.stem, dt)


_WRITERS: dict[str, Callable[[Any, Path], None]] = {
    "netcdf": write_netcdf,
    "matlab": _matlab,
    "uvmat": _uvmat,
}
