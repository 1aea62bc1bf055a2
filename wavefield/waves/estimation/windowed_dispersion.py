"""Spectrum that free waves on a fitted dispersion relation would show through the windows.

Centroids of measured energy are displaced from the relation: along it energy falls by decades, and across it
the windows spread each direction into others. Instead of a formula for each of these effects, waves are put
on the fitted relation, spread by the windows, and followed as the measured ones are: their displacement is
that of the windows.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from wavefield.water import dispersion, group_velocity
from wavefield.waves.estimation import wave_kernels
from wavefield.waves.estimation.windows import hann_power, richardson_lucy

Array = NDArray[Any]

REACH = 4  # cells and lines to either side over which a wave is spread
WAVES_PER_AXIS = 2  # in a cell of the k plane
ROUNDS = 8  # in which the energy of the waves is adjusted: four leave narrow seas too wide
EXPONENT = 1.8  # of a round's factor: with 1 narrow seas would need twice as many
FLOOR = 1e-9  # of the strongest cell: weaker ones are left out
MAX_FACTOR = 4.0  # of the energy in one round


@dataclass(frozen=True)
class SpectralCells:
    """The cells of a spectrum."""

    omega: Array  # (lines,), rad/s, evenly spaced like the next two
    ky: Array  # rad/m
    kx: Array

    @property
    def steps(self) -> tuple[float, float, float]:
        """Distance between cells along each axis."""
        omega, ky, kx = (float(axis[1] - axis[0]) for axis in (self.omega, self.ky, self.kx))
        return omega, ky, kx

    def frequency(self, ky: Array, kx: Array, depth: float, fit: Array) -> Array:
        """Frequency of free waves in the frame of the cameras, rad/s; ``fit`` is current x, y and gamma."""
        k = np.hypot(ky, kx)
        return np.asarray(dispersion(k, depth, fit[2]) + kx * fit[0] + ky * fit[1])


def _energy_on_relation(excess: Array, cells: SpectralCells, depth: float, fit: Array) -> Array:
    """Energy (ny, nx) of each cell of the k plane near its frequency."""
    ky, kx = np.meshgrid(cells.ky, cells.kx, indexing="ij")
    frequency = cells.frequency(ky, kx, depth, fit)
    k = np.maximum(np.hypot(ky, kx), max(cells.steps[1:]))
    slope = group_velocity(k, depth, fit[2]) + np.hypot(fit[0], fit[1])
    reach = 2 * max(cells.steps[1:]) * slope + 2 * cells.steps[0]
    out = np.zeros(frequency.shape)
    for omega, line in zip(cells.omega, excess):
        near = np.abs(omega - frequency) < reach
        out += np.where(near, np.maximum(line.reshape(frequency.shape), 0.0), 0.0)
    return out


def windowed_waves(energy: Array, noise: Array, cells: SpectralCells, depth: float, fit: Array) -> Array:
    """Spectrum of free waves on a fitted relation with the energy of a measured one, through Hann windows.
    Energy, noise and result are (lines, ny * nx), ``fit`` is current x, y (m/s) and gamma.
    """
    measured = _energy_on_relation(energy - noise, cells, depth, fit)
    steps = cells.steps
    # the energy of four waves a cell is adjusted in rounds of `richardson_lucy`, each to the power 1.8, until
    # each cell of the k plane shows what was measured there: a sea that is left too wide would hide how far
    # the windows reach from its strong directions into the weak ones
    offsets = (np.arange(WAVES_PER_AXIS) + 0.5) / WAVES_PER_AXIS - 0.5
    rows, columns = np.meshgrid(np.arange(cells.ky.size), np.arange(cells.kx.size), indexing="ij")
    places = np.array([(rows + a, columns + b) for a in offsets for b in offsets])
    row, column = places.reshape(WAVES_PER_AXIS**2, 2, -1).swapaxes(0, 1).reshape(2, -1)
    ky, kx = cells.ky[0] + row * steps[1], cells.kx[0] + column * steps[2]
    line = (cells.frequency(ky, kx, depth, fit) - cells.omega[0]) / steps[0]
    floor = FLOOR * max(float(measured.max()), 1e-300)
    used = (line > -REACH) & (line < cells.omega.size + REACH)
    used &= np.tile(measured.ravel() > floor, WAVES_PER_AXIS**2)
    place = np.array([line[used], row[used], column[used]])
    cell = np.tile(np.arange(measured.size), WAVES_PER_AXIS**2)[used]
    first = np.rint(place).astype(np.int64)
    offset = np.arange(-REACH, REACH + 1)
    weights = hann_power(first[..., None] + offset - place[..., None])  # (3, waves, cells or lines)

    def spread(power: Array) -> Array:
        out = np.zeros((cells.omega.size, *measured.shape))
        wave_kernels.spread_waves(first - REACH, weights, power, out)
        return out.reshape(cells.omega.size, -1)

    logs = np.log(np.maximum(measured, floor))
    power = richardson_lucy(
        measured,
        np.exp(ndimage.map_coordinates(logs, place[1:], order=1, mode="nearest")),
        lambda power: np.maximum(_energy_on_relation(spread(power), cells, depth, fit), floor * 1e-3),
        lambda power, ratio: power * np.clip(ratio, 1 / MAX_FACTOR, MAX_FACTOR).ravel()[cell] ** EXPONENT,
        ROUNDS,
    )
    return spread(power)
