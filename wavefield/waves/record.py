"""The part of a cube that spectra are computed from: a rectangle of nodes and runs of unbroken steps."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import dask
import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft, ndimage

from wavefield.errors import CubeError
from wavefield.grid import largest_rectangle
from wavefield.variables import CUBE_DIMS, TABLE, FrameStatus, Quality, factor

Array = NDArray[Any]

FILL_MARGIN = 8  # steps and nodes around a gap from which it is filled; a larger margin changes nothing
FLOOR = 1e-8  # smallest power in the prior spectrum, relative to the largest; regularises noise-free fields
# conjugate-gradient steps; with 20 % of the nodes missing at random, more steps change nothing
ITERATIONS = 12
ROUNDS = 3  # alternations between the prior spectrum and the filled values; a fourth changes nothing


def fill(block: Array, missing: NDArray[np.bool_]) -> Array:
    """Return a block (steps, ny, nx) with filled gaps: NaN, and all values at steps of the mask `missing`."""
    if not missing.any() and all_finite(block):
        return block
    hole = ~np.isfinite(block) | missing[:, None, None]
    side = 2 * FILL_MARGIN + 1
    if 4 * np.count_nonzero(hole) * side**3 < hole.size:
        boxes = ndimage.find_objects(ndimage.label(ndimage.maximum_filter(hole, side))[0])
    else:
        at = np.flatnonzero(hole.any(axis=(1, 2)))
        boxes = [(slice(max(at[0] - FILL_MARGIN, 0), at[-1] + FILL_MARGIN + 1),)]
    out = block.copy()
    for box in boxes:
        out[box][hole[box]] = most_probable(block[box], hole[box])
    return out


def fill_error(block: Array) -> float:
    """Return the standard deviation of the error of `fill` at the middle step of a block; NaN if unknown.
    For this, measured values are removed in the shape of the holes but elsewhere, filled and compared."""
    holes = ~np.isfinite(block)
    ny, nx = holes.shape[1:]
    elsewhere = np.roll(holes, (ny // 2, nx // 2), (1, 2))  # at all steps, since a hole may last
    known = elsewhere[FILL_MARGIN] & ~holes[FILL_MARGIN]
    if not known.any() or holes[FILL_MARGIN].all():
        return np.nan
    filled = fill(np.where(elsewhere, np.nan, block), np.zeros(len(block), bool))[FILL_MARGIN]
    return float(np.sqrt(np.mean((filled - block[FILL_MARGIN])[known] ** 2)))


def most_probable(block: Array, hole: NDArray[np.bool_]) -> Array:
    """Return the most probable values where `hole` is true in a block (steps, ny, nx), as (hole.sum(),).
    They are the conditional mean of a Gaussian process with the spectrum S of the filled block. Missing
    values m and observed values o satisfy x_m = G_mm x_m + G_mo x_o, with the filter G = 1 - min(S) / S."""
    mean = block[~hole].mean(dtype=float)
    known = np.where(hole, 0, block - mean).astype(block.dtype)
    weight = ndimage.gaussian_filter((~hole).astype(block.dtype), 1.0)
    x = (ndimage.gaussian_filter(known, 1.0) / np.maximum(weight, 1e-9))[hole]
    _, ny, nx = hole.shape  # a cosine transform: line n has n / 2 periods
    distance = np.hypot(np.linspace(0, 1, ny)[:, None], np.linspace(0, 1, nx))
    ring = np.rint(distance * min(ny, nx)).astype(int)
    line = np.arange(len(hole))[:, None, None] * (ring.max() + 1) + ring
    cells = np.maximum(np.bincount(line.ravel()), 1)
    for _ in range(ROUNDS):
        total = np.bincount(line.ravel(), (fft.dctn(_with(known, hole, x), norm="ortho") ** 2).ravel())
        power = total / cells
        least = max(power[power > 0].min(initial=np.inf), FLOOR * power.max())
        if not np.isfinite(least) or least == power.max():
            break
        gain = (1 - least / np.maximum(power, least)).astype(block.dtype)[line]
        x = _conditional_mean(gain, known, hole, x)
    return np.asarray(x + mean)


def _with(known: Array, hole: NDArray[np.bool_], values: Array) -> Array:
    whole = known.copy()
    whole[hole] = values
    return whole


def _conditional_mean(gain: Array, known: Array, hole: NDArray[np.bool_], x: Array) -> Array:
    """Solve x_m = G_mm x_m + G_mo x_o for the missing x_m, (n,), by conjugate gradients that start from `x`.
    `gain` is G in cosine-transform space; `known` is x_o, with 0 where `hole` is true."""
    from scipy.sparse.linalg import LinearOperator, cg  # slow to import; few records need it

    def predicted(whole: Array) -> Array:
        lines = fft.dctn(whole, norm="ortho", overwrite_x=True)
        return np.asarray(fft.idctn(gain * lines, norm="ortho", overwrite_x=True))[hole]

    nothing = np.zeros_like(known)
    matrix = LinearOperator((x.size, x.size), lambda v: v - predicted(_with(nothing, hole, v)), dtype=x.dtype)
    seen = predicted(known.copy())
    return np.asarray(cg(matrix, seen, x, rtol=FLOOR**0.5, maxiter=ITERATIONS)[0])


# each(work, items) maps work over the items, on workers, and yields the results in the order of the items
Each = Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[Any]]

LONGEST_BRIDGE = 2  # steps; longer gaps split the record (across two, 3.3 Hz turns by half a period at 20 Hz)
STEPS_PER_READ = 256  # steps in memory at once; five fields of 100 x 130 nodes take 67 MB
HOLE_SIDE = 3  # nodes; smaller gaps (outliers) are isolated and filled well
# A node of the rectangle is outside holes in this fraction of the steps, and a valid step has this fraction
# of its nodes outside holes. Chosen: with a larger one the rectangle shrinks, with a smaller one noise rises.
MIN_OUTSIDE = 0.9
MIN_MEASURED = 0.5  # fraction of values, per node and per step, that must be measured; the rest is filled
MIN_NODES = 8  # nodes along each side of the rectangle; chosen: twice the main lobe of a Hann window
FIELDS = ("z", "z_t", "u", "v", "w")


@dataclass(frozen=True)
class Record:
    """The part of a cube that is analysed: a rectangle of nodes, and runs of time steps without long gaps."""

    y: tuple[int, int]  # first node of the rectangle, and one past its last
    x: tuple[int, int]
    runs: tuple[tuple[int, int], ...]  # first step of each run without long gaps, and one past its last
    bridged: tuple[int, ...]  # missing steps inside the runs, whose values are interpolated
    steps: int  # of the whole cube
    holes: int  # number of missing values in rectangle and runs, which are interpolated
    dt: float  # spacing of time, s
    dy: float  # spacing of the nodes, m
    dx: float

    @property
    def shape(self) -> tuple[int, int]:
        """Number of nodes of the rectangle, (ny, nx)."""
        return self.y[1] - self.y[0], self.x[1] - self.x[0]

    @property
    def longest(self) -> int:
        """Number of steps of the longest run."""
        return max((b - a for a, b in self.runs), default=0)

    def steps_in_runs(self, shortest: int = 1) -> int:
        """Total number of steps in the runs with at least ``shortest`` steps."""
        return sum(b - a for a, b in self.runs if b - a >= shortest)

    def some_steps(self, count: int) -> list[int]:
        """Return at most ``count`` evenly spaced steps that are measured and belong to an unbroken run."""
        missing = set(self.bridged)
        steps = [t for a, b in self.runs for t in range(a, b) if t not in missing]
        return sorted({steps[i] for i in np.linspace(0, len(steps) - 1, count).astype(int)})


def _spacing(array: xr.DataArray | xr.Dataset, name: str) -> float:
    values = np.asarray(array[name].values, float)
    if values.size < 2:
        raise CubeError(f"the cube has {values.size} {name}: at least two are needed")
    unit = TABLE[name].units
    scale = factor(str(array[name].attrs.get("units", unit)), unit)
    if scale is None:
        raise CubeError(
            f"the cube's {name!r} is in {array[name].attrs['units']!r}: convert it to {unit!r} first"
        )
    values = values * scale if scale != 1 else values
    steps = np.diff(values)
    step = float((values[-1] - values[0]) / (values.size - 1))
    worst = float(np.abs(steps - step).max())
    if not worst <= 1e-3 * abs(step):
        remedy = "interpolate the cube onto a regular grid first"
        if name == "time":
            remedy = "reindex the cube first, with cube.reindex(time=...), which marks missing steps"
        raise CubeError(
            f"the steps of {name!r} are unequal (from {steps.min():g} to {steps.max():g}): {remedy}"
        )
    return step


def check_axes(array: xr.DataArray | xr.Dataset) -> tuple[float, float, float]:
    """Return the steps dt (s), dy and dx (m) of the axes of a cube.
    Raises `CubeError` if a dimension or coordinate is missing, or if steps are unequal or negative."""
    for name in CUBE_DIMS:
        if name not in array.dims:
            raise CubeError(
                f"the array has dimensions {tuple(array.dims)}: spectra need time, y and x"
                f" ({name!r} is missing)"
            )
        if name not in array.coords:
            raise CubeError(f"the cube has no coordinate {name!r}: assign it, in seconds or metres")
    if array["time"].dtype.kind not in "fiu":
        raise CubeError(
            f"the cube's time is of type {array['time'].dtype}: it must be in seconds since the start,"
            " as numbers"
        )
    spacing = {name: _spacing(array, name) for name in CUBE_DIMS}
    for name, step in spacing.items():
        if step <= 0:
            raise CubeError(f"the cube's {name!r} runs backwards: sort it first, cube.sortby({name!r})")
    return spacing["time"], spacing["y"], spacing["x"]


class _Stored:
    """Part of a field on disk, read each time it is converted to a numpy array and not cached."""

    def __init__(self, variable: xr.Variable, area: tuple[slice, slice, slice]) -> None:
        self.variable, self.area = variable, area

    def __array__(self, dtype: np.typing.DTypeLike | None = None, copy: bool | None = None) -> np.ndarray:
        steps, rows, columns = self.area
        part = self.variable.isel(time=steps, y=rows, x=columns).transpose(*CUBE_DIMS)
        return np.asarray(part.values, dtype)


def piece(array: xr.DataArray, steps: slice, rows: slice = slice(None), columns: slice = slice(None)) -> Any:
    """Return part of a field (steps, rows, columns): a dask array if the field has dask chunks. Otherwise
    return an object that is read when it is converted to a numpy array."""
    if array.chunks is None:
        return _Stored(array.variable, (steps, rows, columns))
    return array.transpose(*CUBE_DIMS).isel(time=steps, y=rows, x=columns).data


def chunk_steps(field: xr.DataArray) -> int:
    """Return the number of time steps in a chunk of the field (dask or on disk); 1 for a field in memory."""
    if field.chunks is not None:
        return int(field.chunks[field.get_axis_num("time")][0])
    return int(field.encoding.get("preferred_chunks", {}).get("time", 1))


def all_finite(block: np.ndarray) -> bool:
    """Return True if all values are finite, from their sum, which is faster than a test of each value."""
    return bool(np.isfinite(block.sum()))


def outside_holes(finite: np.ndarray) -> np.ndarray:
    """Return a mask (steps, ny, nx) that is true outside holes, from the mask `finite` of measured nodes.
    A hole is a gap that contains 3 x 3 missing nodes; nodes beyond an edge count as missing."""
    side = np.ones((1, HOLE_SIDE, HOLE_SIDE), bool)
    holes = np.zeros_like(finite)
    for axis in (1, 2):  # one axis at a time, or a single missing node in a corner would be a hole
        pad = [(0, 0), (0, 0), (0, 0)]
        pad[axis] = (HOLE_SIDE - 1, HOLE_SIDE - 1)
        opened = ndimage.binary_opening(np.pad(~finite, pad, constant_values=True), side)
        holes |= opened.take(range(HOLE_SIDE - 1, HOLE_SIDE - 1 + finite.shape[axis]), axis)
    return np.asarray(~holes)


def _finite(pieces: list[object]) -> np.ndarray | None:
    """Return two bit-packed masks, (2, steps, bytes): nodes measured in all fields, and nodes outside holes.
    `pieces` holds a block (steps, ny, nx) of each field. The result is None if no value is missing."""
    mask = None
    for part in pieces:  # one field at a time saves memory
        block = np.asarray(part)
        if not all_finite(block):
            finite = np.isfinite(block)
            mask = finite if mask is None else mask & finite
    if mask is None:
        return None
    return np.packbits(np.stack([mask, outside_holes(mask)]).reshape(2, mask.shape[0], -1), axis=2)


def _runs(valid_steps: np.ndarray) -> tuple[list[tuple[int, int]], list[int]]:
    edges = np.flatnonzero(np.diff(np.r_[False, valid_steps, False].astype(int)))
    runs: list[tuple[int, int]] = []
    bridged: list[int] = []
    for a, b in zip(edges[::2].tolist(), edges[1::2].tolist()):
        if runs and a - runs[-1][1] <= LONGEST_BRIDGE:
            bridged.extend(range(runs[-1][1], a))
            runs[-1] = (runs[-1][0], b)
        else:
            runs.append((a, b))
    return runs, bridged


def _finite_steps(arrays: Sequence[xr.DataArray], steps: tuple[int, int]) -> np.ndarray | None:
    return _finite([piece(array, slice(*steps)) for array in arrays])


def find_record(cube: xr.DataArray | xr.Dataset, each: Each | None = None) -> Record:
    """Return the `Record` of a cube: its largest rectangle of measured nodes, and its runs of measured steps.
    Missing nodes, and gaps of one or two steps, are interpolated later; longer gaps end a run. `each(work,
    items)` applies work to items on workers. CubeError if no rectangle of 8 x 8 nodes is measured."""
    dt, dy, dx = check_axes(cube)
    arrays = [cube] if isinstance(cube, xr.DataArray) else [cube[name] for name in FIELDS if name in cube]
    if not arrays:
        raise CubeError(f"the cube has none of {', '.join(FIELDS)} over time, y and x")
    steps, ny, nx = (arrays[0].sizes[name] for name in CUBE_DIMS)
    chunk = chunk_steps(arrays[0])
    at_a_time = max(STEPS_PER_READ // chunk, 1) * chunk  # whole chunks, so each is read once
    pieces = [(a, min(a + at_a_time, steps)) for a in range(0, steps, at_a_time)]
    if each is None:
        tasks = (dask.delayed(_finite)([piece(array, slice(a, b)) for array in arrays]) for a, b in pieces)
        masks = dask.compute(*tasks, traverse=True)
    else:
        masks = tuple(each(partial(_finite_steps, arrays), pieces))
    valid_nodes = _ValidNodes(pieces, masks, (ny, nx))
    valid_steps = _valid_steps(valid_nodes, _measured(cube, steps))
    y, x = _rectangle(valid_nodes, valid_steps, _never_masked(cube, valid_nodes))
    size, holes = (y[1] - y[0]) * (x[1] - x[0]), 0
    for steps_of, there in valid_nodes:
        if there is not None:
            measured, outside = there[:, :, y[0] : y[1], x[0] : x[1]].sum(axis=(2, 3))
            valid_steps[steps_of] &= (outside >= MIN_OUTSIDE * size) & (measured >= MIN_MEASURED * size)
            holes += int((size - measured)[valid_steps[steps_of]].sum())
    runs, bridged = _runs(valid_steps)
    return Record(y, x, tuple(runs), tuple(bridged), steps, holes, dt, dy, dx)


@dataclass(frozen=True)
class _ValidNodes:
    """Bit-packed masks of measured nodes and of nodes outside holes, for successive intervals of time."""

    pieces: Sequence[tuple[int, int]]
    masks: Sequence[np.ndarray | None]  # None for a piece without gaps
    shape: tuple[int, int]

    def __iter__(self) -> Iterator[tuple[slice, np.ndarray | None]]:
        ny, nx = self.shape
        for mask, (a, b) in zip(self.masks, self.pieces):
            if mask is None:
                yield slice(a, b), None
            else:
                bits = np.unpackbits(mask, axis=2, count=ny * nx)
                yield slice(a, b), bits.reshape(2, b - a, ny, nx).astype(bool)


def _measured(cube: object, steps: int) -> np.ndarray:
    if isinstance(cube, xr.Dataset) and "frame_status" in cube:
        done = FrameStatus.DONE, FrameStatus.DONE_WITH_FAULTS
        return np.isin(cube["frame_status"].values, done)
    return np.ones(steps, bool)


def _valid_steps(valid_nodes: _ValidNodes, measured: np.ndarray) -> np.ndarray:
    """Return a mask of the `measured` steps with at least half as many values as the median step."""
    ny, nx = valid_nodes.shape
    count = np.full(measured.size, ny * nx)
    for steps, there in valid_nodes:
        if there is not None:
            count[steps] = there[0].sum(axis=(1, 2))
    not_empty = measured & (count > 0)
    if not not_empty.any():
        raise CubeError("no step of the cube holds a single value: run it first, or check its frame_status")
    out: np.ndarray = not_empty & (count >= MIN_MEASURED * np.median(count[not_empty]))
    return out


def _rectangle(
    valid_nodes: _ValidNodes, valid_steps: np.ndarray, open_water: np.ndarray
) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return the largest usable rectangle of nodes in the mask `open_water`, as (first, last + 1) of y and x.
    Usable nodes are measured in half of the valid steps, and outside holes in nine tenths of them."""
    times = np.zeros((2, *valid_nodes.shape), int)  # number of steps measured, and outside of holes
    for steps, there in valid_nodes:
        valid = valid_steps[steps]
        times += int(valid.sum()) if there is None else there[:, valid].sum(axis=1)
    least = np.array([MIN_MEASURED, MIN_OUTSIDE])[:, None, None] * valid_steps.sum()
    y, x = largest_rectangle((times >= least).all(axis=0) & open_water)
    if min(y[1] - y[0], x[1] - x[0]) < MIN_NODES:
        missing = 100 * (1 - times[0].mean() / valid_steps.sum())
        raise CubeError(
            f"the largest rectangle of nodes that are measured throughout is {y[1] - y[0]} x {x[1] - x[0]}"
            f" (y, x), less than {MIN_NODES} x {MIN_NODES} ({missing:.0f} % of the values are missing, and"
            f" {100 * (1 - open_water.mean()):.0f} % of the nodes are masked at some step): choose a grid"
            " inside the common field of all cameras, fill larger holes, or leave out steps with large masks"
        )
    return y, x


