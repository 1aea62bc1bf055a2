"""Verify that a store holds what its ledger lists: every chunk present, and as it was written."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from wavefield.errors import StoreError
from wavefield.store.checked import (
    checksum,
    description,
    note_damaged,
    noted_damaged,
    read_chunk,
    stored_bytes,
)
from wavefield.store.ledger_files import ledger_checksum
from wavefield.store.metadata import WATCHED, completed_ledger, differs_from_completed
from wavefield.store.read import open_group, read_layout
from wavefield.text import spell_ranges
from wavefield.variables import FrameStatus


@dataclass(frozen=True)
class Damage:
    """What is wrong with one chunk of one variable."""

    variable: str
    start: int  # Range of steps
    stop: int
    what: str  # "missing", "not as it was written", "not as long as it was written" or "unreadable"


@dataclass(frozen=True)
class Verification:
    """What was found in a store."""

    store: Path
    steps: int  # Steps of the whole run
    done: int  # Steps that the ledger calls done
    damages: tuple[Damage, ...]  # Chunks that the ledger calls done and that are not as they were written
    read: bool = True  # Whether data were read; else only sizes of files were compared

    @property
    def sound(self) -> bool:
        """Whether everything is there that the ledger calls done."""
        return not self.damages

    @property
    def starts(self) -> list[int]:
        """First steps of the damaged chunks, in order."""
        return sorted({damage.start for damage in self.damages})

    def __str__(self) -> str:
        if self.sound:
            how = (
                "as written" if self.read else "there, as long as when they were written (no data were read)"
            )
            return f"{self.store}: {self.done} of {self.steps} steps are done, and all of them are {how}"
        lines = [f"{self.store}: {len(self.starts)} chunks are damaged"]
        for what in dict.fromkeys(damage.what for damage in self.damages):
            of = [damage for damage in self.damages if damage.what == what]
            steps = sorted({step for damage in of for step in range(damage.start, damage.stop)})
            names = ", ".join(dict.fromkeys(damage.variable for damage in of))
            lines.append(f"  {what}: {names}, steps {spell_ranges(steps)}")
        lines.append("  run the same command as before: these chunks are measured again")
        return "\n".join(lines)


def verify(
    store: str | Path, progress: Callable[[int, int], None] | None = None, read: bool = True
) -> Verification:
    """Compare every chunk that a store calls done with the checksums taken when it was written.

    Parameters
    ----------
    store : path
        Written by `run`, finished or not.
    progress : callable, optional
        Called with (chunks done, all chunks).
    read : bool
        Whether to read the data. If not, what is compared is the size of every file: seconds, whatever the
        cube, but bytes that changed in place are not found.

    Returns
    -------
    Verification

    Raises
    ------
    StoreError
        If it is not there, is not a cube, has no checksums, or its metadata are damaged.

    Notes
    -----
    What is damaged is noted next to the store (``cube.zarr``: ``damaged.json``): the next run, which itself
    compares the sizes of files only, measures it again.

    Examples
    --------
    A store of two steps, of which a file is lost.

    >>> import tempfile
    >>> import numpy as np
    >>> from wavefield.store.checked import chunk_path
    >>> from wavefield.store.layout import StoreLayout, create_store
    >>> from wavefield.store.recipe import Recipe
    >>> from wavefield.store.write_cube import write_chunk
    >>> from wavefield.variables import CUBE_FIELDS
    >>> recipe, layout = Recipe("basin", {}, (0, 2), 20.0, {}, {}, {}), StoreLayout(2, 2, ("left",
    ... "right"), 0)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     store = Path(folder) / "cube.zarr"
    ...     create_store(store, recipe, np.arange(4) * 0.1, np.arange(3) * 0.1, layout, {})
    ...     fields = {name: np.ones((2, 3, 4), np.float32) for name in CUBE_FIELDS}
    ...     write_chunk(store, 0, fields, np.full(2, FrameStatus.DONE), {})
    ...     before = verify(store)
    ...     chunk_path(store, "z", 0).unlink()
    ...     after = verify(store)
    >>> before.done, before.sound
    (2, True)
    >>> [(damage.variable, damage.what) for damage in after.damages]
    [('z', 'missing')]
    """
    path = Path(store)
    group = open_group(path)
    if "stored_bytes" not in group:
        raise StoreError(f"{path} was written by version 0.1.0, without checksums; run the experiment again")
    layout, kept = read_layout(group), completed_ledger(path)
    chunks, damages, done = layout.chunks(), list[Damage](), 0
    for number, (start, stop) in enumerate(chunks):
        ledger = read_chunk(str(path), "frame_status", number)
        if ledger is not None:
            if len(ledger) != layout.chunk_steps:
                damages.append(Damage("frame_status", start, stop, "unreadable"))
            elif any(ledger):
                done += len(ledger[: stop - start]) - ledger[: stop - start].count(FrameStatus.NOT_STARTED)
                damages += _damages(path, number, (start, stop), read)
        if progress:
            progress(number + 1, len(chunks))
    if differs_from_completed(path, kept, ledger_checksum(path, layout)):
        started = [any(read_chunk(str(path), "frame_status", k) or b"") for k in range(len(chunks))]
        lost = [ends for ends, any_step in zip(chunks, started) if not any_step]
        damages += [Damage("frame_status", *ends, "missing") for ends in lost or chunks]
    out = Verification(path, layout.steps, done, tuple(damages), read)
    if read:
        note_damaged(path, out.starts)
    return out


def suspicious(store: Path) -> list[int]:
    """First steps of chunks that differ from the ledger, without reading all of the store."""
    found = set(verify(store, read=False).starts)
    noted = noted_damaged(store) - found
    for number, (start, stop) in enumerate(read_layout(open_group(store)).chunks()):
        if start in noted and _damages(store, number, (start, stop), read=True):
            found.add(start)
    return sorted(found)


def _damages(path: Path, number: int, ends: tuple[int, int], read: bool) -> list[Damage]:
    """What of a chunk is not as it was when its files were described: by checksum, or by size alone."""
    kind, describe, changed = (
        ("checksum", checksum, "not as it was written")
        if read
        else ("stored_bytes", stored_bytes, "not as long as it was written")
    )
    expected = description(path, kind, number) or [0] * len(WATCHED)  # damaged itself
    found = [describe(path, name, number) for name in WATCHED]
    return [
        Damage(name, *ends, changed if one else "missing")
        for name, one, other in zip(WATCHED, found, expected)
        if one != other
    ]
