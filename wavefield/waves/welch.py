"""Welch's method in time, y and x: segments, Hann windows, transforms, sums over segments and intervals."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from dask import delayed
from numpy.typing import NDArray
from scipy import fft, ndimage, special  # scipy.stats takes half a second to import

from wavefield.errors import CubeError
from wavefield.variables import INSTANTANEOUS
from wavefield.water import WATER, water_of
from wavefield.waves import kernels, rings
from wavefield.waves.record import FILL_MARGIN, STEPS_PER_READ, Record, fill, find_record, piece

DEFAULT_SEGMENT = 512  # steps, 25.6 s at 20 Hz: lines .04 Hz apart; chosen
MAIN_LOBE = 2  # lines or cells, half the width of the main lobe of a Hann window
CHANCE = 0.05  # probability that an interval misses the truth and that unrelated fields exceed a level
REACH = 4  # lines or cells on either side, beyond which a Hann window spreads less than 2e-5 of a wave


def hann(n: int) -> np.ndarray:
    """Return a Hann window (n,), offset by half a sample: periodic, symmetric and nowhere zero."""
    return 0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(n) + 0.5) / n)


def hann_power(distance: np.ndarray) -> np.ndarray:
    """Return the relative power of a Hann-windowed sine wave `distance` frequency steps from its peak."""
    off = np.where(np.abs(np.abs(distance) - 1) < 1e-9, 0.0, 1 - distance**2)
    with np.errstate(divide="ignore", invalid="ignore"):
        amplitude = np.where(off == 0, 0.5, np.sinc(distance) / off)
    return np.asarray(amplitude**2)


def segment_count(steps: int, segment: int) -> int:
    """Return how many segments of `segment` steps, overlapping by half, fit into `steps` steps."""
    half = segment // 2
    return max(steps // half - 1, 0)


def choose_segment(steps: int) -> int:
    """Return the default number of steps in a segment: a quarter of `steps`, from 64 to 512.
    It is rounded down to an even number whose Fourier transform is fast."""
    longest = min(DEFAULT_SEGMENT, max(steps // 4, min(64, steps)))
    even = longest - longest % 2
    while even > 4 and fft.next_fast_len(even // 2, real=True) != even // 2:
        even -= 2
    return even


def overlap_factor(segments: float) -> float:
    """Return the factor by which half overlap of Hann-windowed segments raises the variance of their mean."""
    return 1 + 2 * (1 - 1 / segments) / 36


def degrees_of_freedom(segments: float) -> float:
    """Return the degrees of freedom of a spectral value averaged over half-overlapping Hann segments."""
    return 2 * segments / overlap_factor(segments)


def interval(dof: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """Return lower and upper limits of the 95 % interval, relative to the spectrum, in the shape of `dof`."""
    dof = np.asarray(dof, float)
    unique, index = np.unique(dof, return_inverse=True)  # many cells have the same number
    quantiles = 1 - CHANCE / 2, CHANCE / 2  # of chi-squared
    low, high = (unique / (2 * special.gammaincinv(unique / 2, quantile)) for quantile in quantiles)
    return low[index].reshape(dof.shape), high[index].reshape(dof.shape)


def richardson_lucy(
    measured: np.ndarray,
    estimate: np.ndarray,
    through_window: Callable[[np.ndarray], np.ndarray],
    corrected: Callable[[np.ndarray, np.ndarray], np.ndarray],
    rounds: int,
) -> np.ndarray:
    """Return a non-negative spectrum that, blurred by a window, is close to `measured` (Richardson 1972).
    ``through_window(estimate)`` blurs a spectrum. ``corrected(estimate, ratio)`` multiplies ``estimate`` by
    the blurred ``ratio`` of `measured` to the blurred estimate. `estimate` is the first guess."""
    for _ in range(rounds):
        estimate = corrected(estimate, measured / through_window(estimate))
    return estimate


STEPS_AT_ONCE = 4  # steps transformed in space at once; fits the cache, an eighth faster than single steps
CELLS = 128  # cells transformed in time at once; their segments fit the cache
CHAIN_LENGTH = 4  # segments that one task sums; 12,000 steps make 12 tasks

Sums = dict[str, np.ndarray]  # transforms of half a segment, or sums over segments, by name


def segment_length(record: Record, segment: int | None) -> int:
    """Return the number of steps in a segment, by default that of `choose_segment` for the longest run.
    Raises CubeError if the number is odd, below 8 or longer than the longest run."""
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


def _values(part: object) -> np.ndarray:
    block = np.asarray(part)
    return block if block.dtype.kind == "f" else block.astype(np.float64)


def _span(
    record: Record, a: int, b: int, run: tuple[int, int]
) -> tuple[tuple[slice, slice, slice], np.ndarray, slice]:
    """Return, for steps a to b - 1 of a run: slices (time, y, x) to read, with a margin for filling gaps; a
    mask of missing steps among those read; and the slice of steps a to b - 1 among those read."""
    bridged = np.asarray(record.bridged, int)
    reach = FILL_MARGIN if record.holes or bridged.size else 0
    lo, hi = max(a - reach, run[0]), min(b + reach, run[1])
    missing = np.isin(np.arange(lo, hi), bridged)
    return (slice(lo, hi), slice(*record.y), slice(*record.x)), missing, slice(a - lo, b - lo)


class Link(NamedTuple):
    """Half a segment: steps ``start`` to ``stop`` - 1 of a run; ``new`` if no earlier task reads it."""

    start: int
    stop: int
    run: tuple[int, int]
    new: bool


class Reader:
    """Reads time steps of fields in the rectangle of nodes of a `Record`, and fills gaps."""

    def __init__(self, arrays: Sequence[xr.DataArray], record: Record, first: int = 0) -> None:
        self.arrays, self.record = list(arrays), record
        self.first = first  # step of the record at which the arrays begin

    def __call__(self, a: int, b: int, run: tuple[int, int]) -> list[np.ndarray]:
        """Return steps a to b - 1 of the cube: one block (b - a, ny, nx) per field, with gaps filled.
        `run` (first, last + 1) is the unbroken range of steps around these; it alone is used to fill gaps."""
        (steps, *nodes), missing, inner = _span(self.record, a, b, run)
        steps = slice(steps.start - self.first, steps.stop - self.first)
        blocks: list[np.ndarray] = []
        for array in self.arrays:
            part = piece(array, steps, *nodes)
            if hasattr(part, "dask"):
                part = part.compute(scheduler="synchronous")
            # the same memory layout for every chunking gives the same sums to the bit
            blocks.append(np.ascontiguousarray(fill(_values(part), missing)[inner]))
        return blocks

    def blocks(self, run: tuple[int, int]) -> Iterator[list[np.ndarray]]:
        """Yield blocks (steps, ny, nx) of all fields, at most 256 steps at a time, until the end of a run."""
        for a in range(run[0], run[1], STEPS_PER_READ):
            yield self(a, min(a + STEPS_PER_READ, run[1]), run)


def cut_chains(record: Record, segment: int) -> list[list[Link]]:
    """Return lists (chains) of consecutive half segments of a `Record`. Two neighbours in a list form a
    segment; a list has up to five half segments, so up to four segments."""
    half = segment // 2
    out = []
    for run in record.runs:
        number = segment_count(run[1] - run[0], segment)
        for chain in np.array_split(np.arange(number), -(-number // CHAIN_LENGTH)) if number else ():
            halves = range(int(chain[0]), int(chain[-1]) + 2)
            starts = [run[0] + i * half for i in halves]
            out.append([Link(a, a + half, run, i > chain[0] or i == 0) for i, a in zip(halves, starts)])
    return out


def sum_chain(
    read: Reader,
    transform: Callable[[list[np.ndarray], Link, Sums], Sums],
    accumulate: Callable[[Sums, Sums, Sums, int], None],
    links: Sequence[Link],
) -> Sums:
    """Return the sums over consecutive segments, by name, reading and transforming each half segment once.
    ``transform(blocks, link, memory)`` may overwrite arrays in ``memory``. ``accumulate(sums, first, second,
    begin)`` adds to ``sums`` the segment with halves ``first``, ``second`` and first step ``begin``."""
    sums: Sums = {}
    previous: Sums = {}
    oldest: Sums = {}
    for link in links:
        half = transform(read(link.start, link.stop, link.run), link, oldest)
        if previous:
            accumulate(sums, previous, half, 2 * link.start - link.stop)
        previous, oldest = half, previous
    return sums


def sum_segments(
    arrays: Sequence[xr.DataArray], record: Record, segment: int, transform: Any, accumulate: Any
) -> Any:
    """Return the sums of `sum_chain` over all segments of a `Record`, as a Dask delayed object."""

    def work(transform: Any, parts: Sequence[xr.DataArray], first: int, links: Sequence[Link]) -> Sums:
        return sum_chain(Reader(parts, record, first=first), transform, accumulate, links)

    task, sums = delayed(work, pure=False), []
    for links in cut_chains(record, segment):
        if any(array.chunks is not None for array in arrays):
            (steps, *_), *_ = _span(record, links[0].start, links[-1].stop, links[0].run)
            parts = [array.isel(time=steps) for array in arrays]
            sums.append(task(transform, parts, steps.start, links))
        else:
            sums.append(task(transform, arrays, 0, links))
    return reduce(delayed(add_sums, pure=False), sums)


def add_sums(a: Sums, b: Sums) -> Sums:
    """Return the sum of two dictionaries of arrays, name by name; arrays in only one of them are kept."""
    return {**a, **b} | {name: a[name] + b[name] for name in a if name in b}


def spatial_window(ny: int, nx: int) -> np.ndarray:
    """Return the Hann window in space, (ny, nx)."""
    return np.outer(hann(ny), hann(nx))


NODES_PER_AXIS = 4  # nodes per axis at which Fourier lines are kept; chosen: closer nodes are correlated


def some_nodes(block: np.ndarray) -> np.ndarray:
    """Return the values of a block (steps, ny, nx) at 4 x 4 evenly spaced nodes, (16, steps)."""
    middle = (np.arange(NODES_PER_AXIS) + 0.5) / NODES_PER_AXIS
    rows, columns = ((middle * n).astype(int) for n in block.shape[1:])
    return block[:, rows[:, None], columns].reshape(len(block), -1).T


def transform_space(block: Any, out: np.ndarray | None = None) -> np.ndarray:
    """Return the Hann-windowed Fourier transform in y and x, (cells, steps), of a block (steps, ny, nx).
    Cells are the wave vectors with kx >= 0, flattened. `out`, a former result, is overwritten."""
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
    """Yield slices that divide `cells` wave vectors into parts of at most 128, which fit the cache."""
    for a in range(0, cells, CELLS):
        yield slice(a, min(a + CELLS, cells))


class TimeTransform:
    """Fourier transform of segments in time, for up to 128 cells at once, in arrays that are allocated once.
    `half` is the number of steps in half a segment, and `names` the number of results held at a time."""

    def __init__(self, half: int, dtype: np.dtype, names: int = 1) -> None:
        dtype = np.dtype(dtype)
        self.half, self.real = half, dtype.type(0).real.dtype
        self.window = hann(2 * half).astype(self.real)
        self.lines = np.empty((names, 2 * half * CELLS), dtype)
        self.halves = np.empty((2, half * CELLS), dtype)

    def __call__(self, first: np.ndarray, second: np.ndarray, name: int = 0) -> np.ndarray:
        """Return the detrended, Hann-windowed transform (cells, n) of a segment from its halves (cells, n /
        2). The next call with the same index `name` overwrites the result."""
        cells = first.shape[0]
        halves = [part[: self.half * cells].reshape(self.half, cells) for part in self.halves]
        for part, given in zip(halves, (first, second)):
            part[...] = given.T  # into the cache
        joined = self.lines[name, : 2 * self.half * cells].reshape(cells, 2 * self.half)
        first, second = (part.view(self.real) for part in halves)
        kernels.join(first, second, self.window, joined.view(self.real))
        out: np.ndarray = fft.fft(joined, axis=-1, overwrite_x=True)
        return out


Array = NDArray[np.float64]
Coordinates = dict[str, tuple[str, Array]]

LEAST_COUNT = 4  # segments; with fewer, unrelated fields reach a squared coherence of .63 in 5 % of cases
VELOCITY = "velocity"  # attribute of a cube or of its fields: the meaning of the velocities
MEANINGS = {"displacement": 2, "instantaneous": INSTANTANEOUS}  # values of the attribute: `path_frames`
# least ratio of a spectrum to the white error of filled nodes; lasting holes have up to twice this error
MIN_OVER_FILLED = 4.0


def omega_coords(omega: Array) -> Coordinates:
    """Return the coordinates ``omega`` (rad/s) and ``frequency`` (Hz) of a spectrum."""
    return {"omega": ("omega", omega), "frequency": ("omega", omega / (2 * np.pi))}


def k_coords(k: Array) -> Coordinates:
    """Return the coordinates ``k`` (rad/m) and ``cycles`` (1/m) of a spectrum."""
    return {"k": ("k", k), "cycles": ("k", k / (2 * np.pi))}


@dataclass(frozen=True)
class Welch:
    """Settings and factors of Welch's method for a `Record`, which is the usable part of a cube."""

    record: Record  # rectangle and runs
    segment: int  # steps of a segment
    frames: int = 2  # `path_frames` of the velocities and of z_t
    current: tuple[float, float] = (0.0, 0.0)  # frame of reference of nonlinear terms along x and y, m/s
    depth: float = np.inf  # of the water, m, for the group velocity

    @classmethod
    def of(
        cls, fields: xr.DataArray | xr.Dataset, segment: int | None = None, record: Record | None = None
    ) -> "Welch":
        """Return the estimator for fields over (time, y, x). If None, `record` and `segment` are chosen."""
        record = find_record(fields) if record is None else record
        length = segment_length(record, segment)
        return cls(record, length, frames_of(fields), depth=water_of(fields.attrs)[0])

    @cached_property
    def count(self) -> int:
        """Number of segments, overlapping by half, in all runs."""
        return sum(segment_count(b - a, self.segment) for a, b in self.record.runs)

    @property
    def half(self) -> int:
        """Number of steps of half a segment."""
        return self.segment // 2

    @cached_property
    def omega(self) -> Array:
        """Angular frequencies of the spectral lines, rad/s, (segment // 2 + 1,)."""
        return np.asarray(2 * np.pi * np.arange(self.half + 1) / (self.segment * self.record.dt), float)

    @cached_property
    def table(self) -> rings.Rings:
        """Rings of |k|, and the area fraction of each cell (ky, kx) in each ring."""
        record = self.record
        return rings.rings(*record.shape, record.dy, record.dx)

    @property
    def dof(self) -> float:
        """Degrees of freedom of a single value of E(omega, ky, kx)."""
        return degrees_of_freedom(self.count)

    @property
    def duration(self) -> float:
        """Effective duration of the record, s: (int w)^2 / int w^2, where w is the sum of squared windows."""
        return self.segment * self.record.dt * 18 * self.count**2 / (38 * self.count - 3)

    @property
    def density(self) -> float:
        """Factor from |F|^2, summed over segments, to the density E(omega, ky, kx); F are transforms."""
        record = self.record
        energy = float(np.prod([(hann(n) ** 2).sum() for n in (self.segment, *record.shape)]))
        return record.dt * record.dy * record.dx / ((2 * np.pi) ** 3 * energy * self.count)

    @property
    def node_density(self) -> float:
        """Factor from the power at omega >= 0, summed over segments and nodes, to E(omega)."""
        ny, nx = self.record.shape
        window = float((hann(self.segment) ** 2).sum()) * self.count
        return self.record.dt / (2 * np.pi * window * (ny * nx // 2 * 2))

    @property
    def ring_density(self) -> float:
        """Factor from |F|^2, summed over segments and a ring, to the density E(k, omega); F are
        transforms."""
        ny, nx = self.record.shape
        cell = (2 * np.pi) ** 2 / (ny * self.record.dy * nx * self.record.dx)
        return self.density * cell / self.table.dk

    @property
    def plane(self) -> Coordinates:
        """Coordinates ``ky`` and ``kx`` of the k plane (rad/m), ascending."""
        record = self.record
        lengths = zip(("ky", "kx"), record.shape, (record.dy, record.dx))
        return {name: (name, np.sort(rings.wavenumbers(n, step))) for name, n, step in lengths}

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Mask (omega, k): false where E is affected by the removed mean, and at or beyond Nyquist limits."""
        nyquist = np.pi / max(self.record.dy, self.record.dx)
        table = self.table
        in_k = (table.k > MAIN_LOBE * table.dk) & (table.k + table.dk / 2 <= nyquist * (1 + 1e-9))
        return inner(self.omega.size)[:, None] & in_k

    def over_filled(self, energy: Any, added: float) -> Any:
        """Return a mask (omega, k): true where E(k, omega) exceeds four times the error due to interpolated
        nodes. `added` is the power that this error, white in the k plane, adds to E(omega)."""
        plane = 2 * np.pi * self.table.k * self.table.coverage
        white = added * plane * self.record.dy * self.record.dx / (2 * np.pi) ** 2
        return energy > MIN_OVER_FILLED * white

    def freedom(self, sums: Array) -> Array:
        """Return the degrees of freedom (rings, frequencies) of E(k, omega), from `sums` of `ring_powers`.
        They follow from the scatter of energy in a ring and the correlation of cells by Hann windows."""
        power, square = sums[0], sums[1]
        filled = power > 0
        spread = np.divide(self.count * square, power**2, out=np.zeros_like(power), where=filled)
        lobe = 2 * MAIN_LOBE - 1  # lines of a main lobe, over which the spread is averaged
        weight = ndimage.uniform_filter1d(filled.astype(float), lobe, axis=-1, mode="nearest")
        spread = ndimage.uniform_filter1d(spread, lobe, axis=-1, mode="nearest")
        # squares are averaged over segments, which biases the number of cells by 1 / K
        cells = np.divide(weight, spread, out=np.zeros_like(power), where=spread > 0) - 1 / self.count
        cells = np.where(filled, cells, self.table.cells[:, None])  # without energy, as for an even spectrum
        return np.asarray(self.dof * cells.clip(1))

    @property
    def ring_variables(self) -> Mapping[str, tuple[str, Array]]:
        """Over k: ``coverage``, fraction of a ring in the k plane; ``cells``, independent wave vectors."""
        return {"coverage": ("k", self.table.coverage), "cells": ("k", self.table.cells)}

    @property
    def attrs(self) -> dict[str, Any]:
        """Attributes of every spectrum, such as ``segments``, ``degrees_of_freedom`` and ``dt``."""
        record = self.record
        return {
            "estimator": "Welch, Hann windows in t, y and x, half overlap, mean and trend removed",
            "segment": self.segment,
            "segments": self.count,
            "degrees_of_freedom": self.dof,
            "steps_bridged": len(record.bridged),
            "nodes_filled": record.holes,
            "nodes": list(record.shape),
            "node_step": [record.dy, record.dx],
            "dt": record.dt,
            "frames": self.frames,
            "convention": "k points where the wave goes; density in rad/m and rad/s, one-sided in omega",
        }


def with_stated(given: Any) -> Any:
    """Return a field or cube with `path_frames` and water properties as coordinates instead of attributes."""
    if not isinstance(given, xr.DataArray | xr.Dataset):
        return given
    out = given.copy(deep=False)
    fields = [out] if isinstance(out, xr.DataArray) else list(out.data_vars.values())
    stated: dict[str, Any] = {}
    for name in ("path_frames", *WATER):
        for field in fields:
            if name in field.attrs:
                stated[name] = field.attrs.pop(name)
    if isinstance(out, xr.Dataset) and "path_frames" in out:
        stated["path_frames"] = out["path_frames"].drop_vars(out["path_frames"].coords)
    return out.assign_coords({name: value for name, value in stated.items() if name not in out.coords})


def frames_of(fields: xr.DataArray | xr.Dataset) -> int:
    """Return the code `path_frames`: 1 for instantaneous velocities, 2 (default) for displacements between
    two frames, 4 for paths of 4 frames, 6 or 7 for 6 frames. CubeError if ``velocity`` attributes differ."""
    fields = with_stated(fields)
    if "path_frames" in fields.coords:
        return int(fields["path_frames"])
    parts = fields.data_vars.values() if isinstance(fields, xr.Dataset) else ()
    stated = {str(one.attrs[VELOCITY]) for one in (fields, *parts) if VELOCITY in one.attrs}
    return frames_of_meaning(*sorted(stated)) if stated else 2


def frames_of_meaning(*stated: str) -> int:
    """Return the code `path_frames` for "displacement" (2) or "instantaneous" (1).
    Raises CubeError for other words and for more than one argument."""
    if len(stated) > 1 or stated[0] not in MEANINGS:
        raise CubeError(
            f"the velocities are stated to be {' and '.join(stated)}: state one of {', '.join(MEANINGS)}"
        )
    return MEANINGS[stated[0]]


def states_velocity(cube: xr.Dataset) -> bool:
    """Return True if a cube tells whether its velocities are displacements or instantaneous."""
    of = [cube, *(cube[name] for name in ("u", "v", "w"))]
    return "path_frames" in cube.coords or any({VELOCITY, "recipe"} & {*one.attrs} for one in of)


def inner(lines: int) -> NDArray[np.bool_]:
    """Return a mask (lines,) of frequencies that are below Nyquist and unaffected by removal of the mean."""
    index = np.arange(lines)
    return (index >= MAIN_LOBE) & (index < lines - 1)
