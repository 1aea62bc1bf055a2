"""Write results into a cube chunk by chunk; clear or reset steps; change the name and description.

Any number of processes may write different chunks at once. Files are renamed into place when complete, so a
killed process never leaves half a file. ``frame_status`` is written last: a step marked done is complete."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import zarr

from wavefield.atomic_write import make_durable, writing
from wavefield.store.layout import (
    CHUNKED,
    DESCRIPTION,
    FILES_OF_ALL_CHUNKS,
    FINISHED,
    MISSING,
    PACKING,
    CubeGroup,
    chunk_path,
    in_16_bits,
    title,
    update_metadata,
)
from wavefield.store.preview import read_steps, write_preview
from wavefield.store.read import open_group, read_layout
from wavefield.variables import CUBE_FIELDS, FrameFault, FrameStatus


def write_chunk(
    path: Path,
    start: int,
    fields: Mapping[str, np.ndarray],
    frame_status: np.ndarray,
    faults: Mapping[str, Mapping[int, FrameFault]],
) -> None:
    """Write all results of the chunk that begins with step `start` into the cube at `path`.
    `fields` has the variables `CUBE_FIELDS`, (n, ny, nx), in SI units (px for ``eps_piv``), `frame_status`
    (n,) the `FrameStatus` of each step, and `faults` the faults of bad frames by camera and frame index."""
    group = open_group(path, "r+")
    layout = read_layout(group)
    stop = min(start + layout.chunk_steps, layout.steps)
    if start % layout.chunk_steps or not 0 <= start < layout.steps:
        raise ValueError(f"step {start} does not begin a chunk of {layout.chunk_steps}")
    if frame_status.shape != (stop - start,) or not frame_status.all():
        raise ValueError(f"the ledger of steps {start} to {stop} must hold {stop - start} results")
    with writing(path), zarr.config.set(FILES_OF_ALL_CHUNKS):
        for name in ("frame_status", *CHUNKED):  # Zarr would first read these files, which may be damaged
            chunk_path(path, name, start // layout.chunk_steps).unlink(missing_ok=True)
        for name in CUBE_FIELDS:
            array = group[name]
            values = np.asarray(fields[name])
            array[start:stop] = in_16_bits(values, PACKING[name]) if array.dtype == np.int16 else values
        last = layout.steps + 1 if stop == layout.steps else stop  # the last chunk has one frame more
        codes = np.zeros((len(layout.cameras), last - start), np.uint8)
        for k, camera in enumerate(layout.cameras):
            for index, fault in faults.get(camera, {}).items():
                if start <= index < last:
                    codes[k, index - start] = fault
        group["frame_fault"][:, start:last] = codes
        write_preview(group, start, fields)
        _to_disk(path, start // layout.chunk_steps, CHUNKED[:-1])
        _write_ledger(path, group, start, frame_status)


def clear_steps(path: Path, steps: Sequence[int]) -> None:
    """Clear the values of the measured steps among `steps` (indices), and mark them as discontinuous in time.
    Cleared values are NaN, and 0 in ``quality``. The status of all steps is written before any value, so that
    the next run can finish the work after an interruption."""
    group = open_group(path, "r+")
    layout = read_layout(group)
    with writing(path), zarr.config.set(FILES_OF_ALL_CHUNKS):
        cleared = {}
        for start, stop in layout.chunks():
            status = np.asarray(group["frame_status"][start:stop])
            named = np.isin(np.arange(start, stop), steps)
            named &= ~np.isin(status, (FrameStatus.NOT_STARTED, FrameStatus.FAILED))
            if named.any():
                cleared[start] = named, np.where(named, np.uint8(FrameStatus.DISCONTINUOUS), status)
                _write_ledger(path, group, start, cleared[start][1])
        for start, (named, _) in cleared.items():
            fields = {}
            for name in CUBE_FIELDS:
                stored = np.asarray(group[name][start : start + named.size])
                stored[named] = {"f": np.nan, "i": MISSING, "u": 0}[stored.dtype.kind]
                group[name][start : start + named.size] = stored
                fields[name] = read_steps(group, name, start, start + named.size)
            write_preview(group, start, fields)
            _to_disk(path, start // layout.chunk_steps, CHUNKED[:-1])


def relabel(path: Path, name: str, description: Mapping[str, object]) -> list[str]:
    """Set the experiment's name and the attributes `DESCRIPTION` of a cube; those not given are removed.
    Returns a line for each change, with the old value ("there") and the new value ("here")."""
    labels = {"experiment": name, "title": title(name), **dict.fromkeys(DESCRIPTION), **description}
    there = open_group(path).attrs
    changed = [key for key, value in labels.items() if there.get(key) != value]
    if changed:
        update_metadata(path, labels)
    return [f"{key}: {there.get(key)!r} there, {labels[key]!r} here" for key in changed]


def _write_ledger(path: Path, group: CubeGroup, start: int, frame_status: np.ndarray) -> None:
    """Write the `frame_status` (n,) of the chunk that begins with step `start`, and wait for the disk."""
    group["frame_status"][start : start + frame_status.size] = frame_status
    _to_disk(path, start // read_layout(group).chunk_steps, ("frame_status",))


def _to_disk(path: Path, chunk: int, names: Sequence[str]) -> None:
    """Wait until the files of the chunk number `chunk`, from 0, of the arrays `names` are on the disk."""
    folders: dict[Path, None] = {}
    for name in names:
        file = chunk_path(path, name, chunk)
        make_durable([file])
        folders |= dict.fromkeys(
            parent for parent in file.parents if parent.is_relative_to(path / name / "c")
        )
    make_durable(folders)


def reset_chunks(path: Path, starts: Sequence[int]) -> None:
    """Mark the chunks that begin with the steps `starts` as not started, and the cube as unfinished."""
    if not starts:
        return
    update_metadata(path, {FINISHED: None})
    size = read_layout(open_group(path)).chunk_steps
    with writing(path):
        for start in starts:
            chunk_path(path, "frame_status", start // size).unlink(missing_ok=True)


def remove_partial_files(path: Path) -> None:
    """Remove the unfinished files that killed writers left in a store; Zarr names them *.partial."""
    for file in path.rglob("*.partial"):
        file.unlink(missing_ok=True)
