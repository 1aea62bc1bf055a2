"""A spectrum E(omega, ky, kx) as lines of cells of the k plane, with the level of its noise."""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

Array = NDArray[Any]

MIN_CELLS_FROM_ZERO = 2.5  # cells of the k plane: nearer to zero the window mixes waves k and -k
NOISE_ONLY = 0.8  # of the largest k along the axes: waves this short are weak on most lines
# of the mean energy of a cell: without it, what Hann windows leak off the relation of noise-free waves counts
# as waves. Tuned on seas that end at 2.5 to 6 Hz, not sensitive between 3e-4 and 1e-2
LEAST_NOISE = 1e-3
RING_CELLS = 1.5  # width of a ring of wavenumbers


@dataclass(frozen=True)
class WavenumberPlane:
    """Cells of the k plane, flat."""

    kx: Array  # (cells,), rad/m
    ky: Array
    k: Array
    angle: Array
    cell: float  # larger side of a cell, rad/m
    spread: float  # variance along k that the window lends to a single wave, (rad/m)^2
    nyquist: float  # along the axis with the wider nodes, rad/m

    @classmethod
    def of(cls, density: xr.DataArray) -> "WavenumberPlane":
        """The plane of E(omega, ky, kx)."""
        axes = [density[name].values for name in ("ky", "kx")]
        ky, kx = np.meshgrid(*axes, indexing="ij")
        cells = [float(axis[1] - axis[0]) for axis in axes]
        # second moment of a Hann line |W|^2 (weights 1, 4, 1 over 6) is a third of a cell squared; across the
        # wave vector it lengthens |k| on average by spread / 2k
        spread = float(np.mean(np.square(cells))) / 3
        k, angle = np.hypot(kx, ky).ravel(), np.arctan2(ky, kx).ravel()
        nyquist = min(abs(float(axis.min())) for axis in axes)
        return cls(kx.ravel(), ky.ravel(), k, angle, max(cells), spread, nyquist)


@dataclass(frozen=True)
class PlaneSpectrum:
    """Energy and noise of lines of frequency over the cells of the k plane."""

    omega: Array  # (lines,), rad/s
    energy: Array  # (lines, cells)
    noise: Array  # (lines, cells)
    plane: WavenumberPlane
    depth: float  # of the water, m

    @classmethod
    def of(cls, density: xr.DataArray, depth: float) -> "PlaneSpectrum":
        """The spectrum E(omega, ky, kx) with the level of its noise."""
        omega, plane = density["omega"].values, WavenumberPlane.of(density)
        energy = density.values.reshape(omega.size, -1)
        least = np.float32(LEAST_NOISE * energy.mean(dtype=float))
        return cls(omega, energy, np.maximum(noise_level(energy, plane), least), plane, depth)

    def on_lines(self, chosen: Array) -> "PlaneSpectrum":
        """Some lines of the spectrum."""
        return replace(self, omega=self.omega[chosen], energy=self.energy[chosen], noise=self.noise[chosen])


def noise_level(energy: Array, plane: WavenumberPlane) -> Array:
    """Level of the noise, (lines, cells): a function of the frequency times one of the wavenumber.
    Errors are independent from step to step and smooth over a matching window: their spectrum is a product.
    """
    outer = plane.k > NOISE_ONLY * plane.nyquist
    if not outer.any():
        return np.zeros(energy.shape, np.float32)
    along_omega = np.median(energy[:, outer], axis=1)
    ring = np.floor(plane.k / (RING_CELLS * plane.cell)).astype(int)
    ring = np.minimum(ring, ring[outer].min())  # the shortest waves are one ring
    # the mean of a ring in units of that, over all lines, of which free waves are on few
    units = np.where(along_omega > 0, along_omega, np.inf)[:, None]
    order = np.argsort(ring, kind="stable")
    edges = np.searchsorted(ring[order], np.arange(ring.max() + 2))
    levels = np.array(
        [_mean_of_noise(energy[:, order[a:b]] / units) if b > a else 0.0 for a, b in pairwise(edges)]
    )
    return np.asarray(along_omega[:, None] * levels[ring], np.float32)


def _mean_of_noise(values: Array) -> float:
    """Mean of values distributed as chi-squared but for some larger ones: median + variance / (3 mean).
    The variance is from the lower quartile, which waves do not change.
    """
    low, middle = np.quantile(values, [0.25, 0.5])
    std = (middle - low) / 0.6745
    return float(middle + std**2 / (3 * middle)) if middle > 0 else 0.0
