"""Learn the prior spectrum of a field on a lattice of blocks from sample frames.

`first_prior` takes the spectrum of the matched fields. `refined_prior` estimates the MAP fields' spectrum,
with their noise subtracted, and is called several times in turn with the MAP estimate. Wavenumbers are
grouped in rings, and rings in sectors of direction (`WavenumberRings`). A ring is significant if its power
stands out from the noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import convolve1d

from wavefield.matching.map_field import Modes
from wavefield.matching.spectrum import (
    DETECTED_SIGNAL_TO_NOISE,
    FOOTPRINT_VARIANCE,
    NOISE_RINGS,
    SHORTEST_WAVENUMBER,
    Prior,
    WavenumberRings,
    wavenumbers,
)

Float = NDArray[np.floating[Any]]

# A sector with this many modes has the same weight as the mean of its ring; with fewer, the ring prevails.
SHRINKAGE_MODES = 2.0
RING_SMOOTHING = np.array([1.0, 2.0, 3.0, 2.0, 1.0]) / 3.0  # weights of neighbouring rings, for directions
LIMIT_STANDARD_DEVIATIONS = 2.0  # upper limit of a ring that is not significant: its power plus 2 std
SHORTEST_IN_LIMITS = 0.5 * np.pi  # rad per block: fields contain only noise at higher wavenumbers
MIN_POWER_TO_NOISE = 0.01  # lower bound of a ring's power over the noise, which keeps logarithms finite
FULL_WAVE_FRACTION = 0.5  # `shrinkage` is 1 from this fraction of the variance that the spectrum predicts
FULL_SIGNAL_TO_NOISE = 3.0  # and from this ratio of signal to noise variance
SLOPE_RANGE = -9.0, -3.0  # permitted exponents of the power law that extrapolates a spectrum
SLOPE_RINGS = 6  # the exponent is fitted to the last significant rings, this many


def first_prior(fields: Sequence[Float], information: float, area: float = FOOTPRINT_VARIANCE) -> Prior:
    """Return the isotropic prior with the mean spectrum of matched fields (c, ny, nx) from sample frames.
    The fields must have no holes and no slopes at the edges (`edge_field`). `information` is the typical
    inverse variance of a block's value; `area`, px^2, is that of `Prior`."""
    binning = WavenumberRings(*wavenumbers(fields[0].shape[-2:]))
    power = np.mean([np.square(_cosine_coefficients(f)).mean(axis=0) for f in fields], axis=0)
    return Prior.isotropic(binning.k, binning.mean(power).tolist(), information, area)


def refined_prior(
    prior: Prior,
    modes: Modes,
    waves: Sequence[Float],
    information: float,
    noise_alone: Sequence[tuple[Float, float]] = (),
) -> Prior:
    """Return a prior with the spectrum of the MAP fields that the old `prior` gave in sample frames.

    `waves` are the cosine coefficients D (c, my, mx) of these fields, `information` A the typical inverse
    variance of a block, F its footprint. With a spectrum S and noise N = 1 / (F^2 A), a MAP field has the
    gain G = S / (S + N) and the power G^2 (S + N), so S = sum(|D|^2 - G^2 N) / sum G^2 over the modes of a
    ring or of one of its sectors. In rings that do not stand out from the noise, S is the upper limit of
    undetected waves; after the last ring that does, S is a power law. Directions are averaged over
    neighbouring rings and drawn towards uniform where modes are few. `noise_alone` are pairs (coefficients,
    information) of MAP fields that contain only noise. These give the noise as a function of wavenumber; its
    magnitude comes from the rings with the lowest power.
    """
    if not information > 0:  # no block has information
        return prior
    spectrum, binning = prior.spectrum(modes.kx, modes.ky), WavenumberRings(modes.kx, modes.ky)
    measured, of_sectors, noise = _signals_and_noise(
        waves, spectrum, modes.foot, information, binning, noise_alone
    )
    detected = np.array([binning.significant(one) for one in measured / noise])
    lasts = [max(int(np.flatnonzero(flags).max(initial=-1)) + 1, 3) for flags in detected]
    occupied = binning.count > 0
    relative_std = np.sqrt(2.0 / np.maximum(binning.count * len(waves), 1))
    limit = np.maximum(measured, 0.0) + LIMIT_STANDARD_DEVIATIONS * relative_std * noise
    highest = np.where(occupied, np.minimum(limit, DETECTED_SIGNAL_TO_NOISE * noise), np.inf)
    least = float((1.0 / (np.square(modes.foot, dtype=np.float64) * information)).min())
    parts = zip(np.where(detected, measured, limit), lasts, highest)
    rings = np.array([_extrapolated(binning.middle, one, last, least, top) for one, last, top in parts])
    weight = binning.sector_count * len(waves) * np.square(rings / (rings + noise))[:, None]
    power = _shapes(of_sectors / rings[:, None], weight, lasts) * rings[:, None]
    return replace(
        prior,
        k=binning.k,
        power=tuple(tuple(tuple(float(f"{value:.4g}") for value in row) for row in one) for one in power),
        information=information,
        detected=tuple(tuple(map(bool, flags)) for flags in detected),
        undetected_fraction=_undetected_fraction(measured, rings, noise, detected, binning),
    )


