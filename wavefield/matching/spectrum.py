"""Prior spectrum of a field on a lattice of blocks, rings of wavenumber, and the footprint of a block.

The prior is learned once per run from sample frames (learned_spectrum.py) and stored with the results, so
that all frames are weighted alike. Wavenumbers are in rad per block: a wave as long as two blocks has the
wavenumber pi.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

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

Power = tuple[tuple[tuple[float, ...], ...], ...]


@dataclass(frozen=True)
class Prior:
    """Spectrum of a field in both wavenumbers, and the information of its blocks.

    Parameters
    ----------
    k : tuple of float
        Wavenumbers at which the spectrum is tabulated, rad per block.
    power : tuple of tuple of tuple of float
        Mean square of the orthonormal cosine coefficients, in the field's unit squared, nested as
        [component][direction][wavenumber]. One component or direction stands for all. Directions divide a
        quarter turn evenly, from waves along the rows of the lattice to waves along its columns.
    information : float
        Typical information A of a block: the inverse variance of the value that the block alone gives, per
        unit squared.
    noise : float
        Factor on the noise variance that `noise_of_scores` estimates. It makes the misfit between several
        cameras agree with chi^2.
    wave_fraction : float
        Fraction of the spectrum that is waves. The rest is noise of long wavelength, as on still water; the
        uncertainty does not count it as waves that the measurement misses.
    detected : tuple of tuple of bool
        For every component and wavenumber, whether waves stand out from the noise; empty if they always do.
        Where they do not, the power is the upper limit of waves that may be there undetected.
    undetected_fraction : float
        Power in the sample fields at these wavenumbers, as a fraction of the upper limits.
    area : float
        Variance of the area that a block's value averages over, px^2.

    Notes
    -----
    Each component of an image displacement has a directional spectrum of its own, because a short wave moves
    the water along its direction and an oblique camera sees it shortened. Cosines do not distinguish the four
    quarters of direction, so a quarter turn suffices.
    """

    k: tuple[float, ...]
    power: Power
    information: float
    noise: float = 1.0
    wave_fraction: float = 1.0
    detected: tuple[tuple[bool, ...], ...] = ()
    undetected_fraction: float = 1.0
    area: float = FOOTPRINT_VARIANCE

    @classmethod
    def isotropic(
        cls, k: Sequence[float], power: Sequence[float], information: float, area: float = FOOTPRINT_VARIANCE
    ) -> Prior:
        """Return a prior with the same spectrum in all directions and for all components of a field.

        >>> prior = Prior.isotropic((0.1, 1.0), (4.0, 4.0), 1.0)
        >>> prior.spectrum(np.array([0.3, 0.4]), np.array([[0.5]])).tolist()
        [[[4.0, 4.0]]]
        """
        return cls(tuple(map(float, k)), ((tuple(map(float, power)),),), float(information), area=area)

    def footprint(self, kx: Float, ky: Float) -> NDArray[np.float64]:
        """Return the gain F of averaging over the area of a block, at wavenumbers kx, ky, rad per block."""
        return footprint(kx, ky, self.area)

    def with_min_signal_to_noise(self, ratio: float = OPEN_SIGNAL_TO_NOISE) -> Prior:
        """Return the prior, its spectrum raised to at least this signal-to-noise ratio below 2 rad per block.
        A spectrum that is learned with too small a prior comes out too small as well."""
        k = np.array(self.k)
        least = ratio / (self.footprint(k, np.zeros(1)) ** 2 * self.information)
        table = np.maximum(self.power, np.where(k < SHORTEST_WAVENUMBER, least, 0.0))
        power = tuple(tuple(tuple(map(float, ring)) for ring in directions) for directions in table)
        return replace(self, power=power)

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
        """Return the ratio F^2 A S, (component, ...): footprint F, information A, spectrum S at kx, ky."""
        return np.asarray(self.footprint(kx, ky) ** 2 * self.information * self.spectrum(kx, ky))

    def gain(self, kx: Float, ky: Float) -> NDArray[np.float64]:
        """Return the amplitude gain R / (R + 1) of the MAP field, (component, ...), R = `signal_to_noise`."""
        ratio = self.signal_to_noise(kx, ky)
        return np.asarray(ratio / (ratio + 1.0))

    def variances(self, shape: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return two variances (component,) of a MAP field on a lattice (ny, nx): from waves, and from noise.
        They are means of G^2 S and of G^2 / (F^2 A), with the gain G, over all modes but the constant one."""
        kx, ky = wavenumbers(shape)
        squared_gain = np.square(self.gain(kx, ky))
        squared_gain[:, 0, 0] = 0.0
        noise = squared_gain / (self.footprint(kx, ky) ** 2 * self.information)
        return (squared_gain * self.spectrum(kx, ky)).mean(axis=(1, 2)), noise.mean(axis=(1, 2))

    def to_dict(self) -> dict[str, Any]:
        """Return the prior as plain data (numbers, lists), to be stored with the results."""
        names = ("information", "noise", "wave_fraction", "undetected_fraction", "area")
        tables = {
            "k": list(self.k),
            "power": [[list(ring) for ring in directions] for directions in self.power],
            "detected": [list(rings) for rings in self.detected],
        }
        return tables | {name: getattr(self, name) for name in names}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Prior:
        """Make a prior from the data that `to_dict` returned."""
        power = tuple(tuple(tuple(map(float, ring)) for ring in directions) for directions in data["power"])
        detected = tuple(tuple(map(bool, rings)) for rings in data["detected"])
        names = ("noise", "wave_fraction", "undetected_fraction", "area")
        numbers = {name: float(data[name]) for name in names}
        information = float(data["information"])
        return cls(tuple(map(float, data["k"])), power, information, detected=detected, **numbers)


