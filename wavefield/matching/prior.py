"""Prior knowledge of a field on a lattice of blocks: its spectrum.

Measured once per run from sample frames and stored with the results, so that every frame is weighted alike.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import convolve1d

from wavefield.matching.matching_gain import FOOTPRINT_VARIANCE, footprint

Float = NDArray[np.floating[Any]]

RINGS = 40  # of wavenumber, from 0 to pi per block
SECTORS = 6  # of direction, from along columns to along rows
SHRINKAGE_MODES = 2.0  # a sector of so many modes and its ring have equal weights
RING_SMOOTHING = np.array([1.0, 2.0, 3.0, 2.0, 1.0]) / 3.0  # weights of rings with similar directions
MIN_SECTOR_FRACTION = 0.01  # of the ring: least power of a sector
MIN_SQUARED_WINDOW_GAIN = 0.15  # of the windows: less, and a wave is not resolved
MIN_POWER_TO_PLATEAU = 3.0  # of the windowed field over the plateau of noise, to be signal
DETECTED_SIGNAL_TO_NOISE = 0.3  # least that the MAP field separates from noise
SHORTEST_WAVENUMBER = 2.0  # rad per block: shorter waves are not searched for in gaps of a spectrum
SHORTEST_IN_COMMON = 2.9  # the same in what several cameras have in common, in which noise averages out
OPEN_SIGNAL_TO_NOISE = 1.0  # least of every wave while a spectrum is learned
FIRST_SIGNAL_TO_NOISE = 6.0  # the same in the first round, whose noise is several times too small
MIN_STANDARD_DEVIATIONS = 4.0  # by which the power of a ring has to exceed noise to be waves
MIN_RING_SIGNAL_TO_NOISE = 1.5  # of a ring beyond one without waves: the noise of rings is uncertain
LOST_SIGNAL_TO_NOISE = 1.0  # the same where nothing but the uncertainty depends on it
FIRST_NOISE_RING = 4  # longer waves across the sight lines are errors of the calibration, not noise
NOISE_RINGS = 5  # over which the level of noise is averaged
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

SECTOR_ANGLES = (np.arange(SECTORS) + 0.5) * np.pi / (2 * SECTORS)  # middle of every sector, rad

Power = tuple[tuple[tuple[float, ...], ...], ...]


@dataclass(frozen=True)
class Prior:
    """Spectrum of a field in both wavenumbers, and the information of its blocks.

    Parameters
    ----------
    k : tuple of float
        Wavenumbers, rad per block.
    power : tuple of tuple of tuple of float
        Mean square of the field's cosine coefficients (orthonormal), in the field's unit squared: for every
        component (or one for all), for directions evenly from along columns to along rows (a quarter turn; or
        one for all), at the wavenumbers.
    information : float
        Typical information of a block: inverse variance of its own estimate, per unit squared.
    noise : float
        Noise of the scores, from the misfit of several fields, over that of their clusters in one field.
    waves : float
        Fraction of the spectrum that is waves: noise of long wavelength among them, as on still water, is not
        missing from a field.
    shown : tuple of tuple of float
        Least power of every ring of every component over this one: 1 or more where waves are significant, and
        1 in all if empty. In other rings the power is a limit, which weights take for waves.
    share : (float, float)
        How much of these limits the fields show on the whole, and its standard deviation.
    in_common : tuple of tuple of float
        Fraction of the power of every ring of every component that several cameras have in common, and which
        so is waves; none if empty.
    area : float
        Variance of the area that a block's value represents, px^2.

    Notes
    -----
    Waves have directions, a short wave moves the water along itself, and an oblique camera sees it shortened:
    each component of an image displacement has a spectrum of its own in both wavenumbers. Of the four
    quarters of directions cosines represent one.
    """

    k: tuple[float, ...]
    power: Power
    information: float
    noise: float = 1.0
    waves: float = 1.0
    shown: tuple[tuple[float, ...], ...] = ()
    share: tuple[float, float] = (1.0, 0.0)
    in_common: tuple[tuple[float, ...], ...] = ()
    area: float = FOOTPRINT_VARIANCE

    @classmethod
    def isotropic(
        cls, k: Sequence[float], power: Sequence[float], information: float, area: float = FOOTPRINT_VARIANCE
    ) -> Prior:
        """Prior of a field with the same spectrum at wavenumbers k in all directions and components.

        Examples
        --------
        >>> prior = Prior.isotropic((0.1, 1.0), (4.0, 4.0), 1.0)
        >>> prior.spectrum(np.array([0.3, 0.4]), np.array([[0.5]])).tolist()
        [[[4.0, 4.0]]]
        """
        return cls(tuple(map(float, k)), ((tuple(map(float, power)),),), float(information), area=area)

    def footprint(self, kx: Float, ky: Float) -> NDArray[np.float64]:
        """Gain of the area that a block's value represents, at wavenumbers kx, ky, rad per block."""
        return footprint(kx, ky, self.area)

    def with_min_signal_to_noise(self, ratio: float = OPEN_SIGNAL_TO_NOISE) -> Prior:
        """The prior with at least this signal over noise in every resolved mode.

        A prior that is small where a field has waves suppresses them, and what is learned from such a field
        is small there again. Spectra are therefore learned from fields that an open prior gave.
        """
        k = np.array(self.k)
        least = ratio / (self.footprint(k, np.zeros(1)) ** 2 * self.information)
        table = np.maximum(self.power, np.where(k < SHORTEST_WAVENUMBER, least, 0.0))
        power = tuple(tuple(tuple(map(float, ring)) for ring in directions) for directions in table)
        return replace(self, power=power)

    def spectrum(self, kx: Float, ky: Float) -> NDArray[np.float64]:
        """Spectrum at wavenumbers kx, ky, rad per block, that broadcast to S: (1 or c,) + S."""
        table = np.log(np.maximum(self.power, 1e-30))  # a field without any motion has none
        directions = table.shape[1]
        at = np.interp(np.hypot(kx, ky), self.k, np.arange(len(self.k)))
        direction = np.arctan2(np.abs(ky), np.abs(kx)) * (directions / (0.5 * np.pi)) - 0.5
        direction = np.clip(np.broadcast_to(direction, at.shape), 0, directions - 1)
        i, j = (
            np.minimum(np.floor(v).astype(int), n - 2)
            for v, n in ((at, len(self.k)), (direction, directions))
        )
        j, s, t = np.maximum(j, 0), direction - np.maximum(j, 0), at - i
        after = np.minimum(j + 1, directions - 1)
        out = (1 - s) * ((1 - t) * table[:, j, i] + t * table[:, j, i + 1])
        out += s * ((1 - t) * table[:, after, i] + t * table[:, after, i + 1])
        return np.asarray(np.exp(out))

    def expected(self, kx: Float, ky: Float) -> NDArray[np.float64]:
        """Power of waves that is expected over `spectrum`, which is a limit where none were detected.
        Of the share of that every amplitude is as likely before the fields showed something of it.
        """
        share, (estimate, std) = np.linspace(0.0, 1.0, 101) ** 2, self.share
        away = (share - np.clip(estimate, -3.0 * std, 1.0 + 3.0 * std)) / max(std, 1e-3)
        weight = np.exp(-0.5 * np.square(away))
        table = np.maximum(self.shown or [[1.0] * len(self.k)], float(share @ weight / weight.sum()))
        table = np.maximum(self.waves * table, self.in_common or np.zeros_like(table))
        return np.array([np.interp(np.hypot(kx, ky), self.k, one) for one in table])

    def signal_to_noise(self, kx: Float, ky: Float) -> NDArray[np.float64]:
        """F^2 A S of a wave, (1 or c,) + S, with F the footprint of a block and A the typical information."""
        return np.asarray(self.footprint(kx, ky) ** 2 * self.information * self.spectrum(kx, ky))

    def gain(self, kx: Float, ky: Float) -> NDArray[np.float64]:
        """Fraction of a wave's amplitude that the MAP field keeps, F^2 A S / (F^2 A S + 1), (1 or c,) + S."""
        ratio = self.signal_to_noise(kx, ky)
        return np.asarray(ratio / (ratio + 1.0))

    def mean_gain(self, k: Float) -> NDArray[np.float64]:
        """`gain` at wavenumbers k, rad per block, mean over components and directions by their power."""
        at = _in_all_directions(k)
        power = self.spectrum(*at)
        return np.asarray((self.gain(*at) * power).sum(axis=(0, 1)) / power.sum(axis=(0, 1)))

    def variances(self, shape: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Variance of the MAP field by waves, G^2 S, and by noise, G^2 / (F^2 A), each (1 or c,).

        Where all blocks have the typical information; the mean over the field is not counted.
        """
        kx, ky = wavenumbers(shape)
        squared_gain = np.square(self.gain(kx, ky))
        squared_gain[:, 0, 0] = 0.0
        noise = squared_gain / (self.footprint(kx, ky) ** 2 * self.information)
        return (squared_gain * self.spectrum(kx, ky)).mean(axis=(1, 2)), noise.mean(axis=(1, 2))

    def noise_power(self, k: Float) -> NDArray[np.float64]:
        """Noise G^2 / (F^2 A) in the power of the MAP field's cosines, mean over directions and components.

        0 beyond the shortest wave of the lattice.
        """
        total_weight = self.footprint(k, np.zeros(1)) ** 2 * self.information
        squared_gain = np.square(self.gain(*_in_all_directions(k))).mean(axis=(0, 1))
        return np.where(k < np.pi, squared_gain / np.maximum(total_weight, 1e-30), 0.0)

    def to_dict(self) -> dict[str, Any]:
        """Plain data for a recipe."""
        power = [[list(ring) for ring in directions] for directions in self.power]
        names = ("information", "noise", "waves", "area")
        numbers = {name: getattr(self, name) for name in names}
        limits = {"shown": [list(rings) for rings in self.shown], "share": list(self.share)}
        limits["in_common"] = [list(rings) for rings in self.in_common]
        return {"k": list(self.k), "power": power} | numbers | limits

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Prior:
        """Inverse of `to_dict`."""
        power = tuple(tuple(tuple(map(float, ring)) for ring in directions) for directions in data["power"])
        information, noise, waves = (float(data[name]) for name in ("information", "noise", "waves"))
        shown = tuple(tuple(map(float, rings)) for rings in data.get("shown", ()))
        share, std = map(float, data.get("share", (1.0, 0.0)))
        common = tuple(tuple(map(float, rings)) for rings in data.get("in_common", ()))
        limits = shown, (share, std), common
        area = float(data.get("area", FOOTPRINT_VARIANCE))
        return cls(tuple(map(float, data["k"])), power, information, noise, waves, *limits, area)


def _in_all_directions(k: Float) -> tuple[Float, Float]:
    """Wavenumbers (directions,) + S of waves in all directions."""
    direction = SECTOR_ANGLES.reshape(-1, *(1,) * np.ndim(k))
    return k * np.cos(direction), k * np.sin(direction)


def wavenumbers(shape: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Wavenumbers of a lattice's cosines along columns (nx,) and along rows (ny, 1), rad per block."""
    ky, kx = (np.pi * np.arange(n) / n for n in shape)
    return kx, ky[:, None]


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
    binning = _Rings(kx, ky)
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
    binning = _Rings(kx, ky)

    def estimate(
        fields: Sequence[Float], noise: Float, mean: Callable[[Float], Float]
    ) -> tuple[Float, Float]:
        power = np.mean([np.square(f, dtype=np.float64) for f in fields], axis=0)
        spectrum = np.broadcast_to(prior.spectrum(kx, ky), power.shape)
        squared_gain = np.square(spectrum / (spectrum + noise))
        weight = np.maximum(mean(squared_gain), 1e-30)
        return mean(power) / weight, np.maximum(mean(squared_gain * noise) / weight, 1e-30)

    ring_power, noise_power = estimate(waves, noise, binning.rings)
    sector_power, sector_noise_power = estimate(waves, noise, binning.sectors)
    occupied = binning.count > 0
    shape = np.ones_like(ring_power)
    if noise_alone:
        noise_ratios = [
            np.divide(*estimate([field], 1.0 / (np.square(foot, dtype=np.float64) * own), binning.rings))
            for field, own in noise_alone
        ]
        shape = np.array([binning.level(one) for one in np.mean(noise_ratios, axis=0)])
    resolved = occupied & (binning.middle < SHORTEST_WAVENUMBER)
    level = [
        _plateau(one, binning.count[resolved]) for one in (ring_power / (shape * noise_power))[:, resolved]
    ]
    plateau = shape * np.reshape(level, (-1, 1))
    noise_power, sector_noise_power = plateau * noise_power, plateau[:, None] * sector_noise_power
    signal = ring_power - noise_power
    significant = [
        binning.significant(one / np.maximum(own, 1e-30), len(waves)) for one, own in zip(signal, noise_power)
    ]
    lasts = [max(int(np.flatnonzero(flags).max(initial=-1)) + 1, 3) for flags in significant]
    relative_std = np.sqrt(2.0 / np.maximum(binning.count * len(waves), 1))
    limit = np.maximum(signal, 0.0) + LIMIT_STANDARD_DEVIATIONS * relative_std * noise_power
    measured, signal = signal, np.where(significant, signal, limit)
    least = float(noise.min())
    upper_limit = np.where(occupied, np.minimum(limit, DETECTED_SIGNAL_TO_NOISE * noise_power), np.inf)
    rings = np.array(
        [
            _extrapolated(binning.middle, one, last, least, limit_of_component)
            for one, last, limit_of_component in zip(signal, lasts, upper_limit)
        ]
    )
    weight = binning.sector_count * len(waves) * np.square(rings / (rings + noise_power))[:, None]
    shapes = _shapes((sector_power - sector_noise_power) / rings[:, None], weight, lasts)
    power = shapes * rings[:, None]
    expected = np.zeros_like(power)
    if common is not None:
        searched = occupied & (binning.middle < SHORTEST_IN_COMMON)
        alone = (np.array(significant) | ~searched)[:, None]
        expected = np.where(alone, 0.0, np.minimum(np.nan_to_num(common), limit[:, None]))
        power = np.maximum(power, expected)
    # noise hardly changes while the same beads are seen: samples count as one
    chance = LIMIT_STANDARD_DEVIATIONS * np.sqrt(2.0 / np.maximum(binning.count, 1))
    of_limit, found = rings / noise_power, measured / noise_power
    seen = ~np.array(significant) & (binning.middle < SHORTEST_IN_LIMITS)
    # single rings exceed chance by chance, and the level of the noise differs from ring to ring
    lost = [binning.exceeds(one, LOST_SIGNAL_TO_NOISE) for one in found]
    weight = binning.count * (seen & (found < of_limit + chance))
    share = pooled_share(list(map(_share_of_limits, of_limit, found, weight)))
    mean = power.mean(axis=1)
    # where few blocks have most of the information, fields show less of short waves than there is
    more = np.square(_even_over_kept(prior.spectrum(kx, ky), noise, kept, binning))
    shown = np.where(significant, more, measured * (seen & lost & (found > chance)) / mean)
    return Prior(
        binning.k,
        tuple(_rounded(directions) for directions in power),
        information,
        prior.noise,
        prior.waves,
        _rounded(shown),
        share,
        _rounded(expected.mean(axis=1) / mean * more),
        prior.area,
    )


def _even_over_kept(
    spectrum: Float, noise: Float, kept: Sequence[tuple[Float, Float]], binning: _Rings
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


class _Rings:
    """Rings of wavenumber, and their sectors."""

    def __init__(self, kx: Float, ky: Float) -> None:
        edges = np.linspace(0, np.pi, RINGS + 1)
        self.middle = 0.5 * (edges[1:] + edges[:-1])
        self.k = tuple(map(float, self.middle))
        self._which = np.clip(np.digitize(np.hypot(kx, ky).ravel(), edges) - 1, 0, RINGS - 1)
        direction = np.arctan2(ky, kx).ravel() * (SECTORS / (0.5 * np.pi))
        self._sector = np.minimum(direction.astype(int), SECTORS - 1) * RINGS + self._which
        self.count = np.bincount(self._which, minlength=RINGS)
        self.sector_count = np.bincount(self._sector, minlength=SECTORS * RINGS).reshape(SECTORS, RINGS)

    def mean(self, field: NDArray[Any]) -> NDArray[np.float64]:
        """Mean of a field over rings, (rings,)."""
        total = np.bincount(self._which, field.ravel(), minlength=RINGS)
        return np.asarray(total / np.maximum(self.count, 1))

    def rings(self, fields: Float) -> NDArray[np.float64]:
        """Mean of fields (c, my, mx) over rings, (c, rings)."""
        return np.array([self.mean(field) for field in fields])

    def sectors(self, fields: Float) -> NDArray[np.float64]:
        """Mean of fields (c, my, mx) over the sectors of rings, (c, sectors, rings)."""
        size = self.sector_count.size
        total = np.array([np.bincount(self._sector, field.ravel(), minlength=size) for field in fields])
        return np.asarray(total.reshape(-1, SECTORS, RINGS) / np.maximum(self.sector_count, 1))

    def significant(self, ratio: Float, samples: int) -> NDArray[np.bool_]:
        """Rings (rings,) with a significant signal over noise; beyond a gap it has to be larger."""
        contiguous = np.arange(RINGS) < self.count_until_false(
            (self.count > 0) & (ratio > DETECTED_SIGNAL_TO_NOISE)
        )
        # waves beyond the first ring without any have to exceed the noise by more, with both neighbours
        beyond_gap = self.exceeds(ratio, MIN_RING_SIGNAL_TO_NOISE, samples) & (self.count > 0)
        beyond_gap &= ratio > DETECTED_SIGNAL_TO_NOISE
        beyond_gap &= ~contiguous & (self.middle < SHORTEST_WAVENUMBER)
        if beyond_gap.any():  # the first three rings may belong to the gap
            contiguous &= ratio > DETECTED_SIGNAL_TO_NOISE
        return np.asarray(contiguous | beyond_gap)

    def exceeds(self, ratio: Float, least: float, samples: int = 1) -> NDArray[np.bool_]:
        """Rings (rings,) whose signal over noise is more than the least and more than chance, with both
        neighbours.
        """
        count = self.count * samples
        of_three = np.maximum(np.convolve(count, np.ones(3), mode="same"), 1)
        chance = MIN_STANDARD_DEVIATIONS * np.sqrt(2.0 / of_three)
        mean = np.convolve(ratio * count, np.ones(3), mode="same") / of_three
        return np.asarray(mean > np.maximum(chance, least))

    def level(self, ratio: Float) -> NDArray[np.float64]:
        """Level of noise (rings,) from single rings, without long waves, which are errors of calibration."""
        count = np.where((np.arange(RINGS) < FIRST_NOISE_RING), 0, self.count)
        weight = np.convolve(count, np.ones(NOISE_RINGS), mode="same")
        total = np.convolve(ratio * count, np.ones(NOISE_RINGS), mode="same")
        known = np.flatnonzero(weight)
        if not known.size:
            return np.ones(RINGS)
        return np.asarray(np.interp(np.arange(RINGS), known, total[known] / weight[known]))

    @staticmethod
    def count_until_false(flags: NDArray[np.bool_]) -> int:
        """Number of flags before the first that is false, at least three."""
        return max(int(np.argmin(flags)) if not flags.all() else len(flags), 3)


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
