"""The cube as files of other programs: NetCDF, MATLAB, UVMAT."""

import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wavefield.atomic_write import OwnFile, atomic, check_writable, files_named, marked
from wavefield.errors import StoreError
from wavefield.store.ledger import unfinished_note
from wavefield.store.read import open_cube
from wavefield.store.recipe import recipe_of
from wavefield.variables import TABLE

if TYPE_CHECKING:
    import xarray as xr

NETCDF = (".nc", ".nc4", ".cdf", ".h5")
ENDINGS = {
    **dict.fromkeys(NETCDF, "netcdf"),
    ".mat": "matlab",
    ".uvmat": "uvmat",
}
KNOWN = ".nc (NetCDF), .mat (MATLAB) or .uvmat (a folder for UVMAT)"
_AT_ONCE = 16  # steps in memory


def _has_attribute(name: str) -> Callable[[Path], bool]:
    """Recognize an HDF5 file by an attribute."""

    def recognize(path: Path) -> bool:
        import h5py

        with h5py.File(path, "r") as file:
            return name in file.attrs

    return recognize


_MARK = b"written by wavefield"
PRODUCTS = {
    "netcdf": OwnFile("a NetCDF export of a cube", _has_attribute("recipe_hash")),
    "matlab": OwnFile("a MATLAB export of a cube", marked(_MARK, start=b"MATLAB 7.3")),
    "uvmat": OwnFile(
        "a UVMAT export of a cube",
        files_named(r".*_\d+\.nc", marked(b"wavefield", start=b"CDF")),
        folder=True,
    ),
}


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
    check_writable(path, PRODUCTS[kind])
    if note := unfinished_note(store):
        warnings.warn(note, stacklevel=2)
    cube = open_cube(store)
    if steps is not None:
        cube = cube.isel(time=steps)
    if not cube.sizes["time"]:
        raise StoreError(f"{store} has no such steps: it holds {open_cube(store).sizes['time']}")
    _WRITERS[kind](cube, path)


def _steps_of(cube: "xr.Dataset") -> Iterator["xr.Dataset"]:
    """One step of a cube after the other, loaded."""
    for start in range(0, cube.sizes["time"], _AT_ONCE):
        chunk = cube.isel(time=slice(start, start + _AT_ONCE)).load()
        yield from (chunk.isel(time=k) for k in range(chunk.sizes["time"]))


def write_netcdf(cube: "xr.Dataset", path: Path) -> None:
    """Write a cube, or averages of one, as NetCDF (CF)."""
    check_writable(path, PRODUCTS["netcdf"])
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
    with atomic(path, PRODUCTS["netcdf"]) as draft:
        cube.to_netcdf(draft, engine="h5netcdf", format="NETCDF4")


def _matlab(cube: "xr.Dataset", path: Path) -> None:
    from wavefield.store.export_matlab import write_matlab

    with atomic(path, PRODUCTS["matlab"]) as draft:
        write_matlab(cube, _steps_of(cube), draft)


def _uvmat(cube: "xr.Dataset", path: Path) -> None:
    from wavefield.store.export_uvmat import write_uvmat

    dt = 1.0 / float(recipe_of(cube.attrs)["frame_rate"])
    with atomic(path, PRODUCTS["uvmat"]) as draft:
        write_uvmat(_steps_of(cube), draft, path.stem, dt)


_WRITERS: dict[str, Callable[[Any, Path], None]] = {
    "netcdf": write_netcdf,
    "matlab": _matlab,
    "uvmat": _uvmat,
}
