"""Verify that a store holds what its ledger lists: every chunk present, and as it was written."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wavefield.errors import StoreError
from wavefield.store.blocks import ledger_checksum
from wavefield.store.checked import checksum, note_damaged, noted_damaged, stored_bytes
from wavefield.store.layout import WATCHED
from wavefield.store.metadata import is_as_completed
from wavefield.store.read import open_group, read_layout
from wavefield.text import spell_ranges
from wavefield.variables import FrameStatus


@dataclass(frozen=True)
class Damage:
    """What is wrong with one block of one variable."""

    variable: str  # The variable
    start: int  # Range of steps
    stop: int
    what: str  # "missing", "not as it was written", "not as long as it was written" or "unreadable"


@dataclass(frozen=True)
class Verification:
    """What was found in a store."""

    store: Path  # The store
    steps: int  # Steps of the whole run
    done: int  # Steps that the ledger calls done
    damages: tuple[Damage, ...]  # Blocks that the ledger calls done and that are not as they were written
    read: bool = True  # Whether data were read; else only sizes of files were compared

    @property
    def sound(self) -> bool:
        """Whether everything is there that the ledger calls done."""
        return not self.damages

    @property
    def starts(self) -> list[int]:
        """First steps of the damaged blocks, in order."""
        return sorted({damage.start for damage in self.damages})

    def __str__(self) -> str:
        if self.sound:
            how = (
                "as written" if self.read else "there, as long as when they were written (no data were read)"
            )
            return f"{self.store}: {self.done} of {self.steps} steps are done, and all of them are {how}"
        lines = [f"{self.store}: {len(self.starts)} blocks are damaged"]
        for what in dict.fromkeys(damage.what for damage in self.damages):
            of = [damage for damage in self.damages if damage.what == what]
            steps = sorted({step for damage in of for step in range(damage.start, damage.stop)})
            names = ", ".join(dict.fromkeys(damage.variable for damage in of))
            lines.append(f"  {what}: {names}, steps {spell_ranges(steps)}")
        lines.append("  run the same command as before: these blocks are measured again")
        return "\n".join(lines)


def verify(
    store: str | Path, progress: Callable[[int, int], None] | None = None, read: bool = True
) -> Verification:
    """Compare every block that a store calls done with the checksums taken when it was written.

    Parameters
    ----------
    store : path
        Written by `run`, finished or not.
    progress : callable, optional
        Told (blocks done, all blocks).
    read : bool
        Whether to read the data. If not, what is compared is the size of every file: seconds, whatever the
        cube, but bytes that changed in place are not seen.

    Returns
    -------
    Verification

    Raises
    ------
    StoreError
        If it is not there, is not a cube, or is damaged beyond repair: a whole variable is missing.

    Notes
    -----
    What is damaged is noted next to the store (``cube.zarr``: ``damaged.json``): the next run, which itself
    compares the sizes of files only, measures it again.

    Examples
    --------
    A store of two steps, of which a file is lost.

    >>> import tempfile
    >>> from wavefield.store.checked import chunk_path
    >>> from wavefield.store.layout import StoreLayout, create_store
    >>> from wavefield.store.recipe import Recipe
    >>> from wavefield.store.write_cube import write_block
    >>> from wavefield.variables import CUBE_FIELDS
    >>> recipe, layout = Recipe("basin", {}, (0, 2), 20.0, {}, {}, {}), StoreLayout(2, 2, ("left",
    ... "right"), 0)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     store = Path(folder) / "cube.zarr"
    ...     create_store(store, recipe, np.arange(4) * 0.1, np.arange(3) * 0.1, layout, {})
    ...     fields = {name: np.ones((2, 3, 4), np.float32) for name in CUBE_FIELDS}
    ...     write_block(store, 0, fields, np.full(2, FrameStatus.DONE), {})
    ...     before = verify(store)
    ...     chunk_path(store, "z", 0).unlink()
    ...     after = verify(store)
    >>> before.done, before.sound
    (2, True)
    >>> [(damage.variable, damage.what) for damage in after.damages]
    [('z', 'missing')]
    """
    path = Path(store)
    group = _whole_group(path)
    layout = read_layout(group)
    blocks = layout.blocks()
    read = read or "stored_bytes" not in group  # begun before sizes were kept
    ledger, damages = _ledger(group, blocks)
    sizes = None if read else _sizes(group, len(blocks))
    for k, (start, stop) in enumerate(blocks):
        if (ledger[start:stop] != FrameStatus.NOT_STARTED).any():
            found = _compared(path, group, k) if sizes is None else _sized(path, sizes[k], k)
            damages += [Damage(name, start, stop, what) for name, what in found.items()]
        if progress:
            progress(k + 1, len(blocks))
    if not is_as_completed(path, ledger_checksum(path, layout)):
        lost = [(a, b) for a, b in blocks if not ledger[a:b].any()]
        damages += [Damage("frame_status", a, b, "missing") for a, b in lost or blocks]
    done = int(np.count_nonzero(ledger != FrameStatus.NOT_STARTED))
    out = Verification(path, layout.steps, done, tuple(damages), read)
    if read:
        note_damaged(path, out.starts)
    return out


def suspicious(store: Path) -> list[int]:
    """Chunks that differ from the ledger, without reading all of the store."""
    found = verify(store, read=False)
    if found.read:  # all of it was
        return found.starts
    group = open_group(store)
    noted = noted_damaged(store).difference(found.starts)
    blocks = enumerate(read_layout(group).blocks())
    still = [start for k, (start, _) in blocks if start in noted and _compared(store, group, k)]
    return sorted([*found.starts, *still])


def _check_variable(path: Path, group: Any, name: str) -> None:
    try:
        array = group[name]
        if name in ("time", "y", "x", "frame") and not np.isfinite(array[:]).all():
            raise ValueError("it has no values")
    except Exception as error:
        raise StoreError(
            f"{path}: {name} cannot be read ({error}); this store cannot be repaired: remove it and run again"
        ) from None


def _ledger(group: Any, blocks: list[tuple[int, int]]) -> tuple[np.ndarray, list[Damage]]:
    """The ledger, and the blocks of which it cannot be read."""
    ledger = np.zeros(group["frame_status"].shape, np.uint8)
    damages = []
    stored = group["frame_status"]
    try:
        return np.asarray(stored[:]), []
    except Exception:  # whatever a codec makes of damaged bytes: which of the blocks is it?
        for start, stop in blocks:
            try:
                ledger[start:stop] = stored[start:stop]
            except Exception:
                damages.append(Damage("frame_status", start, stop, "unreadable"))
    return ledger, damages


def _whole_group(path: Path) -> Any:
    """The store opened, with every variable there."""
    group = open_group(path)
    for name in ("time", "y", "x", "frame", *WATCHED):
        if name == "camera_shift" and name not in group:  # only with `vibration: correct`
            continue
        _check_variable(path, group, name)
    return group


def _sizes(group: Any, blocks: int) -> np.ndarray:
    """Bytes of every block by variable when it was written; -1 where that cannot be read."""
    stored = group["stored_bytes"]
    try:
        return np.asarray(stored[:], np.int64)
    except Exception:  # damaged itself
        out = np.full(stored.shape, -1, np.int64)
        for k in range(blocks):
            with suppress(Exception):
                out[k] = stored[k]
    return out


def _sized(path: Path, requested: np.ndarray, block: int) -> dict[str, str]:
    """What is wrong with a block's variables by the sizes of their files."""
    out = {}
    for name, size in zip(WATCHED, requested):
        found = stored_bytes(path, name, block)
        if found != size:
            out[name] = "not as long as it was written" if found else "missing"
    return out


def _compared(path: Path, group: Any, block: int) -> dict[str, str]:
    """What is wrong with a block's variables by their checksums."""
    requested = _requested(group, block)
    names = [name for name in WATCHED if name in group] if requested is None else requested
    found = {name: _compare(path, group, name, block, requested) for name in names}
    return {name: what for name, what in found.items() if what}


def _requested(group: Any, block: int) -> dict[str, int] | None:
    """Checksums of a block by variable; None in stores made before there were any."""
    if "checksum" not in group:
        return None
    try:
        return dict(zip(WATCHED, (int(value) for value in group["checksum"][block])))
    except Exception:  # damaged itself
        return dict.fromkeys(WATCHED, 0)


def _compare(path: Path, group: Any, name: str, block: int, requested: dict[str, int] | None) -> str:
    if requested is None:
        try:
            layout = read_layout(group)
            start, stop = layout.blocks()[block]
            group[name][start:stop] if name != "frame_fault" else group[name][:, start:stop]
        except Exception:
            return "unreadable"
        return ""
    found = checksum(path, name, block)
    if found == requested[name]:
        return ""
    return "missing" if found == 0 else "not as it was written"
