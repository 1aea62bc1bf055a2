"""Prior spectrum of a field on a lattice of blocks, and how it is learned from sample frames.

The prior is learned once per run and stored with the results, so that all frames are weighted alike.
`first_prior` takes the spectrum of the matched fields. `refined_prior` estimates the spectrum of MAP fields,
without noise, and is called several times in turn with the MAP estimate. Wavenumbers are in rad per block: a
wave as long as two blocks has the wavenumber pi. They are grouped in rings (bins of |k|), and rings in
sectors of direction. A ring is significant if its power stands out from the noise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import convolve1d

from wavefield.matching.kernels import BLOCK

Float = NDArray[np.floating[Any]]

RINGS = 40  # rings of wavenumber, from 0 to pi rad per block
SECTORS = 6  # sectors of direction in a quarter turn, from waves along the rows to waves along the columns
DETECTED_SIGNAL_TO_NOISE = 0.3  # smallest ratio at which waves in a ring stand out from the noise
SHORTEST_WAVENUMBER = 2.0  # rad per block: beyond it no waves are looked for and the prior is not raised
# the same ratio for rings beyond a ring without waves, where chance matters more
MIN_RING_SIGNAL_TO_NOISE = 1.5
FIRST_NOISE_RING = 4  # errors across the sight lines in lower rings come from the calibration, not from noise
NOISE_RINGS = 5  # neighbouring rings over which the level of the noise is averaged

# px^2: variance of the area that a block's value averages over, for the elevation from two cameras
FOOTPRINT_VARIANCE = 6.0
# px^2: empirical widening of the footprint that offsets the damping of short waves by the prior; tuned on
# random and steep simulated seas
RESTORED_VARIANCE = 1.2
# signal-to-noise ratio to which the prior is raised while a spectrum is learned, and in the first of these
# rounds, where the estimated noise is several times too small
OPEN_SIGNAL_TO_NOISE = 1.0
FIRST_SIGNAL_TO_NOISE = 6.0
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

Power = tuple[tuple[tuple[float, ...], ...], ...]


@dataclass(frozen=True)
class Prior:
    """Spectrum of a field as a function of kx and ky, and the typical inverse variance of its blocks.

    Each component of an image displacement has a directional spectrum of its own, because a short wave moves
    the water along its direction and an oblique camera sees it shortened. A cosine mode is the same for
    directions mirrored in x or y, so directions cover a quarter turn.
    """

    k: tuple[float, ...]  # wavenumbers at which the spectrum is tabulated, rad per block
    # mean square of the orthonormal cosine coefficients, in the field's unit squared, by component, direction
    # (from waves along the rows of the lattice to waves along its columns) and wavenumber; one component or
    # direction stands for all
    power: Power
    information: float  # typical inverse variance A of the value that a block alone gives, per unit squared
    noise: float = 1.0  # factor on the noise variance of the scores, so that cameras agree with chi^2
    # fraction of the spectrum that is waves; the rest is noise of long wavelength, as on still water, which
    # the uncertainty does not count as waves that the measurement misses
    wave_fraction: float = 1.0
    # for every component and wavenumber, whether waves stand out from the noise; empty if they always do;
    # where they do not, the power is the upper limit of waves that may be there undetected
    detected: tuple[tuple[bool, ...], ...] = ()
    undetected_fraction: float = 1.0  # power in the sample fields there, as a fraction of the upper limits
    area: float = FOOTPRINT_VARIANCE  # variance of the area that a block's value averages over, px^2

    @classmethod
    def isotropic(
        cls, k: Sequence[float], power: Sequence[float], information: float, area: float = FOOTPRINT_VARIANCE
    ) -> Prior:
        """Return a prior with one spectrum, `power` at wavenumbers `k`, for all directions and components.

        >>> prior = Prior.isotropic((0.1, 1.0), (4.0, 4.0), 1.0)
        >>> prior.spectrum(np.array([0.3, 0.4]), np.array([[0.5]])).tolist()
        [[[4.0, 4.0]]]
        """
        return cls(tuple(map(float, k)), ((tuple(map(float, power)),),), float(information), area=area)

    def footprint(self, kx: Float, ky: Float) -> NDArray[np.float64]:
        """Return the gain F of averaging over the area of a block, at wavenumbers kx, ky, rad per block."""
        return footprint(kx, ky, self.area)

    def with_min_signal_to_noise(self, ratio: float) -> Prior:
        """Return the prior with a signal-to-noise ratio of at least `ratio` below 2 rad per block.
        A spectrum that is learned with too small a prior comes out too small as well."""
        k = np.array(self.k)
        least = ratio / (self.footprint(k, np.zeros(1)) ** 2 * self.information)
        table = np.maximum(self.power, np.where(k < SHORTEST_WAVENUMBER, least, 0.0))
        return replace(self, power=_nested(table.tolist(), tuple))

    def spectrum(self, kx: Float, ky: Float) -> NDArray[np.float64]:
        """Return the spectrum S, (component, ...), at wavenumbers kx, ky (...), rad per block."""
        table = np.log(np.maximum(self.power, 1e-30))  # a field without motion has power 0
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
        """Return the fraction of `spectrum` that is expected to be waves, (component, ...), at kx, ky (...).
        It is `wave_fraction`, times `undetected_fraction` where the spectrum is only an upper limit."""
        detected = np.array(self.detected or [[True] * len(self.k)])
        fraction = self.wave_fraction * np.where(detected, 1.0, self.undetected_fraction)
        return np.array([np.interp(np.hypot(kx, ky), self.k, one) for one in fraction])

    def signal_to_noise(self, kx: Float, ky: Float) -> NDArray[np.float64]:
        """Return the ratio F^2 A S of signal to noise, (component, ...), at wavenumbers kx, ky (...)."""
        return np.asarray(self.footprint(kx, ky) ** 2 * self.information * self.spectrum(kx, ky))

    def gain(self, kx: Float, ky: Float) -> NDArray[np.float64]:
        """Return the amplitude gain R / (R + 1) of the MAP field, (component, ...); R = `signal_to_noise`."""
        ratio = self.signal_to_noise(kx, ky)
        return np.asarray(ratio / (ratio + 1.0))

    def variances(self, shape: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the variance of a MAP field from waves and its variance from noise, (component,) each.
        They are means of G^2 S and G^2 / (F^2 A), with the gain G, over all modes (`shape`) but the first."""
        kx, ky = wavenumbers(shape)
        squared_gain = np.square(self.gain(kx, ky))
        squared_gain[:, 0, 0] = 0.0
        noise = squared_gain / (self.footprint(kx, ky) ** 2 * self.information)
        return (squared_gain * self.spectrum(kx, ky)).mean(axis=(1, 2)), noise.mean(axis=(1, 2))

    def to_dict(self) -> dict[str, Any]:
        """Return the prior as a dictionary of numbers and lists, to be stored with the results."""
        return {name: _nested(value, list) for name, value in asdict(self).items()}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Prior:
        """Make a prior from the data that `to_dict` returned."""
        return cls(**{one.name: _nested(data[one.name], tuple) for one in fields(cls)})