def _signals_and_noise(
    waves: Sequence[Float],
    spectrum: Float,
    foot: Float,
    information: float,
    binning: WavenumberRings,
    noise_alone: Sequence[tuple[Float, float]],
) -> tuple[Float, Float, Float]:
    """Return the power of waves in rings (c, rings), in sectors (c, sectors, rings), and of noise in rings.
    All three are divided by the squared gain of the MAP field. `foot` is the footprint F of every mode,
    `spectrum` the old prior's; `refined_prior` describes the other arguments."""

    def block_noise(of: float) -> Float:
        """Return N = 1 / (F^2 A) of every mode, for the information A = `of`."""
        return np.asarray(1.0 / (np.square(foot, dtype=np.float64) * of))

    rings, noise = _over_gain(waves, spectrum, block_noise(information), binning.rings)
    sectors, noise_of_sectors = _over_gain(waves, spectrum, block_noise(information), binning.sectors)
    shape = np.ones_like(rings)
    if noise_alone:
        ratios = [
            np.divide(*_over_gain([field], spectrum, block_noise(own), binning.rings))
            for field, own in noise_alone
        ]
        shape = np.array([binning.level(one) for one in np.mean(ratios, axis=0)])
    resolved = (binning.count > 0) & (binning.middle < SHORTEST_WAVENUMBER)
    level = [_plateau(one, binning.count[resolved]) for one in (rings / (shape * noise))[:, resolved]]
    plateau = shape * np.reshape(level, (-1, 1))
    return rings - plateau * noise, sectors - plateau[:, None] * noise_of_sectors, plateau * noise


def _over_gain(
    fields: Sequence[Float], spectrum: Float, noise: Float, mean: Callable[[Float], Float]
) -> tuple[Float, Float]:
    """Return the power of MAP fields (c, my, mx) and of their noise, both divided by the mean squared gain.
    `noise` is N = 1 / (F^2 A) of each mode, and the gain S / (S + N) with the `spectrum` S. `mean` averages
    an array over the modes of each ring or sector."""
    power = np.mean([np.square(f, dtype=np.float64) for f in fields], axis=0)
    spectrum = np.broadcast_to(spectrum, power.shape)
    squared_gain = np.square(spectrum / (spectrum + noise))
    weight = np.maximum(mean(squared_gain), 1e-30)
    return mean(power) / weight, np.maximum(mean(squared_gain * noise) / weight, 1e-30)


def _undetected_fraction(
    measured: Float, rings: Float, noise: Float, detected: NDArray[np.bool_], binning: WavenumberRings
) -> float:
    """Return the power of rings without significant waves as a fraction, 0 to 1, of its upper limit `rings`.
    It is the slope of a line through (upper limit, measured power) / noise of these rings, all (c, rings)."""
    limit, found = rings / noise, measured / noise
    weight = binning.count * (~detected & (binning.middle < SHORTEST_IN_LIMITS))
    total = max(float(weight.sum()), 1e-30)
    mean, level = float((weight * limit).sum()) / total, float((weight * found).sum()) / total
    square = max(float((weight * np.square(limit - mean)).sum()), 1e-6)
    slope = float((weight * (limit - mean) * found).sum()) / square
    return float(np.clip(slope / max(1.0 + level - slope * mean, 0.1), 0.0, 1.0))


def _shapes(estimate: Float, weight: NDArray[Any], lasts: Sequence[int]) -> NDArray[np.float64]:
    """Return the power of each sector over that of its ring, (c, sectors, rings).
    The measured `estimate` of this ratio is averaged over neighbouring rings with `weight`, and drawn towards
    1 where modes are few. In component n, it is constant from ring number lasts[n] - 1 on."""
    for one, last in zip(weight, lasts):
        one[:, last:] = 0.0
    total_weight = convolve1d(weight, RING_SMOOTHING, axis=-1, mode="constant")
    mean = convolve1d(estimate * weight, RING_SMOOTHING, axis=-1, mode="constant") / np.maximum(
        total_weight, 1e-30
    )
    out: NDArray[np.float64] = (total_weight * np.maximum(mean, 0.0) + SHRINKAGE_MODES) / (
        total_weight + SHRINKAGE_MODES
    )
    for one, last in zip(out, lasts):
        one[:, last:] = one[:, last - 1 : last]
    return out


def shrinkage(variance: float, noise: float, waves: float) -> float:
    """Return the fraction of a learned spectrum that is waves, 0 to 1; the rest is noise of long waves.

    `variance` is measured in the MAP fields; the prior predicts `noise` for its noise and `waves` for its
    waves. The fraction is 1 if variance - noise is at least half of `waves` or three times `noise`; below the
    smaller of these limits it is proportional to variance - noise.

    >>> shrinkage(4.0, 1.0, 3.0), round(shrinkage(1.0, 1.0, 3.0), 3)
    (1.0, 0.0)
    """
    signal = variance - noise
    needed = min(FULL_WAVE_FRACTION * waves, FULL_SIGNAL_TO_NOISE * noise)
    return float(np.clip(signal / max(needed, 1e-30), 0.0, 1.0))


def _plateau(ratio: NDArray[np.float64], count: NDArray[np.integer[Any]]) -> float:
    """Return the smallest mean of a ratio (rings,) of power to noise over five neighbouring rings.
    `count` is the number of modes of each ring. With fewer than five rings, the result is 1."""
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
    """Replace a spectrum (rings,) from ring number `last` on by a power law through the rings before it.
    The law stays below `upper_limit`; rings before get at least 0.01 `noise`. k are the rings'
    wavenumbers."""
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
    """Return the orthonormal cosine coefficients of a field (c, ny, nx) along y and x, (c, ny, nx)."""
    out: NDArray[Any] = scipy.fft.dctn(np.asarray(field, np.float64), axes=(-2, -1), norm="ortho", workers=1)
    return out
