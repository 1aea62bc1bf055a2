"""One pass over a cube in bounded memory: all sums that the analysis is made of."""

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import dask
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.waves.estimation import segments
from wavefield.waves.estimation.wave_record import Each
from wavefield.waves.estimation.welch import Welch
from wavefield.waves.fused import fused_spectra
from wavefield.waves.nonlinear import coherence, kinematics
from wavefield.waves.spectra import cross_spectra
from wavefield.waves.surface import statistics

Array = NDArray[Any]

FIELDS = ("z", "z_t", "u", "v", "w")
NAMES = ("z", "z_t", "rise", "u", "v", "w", "nl")
PAIRS = (*coherence.PAIRS, *fused_spectra.PAIRS)
MAPS = ("z", "w")
PLANES = (*MAPS, *fused_spectra.PLANES)
_KINEMATIC_STEPS = 200  # steps at which the kinematic balance is drawn up
_POINT_DISTANCE = 0.08  # m between the points of the higher-order spectra

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Sums:
    """What one pass over a cube gives."""

    rings: dict[str, Array]  # As `crosses.combine` gives it, over all segments
    survey: dict[str, Array]  # As `statistics.survey` gives it, and "slopes"
    # Rows of the kinematic balance (`kinematics.balance`), each with its "step"
    balance: list[dict[str, float]]
    points: Array  # (time, points): w at points far apart


@dataclass(frozen=True)
class _Step:
    """Takes in half a segment: sums of transforms, counts, the balance at some steps, time series."""

    read: segments.Reader
    scale: dict[str, tuple[float, float]]
    welch: Welch
    every: int
    apart: tuple[int, int]

    def __call__(
        self, state: dict[str, Any] | None, a: int, b: int, run: tuple[int, int], new: bool
    ) -> dict[str, Any]:
        state = {"survey": None, "sums": None, "balance": [], "points": []} if state is None else {**state}
        fields = dict(zip(FIELDS, self.read(a, b, run)))
        if new:
            survey = self._survey(fields)
            state["survey"] = survey if state["survey"] is None else segments.add(state["survey"], survey)
            state["balance"] = state["balance"] + self._balance(fields, a)
            points = fields["w"][:, :: self.apart[0], :: self.apart[1]]
            state["points"] = [*state["points"], points.reshape(points.shape[0], -1).copy()]
        # transforms come last: the rest needs room too
        half = cross_spectra.transforms(fields, NAMES, self.welch, state.get("old"))
        if "half" in state:
            if state["sums"] is None:
                state["sums"] = cross_spectra.empty_sums(half["z"], NAMES, PAIRS, PLANES, self.welch.table)
            cross_spectra.add_segment(
                state["sums"], state["half"], half, NAMES, PAIRS, PLANES, self.welch, a - self.welch.half
            )
        return state | {"half": half, "old": state.get("half")}

    def _survey(self, fields: dict[str, Array]) -> dict[str, Array]:
        sums = statistics.survey({name: fields[name] for name in self.scale}, self.scale)
        record = self.welch.record
        sums |= statistics.time_sums({name: fields[name] for name in self.scale}, self.scale)
        return sums | {"slopes": statistics.slope_square(fields["z"], record.dy, record.dx)}

    def _balance(self, fields: dict[str, Array], first: int) -> list[dict[str, float]]:
        record, frames = self.welch.record, self.welch.frames
        distances = record.dt, record.dy, record.dx
        return [
            {"step": float(first + i)} | kinematics.balance(fields, i, *distances, frames, self.welch.current)
            for i in range(1, fields["z"].shape[0] - 1)
            if (first + i) % self.every == 0
        ]


@dataclass(frozen=True)
class _Chain:
    """Takes in the half segments of a chain, one after the other."""

    step: _Step
    report_progress: Callable[[], None] | None = None

    def __call__(self, links: Sequence[segments.Link]) -> dict[str, Any]:
        state: dict[str, Any] | None = None
        for link in links:
            state = self.step(state, *link)
            if self.report_progress:
                self.report_progress()
        assert state is not None
        return {name: part for name, part in state.items() if name not in ("half", "old")}


class _Count:
    """Tells how many parts are done; parts end in any thread."""

    def __init__(self, report_progress: Progress, total: int) -> None:
        self._report_progress, self._total, self._done, self._lock = (
            report_progress,
            total,
            0,
            threading.Lock(),
        )

    def __call__(self) -> None:
        with self._lock:
            self._done += 1
            self._report_progress(self._done, self._total)


@dataclass(frozen=True)
class _ReadPiece:
    """Reads a piece, which complains if a field lacks values there."""

    read: segments.Reader

    def __call__(self, rest: tuple[int, int, tuple[int, int]]) -> None:
        self.read(*rest)


def _sum_here(chain: _Chain, chains: list[list[segments.Link]]) -> list[Any]:
    """Chains as tasks of this process; sums, survey, and what is put together of each chain."""
    task = dask.delayed(chain, pure=False)
    states = [task(links) for links in chains]
    return list(
        dask.compute(
            segments.in_order([state["sums"] for state in states]),
            segments.in_order([state["survey"] for state in states]),
            [state["balance"] for state in states],
            [state["points"] for state in states],
        )
    )


def _sum_of(states: Iterable[dict[str, Any]]) -> list[Any]:
    """The same from chains that are done elsewhere, as they come in."""
    out: list[Any] = []
    for state in states:
        if not out:
            out = [state["sums"], state["survey"], [state["balance"]], [state["points"]]]
            continue
        out[:2] = segments.add(out[0], state["sums"]), segments.add(out[1], state["survey"])
        out[2].append(state["balance"])
        out[3].append(state["points"])
    return out


def one_pass(
    cube: xr.Dataset,
    welch: Welch,
    alike: bool,
    scale: dict[str, tuple[float, float]],
    progress: Progress | None,
    each: Each | None = None,
) -> Sums:
    """Read a cube once.

    With scale (float, float).
    """
    record = welch.record
    used = sum(b - a for a, b in record.runs)
    apart = tuple(max(1, round(_POINT_DISTANCE / step)) for step in (record.dy, record.dx))
    read = segments.Reader([cube[name] for name in FIELDS], record, alike)
    step = _Step(read, scale, welch, max(1, used // _KINEMATIC_STEPS), (apart[0], apart[1]))
    chains = segments.chains(record, welch.segment)
    # what lies in no segment has a say in where the runs end
    rests = segments.remainders(record, welch.segment) if alike else []
    parts = len(chains) if each else sum(len(links) for links in chains)
    report_progress = None if progress is None else _Count(progress, parts)
    if each is None:
        dask.compute(*(dask.delayed(_ReadPiece(read), pure=False)(rest) for rest in rests))
        sums, survey, balance, points = _sum_here(_Chain(step, report_progress), chains)
    else:
        deque(each(_ReadPiece(read), rests), maxlen=0)
        sums, survey, balance, points = _sum_of(_with_progress(each(_Chain(step), chains), report_progress))
    series = np.concatenate([np.concatenate(run) for run in points])
    return Sums(sums, survey, [row for rows in balance for row in rows], series)


def _with_progress(
    states: Iterable[dict[str, Any]], report_progress: Callable[[], None] | None
) -> Iterator[dict[str, Any]]:
    for state in states:
        yield state
        if report_progress:
            report_progress()
