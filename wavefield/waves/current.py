"""Mean velocity of the water, and the current that an estimate used."""

from dataclasses import dataclass
from typing import Any

import dask
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.waves.products import WaveProduct, register
from wavefield.waves.record import Record, chunk_steps, piece
from wavefield.waves.welch import spatial_window

Array = NDArray[np.float64]

SAMPLED_STEPS = 256  # evenly spaced steps that give the means of a record; chosen


def delayed_current(cube: xr.Dataset, record: Record) -> Any:
    """Return the mean of (u, v) and its standard uncertainty, two arrays (2,), m/s, as a Dask delayed object.
    The mean is over up to 256 steps, and over nodes with the weights of a Hann window to suppress waves."""
    area = slice(*record.y), slice(*record.x)
    task = dask.delayed(_means_of_steps, pure=False)
    parts = []
    for steps_of in _by_chunk(cube["u"], record.some_steps(SAMPLED_STEPS)):  # each chunk is read once
        steps_read = slice(steps_of[0], steps_of[-1] + 1)
        at = [t - steps_of[0] for t in steps_of]
        parts.append([task(piece(cube[name], steps_read, *area), at) for name in ("u", "v")])
    return dask.delayed(_mean_and_uncertainty, pure=False, nout=2)(parts)


def _by_chunk(field: xr.DataArray, steps: list[int]) -> list[list[int]]:
    """Group time steps by the chunk of `field` that contains them, and return one list for each chunk."""
    chunk = np.asarray(steps) // chunk_steps(field)
    return [[t for t, c in zip(steps, chunk) if c == number] for number in np.unique(chunk)]


def _means_of_steps(block: object, at: list[int]) -> list[float]:
    return [_mean_of_step(values) for values in np.asarray(block)[at].astype(np.float64)]


def _mean_of_step(values: Array) -> float:
    weight = np.where(np.isfinite(values), spatial_window(*values.shape), 0.0)
    total = float(weight.sum())
    return float((weight * np.nan_to_num(values)).sum() / total) if total > 0 else np.nan


def _mean_and_uncertainty(parts: list[list[list[float]]]) -> tuple[Array, Array]:
    values = np.concatenate([np.asarray(part, np.float64).T for part in parts])
    values = values[np.isfinite(values).all(axis=1)]
    if values.shape[0] < 2:
        return np.zeros(2) if not values.size else values[0], np.full(2, np.nan)
    # the mean is the Fourier line at zero, whose noise is that of the eight neighbouring lines
    lines = np.abs(np.fft.rfft(values - values.mean(axis=0), axis=0)[1:9]) ** 2
    return values.mean(axis=0), np.sqrt(lines.mean(axis=0)) / len(values)


FITTED, GIVEN, NO_CURRENT = "fit", "given", "none"


@dataclass(frozen=True)
class CurrentUsed:
    """Velocity of the water that an estimate, such as a directional spectrum, used, and its origin."""

    velocity: tuple[float, float]  # along x and y, m/s
    std: tuple[float, float]  # standard uncertainty, m/s; NaN where it was not estimated
    source: str  # ``fit``, ``given`` by the user, or ``none`` for still water
    reason: str = ""  # message of the CubeError if the fit failed

    @property
    def attrs(self) -> dict[str, Any]:
        """Attributes for a result: the current and its uncertainty, m/s, its source and why a fit failed."""
        out = {"current": list(self.velocity), "current_std": list(self.std), "current_source": self.source}
        return out | ({"current_fit_refused": self.reason} if self.reason else {})


def current_used(dispersion: xr.Dataset, given: tuple[float, float] | None) -> CurrentUsed:
    """Return the current fitted in `dispersion`, m/s. If that fit failed, return `given`, or else zero."""
    if "current_x" in dispersion:
        velocity, std = ([float(dispersion[f"current_{a}{end}"]) for a in "xy"] for end in ("", "_std"))
        return CurrentUsed((velocity[0], velocity[1]), (std[0], std[1]), FITTED)
    reason = str(dispersion.attrs.get("refused", ""))
    return CurrentUsed(given or (0.0, 0.0), (np.nan, np.nan), GIVEN if given else NO_CURRENT, reason)


register(WaveProduct("current", ("dispersion", "given_current"), current_used))
