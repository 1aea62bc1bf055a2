"""What the pages look at: a cube, its preview in memory, and whatever else lies beside it."""

import threading
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.errors import StoreError, WavefieldError
from wavefield.explorer.map_fields import DERIVED, derive
from wavefield.explorer.selections import MISSING, decode
from wavefield.store import preview as previews
from wavefield.store.checked import chunk_path
from wavefield.store.layout import WATCHED
from wavefield.store.ledger_files import LEDGER, check_chunks
from wavefield.store.read import open_group, read_layout
from wavefield.variables import CUBE_DIMS, TABLE

_KEPT = 160  # steps of single variables in memory
_TOGETHER = 8  # steps that are decoded together anyway
_BALANCE = ("z", "z_t", "u", "v", "w")


class CubeRecord:
    """A cube for looking at: any variable at any step at once, everything at a node as soon as it is read."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path).absolute()
        self.group = open_group(self.path)
        self.layout = read_layout(self.group)
        check_chunks(self.path, self.group, self.layout, LEDGER)  # of fields each is checked as it is read
        self.time, self.y, self.x = (np.asarray(self.group[name][:]) for name in CUBE_DIMS)
        self.frame_rate = float(self.group.attrs["frame_rate"])
        self.experiment = str(self.group.attrs["experiment"])
        self.stored = tuple(n for n, a in self.group.arrays() if a.metadata.dimension_names == CUBE_DIMS)
        self.stored = tuple(sorted(self.stored, key=_in_order))
        self.names = (*self.stored, *(DERIVED if set(_BALANCE) <= set(self.stored) else ()))
        there = "path_frames" in self.group
        self.paths = {"path_frames": np.uint8(self.group["path_frames"][()])} if there else {}
        self._attrs = {name: dict(self.group[name].attrs) for name in self.stored}
        self._kept: OrderedDict[tuple[str, int], NDArray[Any]] = OrderedDict()
        self._lock = threading.Lock()
        self.ledger = np.zeros(self.layout.steps, np.uint8)
        self.refresh()
        self.preview = Preview(self)

    def units(self, name: str) -> str:
        """CF unit of a variable."""
        return "m s-1" if name == "residual" else "s-1" if name in DERIVED else self._attrs[name]["units"]

    def long_name(self, name: str) -> str:
        """What a variable is, in words."""
        return DERIVED[name][0] if name in DERIVED else str(self._attrs[name]["long_name"])

    def refresh(self) -> bool:
        """Look at the ledger again."""
        ledger = np.asarray(self.group["frame_status"][:])
        changed = not np.array_equal(ledger, self.ledger)
        if changed:
            for key in [k for k in self._kept if self.ledger[k[1]] != ledger[k[1]]]:
                self._kept.pop(key, None)
        self.ledger = ledger
        return changed

    @property
    def steps_done(self) -> int:
        """Steps that were tried."""
        return int(np.count_nonzero(self.ledger))

    def first_step(self) -> int:
        """A step to begin with: the first that was measured."""
        done = np.flatnonzero((self.ledger == 1) | (self.ledger == 2))
        return int(done[0]) if done.size else 0

    def field(self, name: str, step: int) -> NDArray[Any]:
        """A variable at one step, at every node.

        Returns (ny, nx): In stored units.
        """
        if name in DERIVED:
            return self._derived(name, step)
        with self._lock:
            if (name, step) not in self._kept:
                self._refuse_half(name, step)
                start = step - step % _TOGETHER
                stop = min(start + _TOGETHER, self.layout.steps)
                for k, values in enumerate(previews.read_steps(self.group, name, start, stop)):
                    self._kept[name, start + k] = values
            self._kept.move_to_end((name, step))
            out = self._kept[name, step]
            while len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        return out

    def _refuse_half(self, name: str, step: int) -> None:
        """Say so where the ledger knows of a file that is not there: it would look like nothing measured."""
        if "stored_bytes" not in self.group or name not in WATCHED:
            return
        block = step // self.layout.chunk_steps
        size = int(self.group["stored_bytes"][block, WATCHED.index(name)])
        if size > 0 and not chunk_path(self.path, name, block).exists():
            first, last = (
                block * self.layout.chunk_steps,
                min((block + 1) * self.layout.chunk_steps, self.layout.steps),
            )
            raise StoreError(
                f"{name} of steps {first} to {last - 1} is not in {self.path.name}, though it was written: "
                "copy the cube again, whole, or see `wavefield verify`"
            )

    def _derived(self, name: str, step: int) -> NDArray[Any]:
        around = [k for k in (step - 1, step, step + 1) if 0 <= k < self.layout.steps]
        steps = xr.Dataset(
            {n: (CUBE_DIMS, np.array([self.field(n, k) for k in around]), self._attrs[n]) for n in _BALANCE},
            coords={"time": self.time[around], "y": self.y, "x": self.x} | self.paths,
        )
        if len(around) < 2:
            return np.full((self.y.size, self.x.size), np.nan, np.float32)
        return derive(steps, name, around.index(step))


def _in_order(name: str) -> int:
    return list(TABLE).index(name) if name in TABLE else len(TABLE)


class Preview:
    """The thinned cube in memory; read once, in the background."""

    def __init__(self, record: CubeRecord) -> None:
        self._record = record
        self.thin = previews.thinning(record.group)
        self.y, self.x = record.y[:: self.thin.every], record.x[:: self.thin.every]
        blocks = record.layout.chunks()
        shape = len(self.thin.names), self.y.size, self.x.size, record.layout.steps
        self.fields = np.full(shape, MISSING, np.int16)
        self.known = np.zeros(len(blocks), bool)
        self.trouble = ""
        self._lock = threading.Lock()

    @property
    def requested(self) -> NDArray[np.bool_]:
        """Which blocks the cube has."""
        return previews.chunks_done(self._record.ledger, self._record.layout)

    @property
    def complete(self) -> bool:
        """Whether all that is measured is in memory."""
        return bool((self.known | ~self.requested).all())

    def load(self, progress: Callable[[int, int], None] | None = None) -> None:
        """Read what the cube has and memory has not; writes what the preview on disk lacks."""
        with self._lock:
            self._load(progress)

    def _load(self, progress: Callable[[int, int], None] | None) -> None:
        record, layout = self._record, self._record.layout
        blocks, requested = layout.chunks(), self.requested
        for index in np.flatnonzero(self.known & ~requested):  # measured again
            self.known[index] = False
        todo = np.flatnonzero(requested & ~self.known)
        if not todo.size:
            return
        on_disk = self._open()
        ready = np.zeros(len(blocks), bool)
        if on_disk is not None:
            ready = previews.chunks_stored(on_disk, layout)
        for count, index in enumerate(todo):
            start, stop = blocks[index]
            try:
                thinned = previews.stored_thinned(on_disk, start, stop) if ready[index] else None
                if thinned is None:
                    thinned = previews.read_thinned(record.group, self.thin, start, stop)
                    self._keep(on_disk, start, thinned)
            except (WavefieldError, OSError, ValueError) as error:
                self.trouble = str(error)
                continue
            self.fields[..., start:stop] = thinned
            self.known[index] = True
            if progress:
                progress(count + 1, int(todo.size))

    def _open(self) -> Any | None:
        record = self._record
        found = previews.open_preview(record.path, record.group)
        if found is None:
            try:
                previews.create_preview(record.path, record.group)
            except StoreError as error:
                self.trouble = f"no preview is kept: {error}"
                return None
            found = previews.open_preview(record.path, record.group)
        return found

    def _keep(self, on_disk: Any | None, start: int, thinned: NDArray[np.int16]) -> None:
        if on_disk is None or self.trouble:
            return
        try:
            writable = previews.open_preview(self._record.path, self._record.group, "r+")
            previews.store_thinned(self._record.path, writable, start, thinned)
        except Exception as error:  # whatever a library makes of a damaged preview: the cube has it all
            self.trouble = f"no preview is kept: {error}"

    def scale(self, name: str) -> float:
        """Value = scale * stored."""
        return self.thin.scales[self.thin.names.index(name)]

    def stored(self, name: str) -> NDArray[np.int16]:
        """One variable, (y, x, time), as stored; what is not read yet is missing."""
        return np.asarray(self.fields[self.thin.names.index(name)])

    def series(self, name: str, j: int, i: int) -> NDArray[np.float32]:
        """A variable at one node of the preview, (time,), in stored units."""
        return decode(self.stored(name)[j, i], self.scale(name))
