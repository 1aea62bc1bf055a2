"""Spectra of wave probes on the frequencies of the cube's."""

import warnings
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft, ndimage

from wavefield.errors import CubeError
from wavefield.variables import annotate
from wavefield.waves.estimation.segments import degrees_of_freedom, hann, interval, segment_count
from wavefield.waves.estimation.welch import LOWEST, Welch, omega_coords
from wavefield.waves.products import WaveProduct, register

Array = NDArray[Any]
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
    """The longest part of a series (n,) without missing values."""
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
    """Number of independent probes, (omega,): n^2 / sum of their squared coherences (n, n, omega)."""
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
