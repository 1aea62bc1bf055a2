"""Which current a spectrum speaks for: every cell votes."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from wavefield.water import dispersion

Array = NDArray[Any]

LONGEST = 2.5  # cells of the k plane: longer waves lie within the window's reach of those that come back
_FASTEST, _SCAN_STEP, _SCAN_SECTORS = 0.8, 0.02, 48  # m/s


@dataclass(frozen=True)
class WavenumberPlane:
    """Cells of the k plane, flat."""

    kx: Array  # (cells,)
    ky: Array
    k: Array
    angle: Array
    cell: float  # larger side of a cell, rad/m
    spread: float  # variance along k that the window lends to a single wave, (rad/m)^2


def plane_of(density: xr.DataArray) -> WavenumberPlane:
    """The plane of E(ky, kx, omega)."""
    ky, kx = np.meshgrid(density["ky"].values, density["kx"].values, indexing="ij")
    cells = [float(density[name][1] - density[name][0]) for name in ("ky", "kx")]
    # second moment of a Hann line |W|^2 (weights 1, 4, 1 over 6) is a third of a cell squared; across the ray
    # it lengthens |k| on average by spread / 2k
    spread = float(np.mean(np.square(cells))) / 3
    return WavenumberPlane(
        kx.ravel(), ky.ravel(), np.hypot(kx, ky).ravel(), np.arctan2(ky, kx).ravel(), max(cells), spread
    )


def scan_current(
    energy: Array, omega: Array, noise: Array, plane: WavenumberPlane, depth: float, gamma: float
) -> Array:
    """Current that gathers most energy on the ridge, to start the fit from.

    Each cell asks for a current (omega - sigma(k)) / k along its direction, or, if its waves run against one
    that carries them back, for (omega + sigma(k)) / k. All votes are counted, each line's energy as its
    part above the noise and short waves, which know it better, more; those of a current U lie on
    U cos(theta - phi).

    With energy (lines, cells); omega (lines,), rad/s; noise (lines, cells); returns (2,): Along x and y, m/s,
    to .02 m/s.
    """
    kept = (plane.k > LONGEST * plane.cell) & (plane.k < 0.9 * plane.k[plane.ky == 0].max())
    k, angle = plane.k[kept], plane.angle[kept]
    sector = np.rint(angle / (2 * np.pi) * _SCAN_SECTORS).astype(int) % _SCAN_SECTORS
    slots = round(2 * _FASTEST / _SCAN_STEP) + 1
    votes = np.zeros(_SCAN_SECTORS * slots)
    sigma = dispersion(k, depth, gamma)
    for o, line, floor in zip(omega, energy, noise):
        weight = np.maximum(line[kept] - 3 * floor[kept], 0.0)
        total = weight.sum() + floor[kept].sum()
        for free in (sigma, -sigma):
            requested = np.rint(((o - free) / k + _FASTEST) / _SCAN_STEP).astype(int)
            inside = (requested >= 0) & (requested < slots) & (weight > 0)
            if total > 0:
                place = sector[inside] * slots + requested[inside]
                votes += np.bincount(place, weight[inside] * k[inside] / total, votes.size)
    votes = ndimage.gaussian_filter1d(votes.reshape(_SCAN_SECTORS, slots), 1.0, axis=1)
    speeds = np.arange(-(slots // 2), slots // 2 + 1) * _SCAN_STEP
    ux, uy = np.meshgrid(speeds, speeds, indexing="ij")
    theta = np.arange(_SCAN_SECTORS) * 2 * np.pi / _SCAN_SECTORS
    score = np.zeros(ux.shape)
    for t, row in zip(theta, votes):
        along = (ux * np.cos(t) + uy * np.sin(t) + _FASTEST) / _SCAN_STEP
        score += np.interp(along, np.arange(slots), row, left=0.0, right=0.0)
    speed = np.hypot(ux, uy)
    alike = score >= 0.98 * score[speed <= _FASTEST].max()
    best = np.argmin(np.where(alike, speed, np.inf))
    return np.array([ux.flat[best], uy.flat[best]])
