"""The part of a cube that spectra are computed from: its largest full rectangle, its unbroken runs."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
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

_WEIGHTS = (15 / 20, -6 / 20, 1 / 20)  # of the steps at 1, 2, 3: exact for polynomials of fifth degree
IN_TIME = len(_WEIGHTS)  # steps before and after that a missing value depends on
FLOOR = 1e-8  # of the largest power of a ring: the range in which a noise-free field is still interpolated
ITERATIONS = 12  # of conjugate gradients: with a fifth of the nodes missing at random more change nothing
ROUNDING = 1e-28  # of the first residual's square: what is left of it is rounding, and in the end 0 / 0
_LAG = 2  # nodes between the values of a fourth difference, which grows with k^4


def fill_nodes(block: Array, missing: NDArray[np.bool_]) -> Array:
    """Fill the missing nodes of steps (steps, ny, nx) that are not missing as a whole.
    First each step is interpolated smoothly, then the error predicted from the steps around is subtracted.
    """
    holes = ~np.isfinite(block) & ~missing[:, None, None]
    out = block.copy()
    alone = {}
    for t in np.flatnonzero(holes.any(axis=(1, 2))).tolist():
        alone[t] = block[t].copy()
        alone[t][holes[t]] = out[t][holes[t]] = most_probable(block[t], holes[t])
    for t, field in alone.items():
        near = slice(t - IN_TIME, t + IN_TIME + 1)
        if near.start < 0 or near.stop > len(block) or missing[near].any():
            continue
        guess = np.zeros(field.shape)
        for distance, weight in enumerate(_WEIGHTS, 1):
            for other in (t - distance, t + distance):
                guess += weight * alone.get(other, block[other])
        guess *= _agreement(field, guess)
        out[t][holes[t]] = guess[holes[t]] + most_probable(block[t] - guess, holes[t])
    return out


def fill_error(block: Array) -> float:
    """Standard deviation of `fill_nodes` at the middle of 2 `IN_TIME` + 1 steps; NaN without holes.
    Measured on present nodes, in holes of the same shapes half a field away.
    """
    holes = ~np.isfinite(block)
    ny, nx = holes.shape[1:]
    elsewhere = np.roll(holes, (ny // 2, nx // 2), (1, 2))  # at all steps: a hole stays for some of them
    known = elsewhere[IN_TIME] & ~holes[IN_TIME]
    if not known.any() or holes[IN_TIME].all():
        return np.nan
    holed = np.where(elsewhere, np.nan, block)
    missing = np.asarray(~np.isfinite(block).any(axis=(1, 2)))
    filled = fill_nodes(holed, missing)[IN_TIME]
    return float(np.sqrt(np.mean((filled - block[IN_TIME])[known] ** 2)))


def _agreement(field: Array, guess: Array) -> float:
    """Factor on a prediction (ny, nx) that leaves the least short-wave energy of a field."""
    short = []
    for values in (field.astype(np.float64), guess):
        parts = [np.zeros(1)]
        for axis, n in enumerate(values.shape):
            if n > 4 * _LAG:
                starts = [np.arange(i * _LAG, n - (4 - i) * _LAG) for i in range(5)]
                moved = [weight * values.take(at, axis) for weight, at in zip((1, -4, 6, -4, 1), starts)]
                parts.append(np.sum(moved, axis=0).ravel())
        short.append(np.concatenate(parts))
    power = float(short[1] @ short[1])
    return float(np.clip(short[0] @ short[1] / power, 0, 1)) if power > 0 else 0.0


def most_probable(field: Array, hole: NDArray[np.bool_]) -> Array:
    """Values of the missing nodes (hole.sum(),) of a field (ny, nx): conditional mean of a Gaussian process.
    Its spectrum S is that of the filled field, averaged over rings of wavenumber, with G = 1 - min(S) / S the
    values are the solution of x_m = G_mm x_m + G_mo x_o, by conjugate gradients. Two rounds, from the mean of
    near nodes.
    """
    mean = field[~hole].mean(dtype=float) if not hole.all() else 0.0
    known = np.where(hole, 0.0, field - mean).astype(float)
    weight = ndimage.gaussian_filter((~hole).astype(float), 1.0)
    x = (ndimage.gaussian_filter(known, 1.0) / np.maximum(weight, 1e-9))[hole]
    ny, nx = hole.shape  # cosines of half a period and more
    distance = np.hypot(np.linspace(0, 1, ny)[:, None], np.linspace(0, 1, nx))
    ring = np.rint(distance * min(ny, nx)).astype(int)
    for _ in range(2):
        total = np.bincount(ring.ravel(), (fft.dctn(_with(known, hole, x), norm="ortho") ** 2).ravel())
        power = total / np.maximum(np.bincount(ring.ravel()), 1)
        least = max(power[power > 0].min(initial=np.inf), FLOOR * power.max())
        if not np.isfinite(least) or least == power.max():
            break
        x = _conditional_mean((1 - least / np.maximum(power, least))[ring], known, hole, x)
    return np.asarray(x + mean)


def _with(known: Array, hole: NDArray[np.bool_], values: Array) -> Array:
    whole = known.copy()
    whole[hole] = values
    return whole


def _conditional_mean(gain: Array, known: Array, hole: NDArray[np.bool_], x: Array) -> Array:
    """Solve x_m = G_mm x_m + G_mo x_o by conjugate gradients from x."""

    def predicted(whole: Array) -> Array:
        return np.asarray(fft.idctn(gain * fft.dctn(whole, norm="ortho"), norm="ortho"))[hole]

    nothing = np.zeros(hole.shape)
    direction = residual = predicted(_with(known, hole, x)) - x
    size = residual @ residual
    solved = ROUNDING * size
    for _ in range(ITERATIONS):
        if not size > solved:
            break
        image = direction - predicted(_with(nothing, hole, direction))
        step = size / (direction @ image)
        x = x + step * direction
        residual = residual - step * image
        size, before = residual @ residual, size
        direction = residual + size / before * direction
    return x


# does work for every item, on workers, and gives the results in the order of the items
Each = Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[Any]]

LONGEST_BRIDGE = 2  # steps: longer gaps split the record
STEPS_PER_READ = 256  # of five fields of 100 x 130 nodes 67 MB
HOLE_SIDE = 3  # nodes: smaller holes, such as rejected nodes leave, are isolated and filled well
MIN_NODE_FRACTION = 0.9  # of the valid steps: a node of the rectangle is outside of holes in so many
MIN_STEP_FRACTION = 0.95  # of the rectangle: a valid step has so many nodes outside of holes
MIN_MEASURED = 0.5  # of the steps of a node, and of the nodes of a step, that isolated ones may lack
FILLED_STEPS = 12  # at which the error of filled nodes is found
MIN_NODES = 8  # along either side of the rectangle
FIELDS = ("z", "z_t", "u", "v", "w")


@dataclass(frozen=True)
class Record:
    """Where in a cube the estimators work.

    Parameters
    ----------
    y, x : tuple of int
        First node and one past the last, of the rectangle.
    runs : tuple of (int, int)
        First step and one past the last, of each run without long gaps.
    bridged : tuple of int
        Missing steps inside the runs: interpolated in time.
    steps : int
        Steps of the whole cube.
    holes : int
        Nodes missing inside the rectangle at valid steps: filled from those around them in space and time.
    dt, dy, dx : float
        Distances, s and m.
    """

    y: tuple[int, int]
    x: tuple[int, int]
    runs: tuple[tuple[int, int], ...]
    bridged: tuple[int, ...]
    steps: int
    holes: int
    dt: float
    dy: float
    dx: float

    @property
    def shape(self) -> tuple[int, int]:
        """Nodes of the rectangle, (ny, nx)."""
        return self.y[1] - self.y[0], self.x[1] - self.x[0]

    @property
    def longest(self) -> int:
        """Steps of the longest run."""
        return max((b - a for a, b in self.runs), default=0)

    def steps_in_runs(self, shortest: int = 1) -> int:
        """Steps of all runs that have so many steps at least."""
        return sum(b - a for a, b in self.runs if b - a >= shortest)

    def part(self, first: int, stop: int) -> "Record":
        """The record of some steps of one run."""
        return replace(
            self, runs=((first, stop),), bridged=tuple(n for n in self.bridged if first <= n < stop)
        )


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
    """Steps dt, dy, dx of the axes of a cube, which are evenly spaced."""
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
    """A piece of a stored field that is read on conversion and not kept (xarray would cache it)."""

    def __init__(self, variable: xr.Variable, area: tuple[slice, slice, slice]) -> None:
        self.variable, self.area = variable, area

    def __array__(self, dtype: np.typing.DTypeLike | None = None, copy: bool | None = None) -> np.ndarray:
        steps, rows, columns = self.area
        part = self.variable.isel(time=steps, y=rows, x=columns).transpose(*CUBE_DIMS)
        return np.asarray(part.values, dtype)


def piece(array: xr.DataArray, steps: slice, rows: slice = slice(None), columns: slice = slice(None)) -> Any:
    """Cut a piece out of a field: a dask array if the cube is chunked, else read inside the task."""
    if array.chunks is None:
        return _Stored(array.variable, (steps, rows, columns))
    return array.transpose(*CUBE_DIMS).isel(time=steps, y=rows, x=columns).data


def all_finite(block: np.ndarray) -> bool:
    """Whether every value is finite, from their sum, which is faster than testing each."""
    return bool(np.isfinite(block.sum(dtype=np.float64)))


def outside_holes(finite: np.ndarray) -> np.ndarray:
    """Nodes (steps, ny, nx) that are measured, or missing in less than `HOLE_SIDE` x `HOLE_SIDE` together.
    Beyond an edge nodes count as missing, so that what is missing along an edge is a hole.
    """
    side = np.ones((1, HOLE_SIDE, HOLE_SIDE), bool)
    holes = np.zeros_like(finite)
    for axis in (1, 2):  # one pair of edges after the other: at a corner a single node would be a hole
        pad = [(0, 0), (0, 0), (0, 0)]
        pad[axis] = (HOLE_SIDE - 1, HOLE_SIDE - 1)
        opened = ndimage.binary_opening(np.pad(~finite, pad, constant_values=True), side)
        holes |= opened.take(range(HOLE_SIDE - 1, HOLE_SIDE - 1 + finite.shape[axis]), axis)
    return np.asarray(~holes)


def _finite(pieces: list[object]) -> np.ndarray | None:
    """Packed masks of nodes with values in all variables, and of nodes outside holes, (2, steps, bytes).
    None if nothing is missing.
    """
    mask = None
    for part in pieces:  # one at a time: memory
        block = np.asarray(part)
        if not all_finite(block):
            finite = np.isfinite(block)
            mask = finite if mask is None else mask & finite
    if mask is None:
        return None
    return np.packbits(np.stack([mask, outside_holes(mask)]).reshape(2, mask.shape[0], -1), axis=2)


def _runs(valid_steps: np.ndarray) -> tuple[list[tuple[int, int]], list[int]]:
    """Runs of valid steps, and the steps in short gaps between them that are bridged."""
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
    """Find the largest full rectangle of nodes and the runs of valid steps of a cube.

    Gaps of at most two steps are bridged by interpolation in time; longer ones split the record.
    The values are read once (a lazy cube is computed for it); only a mask of them is held.

    Parameters
    ----------
    cube : xarray.Dataset or xarray.DataArray
        Variables over (time, y, x), metres and seconds; ``frame_status`` and ``quality`` are used where
        present: no node of the rectangle is masked at any step of the runs.
    each : callable, optional
        ``each(work, items)`` does the work elsewhere, and gives the results in order.

    Returns
    -------
    Record
        What the estimators work on.

    Raises
    ------
    CubeError
        If the axes are uneven, no step is valid or no full rectangle is left.
    """
    dt, dy, dx = check_axes(cube)
    arrays = [cube] if isinstance(cube, xr.DataArray) else [cube[name] for name in FIELDS if name in cube]
    if not arrays:
        raise CubeError(f"the cube has none of {', '.join(FIELDS)} over time, y and x")
    steps, ny, nx = (arrays[0].sizes[name] for name in CUBE_DIMS)
    pieces = [(a, min(a + STEPS_PER_READ, steps)) for a in range(0, steps, STEPS_PER_READ)]
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
            valid_steps[steps_of] &= (outside >= MIN_STEP_FRACTION * size) & (measured >= MIN_MEASURED * size)
            holes += int((size - measured)[valid_steps[steps_of]].sum())
    runs, bridged = _runs(valid_steps)
    return Record(y, x, tuple(runs), tuple(bridged), steps, holes, dt, dy, dx)


@dataclass(frozen=True)
class _ValidNodes:
    """Masks of nodes with values, and of nodes outside holes, packed in bits per piece; None if complete."""

    pieces: Sequence[tuple[int, int]]
    masks: Sequence[np.ndarray | None]
    shape: tuple[int, int]

    def __iter__(self) -> Iterator[tuple[slice, np.ndarray | None]]:
        """Steps of each piece and, unless all nodes have values, the masks, (2, steps, ny, nx) bool."""
        ny, nx = self.shape
        for mask, (a, b) in zip(self.masks, self.pieces):
            if mask is None:
                yield slice(a, b), None
            else:
                bits = np.unpackbits(mask, axis=2, count=ny * nx)
                yield slice(a, b), bits.reshape(2, b - a, ny, nx).astype(bool)


def _measured(cube: object, steps: int) -> np.ndarray:
    """Steps that the ledger marks as measured; all without a ledger."""
    if isinstance(cube, xr.Dataset) and "frame_status" in cube:
        done = FrameStatus.DONE, FrameStatus.DONE_WITH_FAULTS
        return np.isin(cube["frame_status"].values, done)
    return np.ones(steps, bool)


def _valid_steps(valid_nodes: _ValidNodes, measured: np.ndarray) -> np.ndarray:
    """Measured steps with at least half as many values as the median one."""
    ny, nx = valid_nodes.shape
    count = np.full(measured.size, ny * nx)
    for steps, there in valid_nodes:
        if there is not None:
            count[steps] = there[0].sum(axis=(1, 2))
    not_empty = measured & (count > 0)
    if not not_empty.any():
        raise CubeError("no step of the cube holds a single value: run it first, or check its frame_status")
    out: np.ndarray = not_empty & (count >= np.median(count[not_empty]) / 2)
    return out


def _rectangle(
    valid_nodes: _ValidNodes, valid_steps: np.ndarray, open_water: np.ndarray
) -> tuple[tuple[int, int], tuple[int, int]]:
    """Largest rectangle of open water, y and x, whose nodes have values in nearly all valid steps."""
    times = np.zeros((2, *valid_nodes.shape), int)  # measured, and outside of holes
    for steps, there in valid_nodes:
        valid = valid_steps[steps]
        times += int(valid.sum()) if there is None else there[:, valid].sum(axis=1)
    least = np.array([MIN_MEASURED, MIN_NODE_FRACTION])[:, None, None] * valid_steps.sum()
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
    """Nodes (ny, nx) that are masked at no step; a masked node has no value, and is never filled."""
    out = np.ones(valid_nodes.shape, bool)
    if isinstance(cube, xr.Dataset) and "quality" in cube:
        for steps, there in valid_nodes:
            if there is not None:
                bits = np.asarray(piece(cube["quality"], steps), np.float64)  # NaN where it was reindexed
                out &= ((np.nan_to_num(bits).astype(np.int64) & int(Quality.MASKED)) == 0).all(axis=0)
    return out


def whole_record(array: xr.DataArray | xr.Dataset) -> Record:
    """Take every node and step of an array that has nothing missing, without reading its values.

    Parameters
    ----------
    array : xarray.DataArray or xarray.Dataset
        Variables over (time, y, x).

    Returns
    -------
    Record
        All of it.
    """
    dt, dy, dx = check_axes(array)
    steps, ny, nx = (array.sizes[name] for name in CUBE_DIMS)
    return Record((0, ny), (0, nx), ((0, steps),), (), steps, 0, dt, dy, dx)


def filled_error(record: Record, field: xr.DataArray) -> float:
    """Standard deviation of the error of a field at filled nodes, measured on present nodes.
    0 without filled nodes, NaN if runs are too short to measure it.
    """
    if not record.holes:
        return 0.0
    inside = [t for a, b in record.runs for t in range(a + IN_TIME, b - IN_TIME)]
    chosen = {inside[i] for i in np.linspace(0, len(inside) - 1, FILLED_STEPS).astype(int)} if inside else ()
    area = slice(*record.y), slice(*record.x)
    blocks = (np.asarray(piece(field, slice(t - IN_TIME, t + IN_TIME + 1), *area)) for t in sorted(chosen))
    errors = np.array([fill_error(block) for block in blocks])
    errors = errors[np.isfinite(errors)]
    return float(np.sqrt(np.mean(errors**2))) if errors.size else np.nan


def filled_density(record: Record, field: xr.DataArray) -> float:
    """Upper limit of what filled nodes add to E(omega) of a field, per rad/s: white error up to Nyquist."""
    share = record.holes / max(record.steps_in_runs() * record.shape[0] * record.shape[1], 1)
    return float(np.nan_to_num(share * filled_error(record, field) ** 2 * record.dt / np.pi))


def fill(block: np.ndarray, missing: np.ndarray) -> np.ndarray:
    """Fill the missing steps, and nodes, of a piece of a record (steps, ny, nx)."""
    if not missing.any() and all_finite(block):
        return block
    block = fill_nodes(block, missing)
    valid_steps = np.flatnonzero(~missing)
    for t in np.flatnonzero(missing):
        before, after = valid_steps[valid_steps < t][-2:], valid_steps[valid_steps > t][:2]
        if before.size != after.size:  # at an edge: from the nearest
            before, after = before[-1:], after[:1]
        nodes = np.r_[before, after].astype(float)
        weights = [np.prod([(t - q) / (p - q) for q in nodes if q != p]) for p in nodes]
        block[t] = np.tensordot(np.array(weights, block.dtype), block[nodes.astype(int)], axes=1)
    return block
