"""A probe beside the cube's elevation at the same place: unit, sign, clock and position, by correlation."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft  # scipy.signal takes a second to import

from wavefield.parabola import parabola_vertex

Array = NDArray[np.float64]

MIN_OVERLAP = 0.5  # of the elevation's record, at any lag that is tried
MIN_SAMPLES = 40
SAME_WAVES = 0.8  # correlation
MIN_IMPROVEMENT = 0.1  # of the correlation, by another lag or place
_UNITS = {1e3: "mm", 1e2: "cm", 1e6: "um", 1e-3: "km"}


@dataclass(frozen=True)
class ProbeFit:
    """How a probe fits the elevation at its place."""

    name: str  # The probe
    peak_correlation: float  # Correlation as clock and position are stated
    best: float  # The same at the best lag; negative where the sign is turned
    # Seconds by which the probe's clock is ahead: its event comes that much later by its own clock
    lag: float
    gain: float  # Standard deviation of the probe over that of the elevation
    # (float, float): Where in the cube it fits, m, if that is elsewhere than stated
    place: tuple[float, float] | None = None

    def problems(self, dt: float) -> Iterator[tuple[str, str]]:
        """What does not fit, and a remedy."""
        if abs(self.best) < SAME_WAVES:
            if self.place is not None:
                x, y = self.place
                yield f"it fits the elevation at x {x:.2f}, y {y:.2f} m", "Correct its place"
            else:
                yield (
                    f"it is unlike the elevation at its place at any time (correlation {self.best:.2f})",
                    "Is it in the cameras' field, of the same record, and was it wet?",
                )
            return
        if self.best < 0:
            yield "it falls where the elevation rises", "Turn its sign (`factor: -1` in `probes:`)"
        if abs(self.lag) > 0.5 * dt and abs(self.best) > abs(self.peak_correlation) + MIN_IMPROVEMENT:
            yield (
                f"its clock is {abs(self.lag):.3f} s {'ahead of' if self.lag > 0 else 'behind'} the cameras'",
                f"Add {-self.lag:.3f} to its times (`clock` in `probes:`), or correct the cameras' `offset`",
            )
        for factor, unit in _UNITS.items():
            if 0.7 < self.gain / factor < 1.4:
                yield (
                    f"it is {self.gain:.3g} times the elevation, as if it were in {unit}",
                    f"State it (`unit: {unit}` in `probes:`)",
                )
                return
        if not 0.8 < self.gain < 1.25:
            yield (
                f"it is {self.gain:.2f} times the elevation",
                "Calibrate it, or give its `factor` in `probes:`",
            )


def fit_probes(z: xr.DataArray, probes: xr.Dataset) -> list[ProbeFit]:
    """Compare every probe that lies in the field with the elevation z (time, y, x) there.
    Normalised correlation at every lag that leaves half of the record; the peak is refined by a parabola.
    """
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
            fit = _fit(str(name), time, here, clock, values, dt)
            out.append(_elsewhere(fit, z, clock, values, dt) if fit and abs(fit.best) < SAME_WAVES else fit)
    return [fit for fit in out if fit is not None]


def _even(clock: Array, values: Array, dt: float) -> tuple[Array, Array] | None:
    """A probe at the steps of the cube; averaged over a step where it is quicker."""
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
    lags, peak_correlation = correlation(here, values, int(MIN_OVERLAP * time.size))
    if not lags.size:
        return None
    shift = lags * dt + (clock[0] - time[0])  # by which the probe's time is later, event by event
    k = int(np.argmax(np.abs(peak_correlation)))
    inside = 0 < k < lags.size - 1
    fine = float(parabola_vertex(*np.abs(peak_correlation[k - 1 : k + 2]))) if inside else 0.0
    now = float(np.interp(0.0, shift, peak_correlation, left=0.0, right=0.0))
    return ProbeFit(
        name,
        now,
        float(peak_correlation[k]),
        float(shift[k] + fine * dt),
        float(values.std() / np.nanstd(here)),
    )


def correlation(a: Array, b: Array, least: int) -> tuple[NDArray[np.intp], Array]:
    """Lags of two series (n,), and their correlation there, normalised over the overlap."""
    known = [np.isfinite(v).astype(float) for v in (a, b)]
    value = [np.where(k > 0, v - np.nanmean(v), 0.0) for k, v in zip(known, (a, b))]

    def sums(p: Array, q: Array) -> Array:
        full = len(p) + len(q) - 1
        length = fft.next_fast_len(full, real=True)
        product = fft.rfft(q, length) * np.conj(fft.rfft(p, length))
        return np.asarray(np.roll(fft.irfft(product, length), len(p) - 1)[:full])

    count = sums(known[0], known[1])
    one, other = sums(value[0], known[1]), sums(known[0], value[1])
    held = np.maximum(count, 1.0)
    power = (sums(value[0] ** 2, known[1]) - one**2 / held) * (
        sums(known[0], value[1] ** 2) - other**2 / held
    )
    peak_correlation = (sums(value[0], value[1]) - one * other / held) / np.sqrt(np.maximum(power, 1e-30))
    lags = np.arange(-(a.size - 1), b.size)
    enough = (count > least - 0.5) & (power > 1e-12 * float(np.max(power)))
    return lags[enough], np.clip(peak_correlation[enough], -1.0, 1.0)


def _elsewhere(fit: ProbeFit, z: xr.DataArray, clock: Array, values: Array, dt: float) -> ProbeFit:
    """The fit with the place in the cube that a probe fits better, by its own clock."""
    there = np.interp(z["time"].values.astype(float), clock, values, left=np.nan, right=np.nan)
    good = np.isfinite(there)
    if good.sum() < MIN_SAMPLES:
        return fit
    field = z.values[good].astype(float)
    field = field - field.mean(axis=0)
    requested = there[good] - there[good].mean()
    power = np.sqrt((field**2).sum(axis=0) * (requested**2).sum())
    peak_correlation = np.nan_to_num(np.tensordot(requested, field, 1) / np.where(power > 0, power, np.inf))
    row, column = np.unravel_index(int(np.argmax(peak_correlation)), peak_correlation.shape)
    if peak_correlation[row, column] < max(SAME_WAVES, abs(fit.peak_correlation) + MIN_IMPROVEMENT):
        return fit
    place = float(z["x"][column]), float(z["y"][row])
    return ProbeFit(fit.name, fit.peak_correlation, fit.best, fit.lag, fit.gain, place)
