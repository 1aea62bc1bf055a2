"""What takes all steps of a cube: averages over time at every node, series of derived variables at one."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wavefield.explorer.cube_record import CubeRecord
from wavefield.explorer.place import Place
from wavefield.figures.display import DERIVED

MIN_STEPS = 2  # measured at a node, for a mean
MAX_PHASES = 24  # of a period
_REACH = 3  # nodes on either side of one that differences of sixth order use
Field = NDArray[np.float32]
Progress = Callable[[float], None] | None  # takes the fraction that is done


class AverageRequest(NamedTuple):
    """Variables whose averages are to be shown."""

    names: tuple[str, ...]
    steps_done: int  # of the cube at the time of the request
    period: float = 0.0  # of phase averages, s; 0: mean and rms are to be shown


def request_of(record: CubeRecord, place: Place) -> AverageRequest:
    """The variables of the map of a place: the displayed one, and u and v of the arrows."""
    names = place.show, *(name for name in ("u", "v") if name in record.stored)
    period = (place.period or 0.0) if place.averaged == "phase" else 0.0
    return AverageRequest(tuple(dict.fromkeys(names)), record.steps_done, period)


def index_of(record: CubeRecord, place: Place) -> int | None:
    """Which of its averages a place shows; None for phases of no period, or of less than two steps."""
    if place.averaged != "phase":
        return ("mean", "rms").index(place.averaged)
    period = place.period or 0.0
    if period * record.frame_rate <= 2:
        return None
    phases = phases_of(period, record.frame_rate)
    return round(float(record.time[place.step]) / period * phases) % phases  # the nearest to its step


def averages(
    record: CubeRecord, request: AverageRequest, progress: Progress = None
) -> dict[str, list[Field]]:
    """Averages of variables over all measured steps, (ny, nx), in stored units, chunk by chunk.
    Mean, and rms about it, at nodes that were measured twice; or, for a period, the mean at each phase.
    """
    from wavefield.waves.surface.phase_average import phase_weights

    weights = np.ones((1, record.layout.steps))
    if request.period:
        phases = phases_of(request.period, record.frame_rate)
        weights = phase_weights(2 * np.pi * record.time / request.period, phases).T
    shape = 3, len(weights), record.y.size, record.x.size
    sums = {name: np.zeros(shape) for name in request.names}  # of 1, of values, of their squares
    for start, stop in _measured_chunks(record, progress):
        for name, total in sums.items():
            values = np.asarray(record.steps(name, start, stop), np.float64)
            measured = np.isfinite(values)
            values[~measured] = 0.0
            for k, part in enumerate((measured.astype(float), values, values**2)):
                total[k] += np.tensordot(weights[:, start:stop], part, 1)
    least = 0.5 if request.period else MIN_STEPS
    out = {}
    for name, (count, total, squares) in sums.items():
        mean, square = (
            np.where(count >= least, part / np.maximum(count, least), np.nan) for part in (total, squares)
        )
        found = mean if request.period else [*mean, *np.sqrt(np.maximum(square - mean**2, 0.0))]
        out[name] = [field.astype(np.float32) for field in found]
    return out


def phases_of(period: float, frame_rate: float) -> int:
    """Phases of a period, s: no more than it holds steps, so that each is measured."""
    return min(MAX_PHASES, max(int(period * frame_rate + 1e-6), 1))


def derived_series(record: CubeRecord, j: int, i: int, progress: Progress = None) -> dict[str, Field]:
    """The derived variables of a cube at one node, as `kinematics` has them, (time,), in stored units.
    Read from every chunk, not from the thinned preview: differences need the nodes around it.
    """
    names = [name for name in DERIVED if name in record.names]
    rows, columns = (slice(max(k - _REACH, 0), k + _REACH + 1) for k in (j, i))
    out = {name: np.full(record.layout.steps, np.nan, np.float32) for name in names}
    for start, stop in _measured_chunks(record, progress) if names else ():
        terms = record.derived(start, stop, rows, columns)
        for name, series in out.items():
            series[start:stop] = terms[name].values[:, j - rows.start, i - columns.start]
    return out


def _measured_chunks(record: CubeRecord, progress: Progress) -> Iterator[tuple[int, int]]:
    """Ranges of steps of the chunks of which something is measured."""
    chunks = record.layout.chunks()
    for number, (start, stop) in enumerate(chunks, 1):
        if record.ledger[start:stop].any():
            yield start, stop
        if progress is not None:
            progress(number / len(chunks))
