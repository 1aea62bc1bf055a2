"""Wave probes: their spectra on the frequencies of the cube's, and whether they fit the cube's elevation."""

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft, ndimage  # scipy.signal takes a second to import

from wavefield.errors import CubeError
from wavefield.parabola import parabola_vertex
from wavefield.variables import annotate
from wavefield.waves.products import WaveProduct, register
from wavefield.waves.welch import (
    LOWEST,
    Welch,
    degrees_of_freedom,
    hann,
    interval,
    omega_coords,
    segment_count,
)

Array = NDArray[Any]

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
        """Faults of the probe, each with a remedy."""
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
    """The fit, with the place in the cube that matches the probe better, if its clock is right."""
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


LONGEST_GAP = 3  # samples that are bridged
MIN_SEGMENTS_FOR_COHERENCE = 4
COHERENCE_LINES = 9  # over which it is averaged


def probe_spectra(probes: xr.Dataset, omega: xr.DataArray, span: tuple[float, float]) -> xr.Dataset:
    """Elevation spectra of probes over the time of a record, on the record's frequencies.

    Parameters
    ----------
    probes : Dataset
        As `wavefield.read_probes` gives it; any rate of its own.
    omega : DataArray, (omega,)
        Frequencies of the record's spectra, rad/s: their step sets the segment.
    span : tuple of float
        First and last time of the record, s.

    Returns
    -------
    Dataset
        ``Ez_probe`` (probe, omega), ``Ez_probes`` (omega), their mean, in m2 s rad-1, with ``dof_probes``,
        ``low_probes``, ``high_probes``, ``valid_probes``.

    Raises
    ------
    CubeError
        If the probes were not recording while the cameras were, for one segment at least, or have uneven
        steps.

    Notes
    -----
    n probes count as n^2 / sum of gamma_ij^2, their squared coherences: those beside one another see the same
    waves. With fewer than four segments they count as one.
    """
    target = omega.values
    duration = 2 * np.pi / float(omega[1] - omega[0])
    time, rate, elevation = _shared_time(probes["time"].values, probes["elevation"].values, span, duration)
    values = np.array([_bridged(row) for row in elevation])
    usable = np.isfinite(values).all(axis=1)
    if not usable.any():
        part = max((_longest_whole(row) for row in values), key=lambda part: part.stop - part.start)
        if part.stop - part.start < 0.9 * duration * rate:
            raise CubeError(
                "every probe has missing values during the record, and none is whole for one segment of "
                f"{duration:.3g} s: repair or leave out the probes"
            )
        warnings.warn(
            f"every probe has missing values during the record: spectra are of {time[part.start]:g} to "
            f"{time[part.stop - 1]:g} s, the longest part without any",
            stacklevel=2,
        )
        values = values[:, part]
        usable = np.isfinite(values).all(axis=1)
    for name, row in zip(probes["probe"].values[~usable], values[~usable]):
        warnings.warn(
            f"probe {name} is left out: {np.isnan(row).sum()} of its {row.size} values during the record are "
            f"missing, more than {LONGEST_GAP} in a row",
            stacklevel=2,
        )
    own, density, count, coherence = _density(values, rate, duration)
    # the frequencies agree where the rates divide; else straight lines between them
    on_grid = np.array([np.interp(target, own, row, right=np.nan) for row in density])
    on_grid[~usable] = np.nan
    independent = _independent(coherence[np.ix_(usable, usable)], count)
    dof = degrees_of_freedom(count) * np.interp(target, own, independent)
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
                (np.arange(target.size) >= LOWEST) & np.isfinite(on_grid[usable]).all(axis=0),
            ),
        },
        {name: probes[name] for name in ("probe", "probe_x", "probe_y")} | {"omega": omega},
    )
    return annotate(out, "spectra")


def _bridged(values: Array) -> Array:
    """A series with its short gaps filled by straight lines."""
    missing = ~np.isfinite(values)
    if not missing.any() or missing.all():
        return values
    edges = np.flatnonzero(np.diff(np.concatenate([[0], missing.astype(int), [0]])))
    out, there = values.copy(), np.flatnonzero(~missing)
    for start, stop in zip(edges[::2], edges[1::2]):
        if stop - start <= LONGEST_GAP:
            out[start:stop] = np.interp(np.arange(start, stop), there, values[there])
    return out


