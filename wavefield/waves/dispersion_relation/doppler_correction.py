"""The elevation from w on a current: w is the rise of particles, which the current carries along.

A wave at omega passes the water at omega - k . U, and that is the frequency at which w has to be integrated:
cell by cell, since it differs between directions.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft

from wavefield.errors import CubeError
from wavefield.water import dispersion
from wavefield.waves.dispersion_relation.dispersion_fit import fit_dispersion
from wavefield.waves.estimation import rings
from wavefield.waves.estimation.transfer_functions import noise_of_displacement, path_factor
from wavefield.waves.estimation.welch import Welch
from wavefield.waves.spectra.field_spectra import density, plane_density

Array = NDArray[Any]
Water = tuple[float, float]  # depth, m; surface tension over density, m3 s-2
Distances = tuple[float, float, float]  # between frames, s; nodes along y and x, m

MARGIN = 16  # nodes by which fields are mirrored beyond the edge
MEMORY_S = 0.4  # of the integration of w
RESOLVED = 0.9  # of the Nyquist frequency: faster waves may be folded back
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


def blend(
    z: Array,
    w: Array,
    omega: Array,
    distances: Distances,
    current: Any,
    water: Water,
    noise: float,
    frames: int,
) -> Array:
    """Best elevation from the transforms of z and w in time, (omega, ny, nx), on a current, m/s.
    In every cell z and the integrated w are weighted inversely to the noise that they have there.
    """
    dt, dy, dx = distances
    margin = min(MARGIN, *(n - 1 for n in w.shape[1:]))
    padded = [n + 2 * margin for n in w.shape[1:]]
    fade = np.outer(*(_fade(n, margin) for n in padded))
    ky, kx = (2 * np.pi * np.fft.fftfreq(n, step) for n, step in zip(padded, (dy, dx)))
    sigma = dispersion(np.hypot(ky[:, None], kx), *water)
    # numpy's k points where waves come from
    doppler_shift = -(kx * current[0] + ky[:, None] * current[1])
    # waves that pass faster than frames resolve: of omega + 2 pi n / dt the one nearest to their free
    # frequency is taken
    folded = sigma + np.abs(doppler_shift) > RESOLVED * np.pi / dt
    inside = slice(margin, -margin)
    # what a current carries in from outside is not measured: the edges are left to stereo
    carried = (MEMORY_S * np.hypot(*current) / step for step in (dy, dx))
    measured = np.outer(*(_inside(n, nodes) for n, nodes in zip(w.shape[1:], carried)))
    out = z.copy()
    for i in range(1, omega.size):
        turns = np.where(folded, _turns(omega[i], doppler_shift, sigma, dt), 0)
        intrinsic = intrinsic_frequency(omega[i], doppler_shift - 2 * np.pi * turns / dt, sigma, dt)
        half = 2j * np.sin(intrinsic * dt / 2)
        weight = 1 / (1 + 1 / (noise * noise_of_displacement(intrinsic, dt, frames)))
        to_z = dt / (half * path_factor(intrinsic, dt, frames))
        # beyond the edges the fields are mirrored and fade
        planes = fft.fft2(np.pad([z[i], w[i]], ((0, 0), *[(margin, margin)] * 2), mode="reflect") * fade)
        sign = np.where(turns % 2 == 0, 1.0, -1.0)  # half a step of another turn has the other sign
        best = weight * planes[1] * to_z + (1 - weight) * sign * planes[0]
        out[i] += measured * fft.ifft2(best - planes[0])[inside, inside]
    return out


def _turns(omega: float, doppler_shift: Array, sigma: Array, dt: float) -> Array:
    """By how many sampling rates the waves measured at omega are faster."""
    turns = np.array([0, -1, 1])
    off = np.abs(np.abs(omega + 2 * np.pi * turns[:, None, None] / dt - doppler_shift) - sigma)
    return np.asarray(turns[off.argmin(axis=0)])


def _inside(n: int, edge: float) -> Array:
    """Weights (n,) that rise from the ends to one within `edge` nodes."""
    distance = np.minimum(np.arange(n), np.arange(n)[::-1]) + 0.5
    return np.asarray(np.sin(np.pi / 2 * np.minimum(1.0, distance / max(edge, 0.5))) ** 2)


def _fade(n: int, margin: int) -> Array:
    rise = np.sin(np.pi / 2 * (np.arange(margin) + 0.5) / margin) ** 2
    return np.concatenate([rise, np.ones(n - 2 * margin), rise[::-1]])
