"""Series of the derived variables at one node, from the cube instead of its thinned preview."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from bokeh.document import Document
from numpy.typing import NDArray

from wavefield.errors import StoreError
from wavefield.explorer.cube_record import CubeRecord
from wavefield.figures.display import BALANCE, DERIVED
from wavefield.store.preview import read_steps
from wavefield.waves.nonlinear.kinematics import kinematics

_REACH = 3  # nodes on either side of one that differences of sixth order use
_REPORT_S = 0.5  # seconds between reports of progress


def derived_series(
    record: CubeRecord, j: int, i: int, progress: Callable[[float], None] | None = None
) -> dict[str, NDArray[np.float32]]:
    """The derived variables of a cube at one node over the whole record, (time,), in stored units.

    The nodes around it are read from every chunk of the cube: differences need them, and the thinned preview
    leaves them out. The values are those that `kinematics` gives for the cube.
    """
    names = [name for name in DERIVED if name in record.names]
    steps = record.layout.steps
    rows, columns = (slice(max(k - _REACH, 0), k + _REACH + 1) for k in (j, i))
    out = {name: np.full(steps, np.nan, np.float32) for name in names}
    chunks = record.layout.chunks() if names else []
    for number, (start, stop) in enumerate(chunks):
        if record.ledger[start:stop].any():
            around = slice(max(start - 1, 0), min(stop + 1, steps))
            fields = {
                name: read_steps(record.group, name, around.start, around.stop, rows, columns)
                for name in BALANCE
            }
            terms = kinematics(record.dataset(fields, around, rows, columns))
            inner = slice(start - around.start, stop - around.start)
            for name, series in out.items():
                series[start:stop] = terms[name].values[inner, j - rows.start, i - columns.start]
        if progress is not None:
            progress((number + 1) / len(chunks))
    return out


class SeriesRequest(NamedTuple):
    """A node whose derived series are to be shown."""

    j: int
    i: int
    steps_done: int  # of the cube at the time of the request


@dataclass
class DerivedReader:
    """Reads the derived series of the node that was requested last, in a thread of its own."""

    record: CubeRecord
    on_progress: Callable[[str], None]  # these three are called in the document
    on_error: Callable[[str], None]
    on_end: Callable[[], None]
    _requested: SeriesRequest | None = None
    _read: tuple[SeriesRequest | None, dict[str, NDArray[np.float32]]] = (None, {})
    _reading: bool = False

    def series(self, name: str, j: int, i: int, document: Document | None) -> NDArray[np.float32]:
        """A derived series (time,) in stored units; NaN until it is read."""
        self._requested = SeriesRequest(j, i, self.record.steps_done)
        request, series = self._read
        if request == self._requested and name in series:
            return series[name]
        if request != self._requested and not self._reading and document is not None:
            self._reading = True
            threading.Thread(target=self._work, args=(document,), daemon=True, name="derived").start()
        return np.full(self.record.time.size, np.nan, np.float32)

    def _work(self, document: Document) -> None:
        """Read the requested series, and again if the request has changed meanwhile."""
        last_report = time.monotonic()

        def progress(done: float) -> None:
            nonlocal last_report
            if time.monotonic() - last_report > _REPORT_S:
                last_report = time.monotonic()
                document.add_next_tick_callback(partial(self._report, f"reading: {100 * done:.0f} %"))

        while (request := self._requested) is not None and request != self._read[0]:
            try:
                self._read = request, derived_series(self.record, request.j, request.i, progress)
            except StoreError as error:
                self._read = request, {}
                document.add_next_tick_callback(partial(self.on_error, str(error)))
        self._reading = False
        document.add_next_tick_callback(self.on_end)

    def _report(self, words: str) -> None:
        if self._reading:
            self.on_progress(words)
