"""Verify a store: every file that should be there is, and its checksum is right."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wavefield.atomic_write import MARK_ATTRIBUTE, read_mark
from wavefield.errors import StoreError
from wavefield.store.layout import CHUNKED, CubeGroup, StoreLayout, chunk_path
from wavefield.store.metadata import FINISHED
from wavefield.store.read import find_store, is_cube, open_group, open_stored, read_layout
from wavefield.store.write_cube import reset_chunks
from wavefield.text import spell_ranges
from wavefield.variables import FrameStatus


@dataclass(frozen=True)
class Damage:
    """What is wrong with one chunk of one variable."""

    variable: str
    start: int  # Range of steps
    stop: int
    what: str  # "missing" or "not as it was written"


@dataclass(frozen=True)
class Verification:
    """What was found in a store."""

    store: Path
    steps: int = 0  # Steps of the whole run; 0 for waves and smoothed fields
    done: int = 0  # Steps that the ledger calls done
    damages: tuple[Damage, ...] = ()
    marked: bool = False  # Whether the damaged chunks are now marked as not measured

    @property
    def sound(self) -> bool:
        """Whether nothing is missing or damaged."""
        return not self.damages

    @property
    def starts(self) -> list[int]:
        """First steps of the damaged chunks, in order."""
        return sorted({damage.start for damage in self.damages})

    def __str__(self) -> str:
        if not self.steps:
            state = "as it was written" if self.sound else "not as it was written: make it again"
            return f"{self.store} is {state}"
        if self.sound:
            return f"{self.store}: {self.done} of {self.steps} steps are done, and all of them are as written"
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
    """Read every chunk that a cube calls done, and compare it with its checksum.

    Parameters
    ----------
    store : path
        A cube, finished or not, or a store of waves or smoothed fields.
    progress : callable, optional
        Called with (chunks done, all chunks).

    Returns
    -------
    Verification

    Raises
    ------
    StoreError
        If it is not there, is not a store of this program, or its metadata are damaged.

    Notes
    -----
    Damaged chunks of a cube are marked as not measured: the next run measures them again. Waves and smoothed
    fields have one digest for the whole store.

    Examples
    --------
    A store of two steps, of which a file is lost.

    >>> import tempfile
    >>> from wavefield.store.layout import create_store
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
    path = find_store(store)
    if path.is_dir() and not is_cube(path) and _has_mark(path):
        sound = read_mark(path) is not None
        return Verification(path, damages=() if sound else (Damage("", 0, 0, "not as it was written"),))
    group = open_group(path)
    layout = read_layout(group)
    open_stored(path, chunks=None).drop_vars(CHUNKED, errors="ignore").load()  # axes, gains: raises
    chunks, damages, done = layout.chunks(), list[Damage](), 0
    for number, (start, stop) in enumerate(chunks):
        steps_done, found = _read_chunk(path, group, number, (start, stop))
        done += steps_done
        damages += found
        if progress:
            progress(number + 1, len(chunks))
    marked = False
    with suppress(StoreError, OSError):
        reset_chunks(path, sorted({damage.start for damage in damages}))
        marked = True
    return Verification(path, layout.steps, done, tuple(damages), marked)


def _has_mark(path: Path) -> bool:
    """Whether a Zarr store claims to be a product of this program."""
    with suppress(OSError):
        return MARK_ATTRIBUTE.encode() in (path / "zarr.json").read_bytes()
    return False


def _read_chunk(path: Path, group: CubeGroup, number: int, ends: tuple[int, int]) -> tuple[int, list[Damage]]:
    """Number of steps of a chunk that are done, and what is wrong with it."""
    steps, damages = slice(*ends), []
    try:
        ledger = np.asarray(group["frame_status"][steps])
    except Exception:  # whatever a codec makes of damaged bytes
        there = chunk_path(path, "frame_status", number).exists()
        return 0, [Damage("frame_status", *ends, "not as it was written" if there else "missing")]
    if not ledger.any():
        return 0, []
    for name in (name for name in CHUNKED if name in group):
        try:
            array = group[name]
            array[:, steps] if name in ("frame_fault", "camera_shift") else array[steps]
        except Exception:
            there = chunk_path(path, name, number).exists()
            damages.append(Damage(name, *ends, "not as it was written" if there else "missing"))
    return int(np.count_nonzero(ledger != FrameStatus.NOT_STARTED)), damages


def missing_chunks(path: Path, layout: StoreLayout) -> list[int]:
    """First steps of chunks of which files are missing although the ledger calls their steps done."""
    group = open_group(path)
    names = [name for name in CHUNKED if name in group]
    finished = bool(group.attrs.get(FINISHED))
    out = []
    for number, (start, stop) in enumerate(layout.chunks()):
        there = [chunk_path(path, name, number).exists() for name in names]
        try:
            done = bool(np.asarray(group["frame_status"][start:stop]).any())
        except Exception:  # a damaged or missing ledger: measured again
            done, there = True, [False]
        if not all(there) and (done or finished):
            out.append(start)
    return out