def _nested(value: Any, kind: type[list[Any]] | type[tuple[Any, ...]]) -> Any:
    """Return nested lists or tuples with every level converted to `kind`; other values unchanged."""
    return kind(_nested(one, kind) for one in value) if isinstance(value, list | tuple) else value


def wavenumbers(shape: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the wavenumbers kx (nx,) and ky (ny, 1), rad per block, of the cosines on a lattice (ny, nx)."""
    ky, kx = (np.pi * np.arange(n) / n for n in shape)
    return kx, ky[:, None]


class WavenumberRings:
    """Rings (bins of |k|) of the modes kx (mx,), ky (my, 1), each divided into six sectors of direction.
    `middle` (rings,) is the middle wavenumber of a ring, rad per block; `count` (rings,) and `sector_count`
    (sectors, rings) are numbers of modes; `of_modes` (my, mx) is the ring number of each mode."""

    def __init__(self, kx: Float, ky: Float) -> None:
        edges = np.linspace(0, np.pi, RINGS + 1)
        self.middle = 0.5 * (edges[1:] + edges[:-1])
        self.k = tuple(map(float, self.middle))
        self.of_modes = np.clip(np.digitize(np.hypot(kx, ky), edges) - 1, 0, RINGS - 1)
        direction = np.arctan2(ky, kx).ravel() * (SECTORS / (0.5 * np.pi))
        self._sector = np.minimum(direction.astype(int), SECTORS - 1) * RINGS + self.of_modes.ravel()
        self.count = np.bincount(self.of_modes.ravel(), minlength=RINGS)
        self.sector_count = np.bincount(self._sector, minlength=SECTORS * RINGS).reshape(SECTORS, RINGS)

    def mean(self, field: NDArray[Any]) -> NDArray[np.float64]:
        """Return the mean of an array (my, mx) over the modes of each ring, (rings,); 0 in empty rings."""
        total = np.bincount(self.of_modes.ravel(), field.ravel(), minlength=RINGS)
        return np.asarray(total / np.maximum(self.count, 1))

    def rings(self, fields: Float) -> NDArray[np.float64]:
        """Return the mean of arrays (c, my, mx) over the modes of each ring, (c, rings); 0 in empty rings."""
        return np.array([self.mean(field) for field in fields])

    def sectors(self, fields: Float) -> NDArray[np.float64]:
        """Return the mean of arrays (c, my, mx) in each sector of each ring, (c, sectors, rings)."""
        size = self.sector_count.size
        total = np.array([np.bincount(self._sector, field.ravel(), minlength=size) for field in fields])
        return np.asarray(total.reshape(-1, SECTORS, RINGS) / np.maximum(self.sector_count, 1))

    def significant(self, ratio: Float) -> NDArray[np.bool_]:
        """Return a mask (rings,), True where the `ratio` (rings,) of power to noise shows waves.
        True are the first three rings, all rings before the first ratio of at most 0.3, and rings below 2 rad
        per block with a ratio over 1.5, both alone and averaged with their two neighbours."""
        occupied = self.count > 0
        below = np.flatnonzero(~(occupied & (ratio > DETECTED_SIGNAL_TO_NOISE)))
        last = max(int(below.min(initial=RINGS)), 3)
        total, count = (np.convolve(f, np.ones(3), mode="same") for f in (ratio * self.count, self.count))
        least = np.minimum(ratio, total / np.maximum(count, 1))
        beyond_gap = occupied & (self.middle < SHORTEST_WAVENUMBER) & (least > MIN_RING_SIGNAL_TO_NOISE)
        return np.asarray((np.arange(RINGS) < last) | beyond_gap)

    def level(self, ratio: Float) -> NDArray[np.float64]:
        """Return the `ratio` (rings,) of power to noise, averaged over five neighbouring rings (bins of |k|).
        The first four rings are ignored, because they contain calibration errors."""
        count = np.where((np.arange(RINGS) < FIRST_NOISE_RING), 0, self.count)
        weight = np.convolve(count, np.ones(NOISE_RINGS), mode="same")
        total = np.convolve(ratio * count, np.ones(NOISE_RINGS), mode="same")
        known = np.flatnonzero(weight)
        if not known.size:
            return np.ones(RINGS)
        return np.asarray(np.interp(np.arange(RINGS), known, total[known] / weight[known]))


def footprint(kx: np.ndarray, ky: np.ndarray, variance: float = FOOTPRINT_VARIANCE) -> np.ndarray:
    """Return the gain of averaging over a Gaussian area of this variance, px^2, at kx, ky, rad per block."""
    return np.asarray(np.exp(-0.5 * variance * (np.square(kx) + np.square(ky)) / BLOCK**2))


def averaged(fields: np.ndarray, variance: float) -> np.ndarray:
    """Return fields (c, ny, nx) averaged around each block over an area of this variance per axis, px^2."""
    side = 0.5 * variance / BLOCK**2
    kernel = np.array([side, 1.0 - 2.0 * side, side])
    return np.stack(
        [cv2.sepFilter2D(one, -1, kernel, kernel, borderType=cv2.BORDER_REFLECT) for one in fields]
    )


def displacement_area(bead_width: float) -> float:
    """Return the variance, px^2, of the area over which a block's displacement averages the motion.
    It is the sum of 25/12 for the block, w^2 / 3 for beads of width w = `bead_width`, px (measured with drawn
    beads of 1.5 to 4.2 px), and RESTORED_VARIANCE, which offsets the damping of short waves by the prior.

    >>> [round(displacement_area(width), 2) for width in (1.5, 3.0)]
    [4.03, 6.28]
    """
    return BLOCK**2 / 12.0 + bead_width**2 / 3.0 + RESTORED_VARIANCE


def first_prior(fields: Sequence[Float], information: float, area: float = FOOTPRINT_VARIANCE) -> Prior:
    """Return the isotropic prior with the mean spectrum of matched fields (c, ny, nx) from sample frames.
    The fields must have no holes and no slopes at the edges (`edge_field`). `information` is the typical
    inverse variance of a block's value; `area`, px^2, is the variance of the area that the value averages."""
    binning = WavenumberRings(*wavenumbers(fields[0].shape[-2:]))
    waves = [scipy.fft.dctn(f.astype(np.float64), axes=(-2, -1), norm="ortho", workers=1) for f in fields]
    power = np.mean([np.square(one).mean(axis=0) for one in waves], axis=0)
    return Prior.isotropic(binning.k, binning.mean(power).tolist(), information, area)


def refined_prior(
    prior: Prior,
    lattice: tuple[int, int],
    waves: Sequence[Float],
    information: float,
    noise_alone: Sequence[tuple[Float, float]] = (),
) -> Prior:
    """Return a prior with the spectrum of the MAP fields that the old `prior` gave in sample frames.

    `waves` are the cosine coefficients D (c, my, mx) of these fields on a `lattice` of (ny, nx) blocks,
    `information` A the typical inverse variance of a block, F its footprint. With a spectrum S and noise N =
    1 / (F^2 A), a MAP field has the gain G = S / (S + N) and the power G^2 (S + N), so S = sum(|D|^2 - G^2 N)
    / sum G^2 over the modes of a ring (a bin of |k|) or of one of its sectors of direction. In rings that do
    not stand out from the noise, S is the upper limit of undetected waves. Beyond the last ring that stands
    out, S is a power law. Directions are averaged over neighbouring rings and drawn towards uniform where
    modes are few. `noise_alone` are pairs (coefficients, information) of MAP fields that contain only noise.
    They give the noise as a function of wavenumber; its magnitude comes from the rings with the lowest power.
    """
    if not information > 0:  # no block has information
        return prior
    my, mx = waves[0].shape[-2:]
    kx, ky = wavenumbers(lattice)
    kx, ky = kx[:mx], ky[:my]
    spectrum, binning = prior.spectrum(kx, ky), WavenumberRings(kx, ky)
    foot = prior.footprint(kx, ky).astype(np.float32)
    measured, of_sectors, noise = _signals_and_noise(waves, spectrum, foot, information, binning, noise_alone)
    detected = np.array([binning.significant(one) for one in measured / noise])
    lasts = [max(int(np.flatnonzero(flags).max(initial=-1)) + 1, 3) for flags in detected]
    occupied = binning.count > 0
    relative_std = np.sqrt(2.0 / np.maximum(binning.count * len(waves), 1))
    limit = np.maximum(measured, 0.0) + LIMIT_STANDARD_DEVIATIONS * relative_std * noise
    highest = np.where(occupied, np.minimum(limit, DETECTED_SIGNAL_TO_NOISE * noise), np.inf)
    least = float((1.0 / (np.square(foot, dtype=np.float64) * information)).min())
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
    """Return three powers: of waves in rings (c, rings), in sectors (c, sectors, rings), of noise in rings.
    All are divided by the squared gain of the MAP field. `foot` is the footprint F of every mode, `spectrum`
    that of the old prior; `refined_prior` describes the other arguments."""

    def block_noise(of: float) -> Float:
        """Return the noise variance N = 1 / (F^2 A) of every mode, for the information A = `of`."""
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
    """Return the power of MAP fields (c, my, mx), and the power of their noise, over the mean squared gain.
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
    """Return the power of rings where no waves were detected, over its upper limit `rings`: 0 to 1.
    It is the slope of a line through (upper limit, `measured` power) / noise; arrays are (c, rings)."""
    limit, found = rings / noise, measured / noise
    weight = binning.count * (~detected & (binning.middle < SHORTEST_IN_LIMITS))
    total = max(float(weight.sum()), 1e-30)
    mean, level = float((weight * limit).sum()) / total, float((weight * found).sum()) / total
    square = max(float((weight * np.square(limit - mean)).sum()), 1e-6)
    slope = float((weight * (limit - mean) * found).sum()) / square
    return float(np.clip(slope / max(1.0 + level - slope * mean, 0.1), 0.0, 1.0))


def _shapes(estimate: Float, weight: NDArray[Any], lasts: Sequence[int]) -> NDArray[np.float64]:
    """Return the power of each sector over the power of its ring, (c, sectors, rings).
    The measured `estimate` of this ratio is averaged over neighbouring rings with `weight`, and drawn towards
    1 where modes are few. In component n, the ratio is constant from ring number lasts[n] - 1 on."""
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
    """Return the fraction of a learned spectrum that is waves, 0 to 1; the remainder is long-wave noise.

    `variance` is that of the MAP fields. The prior predicts the variance `noise` from noise and `waves` from
    waves. The fraction is 1 if variance - noise is at least half of `waves` or three times `noise`; below the
    smaller of these limits it is proportional to variance - noise.

    >>> shrinkage(4.0, 1.0, 3.0), round(shrinkage(1.0, 1.0, 3.0), 3)
    (1.0, 0.0)
    """
    signal = variance - noise
    needed = min(FULL_WAVE_FRACTION * waves, FULL_SIGNAL_TO_NOISE * noise)
    return float(np.clip(signal / max(needed, 1e-30), 0.0, 1.0))


def _plateau(ratio: NDArray[np.float64], count: NDArray[np.integer[Any]]) -> float:
    """Return the smallest average, over five neighbouring rings, of a ratio (rings,) of power to noise.
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
    upper_limit: Float,
) -> NDArray[np.float64]:
    """Return a spectrum (rings,), with a power law from ring number `last` on, fitted to the rings before it.
    The law stays below `upper_limit`. Rings before `last` are at least 0.01 `noise`. k (rings,) are
    wavenumbers."""
    out = np.maximum(power, MIN_POWER_TO_NOISE * noise)
    first = max(last - SLOPE_RINGS, 1)
    slope = SLOPE_RANGE[1]
    if last - first > 2:
        slope = float(np.polyfit(np.log(k[first:last]), np.log(out[first:last]), 1)[0])
    slope = float(np.clip(slope, *SLOPE_RANGE))
    out[last:] = out[last - 1] * (k[last:] / k[last - 1]) ** slope
    out[last:] = np.minimum.accumulate(np.minimum(out, upper_limit)[last:])
    return out
