"""The elevation from w on a current: w is the rise of particles, which the current carries along.

A wave at omega passes the water at omega - k . U, and that is the frequency at which w has to be integrated:
cell by cell, since it differs between directions.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.errors import CubeError
from wavefield.water import dispersion
from wavefield.waves.dispersion_relation.dispersion_fit import fit_dispersion
from wavefield.waves.estimation import rings
from wavefield.waves.estimation.transfer_functions import noise_of_displacement, path_factor
from wavefield.waves.estimation.welch import Welch
from wavefield.waves.spectra.field_spectra import density, plane_density

Array = NDArray[Any]
Water = tuple[float, float]  # depth, m; surface tension over density, m3 s-2

SLOWEST, FASTEST = 0.5, 1.5  # of the free frequency: the limits of free waves
_TABLE_K = np.geomspace(1e-3, 4e3, 6000)  # rad/m


def intrinsic_frequency(omega: Array, doppler_shift: Array, sigma: Array, dt: float) -> Array:
    """Frequency omega - k . U in the frame of the water, kept off zero and within reach of free waves.

    With all frequencies in rad/s; doppler_shift k . U.

    Examples
    --------
    >>> intrinsic_frequency(10.0, np.array([0.0, 2.0, 10.0, -20.0]), np.full(4, 8.0), 0.05)
    array([10.,  8.,  4., 12.])
    """
    intrinsic = np.asarray(omega - doppler_shift)
    least = np.minimum(omega, SLOWEST * sigma)
    most = np.maximum(omega, np.minimum(FASTEST * sigma, np.pi / dt))
    return np.asarray(np.where(intrinsic < 0, -1.0, 1.0) * np.clip(np.abs(intrinsic), least, most))


@dataclass(frozen=True)
class SpectraOnCurrent:
    """Spectra over the plane of wave vectors, and the current they were measured on."""

    current: tuple[float, float]  # along x and y, m/s
    w: xr.DataArray  # (omega, ky, kx): spectrum of w
    # (omega, ky, kx): Re(i exp(i omega dt / 2) S), S the cross spectrum of z at frame times with w
    zw: xr.DataArray

    @classmethod
    def of(
        cls, sums: dict[str, Array], welch: Welch, water: Water, current: tuple[float, float] | None
    ) -> "SpectraOnCurrent | None":
        """From the sums of cross spectra; the current is fitted if not given. None on still water."""
        w, zw = (
            plane_density(
                xr.Variable(("omega", "ky", "kx"), density(sums[f"map {name}"], welch)), "", "1", welch
            )["E"]
            for name in ("w", "z*w")
        )
        if current is None:
            try:
                fit = fit_dispersion(w, water[0], gamma=water[1])
            except CubeError:
                return None
            current = float(fit["current_x"]), float(fit["current_y"])
        return cls(current, w, zw) if any(current) else None

    def elevations(self, water: Water, dt: float, frames: int) -> tuple[Array, Array, Array]:
        """Integrals over angle, each (omega, k): the spectrum of the elevation from w, its cross spectrum
        with z, and the mean factor by which the integration lowers noise.
        """
        ky, kx = np.meshgrid(self.w["ky"].values, self.w["kx"].values, indexing="ij")
        sigma = dispersion(np.hypot(kx, ky), *water)
        doppler_shift = kx * self.current[0] + ky * self.current[1]
        ny, nx = kx.shape
        cell_y, cell_x = (float(self.w[name][1] - self.w[name][0]) for name in ("ky", "kx"))
        table = rings.rings(ny, nx, 2 * np.pi / (ny * cell_y), 2 * np.pi / (nx * cell_x))
        shares = table.shares.T.tocsr()
        area = np.asarray(shares.sum(axis=1)).ravel()
        out = np.zeros((3, self.w.sizes["omega"], table.k.size))
        for i, omega in enumerate(self.w["omega"].values[1:], 1):
            intrinsic = intrinsic_frequency(omega, doppler_shift, sigma, dt)
            half = np.sin(intrinsic * dt / 2)
            to_z = dt / (2 * half * path_factor(intrinsic, dt, frames))
            shape = 1 / noise_of_displacement(intrinsic, dt, frames)
            planes = np.stack([self.w.values[i] * to_z**2, self.zw.values[i] * to_z, shape])
            flat = np.fft.ifftshift(planes, axes=(1, 2)).reshape(3, -1)
            out[:, i] = (shares @ flat.T).T
        energy, cross = out[:2] * (cell_y * cell_x / table.dk)
        with np.errstate(divide="ignore", invalid="ignore"):
            noise_factor = np.where(out[2] > 0, area / out[2], 0.0)
        return energy, cross, noise_factor


def longest_waves(omega: Array, water: Water, speed: float) -> Array:
    """Wavenumber of the waves that run with a current, the longest of their frequency."""
    return np.asarray(np.interp(omega, dispersion(_TABLE_K, *water) + _TABLE_K * speed, _TABLE_K))


def shortest_waves(omega: Array, water: Water, speed: float) -> Array:
    """Wavenumber of the waves against a current; beyond its limit that of the last ones that it lets pass."""
    with_current = dispersion(_TABLE_K, *water) - _TABLE_K * speed
    blocked = np.flatnonzero(np.diff(with_current) <= 0)
    stop = max(int(blocked[0]), 2) if blocked.size else _TABLE_K.size
    return np.asarray(np.interp(omega, with_current[:stop], _TABLE_K[:stop]))
