"""Mean horizontal velocity of a record: the current that nonlinear quantities are taken relative to."""

from typing import Any

import dask
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.waves.estimation.segments import spatial_window
from wavefield.waves.estimation.wave_record import Record, piece

Array = NDArray[np.float64]

_CURRENT_STEPS = 256  # steps, evenly spread over the record, that the mean is taken over
_SLOWEST = 8  # Fourier lines of the means next to the mean itself, which show its uncertainty


def delayed_current(cube: xr.Dataset, record: Record) -> Any:
    """Mean (2,) of u, v over the measured nodes of evenly spread steps, and uncertainty (2,), m/s; delayed.
    Even weights in place of a Hann window's would leave a hundredth of the waves, coherent with z_t.
    """
    missing = set(record.bridged)
    steps = [t for a, b in record.runs for t in range(a, b) if t not in missing]
    chosen = sorted({steps[i] for i in np.linspace(0, len(steps) - 1, _CURRENT_STEPS).astype(int)})
    area = slice(*record.y), slice(*record.x)
    task = dask.delayed(_mean_of_step, pure=False)
    means = [[task(piece(cube[name], slice(t, t + 1), *area)) for name in ("u", "v")] for t in chosen]
    return dask.delayed(_mean_and_uncertainty, pure=False, nout=2)(means)


def _mean_of_step(block: object) -> float:
    values = np.asarray(block, np.float64)[0]
    weight = np.where(np.isfinite(values), spatial_window(*values.shape), 0.0)
    total = float(weight.sum())
    return float((weight * np.nan_to_num(values)).sum() / total) if total > 0 else np.nan


def _mean_and_uncertainty(means: list[list[float]]) -> tuple[Array, Array]:
    values = np.asarray(means, np.float64)
    values = values[np.isfinite(values).all(axis=1)]
    if values.shape[0] < 2:
        return np.zeros(2) if not values.size else values[0], np.full(2, np.nan)
    # the mean is the line at zero: it has the noise of its neighbours, and as little of the waves
    lines = np.abs(np.fft.rfft(values - values.mean(axis=0), axis=0)[1 : _SLOWEST + 1]) ** 2
    return values.mean(axis=0), np.sqrt(lines.mean(axis=0)) / len(values)