def wavenumbers(shape: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the wavenumbers kx (nx,) and ky (ny, 1), rad per block, of the cosines on a lattice (ny, nx)."""
    ky, kx = (np.pi * np.arange(n) / n for n in shape)
    return kx, ky[:, None]


class WavenumberRings:
    """Rings (bins of wavenumber) of modes kx (mx,), ky (my, 1), each divided into six sectors of direction.
    `middle` (rings,) are wavenumbers, rad per block; `count` (rings,) and `sector_count` (sectors, rings)
    numbers of modes; `of_modes` (my, mx) is the ring of each mode."""

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
        """Return the mean over each ring, (rings,), of an array (my, mx) over the modes; 0 in empty rings."""
        total = np.bincount(self.of_modes.ravel(), field.ravel(), minlength=RINGS)
        return np.asarray(total / np.maximum(self.count, 1))

    def rings(self, fields: Float) -> NDArray[np.float64]:
        """Return the mean over each ring, (c, rings), of arrays (c, my, mx) over the modes."""
        return np.array([self.mean(field) for field in fields])

    def sectors(self, fields: Float) -> NDArray[np.float64]:
        """Return the mean over each sector of each ring, (c, sectors, rings), of arrays (c, my, mx)."""
        size = self.sector_count.size
        total = np.array([np.bincount(self._sector, field.ravel(), minlength=size) for field in fields])
        return np.asarray(total.reshape(-1, SECTORS, RINGS) / np.maximum(self.sector_count, 1))

    def significant(self, ratio: Float) -> NDArray[np.bool_]:
        """Return a mask (rings,), True for rings whose `ratio` (rings,) of power to noise shows waves.
        These are the first three; those before the first with a ratio below 0.3; and any below 2 rad per
        block in which the ratio exceeds 1.5, both alone and averaged with its two neighbours."""
        occupied = self.count > 0
        last = self.count_until_false(occupied & (ratio > DETECTED_SIGNAL_TO_NOISE))
        total, count = (np.convolve(f, np.ones(3), mode="same") for f in (ratio * self.count, self.count))
        least = np.minimum(ratio, total / np.maximum(count, 1))
        beyond_gap = occupied & (self.middle < SHORTEST_WAVENUMBER) & (least > MIN_RING_SIGNAL_TO_NOISE)
        return np.asarray((np.arange(RINGS) < last) | beyond_gap)

    def level(self, ratio: Float) -> NDArray[np.float64]:
        """Return the ratio (rings,) of power to noise, averaged over five neighbouring rings.
        The first four rings do not count, because they contain calibration errors."""
        count = np.where((np.arange(RINGS) < FIRST_NOISE_RING), 0, self.count)
        weight = np.convolve(count, np.ones(NOISE_RINGS), mode="same")
        total = np.convolve(ratio * count, np.ones(NOISE_RINGS), mode="same")
        known = np.flatnonzero(weight)
        if not known.size:
            return np.ones(RINGS)
        return np.asarray(np.interp(np.arange(RINGS), known, total[known] / weight[known]))

    @staticmethod
    def count_until_false(flags: NDArray[np.bool_]) -> int:
        """Return the number of flags before the first False, but at least 3."""
        return max(int(np.argmin(flags)) if not flags.all() else len(flags), 3)


def footprint(kx: np.ndarray, ky: np.ndarray, variance: float = FOOTPRINT_VARIANCE) -> np.ndarray:
    """Return the gain of averaging over a Gaussian area of this variance, px^2, at kx, ky, rad per block."""
    out: np.ndarray = np.exp(-0.5 * variance * (np.square(kx) + np.square(ky)) / BLOCK**2)
    return out


def averaged(fields: np.ndarray, variance: float) -> np.ndarray:
    """Average fields (c, ny, nx) around each block over an area of this variance along each axis, px^2."""
    side = 0.5 * variance / BLOCK**2
    kernel = np.array([side, 1.0 - 2.0 * side, side])
    return np.stack(
        [cv2.sepFilter2D(one, -1, kernel, kernel, borderType=cv2.BORDER_REFLECT) for one in fields]
    )


def displacement_area(bead_width: float) -> float:
    """Return the variance, px^2, of the area over which a block's displacement averages the motion.
    The block adds 25/12, beads of width w, px, w^2 / 3 (measured with drawn beads of 1.5 to 4.2 px), and the
    last part, RESTORED_VARIANCE, offsets the damping of short waves by the prior.

    >>> [round(displacement_area(width), 2) for width in (1.5, 3.0)]
    [4.03, 6.28]
    """
    return BLOCK**2 / 12.0 + bead_width**2 / 3.0 + RESTORED_VARIANCE
