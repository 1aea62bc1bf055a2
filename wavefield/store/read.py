"""Opening a store and reading its description."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Literal, cast

import numpy as np
import zarr

from wavefield.errors import StoreError
from wavefield.store.checked import CheckedStore
from wavefield.store.cube_group import CubeGroup
from wavefield.store.layout import PACKING, StoreLayout
from wavefield.store.ledger_files import check_chunks
from wavefield.store.metadata import check_metadata
from wavefield.text import one_line
from wavefield.variables import TABLE, annotate
from wavefield.water import water_coordinates

if TYPE_CHECKING:  # not needed by workers, and slow to import
    import xarray as xr

Chunks = dict[str, int] | int | Literal["auto"] | None


def open_group(path: Path, mode: Literal["r", "r+"] = "r") -> CubeGroup:
    """Open a store made by `create_store`."""
    if not path.exists():
        raise StoreError(f"{path}: no such store; make one with `wavefield run`")
    if mode == "r":
        check_metadata(path)
    try:
        store = CheckedStore(path) if mode == "r" else path
        group = zarr.open_group(store, mode=mode, use_consolidated=False)
        if "recipe" in group.attrs and "frame_status" in group:
            read_layout(group)
            json.loads(str(group.attrs["recipe"]))
            return cast(CubeGroup, group)
    except Exception as error:
        raise StoreError(
            f"{path} cannot be opened as a cube ({one_line(error)[:200]}); if it is one, it is "
            "damaged beyond repair: remove it and run `wavefield run EXPERIMENT` again"
        ) from None
    raise StoreError(f"{path} is not a cube of `wavefield run`; choose another name")


def read_layout(group: CubeGroup) -> StoreLayout:
    """Sizes of an open store."""
    frames = group["frame"]
    return StoreLayout(
        steps=group["frame_status"].shape[0],
        chunk_steps=int(group.attrs["steps_per_block"]),
        cameras=tuple(group.attrs["cameras"]),
        first_frame=int(frames[0]),
    )


def measured_rate(group: CubeGroup) -> float:
    """Frame rate that velocities are stored for; the cube's own may have been corrected since."""
    return float(group.attrs.get("measured_frame_rate", group.attrs["frame_rate"]))


def open_cube(path: str | Path, chunks: Chunks = "auto") -> "xr.Dataset":
    """Open a cube, lazily.

    Parameters
    ----------
    path : path
        Store written by `run`.
    chunks : optional
        As in `xarray.open_zarr`; by default one Dask chunk per chunk.

    Returns
    -------
    Dataset
        The variables of `wavefield.variables`, attributes with the recipe; steps not yet measured are NaN.
        The water's depth, where it is stated, is a coordinate as well, which every variable keeps.
        Steps over frames that the run found lost, doubled or late are NaN as well; their ``frame_status`` is
        4.
        The names of the cameras and the response to waves (``gain_z``, ...) are coordinates; the recipe, the
        rig, the response and the flags of `quality` are read with ``cube.wavefield``.

    Raises
    ------
    StoreError
        If it is not there, is not a cube, or is damaged: a file missing, cut off or exchanged. What is
        damaged within a file is found when it is read, with the same error.

    Examples
    --------
    The empty store that a run of ten steps begins with, in chunks of four.

    >>> import tempfile
    >>> import numpy as np
    >>> from wavefield.store.layout import create_store
    >>> from wavefield.store.recipe import Recipe
    >>> recipe, layout = Recipe("basin", {}, (0, 10), 20.0, {}, {}, {}), StoreLayout(10, 4, ("left",
    ...     "right"), 0)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     store = Path(folder) / "cube.zarr"
    ...     create_store(store, recipe, np.arange(4) * 0.1, np.arange(3) * 0.1, layout, {})
    ...     cube = open_cube(store)
    ...     missing = bool(cube.z.isnull().all())
    >>> cube.z.dims, cube.z.shape, cube.z.chunks[0]
    (('time', 'y', 'x'), (10, 3, 4), (4, 4, 2))
    >>> missing
    True
    """
    from wavefield.store import accessor  # noqa: F401  # registers `cube.wavefield`

    stored = open_stored(path, chunks)
    stored = stored.drop_vars(["checksum", "stored_bytes"], errors="ignore")
    stored = stored.set_coords([f"gain_{name}" for name in "zuvw" if f"gain_{name}" in stored])
    order = [name for name in TABLE if name in stored.data_vars]
    cube = stored[[*order, *(name for name in stored.data_vars if name not in order)]]
    cube = cube.assign_coords(stored.coords)
    cube = cube.assign_coords(camera=("camera", np.array(stored.attrs["cameras"]), TABLE["camera"].attrs))
    cube.encoding.pop("coordinates", None)
    for name in PACKING:
        if cube[name].dtype == "float64":  # as 16-bit values are unpacked
            cube[name] = cube[name].astype("float32")
    return annotate(cube.assign_coords(water_coordinates(cube.attrs)))


def open_stored(path: str | Path, chunks: Chunks = "auto") -> "xr.Dataset":
    """Open all that a cube's store holds, as it is stored; parameters and errors as of `open_cube`."""
    import xarray as xr

    path = Path(str(path).removeprefix("file://"))
    group = open_group(path)
    layout = read_layout(group)
    check_chunks(path, group, layout)
    if chunks == "auto":
        chunks = {"time": layout.chunk_steps}
    try:
        out: xr.Dataset = xr.open_zarr(CheckedStore(path), chunks=chunks, consolidated=False)
    except StoreError:
        raise
    except Exception as error:  # whatever a library makes of damaged bytes
        raise StoreError(
            f"{path} cannot be read as a cube ({one_line(error)[:200]}); if no copy of it is "
            "left, remove it and run `wavefield run EXPERIMENT` again"
        ) from None
    out.encoding["source"] = str(path)
    return out
