"""Wave probes: their elevation spectra, and a comparison with the elevation of the cube next to them."""

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from wavefield.errors import CubeError
from wavefield.parabola import parabola_vertex
from wavefield.variables import annotate
from wavefield.waves.products import WaveProduct, register
from wavefield.waves.welch import (
    MAIN_LOBE,
    Welch,
    degrees_of_freedom,
    hann,
    interval,
    omega_coords,
    segment_count,
)

Array = NDArray[Any]

# chosen: shorter overlaps of narrow-banded waves are correlated at wrong lags, too
MIN_OVERLAP, MIN_SAMPLES = 0.5, 40  # overlap relative to the record of the cube; samples of either series
SAME_WAVES = 0.8  # chosen: least correlation; noise of a fifth of the waves' variance leaves 0.9


@dataclass(frozen=True)
class ProbeFit:
    """Comparison of one wave probe with the elevation of the cube at the position of the probe."""

    name: str  # of the probe
    at_zero_lag: float  # correlation without a correction of the clock
    best: float  # correlation of largest modulus at any lag; negative if the probe has the wrong sign
    lag: float  # s by which the probe's clock is ahead
    gain: float  # standard deviation of the probe over that of the elevation

    def problems(self, dt: float) -> Iterator[tuple[str, str]]:
        """Yield (fault, remedy), two texts, for each fault of the probe; `dt` is the cube's time step, s."""
        if abs(self.best) < SAME_WAVES:
            yield (
                f"it is unlike the elevation at its place at any time (correlation {self.best:.2f})",
                "Check its `places` and that it is of the same record and was wet",
            )
            return
        if self.best < 0:
            yield "it falls where the elevation rises", "Turn its sign (`factor: -1` in `probes:`)"
        if abs(self.lag) > 0.5 * dt and abs(self.at_zero_lag) < SAME_WAVES:
            yield (
                f"its clock is {abs(self.lag):.3f} s {'ahead of' if self.lag > 0 else 'behind'} the cameras'",
                f"Add {-self.lag:.3f} to its times (`clock` in `probes:`), or correct the cameras' `offset`",
            )
        if not 0.8 < self.gain < 1.25:
            yield (
                f"it is {self.gain:.3g} times the elevation",
                "Calibrate it, or give its `unit` or `factor` in `probes:`",
            )


def fit_probes(z: xr.DataArray, probes: xr.Dataset) -> list[ProbeFit]:
    """Return a `ProbeFit` of every probe inside the field, compared with z (time, y, x) of the cube there.
    The best lag has the largest |correlation|. Probes with few samples or little overlap are left out."""
    time = z["time"].values.astype(float)
    if time.size < MIN_SAMPLES:
        return []
    dt = float(np.median(np.diff(time)))
    out = []
    for k, name in enumerate(probes["probe"].values):
        x, y = float(probes["probe_x"][k]), float(probes["probe_y"][k])
        inside = z["x"].min() <= x <= z["x"].max() and z["y"].min() <= y <= z["y"].max()
        series = _even(probes["time"].values, probes["elevation"].values[k], dt)
        if not inside or series is None:
            continue
        clock, values = series
        here = z.interp(x=x, y=y).values.astype(float)
        if np.isfinite(here).sum() >= MIN_SAMPLES:
            out.append(_fit(str(name), time, here, clock, values, dt))
    return [fit for fit in out if fit is not None]


def _even(clock: Array, values: Array, dt: float) -> tuple[Array, Array] | None:
    """Return the times and elevations of a probe, resampled to the time step `dt` of the cube, s.
    Values are averaged over a step if the probe samples faster. None if fewer than 40 samples remain."""
    good = np.isfinite(values) & np.isfinite(clock)
    if good.sum() < MIN_SAMPLES:
        return None
    clock, values = clock[good], values[good]
    own = float(np.median(np.diff(clock)))
    width = max(1, round(dt / max(own, 1e-9)))
    smooth = np.convolve(values, np.ones(width) / width, "same") if width > 1 else values
    even = np.arange(np.ceil(clock[0] / dt), np.floor(clock[-1] / dt) + 1) * dt
    return (even, np.interp(even, clock, smooth)) if even.size >= MIN_SAMPLES else None


def _fit(name: str, time: Array, here: Array, clock: Array, values: Array, dt: float) -> ProbeFit | None:
    """Return the `ProbeFit` of a probe, `values` at times `clock`, s, against `here`, z of the cube at
    `time`, s. None if the probe covers less than half of the record at every lag."""
    lags, found = correlation(here, values, int(MIN_OVERLAP * time.size))
    if not lags.size:
        return None
    shift = lags * dt + (clock[0] - time[0])  # s by which the probe's clock is ahead
    k = int(np.argmax(np.abs(found)))
    inside = 0 < k < lags.size - 1
    fine = float(parabola_vertex(*np.abs(found[k - 1 : k + 2]))) if inside else 0.0
    at_zero_lag = float(np.interp(0.0, shift, found, left=0.0, right=0.0))
    lag, gain = float(shift[k] + fine * dt), float(values.std() / np.nanstd(here))
    return ProbeFit(name, at_zero_lag, float(found[k]), lag, gain)


