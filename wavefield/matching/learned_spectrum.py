"""The spectrum of a field on a lattice of blocks, from the fields of sample frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import convolve1d

from wavefield.matching.matching_gain import FOOTPRINT_VARIANCE, footprint
from wavefield.matching.prior import Prior, wavenumbers
from wavefield.matching.wavenumber_rings import (
    DETECTED_SIGNAL_TO_NOISE,
    NOISE_RINGS,
    RINGS,
    SHORTEST_WAVENUMBER,
    WavenumberRings,
)

Float = NDArray[np.floating[Any]]

SHRINKAGE_MODES = 2.0  # a sector of so many modes and its ring have equal weights
RING_SMOOTHING = np.array([1.0, 2.0, 3.0, 2.0, 1.0]) / 3.0  # weights of rings with similar directions
MIN_SECTOR_FRACTION = 0.01  # of the ring: least power of a sector
MIN_SQUARED_WINDOW_GAIN = 0.15  # of the windows: less, and a wave is not resolved
MIN_POWER_TO_PLATEAU = 3.0  # of the windowed field over the plateau of noise, to be signal
SHORTEST_IN_COMMON = 2.9  # the same in what several cameras have in common, in which noise averages out
LOST_SIGNAL_TO_NOISE = 1.0  # the same where nothing but the uncertainty depends on it
LIMIT_STANDARD_DEVIATIONS = 2.0  # above its power: upper limit of a ring that is not significant
SHORTEST_IN_LIMITS = 0.5 * np.pi  # rad per block: what shorter waves show of a spectrum is noise
MIN_POWER_TO_NOISE = 0.01  # least of a spectrum before the power law
CERTAIN_NOISE_FRACTION = 0.9  # the noise is uncertain by a tenth
MIN_INFORMATION_SHARE = 1e-3  # of what a prior assumes, in the fields that it gave; else they show nothing
FULL_WAVE_FRACTION = 0.5  # of the variance that a spectrum gives: with so much all of it is waves
FULL_SIGNAL_TO_NOISE = 3.0  # the same over the noise
MOST_OVER_KEPT = 3.0  # of the gain that even information would have
KEPT_MODES = 20.0  # as with even information, that count in every ring: few modes show little
SLOPE_RANGE = -9.0, -3.0  # of the power law that extrapolates a spectrum
SLOPE_RINGS = 6  # from which the slope is fitted


def first_prior(
    fields: Sequence[Float], window: Float, information: float, area: float = FOOTPRINT_VARIANCE
) -> Prior:
    """Prior from windowed fields.

    Parameters
    ----------
    fields : sequence of ndarray, (c, ny, nx)
        Windowed fields of sample frames, without holes and less their edge slopes.
    window : ndarray, (ny, nx)
        Gain of the windows for every cosine mode.
    information : float
        Typical information of a block.
    area : float
        Variance of the area that a block's value represents, px^2.

    Returns
    -------
    Prior

    Notes
    -----
    The spectrum over the windows' gain, less the plateau of noise; a power law where it is less than three
    times the plateau.
    """
    kx, ky = wavenumbers(window.shape)
    power = np.mean([np.square(_cosine_coefficients(f)).mean(axis=0) for f in fields], axis=0)
    binning = WavenumberRings(kx, ky)
    window_power, gain = binning.mean(window**2), binning.mean(footprint(kx, ky, area) ** 2)
    raw = binning.mean(power) / np.maximum(window_power, 1e-9)
    plateau = float(raw[window_power > MIN_SQUARED_WINDOW_GAIN].min())
    signal = np.maximum(raw - plateau, 0.0) / gain
    last = binning.count_until_false(
        (window_power > MIN_SQUARED_WINDOW_GAIN) & (raw > MIN_POWER_TO_PLATEAU * plateau)
    )
    power_law = _extrapolated(binning.middle, signal, last, plateau)
    return Prior.isotropic(binning.k, power_law, information, area)


def better_prior(
    prior: Prior,
    kx: Float,
    ky: Float,
    foot: Float,
    waves: Sequence[Float],
    information: float,
    noise_alone: Sequence[tuple[Float, float]] = (),
    common: Float | None = None,
    kept: Sequence[tuple[Float, Float]] = (),
) -> Prior:
    """Prior from the MAP fields that another prior gave.

    Parameters
    ----------
    prior : Prior
        The one used.
    kx, ky : ndarray, (mx,) and (my, 1)
        Wavenumbers of the modes along columns and rows, rad per block.
    foot : ndarray, (my, mx)
        Gain of a block's footprint.
    waves : sequence of ndarray, (c, my, mx)
        Cosine coefficients of the MAP fields of sample frames, less those of their prior mean.
    information : float
        Mean information of a block in them.
    noise_alone : sequence of (ndarray, float), optional
        Coefficients of fields that the same prior gave of noise alone, and their information: they measure
        how noise changes from ring to ring. Its level is the least of the power over what is expected of it.
    common : ndarray, (c, directions, rings), optional
        Power of waves that is expected from what several cameras have in common; NaN where it is not known.
        Where these fields alone show no waves the spectrum is no less than this, up to their own limit.
    kept : sequence of (ndarray, ndarray), (c, my, mx), optional
        Power of random fields, and the part of it that blocks with the information of the samples keep.

    Returns
    -------
    Prior

    Notes
    -----
    Of a mode with spectrum S and noise N = 1 / (F^2 A), the MAP field keeps G = S / (S + N), and so
    G^2 (S + N) of its power: S = sum(|D|^2 - G^2 N) / sum G^2 over the modes of a ring, and over those of
    every sector of it. A spectrum may have gaps and several peaks: a ring counts where S is significant
    against N. In gaps S is the upper limit of what could be there undetected. Beyond the last ring that
    counts it is a power law, no higher than that limit, with constant sectors. Directions are averaged over
    neighbouring rings, and sectors of few modes shrink to their ring.
    """
    if not information > MIN_INFORMATION_SHARE * prior.information:  # nothing was visible
        return prior
    noise = 1.0 / (np.square(foot, dtype=np.float64) * information)
    spectrum, binning = prior.spectrum(kx, ky), WavenumberRings(kx, ky)
    measured, of_sectors, noise_power, level = _signals_and_noise(
        waves, spectrum, noise, binning, foot, noise_alone
    )
    significant = np.array(
        [
            binning.significant(one / np.maximum(own, 1e-30), len(waves))
            for one, own in zip(measured, noise_power)
        ]
    )
    significant |= _lines(waves, spectrum, noise, level, binning)
    lasts = [max(int(np.flatnonzero(flags).max(initial=-1)) + 1, 3) for flags in significant]
    occupied = binning.count > 0
    relative_std = np.sqrt(2.0 / np.maximum(binning.count * len(waves), 1))
    limit = np.maximum(measured, 0.0) + LIMIT_STANDARD_DEVIATIONS * relative_std * noise_power
    signal, least = np.where(significant, measured, limit), float(noise.min())
    upper_limit = np.where(occupied, np.minimum(limit, DETECTED_SIGNAL_TO_NOISE * noise_power), np.inf)
    rings = np.array(
        [
            _extrapolated(binning.middle, one, last, least, limit_of_component)
            for one, last, limit_of_component in zip(signal, lasts, upper_limit)
        ]
    )
    weight = binning.sector_count * len(waves) * np.square(rings / (rings + noise_power))[:, None]
    power = _shapes(of_sectors / rings[:, None], weight, lasts) * rings[:, None]
    expected = np.zeros_like(power)
    if common is not None:
        searched = occupied & (binning.middle < SHORTEST_IN_COMMON)
        alone = (significant | ~searched)[:, None]
        expected = np.where(alone, 0.0, np.minimum(np.nan_to_num(common), limit[:, None]))
        power = np.maximum(power, expected)
    lost, share = _lost_waves(measured / noise_power, rings / noise_power, significant, binning)
    mean = power.mean(axis=1)
    # where few blocks have most of the information, fields show less of short waves than there is
    more = np.square(_even_over_kept(spectrum, noise, kept, binning))
    return Prior(
        binning.k,
        tuple(_rounded(directions) for directions in power),
        information,
        prior.noise,
        prior.waves,
        _rounded(np.where(significant, more, measured * lost / mean)),
        share,
        _rounded(expected.mean(axis=1) / mean * more),
        prior.area,
    )


def _signals_and_noise(
    waves: Sequence[Float],
    spectrum: Float,
    noise: Float,
    binning: WavenumberRings,
    foot: Float,
    noise_alone: Sequence[tuple[Float, float]],
) -> tuple[Float, Float, Float, Float]:
    """Power of waves in rings (c, rings) and sectors (c, sectors, rings), and of noise in rings, over gains;
    and the level of the noise, over what is expected of it, in rings.
    Fields of noise alone show how it changes from ring to ring; its level is that of rings without waves.
    """
    ring_power, noise_power = _over_gain(waves, spectrum, noise, binning.rings)
    sector_power, sector_noise_power = _over_gain(waves, spectrum, noise, binning.sectors)
    shape = np.ones_like(ring_power)
    if noise_alone:
        noise_ratios = [
            np.divide(
                *_over_gain([field], spectrum, 1.0 / (np.square(foot, dtype=np.float64) * own), binning.rings)
            )
            for field, own in noise_alone
        ]
        shape = np.array([binning.level(one) for one in np.mean(noise_ratios, axis=0)])
    resolved = (binning.count > 0) & (binning.middle < SHORTEST_WAVENUMBER)
    level = [
        _plateau(one, binning.count[resolved]) for one in (ring_power / (shape * noise_power))[:, resolved]
    ]
    plateau = shape * np.reshape(level, (-1, 1))
    noise_power = plateau * noise_power
    of_sectors = sector_power - plateau[:, None] * sector_noise_power
    return ring_power - noise_power, of_sectors, noise_power, plateau


def _lines(
    waves: Sequence[Float], spectrum: Float, noise: Float, level: Float, binning: WavenumberRings
) -> NDArray[np.bool_]:
    """Rings (c, rings) with a wave of one length and direction, from the noise and its level in rings."""
    power = np.mean([np.square(f, dtype=np.float64) for f in waves], axis=0)
    spectrum = np.broadcast_to(spectrum, power.shape)
    ratio = power / (np.square(spectrum / (spectrum + noise)) * noise * level[:, binning.of_modes])
    return np.array([binning.lines(one) for one in ratio])


def _over_gain(
    fields: Sequence[Float], spectrum: Float, noise: Float, mean: Callable[[Float], Float]
) -> tuple[Float, Float]:
    """Mean power of MAP fields of a spectrum, and of their noise, over the squared gain."""
    power = np.mean([np.square(f, dtype=np.float64) for f in fields], axis=0)
    spectrum = np.broadcast_to(spectrum, power.shape)
    squared_gain = np.square(spectrum / (spectrum + noise))
    weight = np.maximum(mean(squared_gain), 1e-30)
    return mean(power) / weight, np.maximum(mean(squared_gain * noise) / weight, 1e-30)


def _lost_waves(
    found: Float, of_limit: Float, significant: NDArray[np.bool_], binning: WavenumberRings
) -> tuple[NDArray[np.bool_], tuple[float, float]]:
    """Rings (c, rings) without significant waves that show some, and what all show of their limits.
    Waves that were found and limits are over noise.
    """
    # noise hardly changes while the same beads are seen: samples count as one
    chance = LIMIT_STANDARD_DEVIATIONS * np.sqrt(2.0 / np.maximum(binning.count, 1))
    seen = ~significant & (binning.middle < SHORTEST_IN_LIMITS)
    # single rings exceed chance by chance, and the level of the noise differs from ring to ring
    lost = [binning.exceeds(one, LOST_SIGNAL_TO_NOISE) for one in found]
    weight = binning.count * (seen & (found < of_limit + chance))
    share = pooled_share(list(map(_share_of_limits, of_limit, found, weight)))
    return seen & lost & (found > chance), share


def _even_over_kept(
    spectrum: Float, noise: Float, kept: Sequence[tuple[Float, Float]], binning: WavenumberRings
) -> Float:
    """The gain S / (S + N) of even information over what fields keep of waves, (1 or c, rings).
    Beads are few: where blocks differ, less is kept of short waves than with their mean information.
    """
    if not kept:
        return np.ones((1, RINGS))
    gain = spectrum / (spectrum + noise)
    powers = [part for _, part in kept], [gain * whole for whole, _ in kept]
    found, even = (
        convolve1d(binning.rings(np.mean(one, axis=0)) * binning.count, np.ones(3), axis=-1, mode="constant")
        for one in powers
    )
    few = KEPT_MODES * even.sum(axis=-1, keepdims=True) / max(3.0 * binning.count.sum(), 1.0)
    return np.asarray(np.clip((even + few) / np.maximum(found + few, 1e-30), 1.0, MOST_OVER_KEPT))


def _rounded(table: Float) -> tuple[tuple[float, ...], ...]:
    """A table for a recipe."""
    return tuple(tuple(float(f"{value:.4g}") for value in row) for row in table)


def _share_of_limits(limit: Float, found: Float, weight: Float) -> tuple[float, float]:
    """How much of the limits that rings (rings,) have over noise is found in them, and its std.
    The level of the noise is fitted as well.
    """
    total = max(float(weight.sum()), 1e-30)
    mean, level = float(weight @ limit) / total, float(weight @ found) / total
    apart = limit - mean
    square = max(float(weight @ np.square(apart)), 1e-6)
    slope = float(weight @ (apart * found)) / square
    return slope / max(1.0 + level - slope * mean, 0.1), float(np.sqrt(2.0 / square))


def _shapes(estimate: Float, weight: NDArray[Any], lasts: Sequence[int]) -> NDArray[np.float64]:
    """Sectors over their rings, (c, sectors, rings), averaged over neighbouring rings and shrunk to 1.
    Constant beyond the last significant ring of each component.
    """
    for one, last in zip(weight, lasts):
        one[:, last:] = 0.0
    total_weight = convolve1d(weight, RING_SMOOTHING, axis=-1, mode="constant")
    mean = convolve1d(estimate * weight, RING_SMOOTHING, axis=-1, mode="constant") / np.maximum(
        total_weight, 1e-30
    )
    out: NDArray[np.float64] = np.maximum(
        (total_weight * mean + SHRINKAGE_MODES) / (total_weight + SHRINKAGE_MODES), MIN_SECTOR_FRACTION
    )
    for one, last in zip(out, lasts):
        one[:, last:] = one[:, last - 1 : last]
    return out


def pooled_share(shares: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """`Prior.share` of several fields of the same waves together, by the precision of each.

    Parameters
    ----------
    shares : sequence of (float, float)
        Of each field, with its standard deviation.

    Returns
    -------
    float, float
        Of all, with its standard deviation.

    Examples
    --------
    >>> pooled_share([(0.2, 0.5), (0.6, 0.5)])
    (0.4, 0.3535533905932738)
    """
    precision = np.array([std**-2 if std > 0 else 1e12 for _, std in shares])
    mean = float(precision @ [share for share, _ in shares] / precision.sum())
    return mean, float(precision.sum() ** -0.5)


def shrinkage(variance: float, noise: float, waves: float) -> float:
    """Fraction of a spectrum that is waves, from the variance of fields.

    Parameters
    ----------
    variance : float
        Of a field.
    noise : float
        The part of it that noise gives.
    waves : float
        The part of it that the spectrum would give.

    Returns
    -------
    float
        1 where the variance is half of what the spectrum would give, or four times that of the noise; less in
        proportion.

    Examples
    --------
    >>> shrinkage(4.0, 1.0, 3.0), round(shrinkage(1.0, 1.0, 3.0), 3)
    (1.0, 0.067)
    """
    signal = variance - CERTAIN_NOISE_FRACTION * noise
    needed = min(FULL_WAVE_FRACTION * waves, FULL_SIGNAL_TO_NOISE * noise)
    return float(np.clip(signal / max(needed, 1e-30), 0.0, 1.0))


def _plateau(ratio: NDArray[np.float64], count: NDArray[np.integer[Any]]) -> float:
    """Power over noise of rings without waves: the least mean over neighbouring rings."""
    if ratio.size < NOISE_RINGS:
        return 1.0
    box = np.ones(NOISE_RINGS)
    total, modes = (np.convolve(f, box, mode="valid") for f in (ratio * count, count))
    return float(np.min(total / modes))


def _extrapolated(
    k: NDArray[np.float64],
    power: NDArray[np.float64],
    last: int,
    noise: float,
    upper_limit: Float | float = np.inf,
) -> tuple[float, ...]:
    """The spectrum with a power law, no higher than the upper limit, beyond its first `last` rings."""
    out = np.maximum(power, MIN_POWER_TO_NOISE * noise)
    first = max(last - SLOPE_RINGS, 1)
    slope = SLOPE_RANGE[1]
    if last - first > 2:
        slope = float(np.polyfit(np.log(k[first:last]), np.log(out[first:last]), 1)[0])
    slope = float(np.clip(slope, *SLOPE_RANGE))
    out[last:] = out[last - 1] * (k[last:] / k[last - 1]) ** slope
    out[last:] = np.minimum.accumulate(np.minimum(out, upper_limit)[last:])
    return tuple(map(float, out))


def _cosine_coefficients(field: Float) -> NDArray[Any]:
    out: NDArray[Any] = scipy.fft.dctn(np.asarray(field, np.float64), axes=(-2, -1), norm="ortho", workers=1)
    return out
