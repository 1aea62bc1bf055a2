"""Points of the measured dispersion relation: centroids in k on each line, in sectors of direction.

`fit` is everywhere an array (3,): current along x and y, m/s, and surface tension over density, m3/s2.
"""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from wavefield.water import dispersion, group_velocity, wavenumber
from wavefield.waves.dispersion_relation.fit_settings import FitSettings
from wavefield.waves.dispersion_relation.plane_spectrum import PlaneSpectrum, WavenumberPlane
from wavefield.waves.estimation import wave_kernels
from wavefield.waves.estimation.windowed_dispersion import SpectralCells, windowed_waves

Array = NDArray[Any]

MIN_CELLS = 5  # in the window of a centroid
MIN_SHARE = 3e-3  # of the energy of the strongest sector on a line: weaker centroids are leakage
MIN_SPEED_ON_CURRENT = (
    0.5  # of the free group velocity: a current that slows waves more smears them over all k
)
MIN_SIGNAL_TO_NOISE = 1.0
CELL_VARIANCE = 0.3  # relative variance of a cell's energy, with its neighbours' share
NOISE_LEVEL_ERROR = 0.03  # relative: what remains of the noise moves a centroid to the middle of its window
CENTROID_ERROR = 0.03  # of a cell of the k plane, for the strongest sector; more in weaker ones, from leakage
LEAKAGE_ERROR = 0.3  # of the displacement of centroids by the windows: of each, and of all alike
MAX_DISPLACEMENT = 0.3  # cells of the k plane: points that the windows displace further are all leakage
SHORTEST_WAVES = 0.8  # of the grid's largest k: sectors are incomplete beyond


@dataclass(frozen=True)
class RelationPoints:
    """Centroids in k, one for a line and sector; all (points,)."""

    omega: Array  # rad/s
    k: Array  # rad/m
    angle: Array
    energy: Array  # above the noise
    key: Array  # number of the line and sector
    k_std: Array  # rad/m
    signal_to_noise: Array

    def __len__(self) -> int:
        return self.omega.size

    def __getitem__(self, chosen: Array) -> "RelationPoints":
        return RelationPoints(*(getattr(self, field.name)[chosen] for field in fields(self)))

    def along(self, fit: Array) -> Array:
        """Current along the wave vector, (points,), m/s."""
        return np.asarray(fit[0] * np.cos(self.angle) + fit[1] * np.sin(self.angle))


@dataclass(frozen=True)
class Sector:
    """Cells of the k plane around one direction, by increasing k."""

    theta: float
    cells: Array  # of the plane
    k: Array
    heading: Array  # (2, cells), cosine and sine of the angle


def sectors_of(plane: WavenumberPlane, count: int) -> list[Sector]:
    """The plane cut into sectors of equal width."""
    out = []
    half_width = np.pi / count
    by_k = np.argsort(plane.k, kind="stable")
    for theta in np.arange(count) * 2 * half_width:
        off = np.abs((plane.angle[by_k] - theta + np.pi) % (2 * np.pi) - np.pi)
        cells = by_k[off < half_width]
        heading = np.array([np.cos(plane.angle[cells]), np.sin(plane.angle[cells])])
        out.append(Sector(theta, cells, plane.k[cells], heading))
    return out


