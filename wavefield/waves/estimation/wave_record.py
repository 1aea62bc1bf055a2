"""The part of a cube that spectra can be taken from: its largest full rectangle, its unbroken runs."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import dask
import numpy as np
import xarray as xr
from scipy import ndimage

from wavefield.errors import CubeError
from wavefield.grid import largest_rectangle
from wavefield.variables import CUBE_DIMS, TABLE, FrameStatus, Quality, factor

# does work for every item, on workers, and gives the results in the order of the items
Each = Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[Any]]

LONGEST_BRIDGE = 2  # steps: longer gaps split the record
_FIELDS = ("z", "z_t", "u", "v", "w")
_STEPS_PER_READ = 256  # steps looked at in one piece
_NODE_FRACTION = 0.9  # of the good steps in which a node must be there to belong to the rectangle
_STEP_FRACTION = 0.95  # of the rectangle that must be there for a step to count
_SMALLEST = 8  # nodes along either side of a usable rectangle


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
        Single nodes missing inside the rectangle at good steps: filled from their neighbours.
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


def _spacing(array: Any, name: str) -> float:
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
        what = (
            "put the cube on its clock first, for example with cube.reindex(time=...), which marks what is"
            " missing"
            if name == "time"
            else "interpolate the cube onto a regular grid first"
        )
        raise CubeError(
            f"the steps of {name!r} are unequal (from {steps.min():g} to {steps.max():g}): {what}"
        )
    return step


def check_axes(array: Any) -> tuple[float, float, float]:
    """Check that an array has the axes of a cube, evenly spaced."""
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
    """A piece of a stored field: read when it is looked at, and not kept (xarray keeps what it has read)."""

    def __init__(self, variable: xr.Variable, area: tuple[slice, slice, slice]) -> None:
        self.variable, self.area = variable, area

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        steps, rows, columns = self.area
        part = self.variable.isel(time=steps, y=rows, x=columns).transpose(*CUBE_DIMS)
        return np.asarray(part.values, dtype)


def piece(array: xr.DataArray, steps: slice, rows: slice = slice(None), columns: slice = slice(None)) -> Any:
    """Cut a piece out of a field: a dask array where the cube is chunked, else read when its task runs."""
    if array.chunks is None:
        return _Stored(array.variable, (steps, rows, columns))
    return array.transpose(*CUBE_DIMS).isel(time=steps, y=rows, x=columns).data


def is_whole(block: np.ndarray) -> bool:
    """Whether every value is finite: a sum, which is quicker than a look at each."""
    return bool(np.isfinite(block.sum(dtype=np.float64)))


def _finite(pieces: list[Any]) -> np.ndarray | None:
    # packed mask of what is there in all variables; None where nothing is missing (the usual case, and quick)
    mask = None
    for part in pieces:  # one at a time: memory
        block = np.asarray(part)
        if not is_whole(block):
            there = np.isfinite(block)
            mask = there if mask is None else mask & there
    return None if mask is None else np.packbits(mask.reshape(mask.shape[0], -1), axis=1)


def _runs(
    valid_steps: np.ndarray, longest_bridge: int, barred: np.ndarray
) -> tuple[list[tuple[int, int]], list[int]]:
    # runs of good steps; gaps up to `longest_bridge` between good steps are bridged, but none that is barred
    edges = np.flatnonzero(np.diff(np.r_[False, valid_steps, False].astype(int)))
    pieces = list(zip(edges[::2].tolist(), edges[1::2].tolist()))
    runs: list[tuple[int, int]] = []
    bridged: list[int] = []
    for a, b in pieces:
        if runs and a - runs[-1][1] <= longest_bridge and not barred[runs[-1][1] : a].any():
            bridged.extend(range(runs[-1][1], a))
            runs[-1] = (runs[-1][0], b)
        else:
            runs.append((a, b))
    return runs, bridged


def _masks(arrays: Sequence[xr.DataArray], pieces: Sequence[tuple[int, int]]) -> Sequence[np.ndarray | None]:
    tasks = (dask.delayed(_finite)([piece(array, slice(a, b)) for array in arrays]) for a, b in pieces)
    found: tuple[np.ndarray | None, ...] = dask.compute(*tasks, traverse=True)
    return found


@dataclass(frozen=True)
class _Mask:
    """What is there of some steps of fields that are not computed yet, or stored."""

    arrays: Sequence[xr.DataArray]

    def __call__(self, steps: tuple[int, int]) -> np.ndarray | None:
        return _finite([piece(array, slice(*steps)) for array in self.arrays])


def find_record(cube: Any, longest_bridge: int = LONGEST_BRIDGE, each: Each | None = None) -> Record:
    """Find the largest full rectangle of nodes and the runs of good steps of a cube.

    The values are read once (a cube that is not computed yet is computed for it); nothing is kept but a mask.

    Parameters
    ----------
    cube : xarray.Dataset or xarray.DataArray
        Variables over (time, y, x), metres and seconds; ``frame_status`` is heeded where there is one, and
        what ``quality`` calls masked: no node of the rectangle is masked at any step of the runs.
    longest_bridge : int
        Longest gap, in steps, that is bridged by interpolation in time; longer ones split the record.
    each : callable, optional
        ``each(work, items)`` does the work elsewhere, and gives the results in order.

    Returns
    -------
    Record
        What the estimators work on.

    Raises
    ------
    CubeError
        If the axes are uneven, no step is good or no full rectangle is left.
    """
    dt, dy, dx = check_axes(cube)
    arrays = [cube] if isinstance(cube, xr.DataArray) else [cube[name] for name in _FIELDS if name in cube]
    if not arrays:
        raise CubeError(f"the cube has none of {', '.join(_FIELDS)} over time, y and x")
    steps, ny, nx = (arrays[0].sizes[name] for name in CUBE_DIMS)
    pieces = [(a, min(a + _STEPS_PER_READ, steps)) for a in range(0, steps, _STEPS_PER_READ)]
    masks = _masks(arrays, pieces) if each is None else list(each(_Mask(arrays), pieces))

    valid_nodes = _ValidNodes(pieces, masks, (ny, nx))
    valid_steps = _good_steps(valid_nodes, _measured(cube, steps))
    (y, x), barred = _beside_masks(valid_nodes, valid_steps, _masked_pieces(cube, valid_nodes))
    valid_steps &= ~barred
    size, holes = (y[1] - y[0]) * (x[1] - x[0]), 0
    for steps_of, there in valid_nodes:
        if there is not None:
            inside = there[:, y[0] : y[1], x[0] : x[1]].sum(axis=(1, 2))
            valid_steps[steps_of] &= inside >= _STEP_FRACTION * size
            holes += int((size - inside)[valid_steps[steps_of]].sum())
    runs, bridged = _runs(valid_steps, longest_bridge, barred)
    return Record(y, x, tuple(runs), tuple(bridged), steps, holes, dt, dy, dx)


@dataclass(frozen=True)
class _ValidNodes:
    """Which nodes hold values: of each piece of the steps a mask in bits, None where all do."""

    pieces: Sequence[tuple[int, int]]
    masks: Sequence[np.ndarray | None]
    shape: tuple[int, int]

    def __iter__(self) -> Iterator[tuple[slice, np.ndarray | None]]:
        """Steps of each piece and, unless all nodes hold values, (steps, ny, nx) bool."""
        ny, nx = self.shape
        for mask, (a, b) in zip(self.masks, self.pieces):
            if mask is None:
                yield slice(a, b), None
            else:
                bits = np.unpackbits(mask, axis=1, count=ny * nx)
                yield slice(a, b), bits.reshape(b - a, ny, nx).astype(bool)


def _measured(cube: Any, steps: int) -> np.ndarray:
    """Steps that the ledger, where there is one, calls measured."""
    if isinstance(cube, xr.Dataset) and "frame_status" in cube:
        done = FrameStatus.DONE, FrameStatus.DONE_WITH_FAULTS
        return np.isin(cube["frame_status"].values, done)
    return np.ones(steps, bool)


def _good_steps(valid_nodes: _ValidNodes, known: np.ndarray) -> np.ndarray:
    """Measured steps that hold half as many values as the median one at least."""
    ny, nx = valid_nodes.shape
    count = np.full(known.size, ny * nx)
    for steps, there in valid_nodes:
        if there is not None:
            count[steps] = there.sum(axis=(1, 2))
    alive = known & (count > 0)
    if not alive.any():
        raise CubeError("no step of the cube holds a single value: run it first, or look at its frame_status")
    out: np.ndarray = alive & (count >= np.median(count[alive]) / 2)
    return out


def _rectangle(
    valid_nodes: _ValidNodes, valid_steps: np.ndarray, open_water: np.ndarray | bool = True
) -> tuple[tuple[int, int], tuple[int, int]]:
    """Largest rectangle of nodes, y and x, that hold values in nearly all good steps."""
    seen = np.zeros(valid_nodes.shape, int)
    for steps, there in valid_nodes:
        seen += int(valid_steps[steps].sum()) if there is None else there[valid_steps[steps]].sum(axis=0)
    y, x = largest_rectangle((seen >= _NODE_FRACTION * valid_steps.sum()) & open_water)
    if min(y[1] - y[0], x[1] - x[0]) < _SMALLEST:
        raise CubeError(
            f"the largest rectangle of nodes that are measured throughout is {y[1] - y[0]} x {x[1] - x[0]}"
            f" (y, x), less than {_SMALLEST} x {_SMALLEST}: choose a grid inside the field that all cameras"
            " see"
        )
    return y, x


def _masked_pieces(cube: Any, valid_nodes: _ValidNodes) -> list[tuple[slice, np.ndarray]]:
    """Where something is masked at some steps, (steps, ny, nx) bool; a mask leaves no values."""
    if not (isinstance(cube, xr.Dataset) and "quality" in cube):
        return []
    out = []
    for steps, there in valid_nodes:
        if there is not None:
            bits = np.asarray(piece(cube["quality"], steps), np.float64)  # NaN where it was reindexed
            masked = (np.nan_to_num(bits).astype(np.int64) & int(Quality.MASKED)) != 0
            if masked.any():
                out.append((steps, masked))
    return out


def _beside_masks(
    valid_nodes: _ValidNodes, valid_steps: np.ndarray, masked: Sequence[tuple[slice, np.ndarray]]
) -> tuple[tuple[tuple[int, int], tuple[int, int]], np.ndarray]:
    """Rectangle, and steps to be left out, so that nothing masked is left: it is no water, and never filled.

    Nodes that are masked at any step are left out, or all such steps are: what keeps more.
    """
    ever, none = np.zeros(valid_nodes.shape, bool), np.zeros(valid_steps.size, bool)
    for _, what in masked:
        ever |= what.any(axis=0)
    across, barred = _rectangle(valid_nodes, valid_steps), none.copy()
    (y0, y1), (x0, x1) = across
    for steps, what in masked:
        barred[steps] = what[:, y0:y1, x0:x1].any(axis=(1, 2))
    if not barred.any():
        return across, barred
    with suppress(CubeError):  # where no rectangle is left beside what moves
        (v0, v1), (u0, u1) = beside = _rectangle(valid_nodes, valid_steps, ~ever)
        if (v1 - v0) * (u1 - u0) * valid_steps.sum() >= (y1 - y0) * (x1 - x0) * (valid_steps & ~barred).sum():
            return beside, none
    return across, barred


def whole_record(array: Any) -> Record:
    """Take every node and step of an array that has nothing missing, without looking at its values.

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


def fill(block: np.ndarray, missing: np.ndarray) -> np.ndarray:
    """Fill what is missing in a piece of a record.

    With block (steps, ny, nx); missing (steps,).
    """
    if not missing.any() and is_whole(block):
        return block
    block = block.copy()
    valid_steps = np.flatnonzero(~missing)
    for t in valid_steps:
        hole = ~np.isfinite(block[t])
        if hole.any():
            nearest = ndimage.distance_transform_edt(hole, return_distances=False, return_indices=True)
            block[t] = block[t][tuple(nearest)]
    for t in np.flatnonzero(missing):
        before, after = valid_steps[valid_steps < t][-2:], valid_steps[valid_steps > t][:2]
        if before.size != after.size:  # at an edge: lean on the nearest
            before, after = before[-1:], after[:1]
        nodes = np.r_[before, after].astype(float)
        weights = [np.prod([(t - q) / (p - q) for q in nodes if q != p]) for p in nodes]
        block[t] = np.tensordot(np.array(weights, block.dtype), block[nodes.astype(int)], axes=1)
    return block
