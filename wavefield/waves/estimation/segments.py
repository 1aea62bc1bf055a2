"""Windows, degrees of freedom and confidence intervals of Welch's method; deconvolution from windows."""

from collections.abc import Callable, Iterator, Sequence
from functools import reduce
from itertools import count, pairwise
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from dask import delayed
from scipy import fft, special  # scipy.stats takes half a second to import

from wavefield.errors import CubeError
from wavefield.waves.estimation import wave_kernels
from wavefield.waves.estimation.record import IN_TIME, LONGEST_BRIDGE, Record, all_finite, fill, piece

DEFAULT_SEGMENT = 512  # steps: 25.6 s at 20 Hz
CORRELATED_CELLS = 1 + 2 * (4 / 9 + 1 / 36)  # along an axis of a spectrum under a Hann window

CONFIDENCE = 0.95  # of the intervals of all spectra


def hann(n: int) -> np.ndarray:
    """Hann window with a half-sample offset, (n,): periodic, symmetric and without a zero sample."""
    return 0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(n) + 0.5) / n)


def hann_power(distance: np.ndarray) -> np.ndarray:
    """Energy of a long Hann window's line at distances from it, in lines; 1 at none."""
    off = np.where(np.abs(np.abs(distance) - 1) < 1e-9, 0.0, 1 - distance**2)
    with np.errstate(divide="ignore", invalid="ignore"):
        amplitude = np.where(off == 0, 0.5, np.sinc(distance) / off)
    return np.asarray(amplitude**2)


