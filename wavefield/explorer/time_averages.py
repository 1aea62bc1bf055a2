"""Mean, rms and phase averages of the variables over the steps of a cube, at every node."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wavefield.explorer.cube_record import CubeRecord

MIN_STEPS = 2  # measured at a node
MAX_PHASES = 24  # of a period
Field = NDArray[np.float32]
Sums = NDArray[np.float64]


class AverageRequest(NamedTuple):
    """Variables whose averages are to be shown."""

    names: tuple[str, ...]
    steps_done: int  # of the cube at the time of the request
    period: float = 0.0  # of phase averages, s; 0: mean and rms are to be shown


class TimeAverage(NamedTuple):
    """Averages of one variable, in stored units; NaN at nodes that were measured less than twice."""

    mean: Field  # (ny, nx)
    rms: Field  # (ny, nx), about the mean


def time_averages(
    record: CubeRecord, names: tuple[str, ...], progress: Callable[[float], None] | None = None
) -> dict[str, TimeAverage]:
    """Averages of variables over all measured steps, chunk by chunk."""
    shape = record.y.size, record.x.size
    sums = {name: np.zeros((3, *shape)) for name in names}  # of 1, of values, of their squares
    chunks = record.layout.chunks()
    for number, (start, stop) in enumerate(chunks):
        if record.ledger[start:stop].any():
            for name, total in sums.items():
                values = np.asarray(record.steps(name, start, stop), np.float64)
                measured = np.isfinite(values)
                values[~measured] = 0.0
                total += [measured.sum(axis=0), values.sum(axis=0), np.einsum("tyx,tyx->yx", values, values)]
        if progress is not None:
            progress((number + 1) / len(chunks))
    return {name: _average(*total) for name, total in sums.items()}


def phase_averages(
    record: CubeRecord,
    names: tuple[str, ...],
    period: float,
    progress: Callable[[float], None] | None = None,
) -> dict[str, list[Field]]:
    """Averages of variables at each phase of a period, s; NaN at nodes that were not measured there."""
    from wavefield.waves.surface.phase_average import phase_weights

    phases = phases_of(period, record.frame_rate)
    weights = phase_weights(2 * np.pi * record.time / period, phases).T  # (phases, steps)
    sums = {name: np.zeros((2, phases, record.y.size, record.x.size)) for name in names}
    chunks = record.layout.chunks()
    for number, (start, stop) in enumerate(chunks):
        if record.ledger[start:stop].any():
            for name, total in sums.items():
                values = np.asarray(record.steps(name, start, stop), np.float64)
                measured = np.isfinite(values)
                for k, part in enumerate((measured.astype(float), np.where(measured, values, 0.0))):
                    total[k] += np.tensordot(weights[:, start:stop], part, 1)
        if progress is not None:
            progress((number + 1) / len(chunks))
    return {
        name: list(np.where(count > 0.5, total / np.maximum(count, 0.5), np.nan).astype(np.float32))
        for name, (count, total) in sums.items()
    }


def phases_of(period: float, frame_rate: float) -> int:
    """Phases of a period, s: no more than it holds steps, so that each is measured."""
    return min(MAX_PHASES, max(int(period * frame_rate + 1e-6), 1))


def _average(count: Sums, total: Sums, squares: Sums) -> TimeAverage:
    known = count >= MIN_STEPS
    mean, square = (np.where(known, part / np.maximum(count, 1), np.nan) for part in (total, squares))
    rms = np.sqrt(np.maximum(square - mean**2, 0.0))
    return TimeAverage(mean.astype(np.float32), rms.astype(np.float32))