def correlation(a: Array, b: Array, least: int) -> tuple[NDArray[np.intp], Array]:
    """Return lags in samples, and the normalised correlation of the series a and b at each lag. Lags with
    fewer than `least` pairs of finite samples are left out. At a positive lag, b is later than a."""
    from scipy.signal import correlate, correlation_lags  # takes a second to import

    known = [np.isfinite(v).astype(float) for v in (a, b)]
    value = [np.where(k > 0, v - np.nanmean(v), 0.0) for k, v in zip(known, (a, b))]

    def sums(p: Array, q: Array) -> Array:
        return np.asarray(correlate(q, p))

    count = sums(known[0], known[1])
    one, other = sums(value[0], known[1]), sums(known[0], value[1])
    held = np.maximum(count, 1.0)
    power = (sums(value[0] ** 2, known[1]) - one**2 / held) * (
        sums(known[0], value[1] ** 2) - other**2 / held
    )
    found = (sums(value[0], value[1]) - one * other / held) / np.sqrt(np.maximum(power, 1e-30))
    enough = (count > least - 0.5) & (power > 1e-12 * float(np.max(power)))
    return correlation_lags(b.size, a.size)[enough], np.clip(found[enough], -1.0, 1.0)


LONGEST_GAP = 3  # chosen: samples of a dropout of the logger that are interpolated


def probe_spectra(probes: xr.Dataset, omega: xr.DataArray, span: tuple[float, float]) -> xr.Dataset:
    """Return elevation spectra of `probes` in the time `span` (first, last), s, at the frequencies `omega`.
    The spacing of `omega` sets the length of segments. Probes with long gaps are left out with a warning.
    Raises CubeError if no probe is complete, steps are unequal or less than a segment is covered."""
    target = omega.values
    duration = 2 * np.pi / float(omega[1] - omega[0])
    inside, rate = _shared_time(probes["time"].values, span, duration)
    recorded = probes["elevation"].values[:, inside]
    values = pd.DataFrame(recorded.T).interpolate(limit=LONGEST_GAP).to_numpy().T
    usable = np.isfinite(values).all(axis=1)
    if not usable.any():
        raise CubeError(
            f"every probe lacks more than {LONGEST_GAP} values in a row during the record: repair or leave"
            " out the probes"
        )
    for name, row in zip(probes["probe"].values[~usable], recorded[~usable]):
        warnings.warn(
            f"probe {name} is left out: {np.isnan(row).sum()} of its {row.size} values during the record are "
            f"missing, more than {LONGEST_GAP} in a row",
            stacklevel=2,
        )
    own, density, count = _density(values[usable], rate, duration)
    # interpolation does nothing if the sampling rates are multiples of each other
    on_grid = np.full((usable.size, target.size), np.nan)
    on_grid[usable] = [np.interp(target, own, row, right=np.nan) for row in density]
    dof = np.full(target.size, degrees_of_freedom(count))
    low, high = interval(dof)
    out = xr.Dataset(
        {
            "Ez_probe": (("probe", "omega"), on_grid),
            "Ez_probes": ("omega", np.nanmean(on_grid[usable], axis=0)),
            "dof_probes": ("omega", dof),
            "low_probes": ("omega", low),
            "high_probes": ("omega", high),
            "valid_probes": (
                "omega",
                (np.arange(target.size) >= MAIN_LOBE) & np.isfinite(on_grid[usable]).all(axis=0),
            ),
        },
        {name: probes[name] for name in ("probe", "probe_x", "probe_y")} | {"omega": omega},
    )
    return annotate(out, "spectra")


def _shared_time(time: Array, span: tuple[float, float], duration: float) -> tuple[NDArray[np.bool_], float]:
    """Return a mask of the probe samples within `span` (first, last), s, and their sampling rate, Hz. Raises
    CubeError if these samples cover less than `duration`, s, or have unequal steps."""
    inside = (time >= span[0] - 1e-9) & (time <= span[1] + 1e-9)
    if inside.sum() < 8 or time[inside][-1] - time[inside][0] < 0.9 * duration:
        raise CubeError(
            f"the probes cover {time[0]:g} to {time[-1]:g} s, the record {span[0]:g} to {span[1]:g} s:"
            f" they share less than one segment of {duration:.3g} s; check the clock of the probes or"
            " leave them out"
        )
    step = np.diff(time[inside])
    if np.abs(step / step.mean() - 1).max() > 0.01:
        raise CubeError("the probes' time steps are unequal: resample them at a fixed rate first")
    return inside, float(1 / step.mean())


def _density(values: Array, rate: float, duration: float) -> tuple[Array, Array, int]:
    """Return three results of Welch's method: frequencies, rad/s; densities (probe, omega); number of
    segments. `values` (probe, time) are sampled at `rate`, Hz; segments last `duration`, s."""
    from scipy.signal import welch  # takes a second to import

    n = min(round(duration * rate), values.shape[1])
    n -= n % 2
    hertz, power = welch(values, rate, hann(n), n, n // 2, detrend="linear")
    return 2 * np.pi * hertz, power / (2 * np.pi), segment_count(values.shape[1], n)


def _group(probes: xr.Dataset | None, welch: Welch, cube: xr.Dataset) -> xr.Dataset | None:
    if probes is None:
        return None
    time, runs = cube["time"].values.astype(float), welch.record.runs
    axis = annotate(xr.Dataset(coords=omega_coords(welch.omega)))["omega"].drop_vars("frequency")
    return probe_spectra(probes, axis, (float(time[runs[0][0]]), float(time[runs[-1][1] - 1])))


register(WaveProduct("probe_spectra", ("probes", "welch", "cube"), _group, group="spectra"))
