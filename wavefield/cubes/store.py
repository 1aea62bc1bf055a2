"""The cube's store: a Zarr v3 group, made whole before the first step is measured, filled block by block.

Each block is one shard of every variable, and one chunk of the ledger. `write_block` is the only function
that writes results; no two blocks ever touch the same file, so any number of processes may write at once.
Whole files are renamed into place, so a killed writer never leaves half a shard. The ledger
``frame_status(time)`` is written last: a step that is marked done has all its data.
"""

import errno
import json
import os
import shutil
import uuid
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import zarr
from zarr.codecs import BloscCodec

from wavefield.errors import StoreError
from wavefield.variables import CUBE_DIMS, CUBE_FIELDS, TABLE, FrameFault, FrameStatus, Variable, register

if TYPE_CHECKING:  # not needed by workers, and slow to import
    import xarray as xr

    from wavefield.cubes.recipe import Recipe

register(
    Variable("frame", ("frame",), "1", "frame number", dtype="int64"),
    Variable(
        "frame_fault",
        ("camera", "frame"),
        "1",
        "what was wrong with a frame",
        dtype="uint8",
        extra={
            "flag_values": [int(fault) for fault in FrameFault],
            "flag_meanings": " ".join(fault.name.lower() for fault in FrameFault),
        },
    ),
)

# value = scale * stored; -32768 is missing, and so is what does not fit into 16 bits
PACKING = {
    "z": 1e-5,
    "z_t": 1e-4,
    "u": 1e-4,
    "v": 1e-4,
    "w": 1e-4,
    "eps_y": 1e-5,
    "eps_piv": 1e-3,
    "z_std": 1e-6,
    "u_std": 1e-5,
    "v_std": 1e-5,
    "w_std": 1e-5,
}
_MISSING = -32768
# half the time of level 3, and files 3 % larger
COMPRESSION: dict[str, Any] = {"cname": "zstd", "clevel": 1}
_CHUNK_STEPS = 8  # steps that a reader must decode to see one


@dataclass(frozen=True)
class Layout:
    """Sizes of a store.

    Parameters
    ----------
    steps : int
        Number of steps; there is one frame more.
    block : int
        Steps per block (shard).
    cameras : tuple of str
        Cameras whose frames are watched.
    first_frame : int
        Number of the first frame.
    """

    steps: int
    block: int
    cameras: tuple[str, ...]
    first_frame: int

    def blocks(self) -> list[tuple[int, int]]:
        """Ranges of steps of all blocks, in order.

        Returns
        -------
        list of (start, stop)
        """
        return [(i, min(i + self.block, self.steps)) for i in range(0, self.steps, self.block)]


