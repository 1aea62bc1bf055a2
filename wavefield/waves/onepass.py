"""One pass over a cube in bounded memory: all sums that the products of an analysis need."""

import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial, reduce
from operator import add
from typing import Any

import dask
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.waves.estimation import segments
from wavefield.waves.estimation.record import Each
from wavefield.waves.estimation.welch import Welch
from wavefield.waves.estimators import kinematics, statistics
from wavefield.waves.estimators.cross_spectra import Requested, add_segment, empty_sums, transforms

Array = NDArray[Any]

FIELDS = ("z", "z_t", "u", "v", "w")
BALANCE_STEPS = 200  # at which the kinematic balance is taken
POINT_DISTANCE = 0.08  # m, between the points of the higher-order spectra

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Sums:
    """What one pass over a cube gives."""

    scale: dict[str, tuple[float, float]]  # rough mean and standard deviation of each field
    ring_sums: dict[str, Array]  # as `segment_sums.sum_segment` gives it, over all segments
    survey_sums: dict[str, Array]  # as `statistics.sums_of` gives it
    balance_rows: list[dict[str, float]]  # of `kinematics.balance`, each with its "step"
    point_series: Array  # (time, points), w at points far apart


@dataclass
class _Partial:
    """Sums of one chain, or of several."""

    ring_sums: dict[str, Array] = field(default_factory=dict)
    survey_sums: dict[str, Array] = field(default_factory=dict)
    balance_rows: list[dict[str, float]] = field(default_factory=list)
    points: list[Array] = field(default_factory=list)

    def __add__(self, other: "_Partial") -> "_Partial":
        return _Partial(
            segments.add(self.ring_sums, other.ring_sums),
            segments.add(self.survey_sums, other.survey_sums),
            self.balance_rows + other.balance_rows,
            self.points + other.points,
        )


@dataclass(frozen=True)
class _Chain:
    """Sums over the half segments of a chain, one after the other."""

    read: segments.Reader
    welch: Welch
    scale: dict[str, tuple[float, float]]
    requested: Requested
    every: int  # steps from one kinematic balance to the next
    report_progress: Callable[[], None] | None = None

    def __call__(self, links: Sequence[segments.Link]) -> _Partial:
        out = _Partial()
        previous: dict[str, Array] = {}
        oldest: dict[str, Array] = {}  # its memory is used again
        for start, stop, run, new in links:
            fields = dict(zip(FIELDS, self.read(start, stop, run)))
            if new:
                self._survey(fields, start, out)
            # transforms come last: they release the fields
            half = transforms(fields, self.requested.names, self.welch, oldest)
            if previous:
                if not out.ring_sums:
                    out.ring_sums = empty_sums(half["z"], self.requested, self.welch.table)
                begin = start - self.welch.half
                add_segment(out.ring_sums, previous, half, self.requested, self.welch, begin)
            previous, oldest = half, previous
            if self.report_progress:
                self.report_progress()
        return out

    def _survey(self, fields: dict[str, Array], start: int, out: _Partial) -> None:
        record, welch = self.welch.record, self.welch
        surveyed = {name: fields[name] for name in self.scale}
        out.survey_sums = segments.add(
            out.survey_sums, statistics.sums_of(surveyed, self.scale, record.dy, record.dx)
        )
        out.balance_rows += [
            {"step": float(start + i)}
            | kinematics.balance(fields, i, record.dt, record.dy, record.dx, welch.frames, welch.current)
            for i in range(1, fields["z"].shape[0] - 1)
            if (start + i) % self.every == 0
        ]
        apart = [max(1, round(POINT_DISTANCE / step)) for step in (record.dy, record.dx)]
        points = fields["w"][:, :: apart[0], :: apart[1]]
        out.points.append(points.reshape(points.shape[0], -1).copy())


class _Counter:
    """Reports how many parts are done; parts end in any thread."""

    def __init__(self, progress: Progress, total: int) -> None:
        self._progress, self._total, self._done, self._lock = progress, total, 0, threading.Lock()

    def __call__(self) -> None:
        with self._lock:
            self._done += 1
            self._progress(self._done, self._total)


def _check_piece(read: segments.Reader, piece: tuple[int, int, tuple[int, int]]) -> None:
    read(*piece)  # raises `UnlikeFirst` if a field lacks values there


def one_pass(
    cube: xr.Dataset,
    welch: Welch,
    alike: bool,
    requested: Requested,
    progress: Progress | None,
    each: Each | None = None,
) -> Sums:
    """Read a cube once; with ``alike`` all fields are taken to have values where the first one has them."""
    record = welch.record
    scale = statistics.rough_scales(cube, record, list(statistics.QUANTITIES.values()))
    read = segments.Reader([cube[name] for name in FIELDS], record, alike)
    chain = partial(_Chain, read, welch, scale, requested, max(1, record.steps_in_runs() // BALANCE_STEPS))
    chains = segments.chains(record, welch.segment)
    # steps that no segment holds could end a run as well
    remainders = segments.remainders(record, welch.segment) if alike else []
    check = partial(_check_piece, read)
    if each is None:
        count = None if progress is None else _Counter(progress, sum(len(links) for links in chains))
        dask.compute(*(dask.delayed(check, pure=False)(piece) for piece in remainders))
        task = dask.delayed(chain(count), pure=False)
        (total,) = dask.compute(reduce(dask.delayed(add, pure=False), [task(links) for links in chains]))
    else:
        deque(each(check, remainders), maxlen=0)
        count = None if progress is None else _Counter(progress, len(chains))
        total = reduce(add, _counted(each(chain(), chains), count))
    return Sums(scale, total.ring_sums, total.survey_sums, total.balance_rows, np.concatenate(total.points))


def _counted(results: Iterator[_Partial], count: _Counter | None) -> Iterator[_Partial]:
    for result in results:
        yield result
        if count:
            count()
