"""The elevation from w where water moves: w is the rise of particles, which a current carries along.

A wave seen at omega passes the water at omega - k . U, and that is the rate at which w has to be integrated:
cell by cell, since it differs between directions.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft

from wavefield.errors import CubeError
from wavefield.water import dispersion
from wavefield.waves.dispersion_relation.dispersion_fit import fit_dispersion
from wavefield.waves.estimation import rings
from wavefield.waves.estimation.transfer_functions import path_factor
from wavefield.waves.estimation.welch import Welch
from wavefield.waves.spectra.field_spectra import density, plane_density

Array = NDArray[Any]
Water = tuple[float, float]  # depth, m; surface tension over density, m3 s-2
Distances = tuple[float, float, float]  # between frames, s; nodes along y and x, m

_CROSS = "z*w"  # the plane of their cross spectrum
_MARGIN = 16  # nodes beyond the edge
_MEMORY = 0.4  # s, of the integration of w
_FOLLOWED = 0.9  # of a record's highest frequency: faster waves may show at another one
_SLOWEST, _FASTEST = 0.5, 1.5  # of a free wave's frequency: what lies further off is no wave


def intrinsic(omega: Any, drift: Array, sigma: Array, dt: float) -> Array:
    """Frequency at which water meets waves, kept off zero and within reach of free waves.

    With omega, rad/s; drift, rad/s; sigma, rad/s; returns omega - k . U, rad/s.

    Examples
    --------
    >>> intrinsic(10.0, np.array([0.0, 2.0, 10.0, -20.0]), np.full(4, 8.0), 0.05)
    array([10.,  8.,  4., 12.])
    """
    still = np.asarray(omega - drift)
    least = np.minimum(omega, _SLOWEST * sigma)
    most = np.maximum(omega, np.minimum(_FASTEST * sigma, np.pi / dt))
    return np.asarray(np.where(still < 0, -1.0, 1.0) * np.clip(np.abs(still), least, most))


@dataclass(frozen=True)
class Moving:
    """Spectra over the plane of wave vectors, and the current they were measured on."""

    current: tuple[float, float]  # Velocity of the water along x and y, m/s
    w: xr.DataArray  # (omega, ky, kx): Spectrum of w
    # (omega, ky, kx): Re(i exp(i omega dt / 2) S), S the cross spectrum of z at frame times with w
    zw: xr.DataArray

    @cached_property
    def _plane(self) -> tuple[Array, Array]:
        ky, kx = np.meshgrid(self.w["ky"].values, self.w["kx"].values, indexing="ij")
        return kx, ky

    def elevations(self, water: Water, dt: float, frames: int) -> tuple[Array, Array, Array]:
        """Spectra of the elevation from w, and what they make of noise.

        Returns w, cross, shape (omega, k): Integrals over angle of the spectra.
        """
        kx, ky = self._plane
        sigma = dispersion(np.hypot(kx, ky), *water)
        drift = kx * self.current[0] + ky * self.current[1]
        ny, nx = kx.shape
        cell_y, cell_x = (float(self.w[name][1] - self.w[name][0]) for name in ("ky", "kx"))
        table = rings.rings(ny, nx, 2 * np.pi / (ny * cell_y), 2 * np.pi / (nx * cell_x))
        shares = table.shares.T.tocsr()
        area = np.asarray(shares.sum(axis=1)).ravel()
        out = np.zeros((3, self.w.sizes["omega"], table.k.size))
        for i, omega in enumerate(self.w["omega"].values):
            if i == 0:
                continue
            still = intrinsic(omega, drift, sigma, dt)
            half = np.sin(still * dt / 2)
            lift = dt / (2 * half * path_factor(still, dt, frames))
            planes = np.stack([self.w.values[i] * lift**2, self.zw.values[i] * lift, 1 / (4 * half**2)])
            flat = np.fft.ifftshift(planes, axes=(1, 2)).reshape(3, -1)
            out[:, i] = (shares @ flat.T).T
        energy, cross = out[:2] * (cell_y * cell_x / table.dk)
        with np.errstate(divide="ignore", invalid="ignore"):
            shape = np.where(out[2] > 0, area / out[2], 0.0)
        return energy, cross, shape


def longest(omega: Array, water: Water, speed: float) -> Array:
    """Wavenumber of the waves that run with a current, the longest of their frequency.

    With speed, m/s.
    """
    k = np.geomspace(1e-3, 4e3, 6000)
    return np.asarray(np.interp(omega, dispersion(k, *water) + k * speed, k))


def shortest(omega: Array, water: Water, speed: float) -> Array:
    """As `longest`, of waves against the current; where it holds them up, of the last that do not stop."""
    k = np.geomspace(1e-3, 4e3, 6000)
    seen = dispersion(k, *water) - k * speed
    held_up = np.flatnonzero(np.diff(seen) <= 0)
    stop = max(int(held_up[0]), 2) if held_up.size else k.size
    return np.asarray(np.interp(omega, seen[:stop], k[:stop]))


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
    """Best elevation from the transforms of z and w in time, on a current.

    In every cell (k, omega) the two are weighted inversely to the noise that they have there: the integrated
    w has that of the displacement over 4 sin^2((omega - k . U) dt / 2). Waves that pass faster than frames
    follow show folded back: of omega + 2 pi n / dt the one nearest to their free frequency is taken. Beyond
    the edges the fields are mirrored and fade; within what water goes in .4 s the result passes to z alone.

    With z (omega, ny, nx); w (omega, ny, nx); omega (omega,); current, m/s; returns (omega, ny, nx): Of the
    elevation at mid-time.
    """
    dt, dy, dx = distances
    margin = min(_MARGIN, *(n - 1 for n in w.shape[1:]))
    wide = [n + 2 * margin for n in w.shape[1:]]
    fade = np.outer(*(_fade(n, margin) for n in wide))
    ky, kx = (2 * np.pi * np.fft.fftfreq(n, step) for n, step in zip(wide, (dy, dx)))
    sigma = dispersion(np.hypot(ky[:, None], kx), *water)
    # numpy's k points where waves come from
    drift = -(kx * current[0] + ky[:, None] * current[1])
    folded = sigma + np.abs(drift) > _FOLLOWED * np.pi / dt
    inside = slice(margin, -margin)
    # what a current carries in from outside is not known: the edges are left to stereo
    carried = (_MEMORY * np.hypot(*current) / step for step in (dy, dx))
    known = np.outer(*(_known(n, nodes) for n, nodes in zip(w.shape[1:], carried)))
    out = z.copy()
    for i in range(1, omega.size):
        turns = np.where(folded, _turns(omega[i], drift, sigma, dt), 0)
        still = intrinsic(omega[i], drift - 2 * np.pi * turns / dt, sigma, dt)
        half = 2j * np.sin(still * dt / 2)
        weight = 1 / (1 + 1 / (noise * np.abs(half) ** 2))
        lift = dt / (half * path_factor(still, dt, frames))
        planes = fft.fft2(np.pad([z[i], w[i]], ((0, 0), *[(margin, margin)] * 2), mode="reflect") * fade)
        right = np.where(turns % 2 == 0, 1.0, -1.0)  # half a step of another turn has the other sign
        found = weight * planes[1] * lift + (1 - weight) * right * planes[0]
        out[i] += known * fft.ifft2(found - planes[0])[inside, inside]
    return out


def _turns(omega: float, drift: Array, sigma: Array, dt: float) -> Array:
    # by how many sampling rates waves seen at omega are quicker
    turns = np.array([0, -1, 1])
    off = np.abs(np.abs(omega + 2 * np.pi * turns[:, None, None] / dt - drift) - sigma)
    return np.asarray(turns[off.argmin(axis=0)])


def _known(n: int, edge: float) -> Array:
    distance = np.minimum(np.arange(n), np.arange(n)[::-1]) + 0.5
    return np.asarray(np.sin(np.pi / 2 * np.minimum(1.0, distance / max(edge, 0.5))) ** 2)


def _fade(n: int, margin: int) -> Array:
    rise = np.sin(np.pi / 2 * (np.arange(margin) + 0.5) / margin) ** 2
    return np.concatenate([rise, np.ones(n - 2 * margin), rise[::-1]])


def moving_of(
    sums: dict[str, Array],
    welch: Welch,
    water: Water,
    current: tuple[float, float] | None = None,
) -> Moving | None:
    """What `from_spectra` wants to know of a current."""
    planes = [
        plane_density(xr.Variable(("omega", "ky", "kx"), density(sums[f"map {name}"], welch)), "", "1", welch)
        for name in ("w", _CROSS)
    ]
    w, zw = (plane["E"] for plane in planes)
    if current is None:
        try:
            fit = fit_dispersion(w, water[0], gamma=water[1])
        except CubeError:
            return None
        current = float(fit["current_x"]), float(fit["current_y"])
    return Moving(current, w, zw) if any(current) else None