def segment_count(steps: int, segment: int) -> int:
    """Segments of length `segment`, overlapping by half, in `steps` steps."""
    half = segment // 2
    return max(steps // half - 1, 0)


def choose_segment(steps: int) -> int:
    """Segment length, even, for a record of so many steps."""
    longest = min(DEFAULT_SEGMENT, max(steps // 4, min(64, steps)))
    even = longest - longest % 2
    while even > 4 and fft.next_fast_len(even // 2, real=True) != even // 2:
        even -= 2
    return even


def degrees_of_freedom(segments: float) -> float:
    """Degrees of freedom of a spectral cell: neighbours have a squared correlation of 1/36 (Welch 1967)."""
    return 2 * segments / (1 + (1 - 1 / segments) / 18)


def effective_duration(segments: float, length: float) -> float:
    """Length of a record, weighted as by its Hann-windowed, half-overlapping segments, of this length."""
    return length * 18 * segments**2 / (38 * segments - 3)


def interval(dof: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """Confidence interval of a spectrum as factors."""
    dof = np.asarray(dof, float)
    unique, index = np.unique(dof, return_inverse=True)  # rings of all frequencies have the same
    tails = 0.5 + CONFIDENCE / 2, 0.5 - CONFIDENCE / 2
    low, high = (unique / (2 * special.gammaincinv(unique / 2, tail)) for tail in tails)  # of chi squared
    return low[index].reshape(dof.shape), high[index].reshape(dof.shape)


def richardson_lucy(
    measured: np.ndarray,
    estimate: np.ndarray,
    through_window: Callable[[np.ndarray], np.ndarray],
    corrected: Callable[[np.ndarray, np.ndarray], np.ndarray],
    rounds: int,
) -> np.ndarray:
    """Non-negative estimate that a window turns into what was measured (Richardson 1972, Lucy 1974).
    ``corrected(estimate, ratio)`` multiplies it by measured / ``through_window(estimate)``, window-averaged.
    """
    for _ in range(rounds):
        estimate = corrected(estimate, measured / through_window(estimate))
    return estimate


STEPS_AT_ONCE = 4  # transformed in space: they fit the cache
CELLS = 128  # cells transformed in time at once: so do their segments
CHAIN_LENGTH = 8  # segments in a row that are summed one after the other
SHORT_SEGMENTS, MAX_SHORT_SEGMENT = 12, 256  # that a record is cut into for a change in time; steps

Sums = dict[str, np.ndarray]  # by name, of one half segment or of many
Transform = Callable[..., Sums]  # of the blocks of half a segment


def segment_length(record: Record, segment: int | None) -> int:
    """Segment length to use, checked against the record."""
    longest = record.longest
    if segment is None:
        segment = choose_segment(longest)
    if segment % 2 or segment < 8:
        raise CubeError(f"the segment length is {segment} steps: choose an even number, 8 at least")
    if longest < segment:
        raise CubeError(
            f"the longest run without gaps has {longest} steps, less than one segment of {segment}:"
            f" choose a segment of at most {longest - longest % 2} steps"
        )
    return segment


def count_segments(record: Record, segment: int) -> int:
    """Number of segments, overlapping by half, in all runs of a record."""
    return sum(segment_count(b - a, segment) for a, b in record.runs)


def _values(part: object) -> np.ndarray:
    block = np.asarray(part)
    return block if block.dtype.kind == "f" else block.astype(np.float64)


def _prepared(
    make: Transform, pieces: Sequence[object], missing: np.ndarray, inner: slice, first: int
) -> Sums:
    return make([np.ascontiguousarray(fill(_values(part), missing)[inner]) for part in pieces], first)


def _span(
    record: Record, a: int, b: int, run: tuple[int, int]
) -> tuple[tuple[slice, slice, slice], np.ndarray, slice]:
    """What to read for the steps a to b, which of it is missing, and where a to b are in it."""
    # interpolation in time needs measured steps on either side, and filling missing nodes some more
    bridged = np.asarray(record.bridged, int)
    reach = IN_TIME if record.holes else 0
    if ((bridged >= a - 1) & (bridged <= b)).any():
        reach += LONGEST_BRIDGE + 2
    lo, hi = max(a - reach, run[0]), min(b + reach, run[1])
    missing = np.isin(np.arange(lo, hi), bridged)
    return (slice(lo, hi), slice(*record.y), slice(*record.x)), missing, slice(a - lo, b - lo)


def _task(
    arrays: Sequence[xr.DataArray],
    record: Record,
    a: int,
    b: int,
    run: tuple[int, int],
    make: Transform,
) -> Any:
    area, missing, inner = _span(record, a, b, run)
    pieces = [piece(array, *area) for array in arrays]
    return delayed(_prepared, pure=False)(make, pieces, missing, inner, a)


class Link(NamedTuple):
    """Half a segment of a chain: steps ``start`` to ``stop`` of a run; ``new`` if no other chain has them."""

    start: int
    stop: int
    run: tuple[int, int]
    new: bool


class UnlikeFirst(Exception):
    """A field of a record lacks values where the first one has them."""


class Reader:
    """Reads pieces of a record inside a task: nothing is read before it is needed."""

    def __init__(self, arrays: Sequence[xr.DataArray], record: Record, alike: bool = False) -> None:
        self.arrays, self.record, self.alike = list(arrays), record, alike

    def __call__(self, a: int, b: int, run: tuple[int, int]) -> list[np.ndarray]:
        """Blocks (b - a, ny, nx) of the steps a to b of a run, without gaps."""
        area, missing, inner = _span(self.record, a, b, run)
        blocks: list[np.ndarray] = []
        holes = np.zeros((), bool)  # of the first field
        for array in self.arrays:
            part = piece(array, *area)
            if hasattr(part, "dask"):
                part = part.compute(scheduler="synchronous")
            block = _values(part)
            if self.alike and not all_finite(block):
                lacking = ~np.isfinite(block)
                if not blocks:
                    holes = lacking
                elif (lacking & ~holes)[~missing].any():
                    raise UnlikeFirst
            # one layout, one compiled kernel: the same sums to the bit
            blocks.append(np.ascontiguousarray(fill(block, missing)[inner]))
        return blocks

    def blocks(self, run: tuple[int, int], steps: int) -> Iterator[list[np.ndarray]]:
        """Blocks of a run, some steps at a time."""
        for a in range(run[0], run[1], steps):
            yield self(a, min(a + steps, run[1]), run)


def remainders(record: Record, segment: int) -> list[tuple[int, int, tuple[int, int]]]:
    """Steps (first, one past the last, run) that no segment holds, in pieces of half a segment at most."""
    half = segment // 2
    out = []
    for run in record.runs:
        number = segment_count(run[1] - run[0], segment)
        start = run[0] + (number + 1) * half if number else run[0]
        out += [(a, min(a + half, run[1]), run) for a in range(start, run[1], half)]
    return out


def chains(record: Record, segment: int) -> list[list[Link]]:
    """Cut the segments of a record into chains that are summed one after the other."""
    half = segment // 2
    out = []
    for run in record.runs:
        number = segment_count(run[1] - run[0], segment)
        for chain in np.array_split(np.arange(number), -(-number // CHAIN_LENGTH)) if number else ():
            halves = range(int(chain[0]), int(chain[-1]) + 2)
            starts = [run[0] + i * half for i in halves]
            out.append([Link(a, a + half, run, i > chain[0] or i == 0) for i, a in zip(halves, starts)])
    return out


def half_segments(
    arrays: Sequence[xr.DataArray], record: Record, half: int, make: Transform
) -> list[list[Any]]:
    """Tasks, by run, that turn half segments of a record into what ``make(blocks, first step)`` gives."""
    return [
        [_task(arrays, record, a, a + half, run, make) for a in range(run[0], run[1] - half + 1, half)]
        for run in record.runs
    ]


def sum_segments(
    arrays: Sequence[xr.DataArray],
    record: Record,
    half: int,
    make: Transform,
    combine: Transform,
) -> Any:
    """Delayed sum over all segments of ``combine(first, second, begin=step)`` of halves from `make`."""
    task = delayed(combine, pure=False)
    runs = zip(half_segments(arrays, record, half, make), record.runs)
    return in_order(
        [
            task(first, second, begin=begin)
            for halves, run in runs
            for begin, (first, second) in zip(count(run[0], half), pairwise(halves))
        ]
    )


def pieces(arrays: Sequence[xr.DataArray], record: Record, length: int, make: Transform) -> list[Any]:
    """Tasks as of `half_segments`, over every step of all runs; the last of a run may be shorter."""
    return [
        _task(arrays, record, a, min(a + length, run[1]), run, make)
        for run in record.runs
        for a in range(run[0], run[1], length)
    ]


def in_order(parts: Sequence[object]) -> Any:
    """Sum delayed dictionaries of arrays one after the other, in their order."""
    return reduce(delayed(add, pure=False), parts)


def add(a: Sums, b: Sums) -> Sums:
    """Sum two dictionaries of arrays, name by name; what only one of them has is kept."""
    return {**a, **b} | {name: a[name] + b[name] for name in a if name in b}


def spatial_window(ny: int, nx: int) -> np.ndarray:
    """Hann window of the rectangle, (ny, nx)."""
    return np.outer(hann(ny), hann(nx))


def window_energy(segment: int, ny: int, nx: int) -> float:
    """Sum of the squared window over a segment."""
    return float((hann(segment) ** 2).sum() * (hann(ny) ** 2).sum() * (hann(nx) ** 2).sum())


def transform_space(block: Any, out: np.ndarray | None = None) -> np.ndarray:
    """Windowed transform of each step (ny, nx) in space, (cells, steps), cells being ky x kx with kx >= 0."""
    steps, ny, nx = block.shape
    window = spatial_window(ny, nx).astype(block.dtype)
    shape = steps, ny, nx // 2 + 1
    if out is None:
        out = np.empty((steps, ny * shape[2]), np.result_type(block.dtype, np.complex64)).T
    planes = out.T.reshape(shape)
    memory = np.empty((min(STEPS_AT_ONCE, steps), ny, nx), block.dtype)
    for a in range(0, steps, STEPS_AT_ONCE):
        part = block[a : a + STEPS_AT_ONCE]
        windowed = np.multiply(part, window, out=memory[: part.shape[0]])
        planes[a : a + STEPS_AT_ONCE] = fft.rfft2(windowed, axes=(1, 2))
    return out


def slabs(cells: int) -> Iterator[slice]:
    """Cut cells into slabs that fit the cache."""
    for a in range(0, cells, CELLS):
        yield slice(a, min(a + CELLS, cells))


class TimeTransform:
    """Transforms segments in time, slab by slab, in work space of its own: it is made once and used again."""

    def __init__(self, half: int, dtype: np.dtype, names: int = 1) -> None:
        dtype = np.dtype(dtype)
        self.half, self.real = half, dtype.type(0).real.dtype
        self.window = hann(2 * half).astype(self.real)
        self.lines = np.empty((names, 2 * half * CELLS), dtype)
        self.halves = np.empty((2, half * CELLS), dtype)

    def __call__(self, first: np.ndarray, second: np.ndarray, name: int = 0) -> np.ndarray:
        """Transform (cells, n) of the two halves of a slab, without mean and trend, windowed."""
        cells = first.shape[0]
        halves = [part[: self.half * cells].reshape(self.half, cells) for part in self.halves]
        for part, given in zip(halves, (first, second)):
            part[...] = given.T  # read once from far, then from the cache
        joined = self.lines[name, : 2 * self.half * cells].reshape(cells, 2 * self.half)
        first, second = (part.view(self.real) for part in halves)
        wave_kernels.join(first, second, self.window, joined.view(self.real))
        out: np.ndarray = fft.fft(joined, axis=-1, overwrite_x=True)
        return out


def transform_time(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Transform a slab of a segment in time, as `TimeTransform` does."""
    return TimeTransform(first.shape[1], first.dtype)(first, second)