def create_store(
    path: Path,
    recipe: "Recipe",
    x: np.ndarray,
    y: np.ndarray,
    layout: Layout,
    attributes: Mapping[str, Any],
) -> None:
    """Make an empty store: metadata, coordinates, attributes. It appears whole or not at all.

    Parameters
    ----------
    path : path
        The store.
    recipe : Recipe
        Put into the attributes with its hash.
    x, y : ndarray
        Nodes, metres.
    layout : Layout
        Sizes.
    attributes : mapping
        Further attributes.

    Raises
    ------
    StoreError
        If it cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _fill_in(temporary, recipe, x, y, layout, attributes)
        temporary.rename(path)
    except OSError as error:
        shutil.rmtree(temporary, ignore_errors=True)
        raise write_error(path, error) from None


def _fill_in(
    path: Path, recipe: "Recipe", x: np.ndarray, y: np.ndarray, layout: Layout, attributes: Mapping[str, Any]
) -> None:
    n, block = layout.steps, layout.block
    group = zarr.open_group(
        path,
        mode="w",
        zarr_format=3,
        attributes={
            "Conventions": "CF-1.11",
            "title": f"water surface and its velocity, {recipe.experiment}",
            "experiment": recipe.experiment,
            "frame_rate": recipe.frame_rate,
            "cameras": list(layout.cameras),
            "steps_per_block": block,
            "recipe": recipe.to_json(),
            "recipe_hash": recipe.hash,
            "wavefield_version": recipe.wavefield,
            **attributes,
        },
    )
    frames = layout.first_frame + np.arange(n + 1)
    for name, values in (
        ("time", (frames[:-1] + 0.5) / recipe.frame_rate),
        ("y", y),
        ("x", x),
        ("frame", frames),
    ):
        row = TABLE[name]
        array = group.create_array(
            name,
            shape=values.shape,
            chunks=values.shape,
            dtype=row.dtype,
            dimension_names=row.dims,
            attributes=row.attrs,
        )
        array[:] = values
    chunk = max(k for k in range(1, _CHUNK_STEPS + 1) if block % k == 0)
    for name in CUBE_FIELDS:
        row = TABLE[name]
        packed = recipe.packing == "int16" and name in PACKING
        dtype = "int16" if packed else row.dtype
        fill: Any = _MISSING if packed else np.nan if dtype == "float32" else 0
        encoding = (
            {"scale_factor": PACKING[name], "add_offset": 0.0, "_FillValue": _MISSING} if packed else {}
        )
        group.create_array(
            name,
            shape=(n, y.size, x.size),
            chunks=(chunk, y.size, x.size),
            shards=(block, y.size, x.size),
            dtype=dtype,
            fill_value=fill,
            compressors=BloscCodec(**COMPRESSION, shuffle="shuffle"),
            dimension_names=CUBE_DIMS,
            attributes=row.attrs | encoding,
        )
    for name, shape, chunks in (
        ("frame_status", (n,), (block,)),
        ("frame_fault", (len(layout.cameras), n + 1), (len(layout.cameras), block)),
    ):
        row = TABLE[name]
        group.create_array(
            name,
            shape=shape,
            chunks=chunks,
            dtype=row.dtype,
            fill_value=0,
            dimension_names=row.dims,
            attributes=row.attrs,
        )
    with warnings.catch_warnings():
        # metadata never change after this, so that gathering them is safe; it spares readers a warning
        warnings.simplefilter("ignore")
        zarr.consolidate_metadata(path)


def open_group(path: Path, mode: Any = "r") -> Any:
    """Open a store made by `create_store`.

    Parameters
    ----------
    path : path
        The store.
    mode : {"r", "r+"}
        To read, or to read and write.

    Returns
    -------
    zarr.Group

    Raises
    ------
    StoreError
        If it is not there or is not a cube.
    """
    if not path.exists():
        raise StoreError(f"{path}: no such store; make one with `wavefield run`")
    try:
        group = zarr.open_group(path, mode=mode, use_consolidated=False)
        if "recipe" in group.attrs and "frame_status" in group:
            return group
    except Exception as error:
        raise StoreError(f"{path} cannot be opened as a Zarr store: {error}") from None
    raise StoreError(f"{path} is not a cube of `wavefield run`; choose another name")


def read_layout(group: Any) -> Layout:
    """Sizes of an open store.

    Parameters
    ----------
    group : zarr.Group
        As from `open_group`.

    Returns
    -------
    Layout
    """
    frames = group["frame"]
    return Layout(
        steps=group["frame_status"].shape[0],
        block=int(group.attrs["steps_per_block"]),
        cameras=tuple(group.attrs["cameras"]),
        first_frame=int(frames[0]),
    )


def check_recipe(path: Path, group: Any, recipe: "Recipe") -> None:
    """Refuse to go on with a store that was made with another recipe.

    Parameters
    ----------
    path : path
        The store, for the message.
    group : zarr.Group
        The open store.
    recipe : Recipe
        Of the run that wants to go on.

    Raises
    ------
    StoreError
        If the recipes differ; the message says in what.
    """
    from wavefield.cubes.recipe import differences

    if group.attrs["recipe_hash"] == recipe.hash:
        return
    found = differences(str(group.attrs["recipe"]), recipe.to_json())
    more = f" and {len(found) - 2} more" if len(found) > 2 else ""
    raise StoreError(
        f"{path} was made with another recipe ({'; '.join(found[:2])}{more}); "
        "write to another store with -o, or remove this one"
    )


def write_block(
    path: Path,
    start: int,
    fields: Mapping[str, np.ndarray],
    frame_status: np.ndarray,
    faults: Mapping[str, Mapping[int, FrameFault]],
) -> None:
    """Write all results of one block, the ledger last. The only function that writes results.

    Parameters
    ----------
    path : path
        The store.
    start : int
        First step; must begin a block.
    fields : mapping of str to ndarray, (n, ny, nx)
        Every variable of the cube; n must be a whole block, or what is left at the end.
    frame_status : ndarray of uint8, (n,)
        Ledger of these steps; never NOT_STARTED.
    faults : mapping of str to mapping of int to FrameFault
        Bad frames by camera and index; those of neighbouring blocks are left to them.

    Raises
    ------
    StoreError
        If the disk is full or the store cannot be written; nothing that was written before is harmed.
    ValueError
        If the arrays are not those of one whole block.
    """
    group = open_group(path, "r+")
    layout = read_layout(group)
    stop = min(start + layout.block, layout.steps)
    if start % layout.block or not 0 <= start < layout.steps:
        raise ValueError(f"step {start} does not begin a block of {layout.block}")
    if frame_status.shape != (stop - start,) or not frame_status.all():
        raise ValueError(f"the ledger of steps {start} to {stop} must hold {stop - start} results")
    absent = [name for name in CUBE_FIELDS if name not in fields]
    if absent:
        raise ValueError(f"the measurement gave no {', '.join(absent)}")
    try:
        for name in CUBE_FIELDS:
            array = group[name]
            values = np.asarray(fields[name])
            if values.shape != (stop - start, *array.shape[1:]):
                raise ValueError(
                    f"{name} has shape {values.shape}, expected {(stop - start, *array.shape[1:])}"
                )
            array[start:stop] = pack(values, name) if array.dtype == np.int16 else values
        last = layout.steps + 1 if stop == layout.steps else stop  # the last block owns the last frame
        codes = np.zeros((len(layout.cameras), last - start), np.uint8)
        for k, camera in enumerate(layout.cameras):
            for index, fault in faults.get(camera, {}).items():
                if start <= index < last:
                    codes[k, index - start] = fault
        group["frame_fault"][:, start:last] = codes
        group["frame_status"][start:stop] = frame_status
    except OSError as error:
        raise write_error(path, error) from None


def reset_blocks(path: Path, starts: Sequence[int]) -> None:
    """Mark blocks as not started, before they are measured again.

    Parameters
    ----------
    path : path
        The store.
    starts : sequence of int
        First steps of the blocks.
    """
    group = open_group(path, "r+")
    layout = read_layout(group)
    for start in starts:
        stop = min(start + layout.block, layout.steps)
        group["frame_status"][start:stop] = np.uint8(FrameStatus.NOT_STARTED)


def pack(values: np.ndarray, name: str) -> np.ndarray:
    """Pack a variable into 16 bits.

    Parameters
    ----------
    values : ndarray of float
        In units of the table.
    name : str
        The variable.

    Returns
    -------
    ndarray of int16
        Round(values / scale); -32768 where values are missing or do not fit.
    """
    with np.errstate(invalid="ignore"):
        scaled = np.rint(values / PACKING[name])
        return np.where(np.abs(scaled) <= 32767, scaled, _MISSING).astype(np.int16)


def clean_up(path: Path) -> None:
    """Remove what killed writers left behind (files that were never renamed into place).

    Parameters
    ----------
    path : path
        The store.
    """
    for folder, _, names in os.walk(path):
        for name in names:
            if name.endswith(".partial"):
                (Path(folder) / name).unlink(missing_ok=True)
    for left in path.parent.glob(f".{path.name}.*.partial"):
        shutil.rmtree(left, ignore_errors=True)


def write_error(path: Path, error: OSError) -> StoreError:
    """Turn a failed write into a sentence.

    Parameters
    ----------
    path : path
        The store.
    error : OSError
        What went wrong.

    Returns
    -------
    StoreError
    """
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return StoreError(
            f"the disk that holds {path} is full; nothing that was written is lost: free some room "
            "and run the same command again to go on"
        )
    return StoreError(f"{path} cannot be written: {error.strerror or error}; check its disk and permissions")


def open_cube(path: str | Path, chunks: Any = "auto") -> "xr.Dataset":
    """Open a cube, lazily.

    Parameters
    ----------
    path : path
        Store written by `run`.
    chunks : optional
        As in `xarray.open_zarr`; by default one Dask chunk per block.

    Returns
    -------
    Dataset
        The variables of `wavefield.variables`, attributes with the recipe; steps not yet measured are NaN.

    Raises
    ------
    StoreError
        If it is not there or is not a cube.
    """
    import xarray as xr

    path = Path(str(path).removeprefix("file://"))
    group = open_group(path)
    if chunks == "auto":
        chunks = {"time": read_layout(group).block}
    cube = xr.open_zarr(path, chunks=chunks, consolidated=False)
    for name in PACKING:
        if cube[name].dtype == "float64":  # as 16-bit values are unpacked
            cube[name] = cube[name].astype("float32")
    return cube


def cube_recipe(dataset: "xr.Dataset") -> dict[str, Any]:
    """The recipe in the attributes of a cube.

    Parameters
    ----------
    dataset : Dataset
        As from `open_cube`.

    Returns
    -------
    dict
    """
    return json.loads(dataset.attrs["recipe"])