def _longest_whole(values: Array) -> slice:
    """The longest part of a series (n,) without NaN."""
    known = np.concatenate([[0], np.isfinite(values).astype(int), [0]])
    edges = np.flatnonzero(np.diff(known))
    if not edges.size:
        return slice(0, 0)
    starts, stops = edges[::2], edges[1::2]
    k = int(np.argmax(stops - starts))
    return slice(int(starts[k]), int(stops[k]))


def _shared_time(
    time: Array, elevation: Array, span: tuple[float, float], duration: float
) -> tuple[Array, float, Array]:
    """Times during the record, their rate, and elevations (probe, n): missing where the logger paused."""
    inside = (time >= span[0] - 1e-9) & (time <= span[1] + 1e-9)
    if inside.sum() < 8 or time[inside][-1] - time[inside][0] < 0.9 * duration:
        raise CubeError(
            f"the probes cover {time[0]:g} to {time[-1]:g} s, the record {span[0]:g} to {span[1]:g} s:"
            f" they share less than one segment of {duration:.3g} s; check the clock of the probes or"
            " leave them out"
        )
    time, elevation = time[inside], elevation[:, inside]
    steps = np.diff(time)
    rate = float((time.size - 1) / (time[-1] - time[0]))
    step = float(np.median(steps))
    paused = np.flatnonzero(steps > 1.5 * step)
    if paused.size:
        steps_between = np.delete(steps, paused)
        step = float(steps_between.mean())
        rate = 1 / step
        lost = steps[paused] / step - 1
        count = np.maximum(np.rint(lost), 1).astype(int)
        # a pause that is no multiple of the step is not bridged: what follows has other times
        count[np.abs(lost - count) > 0.05] += LONGEST_GAP
        at = np.repeat(paused + 1, count)
        after = np.concatenate([np.arange(1, n + 1) for n in count]) * step
        elevation = np.insert(elevation, at, np.nan, axis=1)
        time, steps = np.insert(time, at, time[at - 1] + after), steps_between
    if np.abs(steps * rate - 1).max() > 0.01:
        raise CubeError("the probes' time steps are unequal: resample them at a fixed rate first")
    return time, rate, elevation


def _independent(coherence: Array, count: int) -> Array:
    """Number of independent probes, (omega,): n^2 over the sum of their squared coherences (n, n, omega)."""
    n, lines = coherence.shape[1:]
    if count < MIN_SEGMENTS_FOR_COHERENCE:
        return np.ones(lines)
    coherence = ndimage.uniform_filter1d(coherence, min(COHERENCE_LINES, lines), axis=-1, mode="nearest")
    coherence = ((coherence - 1 / count) / (1 - 1 / count)).clip(0, 1)  # by chance it is 1 / count
    coherence[np.arange(n), np.arange(n)] = 1
    return np.asarray(n**2 / coherence.sum(axis=(0, 1)))


def _density(values: Array, rate: float, duration: float) -> tuple[Array, Array, int, Array]:
    """Frequencies, one-sided density (probe, omega), number of segments, squared coherence of each pair."""
    n = min(round(duration * rate), values.shape[1])
    n -= n % 2
    half, window = n // 2, hann(n)
    count = segment_count(values.shape[1], n)
    ramp = np.arange(n) - (n - 1) / 2
    total = np.zeros((values.shape[0], values.shape[0], n // 2 + 1), complex)
    for s in range(count):
        part = values[:, s * half : s * half + n]
        part = part - part.mean(axis=1, keepdims=True)
        part = part - np.outer(part @ ramp / (ramp @ ramp), ramp)
        lines = fft.rfft(part * window, axis=1)
        total += lines[:, None].conj() * lines
    power = np.einsum("iiw->iw", total).real
    with np.errstate(divide="ignore", invalid="ignore"):
        coherence = np.nan_to_num(np.abs(total) ** 2 / (power[:, None] * power))
    density = power / (count * (window**2).sum() * rate * 2 * np.pi)
    density[:, 1:-1] *= 2
    return 2 * np.pi * np.arange(n // 2 + 1) * rate / n, density, count, coherence


def _group(probes: xr.Dataset | None, welch: Welch, cube: xr.Dataset) -> xr.Dataset | None:
    if probes is None:
        return None
    time, runs = cube["time"].values.astype(float), welch.record.runs
    axis = annotate(xr.Dataset(coords=omega_coords(welch.omega)))["omega"].drop_vars("frequency")
    return probe_spectra(probes, axis, (float(time[runs[0][0]]), float(time[runs[-1][1] - 1])))


register(WaveProduct("probe_spectra", ("probes", "welch", "cube"), _group, group="spectra"))
