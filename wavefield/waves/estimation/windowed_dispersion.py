"""What the windows make of a ridge: the spectrum that free waves on a fitted current would show.

Centroids of a smeared ridge lie beside it: along it energy falls by decades, across it the window reaches
from one direction into others. Instead of a formula for each of these, the waves of the sea are put on the
fitted relation, seen through the windows, and followed as the measured ones are: what then lies beside the
relation is the windows' doing.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from wavefield.water import dispersion, group_velocity
from wavefield.waves.estimation import wave_kernels

Array = NDArray[Any]

_REACH = 4  # cells and lines to either side that a wave is seen in
_PARTS = 2  # waves of a cell along each axis
_ROUNDS = 4  # in which the energy of the waves is adjusted to what is seen
_HASTE = 1.8  # power of the factor of a round: narrow seas want some ten rounds of 1
_LEAST = 1e-9  # of the strongest cell: weaker ones are left out
_MOST = 4.0  # factor by which a round changes the energy at most


def hann_power(distance: Array) -> Array:
    """Energy of a long Hann window's line at distances from it, in cells; 1 at none.

    Examples
    --------
    >>> [round(float(p), 3) for p in hann_power(np.array([0.0, 1.0, 2.0, 2.5]))]
    [1.0, 0.25, 0.0, 0.001]
    """
    off = np.where(np.abs(np.abs(distance) - 1) < 1e-9, 0.0, 1 - distance**2)
    with np.errstate(divide="ignore", invalid="ignore"):
        amplitude = np.where(off == 0, 0.5, np.sinc(distance) / off)
    return np.asarray(amplitude**2)


@dataclass(frozen=True)
class SpectralCells:
    """The cells of a spectrum."""

    omega: Array  # (lines,): rad/s and rad/m, evenly spaced
    ky: Array
    kx: Array

    @property
    def steps(self) -> tuple[float, float, float]:
        """Distance between them along each axis."""
        return tuple(float(axis[1] - axis[0]) for axis in (self.omega, self.ky, self.kx))  # type: ignore[return-value]

    def frequency(self, ky: Array, kx: Array, depth: float, fit: Array) -> Array:
        """Frequency at which free waves are seen, rad/s; ``fit`` is current x, y and surface tension."""
        k = np.hypot(ky, kx)
        return np.asarray(dispersion(k, depth, fit[2]) + kx * fit[0] + ky * fit[1])


def _on_ridge(energy: Array, noise: Array, cells: SpectralCells, depth: float, fit: Array) -> Array:
    # energy of each cell of the k plane on the ridge, (ny, nx)
    ky, kx = np.meshgrid(cells.ky, cells.kx, indexing="ij")
    seen = cells.frequency(ky, kx, depth, fit)
    k = np.maximum(np.hypot(ky, kx), max(cells.steps[1:]))
    slope = group_velocity(k, depth, fit[2]) + np.hypot(fit[0], fit[1])
    reach = 2 * max(cells.steps[1:]) * slope + 2 * cells.steps[0]
    out = np.zeros(seen.shape)
    for omega, line, floor in zip(cells.omega, energy, noise):
        near = np.abs(omega - seen) < reach
        out += np.where(near, np.maximum((line - floor).reshape(seen.shape), 0.0), 0.0)
    return out


def _parts(place: Array) -> tuple[Array, Array]:
    # where single waves at places in cells (3, waves) begin to be seen through the windows, and their parts
    # (3, waves, near) from there on
    near = np.arange(-_REACH, _REACH + 1)
    first = np.rint(place).astype(np.int64)
    return first - _REACH, hann_power(first[..., None] + near - place[..., None])


def _seen(parts: tuple[Array, Array], power: Array, shape: tuple[int, ...]) -> Array:
    # spectrum of single waves through the windows
    out = np.zeros(shape)
    wave_kernels.spread_waves(*parts, power, out)
    return out


def as_seen(energy: Array, noise: Array, cells: SpectralCells, depth: float, fit: Array) -> Array:
    """Spectrum of free waves on a fitted relation with the energy of a measured one, through Hann windows.

    Four waves a cell, whose energy is adjusted in four rounds (Richardson and Lucy, each to the power 1.8)
    so that each cell of the k plane shows on the ridge what was measured there. A sea that is left too wide
    hides how far the windows reach from its strong directions into the weak ones.

    With energy (lines, ny * nx); noise (lines, ny * nx); fit (3,), m/s; returns (lines, ny * nx).
    """
    requested = _on_ridge(energy, noise, cells, depth, fit)
    steps = cells.steps
    within = (np.arange(_PARTS) + 0.5) / _PARTS - 0.5
    rows, columns = np.meshgrid(np.arange(cells.ky.size), np.arange(cells.kx.size), indexing="ij")
    places = np.array([(rows + a, columns + b) for a in within for b in within]).reshape(_PARTS**2, 2, -1)
    row, column = np.moveaxis(places, 1, 0).reshape(2, -1)
    line = (
        cells.frequency(cells.ky[0] + row * steps[1], cells.kx[0] + column * steps[2], depth, fit)
        - cells.omega[0]
    ) / steps[0]
    floor = _LEAST * max(float(requested.max()), 1e-300)
    kept = (line > -_REACH) & (line < cells.omega.size + _REACH)
    kept &= np.tile(requested.ravel() > floor, _PARTS**2)
    place = np.array([line[kept], row[kept], column[kept]])
    cell = np.tile(np.arange(requested.size), _PARTS**2)[kept]
    logs = np.log(np.maximum(requested, floor))
    power = np.exp(ndimage.map_coordinates(logs, place[1:], order=1, mode="nearest"))
    shape, parts = (cells.omega.size, *requested.shape), _parts(place)
    out = _seen(parts, power, shape)
    for _ in range(_ROUNDS):
        found = _on_ridge(out.reshape(shape[0], -1), np.zeros((shape[0], 1)), cells, depth, fit)
        ratio = np.clip(requested / np.maximum(found, floor * 1e-3), 1 / _MOST, _MOST)
        power = power * ratio.ravel()[cell] ** _HASTE
        out = _seen(parts, power, shape)
    return out.reshape(shape[0], -1)
