"""Lazy arrays of a cube, one Dask task per chunk of steps; of a selection only its own steps are measured."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import getitem
from typing import Any

import dask
import dask.array as da
import numpy as np
from dask.delayed import Delayed
from dask.highlevelgraph import HighLevelGraph

from wavefield.pipeline.chunk import Chunk, Source, make_chunk, measure_chunk
from wavefield.variables import AROUND, CUBE_DIMS, TABLE

Pieces = Sequence[tuple[int, int]]  # ranges of steps, each measured by one task


@dataclass(frozen=True)
class LazySteps:
    """The steps of a record, measured piece by piece when values are requested."""

    sources: Mapping[str, Source]
    departures: np.ndarray | None
    frame_rate: float
    known: Delayed  # geometry, and what was learned from the record
    shape: tuple[int, int]  # nodes along y, x
    token: str

    def array(self, name: str, pieces: Pieces) -> "StepsArray":
        """One variable of the cube over some ranges of steps."""
        tasks = [self._task(*piece) for piece in pieces]
        row = TABLE[name]
        cube = row.dims == CUBE_DIMS
        key = f"{name}-{self.token}-{dask.base.tokenize(list(pieces))}"
        layer: dict[Any, Any] = {
            (key, k, *((0, 0) if cube else ())): (getitem, task.key, name) for k, task in enumerate(tasks)
        }
        graph = HighLevelGraph.from_collections(key, layer, dependencies=tasks)  # type: ignore[arg-type]
        sizes = tuple(stop - start for start, stop in pieces)
        chunks = (sizes, *((n,) for n in self.shape)) if cube else (sizes,)
        out: StepsArray = da.Array.__new__(StepsArray, graph, key, chunks, row.dtype)
        out.lazy_steps, out.variable, out.pieces = self, name, tuple(pieces)
        return out

    def _task(self, start: int, stop: int) -> Delayed:
        # one key for all variables: they are measured together
        task: Delayed = dask.delayed(_measure, pure=False, traverse=True)(
            make_chunk(self.sources, start, stop, self.departures),
            self.known,
            self.frame_rate,
            dask_key_name=f"measure-{self.token}-{start}-{stop}",
        )
        return task


class _DaskType(type):
    """Equal to the type of Dask's arrays: xarray refuses to compute with chunked arrays of several types."""

    def __eq__(cls, other: object) -> bool:
        return other is cls or other is da.Array

    def __hash__(cls) -> int:
        return hash(da.Array)


class StepsArray(da.Array, metaclass=_DaskType):
    """A variable of the lazy cube; what is selected along time is measured without the rest of its chunks."""

    __slots__ = ("lazy_steps", "pieces", "variable")

    lazy_steps: LazySteps
    variable: str
    pieces: tuple[tuple[int, int], ...]

    def __getitem__(self, index: Any) -> Any:
        whole: Any = super()
        first, *rest = index if isinstance(index, tuple) else (index,)
        if not isinstance(first, int | np.integer | slice | list | np.ndarray):
            return whole.__getitem__(index)
        steps = np.concatenate([np.arange(*piece) for piece in self.pieces])
        requested = np.atleast_1d(steps[first])
        own = np.unique(requested)
        pieces = _runs(own, [start for start, _ in self.pieces])
        touched = [(a, b) for a, b in self.pieces if ((own >= a) & (own < b)).any()]
        if not pieces or _cost(pieces) >= _cost(touched):
            return whole.__getitem__(index)
        if isinstance(first, int | np.integer):
            place: Any = 0
        else:
            place = slice(None) if np.array_equal(own, requested) else np.searchsorted(own, requested)
        own_steps: Any = super(StepsArray, self.lazy_steps.array(self.variable, pieces))
        return own_steps.__getitem__((place, *rest))

    def __reduce__(self) -> Any:  # elsewhere it is an array of whole chunks
        return da.Array, (self.dask, self.name, self.chunks, self.dtype, self._meta)


def _runs(steps: np.ndarray, starts: Sequence[int]) -> list[tuple[int, int]]:
    """Ranges of consecutive steps (ascending), cut where a chunk starts."""
    cut = np.flatnonzero((np.diff(steps) > 1) | np.isin(steps[1:], list(starts))) + 1
    return [(int(run[0]), int(run[-1]) + 1) for run in np.split(steps, cut) if run.size]


def _cost(pieces: Pieces) -> int:
    """What pieces cost to measure, in steps: each begins with surfaces of the frames around its first."""
    return sum(stop - start + AROUND for start, stop in pieces)


def _measure(chunk: Chunk, known: Any, frame_rate: float) -> dict[str, np.ndarray]:
    geometry, model = known
    measured = measure_chunk(chunk, geometry, frame_rate, model)
    return {**measured.fields, "frame_status": measured.frame_status}
