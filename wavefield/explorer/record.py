"""The cube that a page shows: fields at any step, series from a thinned copy, and the files of its run.

The thinned copy in memory, the preview, is int16 (variable, y, x, time). A value is the stored integer times
the scale of the variable; -32768 marks a missing value.
"""

import threading
from collections import OrderedDict
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from wavefield.errors import WavefieldError
from wavefield.figures.display import BALANCE, DERIVED
from wavefield.store.layout import MISSING
from wavefield.store.preview import read_steps, read_thinned, thinning
from wavefield.store.read import open_group, read_array, read_layout
from wavefield.variables import CUBE_DIMS, TABLE, FrameStatus

if TYPE_CHECKING:  # slow to import: the first map does not need it
    from wavefield.pipeline import Run

_CACHED_FIELDS = 160  # steps of single variables in memory
_STEPS_PER_READ = 8  # steps of a field read at once, which makes playback smooth


def nearest(positions: NDArray[np.floating], requested: float) -> int:
    """Return the index at which `positions` (n,) are nearest to the requested position."""
    return int(np.argmin(np.abs(positions - requested)))


class CubeRecord:
    """A cube, finished or not: pages read steps from it, and time series from its thinned copy `preview`."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path).absolute()
        self.group = open_group(self.path)
        self.layout = read_layout(self.group)
        self.time, self.y, self.x = (read_array(self.group, self.path, name) for name in CUBE_DIMS)
        fields = {n for n, array in self.group.arrays() if array.metadata.dimension_names == CUBE_DIMS}
        self.stored = tuple(name for name in TABLE if name in fields)
        self._cache: OrderedDict[tuple[str, int], NDArray[np.float32]] = OrderedDict()
        self._lock = threading.Lock()
        self.ledger = np.zeros(self.layout.steps, np.uint8)  # `frame_status` of each step
        self.refresh()
        self.preview = Preview(self)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the stored variables and of those that can be derived from them."""
        return self.stored + (DERIVED if set(BALANCE) <= set(self.stored) else ())

    @property
    def frame_rate(self) -> float:
        """Frame rate of the cameras, Hz."""
        return float(self.group.attrs["frame_rate"])

    def refresh(self) -> bool:
        """Read the status of all steps again, and drop fields in memory whose step has a new status.
        Return whether the status of any step has changed."""
        ledger = read_array(self.group, self.path, "frame_status")
        changed = ledger != self.ledger
        for key in [key for key in self._cache if changed[key[1]]]:
            self._cache.pop(key, None)
        self.ledger = ledger
        return bool(changed.any())

    @property
    def steps_done(self) -> int:
        """Number of steps that the run has finished, with or without success."""
        return int(np.count_nonzero(self.ledger))

    def first_step(self) -> int:
        """Return the index of the earliest measured step; 0 if no step is measured."""
        measured = np.isin(self.ledger, (FrameStatus.DONE, FrameStatus.DONE_WITH_FAULTS))
        return int(np.argmax(measured))

    def field(self, name: str, step: int) -> NDArray[np.float32]:
        """Return a stored or derived variable at one step, (ny, nx), in the units of the cube."""
        if name in DERIVED:
            from wavefield.waves.motion import terms

            fields = {stored: self.field(stored, step) for stored in BALANCE}
            dy, dx = (float(np.mean(np.diff(axis))) for axis in (self.y, self.x))
            return terms(fields, dy, dx)[name]
        with self._lock:
            if (name, step) not in self._cache:
                start = step - step % _STEPS_PER_READ
                stop = min(start + _STEPS_PER_READ, self.layout.steps)
                for k, values in enumerate(read_steps(self.group, name, start, stop)):
                    self._cache[name, start + k] = values
            self._cache.move_to_end((name, step))
            out = self._cache[name, step]
            while len(self._cache) > _CACHED_FIELDS:
                self._cache.popitem(last=False)
        return out


class Preview:
    """A copy of a cube in memory with fewer nodes and 16-bit values, read in the background for series."""

    def __init__(self, record: CubeRecord) -> None:
        self._record = record
        self.thin = thinning(record.group)
        self.y, self.x = record.y[:: self.thin.every], record.x[:: self.thin.every]
        shape = len(self.thin.names), self.y.size, self.x.size, record.layout.steps
        self.fields = np.full(shape, MISSING, np.int16)
        self.loaded = np.zeros(len(record.layout.chunks()), bool)  # chunks in memory
        self.trouble = ""
        self._lock = threading.Lock()

    @property
    def measured(self) -> NDArray[np.bool_]:
        """For each chunk (range of steps) of the cube, whether all its steps are finished, (chunks,)."""
        ledger = self._record.ledger
        return np.array([bool(ledger[a:b].all()) for a, b in self._record.layout.chunks()])

    @property
    def complete(self) -> bool:
        """Whether all chunks (ranges of steps) that the run has finished are in memory."""
        return bool((self.loaded | ~self.measured).all())

    @property
    def count(self) -> int:
        """Number of chunks (ranges of steps) in memory; pages draw series again when it changes."""
        return int(self.loaded.sum())

    def load(self) -> None:
        """Read the finished chunks (ranges of steps) that are not in memory; note an error in `trouble`."""
        with self._lock:
            measured = self.measured
            self.loaded &= measured  # a chunk that is being measured again must be read again
            bounds = self._record.layout.chunks()
            for index in np.flatnonzero(measured & ~self.loaded):
                start, stop = bounds[index]
                try:
                    self.fields[..., start:stop] = read_thinned(self._record.group, self.thin, start, stop)
                except (WavefieldError, OSError, ValueError) as error:
                    self.trouble = str(error)
                    continue
                self.loaded[index] = True

    def stored(self, name: str) -> NDArray[np.int16]:
        """Return one variable, (y, x, time), as 16-bit integers; `MISSING` stands for unknown values."""
        return np.asarray(self.fields[self.thin.names.index(name)])

    def series(self, name: str, j: int, i: int) -> NDArray[np.float32]:
        """Return a variable over time, (time,), at row j and column i of the thinned grid, in cube units."""
        stored, scale = self.stored(name)[j, i], self.thin.scales[self.thin.names.index(name)]
        return np.where(stored == MISSING, np.float32(np.nan), stored * np.float32(scale))


class LookSession:
    """The cube and the files of its run that all pages of one server share; the cube may be unfinished."""

    def __init__(self, path: str | Path) -> None:
        self.record = CubeRecord(path)

    @cached_property
    def run(self) -> "Run":
        """The run that writes the cube, with rig, experiment, images, waves and probes; slow at first use."""
        import xarray as xr

        from wavefield.pipeline import Run

        record = self.record
        coords = {name: getattr(record, name) for name in CUBE_DIMS}
        status = {"frame_status": ("time", record.ledger)}  # `Run` checks the waves against it
        axes = xr.Dataset(status, coords, dict(record.group.attrs))
        return Run(axes, record.path)

    def load(self) -> threading.Thread:
        """Start to read the thinned copy of the cube in a thread; return the thread."""
        thread = threading.Thread(target=self.record.preview.load, daemon=True, name="preview")
        thread.start()
        return thread