def _never_masked(cube: xr.Dataset | xr.DataArray, valid_nodes: _ValidNodes) -> np.ndarray:
    """Return a mask (ny, nx) of the nodes that are masked at no step; masked nodes are not water."""
    out = np.ones(valid_nodes.shape, bool)
    if isinstance(cube, xr.Dataset) and "quality" in cube:
        for steps, there in valid_nodes:
            if there is not None:
                bits = np.asarray(piece(cube["quality"], steps), np.float64)  # NaN at reindexed steps
                out &= ((np.nan_to_num(bits).astype(np.int64) & int(Quality.MASKED)) == 0).all(axis=0)
    return out


def whole_record(array: xr.DataArray | xr.Dataset) -> Record:
    """Return a `Record` of all nodes and steps of an array without missing values, without reading it."""
    dt, dy, dx = check_axes(array)
    steps, ny, nx = (array.sizes[name] for name in CUBE_DIMS)
    return Record((0, ny), (0, nx), ((0, steps),), (), steps, 0, dt, dy, dx)


def filled_error(record: Record, field: xr.DataArray) -> float:
    """Return the standard deviation of the error of `field` at interpolated nodes.
    It is 0 if no node is interpolated, and NaN if it cannot be estimated."""
    if not record.holes:
        return 0.0
    inside = [t for a, b in record.runs for t in range(a + FILL_MARGIN, b - FILL_MARGIN)]
    # twelve steps give the error to 20 %
    chosen = {inside[i] for i in np.linspace(0, len(inside) - 1, 12).astype(int)} if inside else ()
    area = slice(*record.y), slice(*record.x)
    blocks = (
        np.asarray(piece(field, slice(t - FILL_MARGIN, t + FILL_MARGIN + 1), *area)) for t in sorted(chosen)
    )
    errors = np.array([fill_error(block) for block in blocks])
    errors = errors[np.isfinite(errors)]
    return float(np.sqrt(np.mean(errors**2))) if errors.size else np.nan


def filled_density(record: Record, field: xr.DataArray) -> float:
    """Return the power that errors of interpolated nodes add to E(omega) at every omega; 0 if unknown."""
    share = record.holes / max(record.steps_in_runs() * record.shape[0] * record.shape[1], 1)
    return float(np.nan_to_num(share * filled_error(record, field) ** 2 * record.dt / np.pi))
