"""Verify a store: check that all files exist, and that their checksums are right."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wavefield.atomic_write import has_mark, read_mark
from wavefield.errors import StoreError
from wavefield.store.layout import CHUNKED, CubeGroup, StoreLayout, chunk_path
from wavefield.store.read import find_store, is_cube, open_group, read_layout
from wavefield.store.write_cube import reset_chunks
from wavefield.text import spell_ranges


@dataclass(frozen=True)
class Damage:
    """Damage of one variable in one chunk of steps: a file is missing or was changed."""

    variable: str
    start: int  # First step of the chunk
    stop: int  # Step after its last
    what: str  # "missing" or "not as it was written"


@dataclass(frozen=True)
class Verification:
    """Result of `verify`: what is missing or damaged in a store, and how many steps it has."""

    store: Path
    steps: int = 0  # Steps of the whole run; 0 for waves and smoothed fields
    done: int = 0  # Steps that the run has tried, failed ones included, in chunks with a sound `frame_status`
    damages: tuple[Damage, ...] = ()
    marked: bool = False  # Whether the damaged chunks are now marked as not measured

    @property
    def sound(self) -> bool:
        """Whether the store is complete and undamaged."""
        return not self.damages

    @property
    def starts(self) -> list[int]:
        """The first step of each damaged chunk, in order."""
        return sorted({damage.start for damage in self.damages})

    def __str__(self) -> str:
        if not self.steps:
            state = "as it was written" if self.sound else "not as it was written: make it again"
            return f"{self.store} is {state}"
        if self.sound:
            return f"{self.store}: {self.done} of {self.steps} steps are done, and none of them is damaged"
        lines = [f"{self.store}: {len(self.starts)} chunks are damaged"]
        for what in dict.fromkeys(damage.what for damage in self.damages):
            of = [damage for damage in self.damages if damage.what == what]
            steps = sorted({step for damage in of for step in range(damage.start, damage.stop)})
            names = ", ".join(dict.fromkeys(damage.variable for damage in of))
            lines.append(f"  {what}: {names}, steps {spell_ranges(steps)}")
        lines.append(
            "  run the same command as before: these chunks are measured again"
            if self.marked
            else "  the cube cannot be written, so these chunks are not marked for a new measurement"
        )
        return "\n".join(lines)


def verify(store: str | Path, progress: Callable[[int, int], None] | None = None) -> Verification:
    """Read every chunk that a run has written, and compare it with its checksum.

    Parameters
    ----------
    store : path
        A cube, finished or not, or a store of waves or smoothed fields.
    progress : callable, optional
        Called after each chunk with the number of chunks that were read and the number of all chunks.

    Returns
    -------
    Verification
        The missing and damaged parts. Damaged chunks of a cube are also marked as not measured, if the cube
        can be written; the next run measures them again. Other stores have one checksum for the whole.

    Raises
    ------
    StoreError
        If the store does not exist, is not one of wavefield, or has damaged metadata.

    Examples
    --------
    A cube that has lost a file.

    >>> import shutil
    >>> copy = shutil.copytree("cube.zarr", "copy.zarr")
    >>> Path("copy.zarr/z/c/0/0/0").unlink()
    >>> [(damage.variable, damage.what) for damage in verify(copy).damages]
    [('z', 'missing')]
    """
    from wavefield.store.cube import open_stored  # imports xarray, which a run needs only at its end

    path = find_store(store)
    if path.is_dir() and not is_cube(path) and has_mark(path):
        sound = read_mark(path) is not None
        return Verification(path, damages=() if sound else (Damage("", 0, 0, "not as it was written"),))
    group = open_group(path)
    layout = read_layout(group)
    open_stored(path, chunks=None).drop_vars(CHUNKED, errors="ignore").load()  # axes, gains
    chunks, damages = layout.chunks(), list[Damage]()
    for number in range(len(chunks)):
        damages += _damages(path, group, layout, number)
        if progress:
            progress(number + 1, len(chunks))
    lost = {damage.start for damage in damages if damage.variable == "frame_status"}
    kept = [slice(start, stop) for start, stop in chunks if start not in lost]
    done = sum(int(np.count_nonzero(group["frame_status"][steps])) for steps in kept)
    marked = False
    with suppress(StoreError, OSError):
        reset_chunks(path, sorted({damage.start for damage in damages}))
        marked = True
    return Verification(path, layout.steps, done, tuple(damages), marked)


def _damages(
    path: Path, group: CubeGroup, layout: StoreLayout, number: int, read: bool = True
) -> Iterator[Damage]:
    """Yield the damage of the chunk `number`, from 0, of a cube; none if no run has written the chunk.
    If `read` is false, only ``frame_status`` is read, and other variables are checked for missing files."""
    start, stop = layout.chunks()[number]

    def damage(name: str) -> Damage:
        there = chunk_path(path, name, number).exists()
        return Damage(name, start, stop, "not as it was written" if there else "missing")

    try:
        if not np.asarray(group["frame_status"][start:stop]).any():
            return
    except Exception:  # codecs raise errors of many kinds on damaged bytes
        yield damage("frame_status")
        return
    for name in (name for name in CHUNKED if name in group):
        try:
            if read:
                _ = group[name][:, start:stop] if name == "frame_fault" else group[name][start:stop]
            elif not chunk_path(path, name, number).exists():
                yield damage(name)
        except Exception:
            yield damage(name)


def missing_chunks(path: Path, layout: StoreLayout) -> list[int]:
    """Return the first step of each chunk that lost a file, or whose ``frame_status`` is damaged."""
    group = open_group(path)
    numbered = enumerate(layout.chunks())
    return [
        start for number, (start, _) in numbered if any(_damages(path, group, layout, number, read=False))
    ]
