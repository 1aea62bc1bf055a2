"""Structure functions: moments of the increments of a field in time and space, with uncertainties."""

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.errors import CubeError
from wavefield.variables import annotate
from wavefield.waves.crests import BOOTSTRAP_DRAWS, MIN_BLOCKS, POINT_DISTANCE
from wavefield.waves.inputs import a_field, takes
from wavefield.waves.record import Record, find_record
from wavefield.waves.welch import Reader

Array = NDArray[Any]

ORDERS = np.arange(1, 7)
STEP_DISTANCE_S = 0.2  # s between the steps whose increments in space are taken: half a period at 2.5 Hz
_AXES = ("time", "y", "x")


def lags(longest: int) -> Array:
    """Return the lags 1, 2, 3, 4, 6, 8, 12, ... (2^n and 3 times 2^n) up to `longest`, in steps or nodes."""
    doubled = 2 ** np.arange(0, 32)
    both = np.unique(np.concatenate([doubled, 3 * doubled]))
    return both[both <= longest]


def powers_of_differences(values: Array, axis: int, lag: int, differences: int) -> Array:
    """Return an array (7,): the number of increments along an axis, and sums of |increment|^p for p = 1 to 6.
    `differences` is 1 or 2, for first or second differences; `lag` is in nodes or steps."""
    size = values.shape[axis] - differences * lag
    if size <= 0:
        return np.zeros(ORDERS.size + 1)
    parts = [np.take(values, range(i * lag, i * lag + size), axis) for i in range(differences + 1)]
    change = parts[1] - parts[0] if differences == 1 else parts[2] - 2 * parts[1] + parts[0]
    absolute = np.abs(change.astype(float)).ravel()
    out = [float(absolute.size)]
    power = np.ones_like(absolute)
    for _ in ORDERS:
        power *= absolute
        out.append(float(power.sum()))
    return np.array(out)


def _blocks_of_time(record: Record, longest: int) -> list[tuple[int, int, tuple[int, int]]]:
    """Return blocks of time steps as (start, stop, run); `run` is the range of unbroken steps around a block.
    A block is twice as long as the `longest` lag, or shorter if there would be fewer than eight blocks."""
    steps = record.steps_in_runs()
    length = max(min(2 * longest, steps // MIN_BLOCKS), 2)
    return [(a, a + length, run) for run in record.runs for a in range(run[0], run[1] - length + 1, length)]


@takes(a_field)
def structure_functions(field: xr.DataArray, *, differences: int = 1) -> xr.Dataset:
    """Structure functions of a field and flatness of its increments, in time and along x and y.

    Parameters
    ----------
    field : DataArray, (time, y, x)
        Any variable of a cube; time in s, x and y in m. A field on disk is read in pieces.
    differences : int, optional
        1, the default, for increments f(s + r) - f(s); 2 for f(s + r) - 2 f(s) + f(s - r). Use 2 for spectra
        steeper than the power -3, where the slope of the longest waves dominates first differences.

    Returns
    -------
    Dataset
        ``structure_time`` (lag_time, order), ``structure_x`` (lag_x, order) and ``structure_y`` (lag_y,
        order): S_p, the mean of |increment|^p for p = 1 to 6, in the field's units to the power p;
        ``flatness_time``, ``flatness_x``, ``flatness_y``, each over its lag: S_4 / S_2^2. Variables whose
        names end in ``_std`` are standard uncertainties. Lags are in s and m. Attributes ``differences``,
        ``blocks`` (the number of blocks in the bootstrap) and ``gaussian_flatness`` (3).

    Raises
    ------
    CubeError
        If fewer than 16 steps or 8 x 8 nodes are measured, or ``differences`` is neither 1 nor 2.

    Notes
    -----
    Lags reach a sixteenth of the record, at most 10 s, and a third of the rectangle of measured nodes. The
    uncertainties are from a bootstrap over blocks of time. A Gaussian field has flatness 3 at every lag;
    intermittency is a flatness that rises above 3 towards short lags (Falcon, Fauve and Laroche, Phys. Rev.
    Lett. 98 (2007) 154501). Gaussian noise of single nodes dominates the shortest lags.

    Examples
    --------
    The waves of linear theory are Gaussian.

    >>> import wavefield as wf
    >>> found = wf.structure_functions(wf.open_cube("sea.zarr").z)
    >>> bool(abs(found.flatness_x - 3).max() < 0.2)
    True
    """
    if differences not in (1, 2):
        raise CubeError(f"differences is {differences}: choose 1 or 2")
    record = find_record(field)
    steps = record.steps_in_runs()
    spans = [max(int(min(steps / 16, 10 / record.dt)), 1), *(max(n // 3, 1) for n in record.shape)]
    chosen = [lags(span) for span in spans]
    blocks = _blocks_of_time(record, differences * spans[0])
    if len(blocks) < MIN_BLOCKS:
        raise CubeError(
            f"the record of {steps} steps holds {len(blocks)} blocks, and errors of increments need"
            f" {MIN_BLOCKS}: choose a longer record"
        )
    read = Reader([field], record)
    apart_y, apart_x = (max(1, round(POINT_DISTANCE / step)) for step in (record.dy, record.dx))
    every = max(1, round(STEP_DISTANCE_S / record.dt))
    sums = [np.empty((len(blocks), lag.size, ORDERS.size + 1)) for lag in chosen]
    for b, (start, stop, run) in enumerate(blocks):
        values = read(start, stop, run)[0]
        in_space = values[::every]
        for axis, part in enumerate((values[:, ::apart_y, ::apart_x], in_space, in_space)):
            for i, lag in enumerate(chosen[axis]):
                sums[axis][b, i] = powers_of_differences(part, axis, int(lag), differences)
    drawn = np.random.default_rng(0).integers(0, len(blocks), (BOOTSTRAP_DRAWS, len(blocks)))
    out: dict[str, Any] = {}
    coords: dict[str, Array] = {"order": ORDERS}
    for name, lag, step, part in zip(_AXES, chosen, (record.dt, record.dy, record.dx), sums):
        dim = f"lag_{name}"
        coords[dim] = lag * step
        structure, flatness = _moments(part.sum(axis=0))
        structures, flatnesses = _moments(part[drawn].sum(axis=1))
        out[f"structure_{name}"] = ((dim, "order"), structure)
        out[f"structure_{name}_std"] = ((dim, "order"), structures.std(axis=0, ddof=1))
        out[f"flatness_{name}"] = (dim, flatness)
        out[f"flatness_{name}_std"] = (dim, flatnesses.std(axis=0, ddof=1))
    attrs = {
        "field": "" if field.name is None else str(field.name),
        "field_units": str(field.attrs.get("units", "1")),
        "differences": differences,
        "blocks": len(blocks),
        "gaussian_flatness": 3.0,
    }
    return annotate(xr.Dataset(out, coords, attrs), "increments")


def _moments(sums: Array) -> tuple[Array, Array]:
    """Return structure functions (..., lags, 6) and flatness (..., lags) from sums of |increment|^p."""
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = sums[..., 1:] / sums[..., :1]
        return mean, mean[..., 3] / mean[..., 1] ** 2