def centroids(
    spectrum: PlaneSpectrum, sectors: list[Sector], fit: Array, settings: FitSettings
) -> RelationPoints:
    """Centroids in k of the energy above the noise, in a window around the relation `fit`."""
    plane, omega, depth = spectrum.plane, spectrum.omega, spectrum.depth
    k_table = np.linspace(0.1, 1.2 * plane.k.max(), 4000)
    free = dispersion(k_table, depth, fit[2])
    speed = np.gradient(free, k_table)
    largest_k = np.full(omega.size, SHORTEST_WAVES * min(plane.kx.max(), plane.ky.max()))
    if settings.highest:
        highest = 2 * np.pi * settings.highest
        shortest = wavenumber(highest, depth, fit[2])
        largest_k[omega > highest] = np.minimum(largest_k[omega > highest], shortest)
    parts = []
    for number, sector in enumerate(sectors):
        along = fit[0] * np.cos(sector.theta) + fit[1] * np.sin(sector.theta)
        centres = _relation_in_k(omega, k_table, free, speed, along)
        reach = np.maximum(settings.half_width * centres, settings.least_width * plane.cell)
        known = np.isfinite(centres)
        middle, reach = np.where(known, centres, 0.0), np.where(known, reach, 0.0)
        first = np.searchsorted(sector.k, middle - reach, "right")
        last = np.searchsorted(sector.k, middle + reach, "left")
        sums = np.empty((8, omega.size))
        wave_kernels.windowed_sums(
            spectrum.energy, spectrum.noise, sector.cells, sector.k, sector.heading, first, last, sums
        )
        usable = (last - first >= MIN_CELLS) & (sums[0] > MIN_SIGNAL_TO_NOISE * sums[7]) & (sums[0] > 0)
        usable &= centres < largest_k
        weight, weight_k, cosine, sine, square, square_k, square_k2, noise = sums[:, usable]
        k = weight_k / weight
        second_moment = square_k2 - 2 * k * square_k + k**2 * square
        noise_error = NOISE_LEVEL_ERROR * noise * reach[usable]
        k_std = np.sqrt(CELL_VARIANCE * np.maximum(second_moment, 0) + noise_error**2) / weight
        k -= plane.spread / (2 * k)
        key = np.flatnonzero(usable) * len(sectors) + number
        signal_to_noise = weight / np.maximum(noise, 1e-9 * weight)
        angle = np.arctan2(sine, cosine)
        points = RelationPoints(omega[usable], k, angle, weight, key, k_std, signal_to_noise)
        # waves about as long as the rectangle: the window's spread exceeds them
        parts.append(points[(k > 0) & (np.abs(k - centres[usable]) < reach[usable])])
    names = [field.name for field in fields(RelationPoints)]
    points = RelationPoints(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))
    strongest = _strongest_sector(points)
    leakage = CENTROID_ERROR * plane.cell * np.sqrt(strongest / points.energy)
    points = replace(points, k_std=np.hypot(points.k_std, leakage))
    return points[points.energy > MIN_SHARE * strongest]


def _relation_in_k(omega: Array, k: Array, free: Array, speed: Array, along: float) -> Array:
    """Wavenumber of each line from the table k -> free + k * along; NaN for waves that the current blocks.
    Against a current omega rises with k only as long as the group velocity `speed` of free waves exceeds it.
    """
    doppler = free + k * along
    blocked = speed + along < MIN_SPEED_ON_CURRENT * speed
    last = int(blocked.argmax()) if blocked.any() else k.size
    if last < 2:
        return np.full(omega.size, np.nan)
    return np.interp(omega, doppler[:last], k[:last], right=np.nan)


def _strongest_sector(points: RelationPoints) -> Array:
    """Energy of the strongest sector on each point's line and its neighbours, (points,)."""
    if not len(points):
        return points.energy
    _, line = np.unique(points.omega, return_inverse=True)
    top = np.zeros(line.max() + 1)
    np.maximum.at(top, line, points.energy)
    return np.asarray(ndimage.maximum_filter1d(top, 3)[line])


@dataclass(frozen=True)
class WindowDisplacement:
    """How far the spectral windows move centroids."""

    key: Array  # as of the points
    k: Array  # rad/m

    @classmethod
    def measure(
        cls,
        spectrum: PlaneSpectrum,
        cells: SpectralCells,
        band: Array,
        sectors: list[Sector],
        fit: Array,
        settings: FitSettings,
    ) -> "WindowDisplacement":
        """Displacements of the centroids of free waves on the relation `fit`, as the windows show them.
        Points displaced far are left out: beyond the end of a sea all energy is leakage. band is (lines,).
        """
        free_waves = windowed_waves(spectrum.energy, spectrum.noise, cells, spectrum.depth, fit)[band]
        simulated = replace(
            spectrum, omega=spectrum.omega[band], energy=free_waves, noise=np.zeros_like(free_waves)
        )
        points = centroids(simulated, sectors, fit, settings)
        along = points.along(fit)
        off = points.omega - dispersion(points.k, spectrum.depth, fit[2]) - points.k * along
        displacement = -off / (group_velocity(points.k, spectrum.depth, fit[2]) + along)
        near = np.abs(displacement) < MAX_DISPLACEMENT * spectrum.plane.cell
        return cls(points.key[near], displacement[near])

    def removed_from(self, points: RelationPoints, part: float = 1.0) -> RelationPoints:
        """Points without that part of their displacement; without those that it does not hold."""
        _, measured, simulated = np.intersect1d(points.key, self.key, assume_unique=True, return_indices=True)
        points, displacement = points[measured], self.k[simulated]
        k_std = np.hypot(points.k_std, LEAKAGE_ERROR * displacement)
        points = replace(points, k=points.k - part * displacement, k_std=k_std)
        return points[points.k > 0]
