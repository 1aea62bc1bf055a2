"""Rings of wavenumber of a lattice of blocks, and their sectors of direction."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.floating[Any]]

RINGS = 40  # of wavenumber, from 0 to pi per block
SECTORS = 6  # of direction, from along columns to along rows
DETECTED_SIGNAL_TO_NOISE = 0.3  # least that the MAP field separates from noise
SHORTEST_WAVENUMBER = 2.0  # rad per block: shorter waves are not searched for in gaps of a spectrum
MIN_STANDARD_DEVIATIONS = 4.0  # by which the power of a ring has to exceed noise to be waves
MIN_RING_SIGNAL_TO_NOISE = 1.5  # of a ring beyond one without waves: the noise of rings is uncertain
FIRST_NOISE_RING = 4  # longer waves across the sight lines are errors of the calibration, not noise
NOISE_RINGS = 5  # over which the level of noise is averaged

SECTOR_ANGLES = (np.arange(SECTORS) + 0.5) * np.pi / (2 * SECTORS)  # middle of every sector, rad


class WavenumberRings:
    """Rings of wavenumber, and their sectors."""

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
        """Mean of a field over rings, (rings,)."""
        total = np.bincount(self.of_modes.ravel(), field.ravel(), minlength=RINGS)
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
