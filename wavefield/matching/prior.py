"""Prior knowledge of a field on a lattice of blocks: its spectrum.

Measured once per run from sample frames (`spectrum`) and stored with the results, so that every frame
is weighted alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.matching.matching_gain import FOOTPRINT_VARIANCE, footprint
from wavefield.matching.wavenumber_rings import SECTOR_ANGLES, SHORTEST_WAVENUMBER

Float = NDArray[np.floating[Any]]

OPEN_SIGNAL_TO_NOISE = 1.0  # least of every wave while a spectrum is learned
FIRST_SIGNAL_TO_NOISE = 6.0  # the same in the first round, whose noise is several times too small

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
    wave_fraction : float
        Fraction of the spectrum that is waves. Noise of long wavelength among them, as on still water, is not
        missing from a field.
    detected : tuple of tuple of bool
        Rings of every component in which waves stand out from the noise; all if empty. In the others the
        power is the upper limit of what may be there undetected: a field is not damped below it.
    undetected_fraction : float
        Fraction of these limits that the sample fields contain.
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
    wave_fraction: float = 1.0
    detected: tuple[tuple[bool, ...], ...] = ()
    undetected_fraction: float = 1.0
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
        """Fraction of `spectrum` that is expected to be waves, (1 or c,) + S."""
        detected = np.array(self.detected or [[True] * len(self.k)])
        fraction = self.wave_fraction * np.where(detected, 1.0, self.undetected_fraction)
        return np.array([np.interp(np.hypot(kx, ky), self.k, one) for one in fraction])

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
        names = ("information", "noise", "wave_fraction", "undetected_fraction", "area")
        tables = {
            "k": list(self.k),
            "power": [[list(ring) for ring in directions] for directions in self.power],
            "detected": [list(rings) for rings in self.detected],
        }
        return tables | {name: getattr(self, name) for name in names}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Prior:
        """Inverse of `to_dict`."""
        power = tuple(tuple(tuple(map(float, ring)) for ring in directions) for directions in data["power"])
        detected = tuple(tuple(map(bool, rings)) for rings in data["detected"])
        names = ("noise", "wave_fraction", "undetected_fraction", "area")
        numbers = {name: float(data[name]) for name in names}
        information = float(data["information"])
        return cls(tuple(map(float, data["k"])), power, information, detected=detected, **numbers)


def _in_all_directions(k: Float) -> tuple[Float, Float]:
    """Wavenumbers (directions,) + S of waves in all directions."""
    direction = SECTOR_ANGLES.reshape(-1, *(1,) * np.ndim(k))
    return k * np.cos(direction), k * np.sin(direction)


def wavenumbers(shape: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Wavenumbers of a lattice's cosines along columns (nx,) and along rows (ny, 1), rad per block."""
    ky, kx = (np.pi * np.arange(n) / n for n in shape)
    return kx, ky[:, None]
