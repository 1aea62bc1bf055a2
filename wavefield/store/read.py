"""Opening a store and reading its description."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
import zarr
from numpy.typing import NDArray

from wavefield.errors import StoreError
from wavefield.store.checked import CheckedStore
from wavefield.store.cube_group import CubeGroup
from wavefield.store.layout import PACKING, StoreLayout
from wavefield.store.ledger_files import check_chunks
from wavefield.store.metadata import check_metadata
from wavefield.text import one_line
from wavefield.variables import CUBE_FIELDS, TABLE, FrameStatus, annotate
from wavefield.water import water_coordinates

if TYPE_CHECKING:  # not needed by workers, and slow to import
    import xarray as xr

Chunks = dict[str, int] | int | Literal["auto"] | None
# Jitter of the frame times that a run found when it ended, and no time stamps state: std of the moment of z,
# frame intervals, and relative error of velocities
JITTER = ("elevation_jitter", "velocity_jitter")
# Steps, from 0, that a run found discontinuous when it ended, and those whose six frames lie on both sides
DISCONTINUOUS_STEPS = "discontinuous_steps"
FOUND_AFTER_RUN = (*JITTER, DISCONTINUOUS_STEPS)


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
        Where the run found jitter of the frame times that no time stamps state, the standard uncertainties
        contain it (`with_jitter`). Steps over frames that it found lost, duplicated or mistimed are NaN as
        well; their ``frame_status`` is 4.
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
    cube = without_discontinuous(with_jitter(open_as_measured(path, chunks)))
    return annotate(cube.assign_coords(water_coordinates(cube.attrs)))


def open_as_measured(path: str | Path, chunks: Chunks = "auto") -> "xr.Dataset":
    """As `open_cube`, with all values and uncertainties as they were measured, step by step."""
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
    return cube


def with_jitter(cube: "xr.Dataset") -> "xr.Dataset":
    """Add the jitter of the frame times that a cube's attributes state to its standard uncertainties.
    It changes all velocities of a step by one factor, and gives its elevation at another moment.
    """
    import xarray as xr

    late, factor = (float(cube.attrs.get(name, 0.0)) for name in JITTER)
    if not late > 0:
        return cube
    parts = {name: factor * cube[name] for name in ("u", "v", "w")}
    parts["z"] = late / float(cube.attrs["frame_rate"]) * cube["z_t"]
    total = {
        f"{name}_std": xr.apply_ufunc(
            np.hypot, cube[f"{name}_std"], part, dask="allowed", keep_attrs="override"
        )
        for name, part in parts.items()
    }
    return cube.assign(total)


def mark_discontinuous(status: NDArray[np.uint8], attributes: Mapping[str, Any]) -> NDArray[np.uint8]:
    """Status of the steps, (n,), where those that the cube's attributes name are discontinuous."""
    named = np.isin(np.arange(status.size), attributes.get(DISCONTINUOUS_STEPS, ()))
    measured = np.isin(status, (FrameStatus.DONE, FrameStatus.DONE_WITH_FAULTS))
    return np.where(named & measured, np.uint8(FrameStatus.DISCONTINUOUS), status)


def without_discontinuous(cube: "xr.Dataset") -> "xr.Dataset":
    """Leave out the values of discontinuous steps."""
    if DISCONTINUOUS_STEPS not in cube.attrs:
        return cube
    kept = cube["frame_status"] != int(FrameStatus.DISCONTINUOUS)
    fields = {name: cube[name] for name in CUBE_FIELDS if name in cube}
    return cube.assign(
        {n: one.where(kept, one.dtype.type(0 if n == "quality" else np.nan)) for n, one in fields.items()}
    )


def open_stored(path: str | Path, chunks: Chunks = "auto") -> "xr.Dataset":
    """Open all that a cube's store holds, as it is stored, but the status of discontinuous steps; parameters
    and errors as of `open_cube`.
    """
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
    if DISCONTINUOUS_STEPS in out.attrs:
        status = mark_discontinuous(out["frame_status"].values, out.attrs)
        out["frame_status"] = out["frame_status"].copy(data=status)
    return out
