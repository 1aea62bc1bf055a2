"""Measured points of the dispersion relation: centroids in k at each frequency, in sectors of direction.

A cell is a wave vector (ky, kx) of a spectrum, and a line a frequency. `current` is (2,), along x and y, m/s.
"""

from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from wavefield.water import dispersion, group_velocity
from wavefield.waves import kernels
from wavefield.waves.welch import REACH, hann_power, richardson_lucy

Array = NDArray[Any]
Water = tuple[float, float]  # depth, m; surface tension over density, m3 s-2
Sectors = list[tuple[float, Array]]  # direction of each sector and its cells of the k plane, sorted by k

MIN_CELLS_FROM_ZERO = 2.5  # smallest k, in cells of the k plane: below, the window mixes waves k and -k
SHORTEST_WAVES = 0.8  # largest k, relative to that of the grid: shorter waves are weak, sectors incomplete
# Least noise, relative to the mean energy of a cell: in noise-free seas, leakage would count as waves. Tuned
# on seas that end at 2.5 to 6 Hz; a tenth of it refuses some of them
LEAST_NOISE = 1e-4


@dataclass(frozen=True)
class PlaneSpectrum:
    """A spectrum E(omega, ky, kx) and its noise, over lines (frequencies) and cells (wave vectors)."""

    omega: Array  # (lines,), rad/s
    energy: Array  # (lines, cells)
    noise: Array  # (lines, cells)
    kx: Array  # (cells,), rad/m
    ky: Array
    k: Array  # wavenumber of the cells
    angle: Array  # of k, counted from the x axis, rad
    axes: tuple[Array, Array]  # ky and kx of the grid, rad/m
    sides: Array  # of a cell along ky and kx, rad/m
    cell: float  # larger side, rad/m
    water: Water

    @classmethod
    def of(cls, density: xr.DataArray, water: Water) -> "PlaneSpectrum":
        """Return a `PlaneSpectrum` from an array E(omega, ky, kx); the noise is estimated from the array."""
        omega, *axes = (density[name].values for name in ("omega", "ky", "kx"))
        ky, kx = (part.ravel() for part in np.meshgrid(*axes, indexing="ij"))
        k, angle, sides = np.hypot(kx, ky), np.arctan2(ky, kx), np.array([axis[1] - axis[0] for axis in axes])
        energy, cell = density.values.reshape(omega.size, -1), float(sides.max())
        outer = k > SHORTEST_WAVES * min(abs(float(axis.min())) for axis in axes)
        least = np.float32(LEAST_NOISE * energy.mean(dtype=float))
        noise = np.maximum(noise_level(energy, outer, k / cell), least)
        return cls(omega, energy, noise, kx, ky, k, angle, (axes[0], axes[1]), sides, cell, water)

    def on_lines(self, chosen: Array) -> "PlaneSpectrum":
        """Return the spectrum at the frequencies where the mask `chosen` (frequencies,) is true."""
        return replace(self, omega=self.omega[chosen], energy=self.energy[chosen], noise=self.noise[chosen])


def noise_level(energy: Array, outer: Array, distance: Array) -> Array:
    """Return the noise of a spectrum `energy` (frequencies, wave vectors), estimated as f(omega) times
    g(|k|). `outer` (wave vectors,) is true where |k| is too large for waves; `distance` is |k| in cells."""
    if not outer.any():
        return np.zeros(energy.shape, np.float32)
    along_omega = np.median(energy[:, outer], axis=1)
    ring = np.floor(distance / 1.5).astype(int)  # chosen: rings of one and a half cells
    ring = np.minimum(ring, ring[outer].min())  # the shortest waves are one ring
    # mean of each ring relative to that, robust against the few lines with free waves
    units = np.where(along_omega > 0, along_omega, np.inf)[:, None]
    order = np.argsort(ring, kind="stable")
    edges = np.searchsorted(ring[order], np.arange(ring.max() + 2))
    levels = np.array(
        [_mean_of_noise(energy[:, order[a:b]] / units) if b > a else 0.0 for a, b in pairwise(edges)]
    )
    return np.asarray(along_omega[:, None] * levels[ring], np.float32)


def _mean_of_noise(values: Array) -> float:
    """Return the mean of the noise in spectral `values` that also contain some waves; 0 if the median is 0.
    It is estimated from the median and lower quartile, since noise is distributed as chi-squared."""
    low, middle = np.quantile(values, [0.25, 0.5])
    std = (middle - low) / 0.6745
    return float(middle + std**2 / (3 * middle)) if middle > 0 else 0.0


MAX_SPEED, SPEED_STEP = 0.8, 0.02  # m/s, chosen: largest current in flumes; error that the fit corrects
# sectors of 15 degrees; with narrower ones, an isotropic sea appears anisotropic by 2 %
SECTORS = 24
VOTING_SECTORS = 2 * SECTORS  # finer, because single cells vote


def scan_current(spectrum: PlaneSpectrum) -> Array:
    """Return the current (2,), m/s, whose dispersion relation contains the most energy, to 0.02 m/s. In this
    Hough transform, each value E(omega, k) votes for a current of (omega -+ sigma(k)) / k along k."""
    used = spectrum.k > MIN_CELLS_FROM_ZERO * spectrum.cell
    used &= spectrum.k < 0.9 * spectrum.k[spectrum.ky == 0].max()
    k = spectrum.k[used]
    sector = np.rint(spectrum.angle[used] / (2 * np.pi) * VOTING_SECTORS).astype(int) % VOTING_SECTORS
    bins = round(2 * MAX_SPEED / SPEED_STEP) + 1
    histogram = np.zeros(VOTING_SECTORS * bins)
    # omega + sigma is for waves that the current carries backwards
    sigma = dispersion(k, *spectrum.water)
    # a vote is the energy above the noise, relative to its line, times k: short waves determine U better
    for line_omega, energy, noise in zip(spectrum.omega, spectrum.energy, spectrum.noise):
        weight = np.maximum(energy[used] - 3 * noise[used], 0.0)
        total = weight.sum() + noise[used].sum()
        if not total > 0:
            continue
        for free in (sigma, -sigma):
            speed_bin = np.rint(((line_omega - free) / k + MAX_SPEED) / SPEED_STEP).astype(int)
            inside = (speed_bin >= 0) & (speed_bin < bins) & (weight > 0)
            place = sector[inside] * bins + speed_bin[inside]
            histogram += np.bincount(place, weight[inside] * k[inside] / total, histogram.size)
    histogram = ndimage.gaussian_filter1d(histogram.reshape(VOTING_SECTORS, bins), 1.0, axis=1)
    speeds = np.arange(-(bins // 2), bins // 2 + 1) * SPEED_STEP
    ux, uy = np.meshgrid(speeds, speeds, indexing="ij")
    score = np.zeros(ux.shape)
    for theta, row in zip(np.arange(VOTING_SECTORS) * 2 * np.pi / VOTING_SECTORS, histogram):
        place = (ux * np.cos(theta) + uy * np.sin(theta) + MAX_SPEED) / SPEED_STEP
        score += np.interp(place, np.arange(bins), row, left=0.0, right=0.0)
    speed = np.hypot(ux, uy)
    nearly_best = score >= 0.98 * score[speed <= MAX_SPEED].max()
    slowest = np.argmin(np.where(nearly_best, speed, np.inf))
    return np.array([ux.flat[slowest], uy.flat[slowest]])


def _near_relation(spectrum: PlaneSpectrum, current: Array) -> Array:
    """Return a mask (frequencies, wave vectors): true near the dispersion relation of waves on `current`.
    Near means within two cell widths in k plus two frequency steps, converted to a distance in omega."""
    omega, k, cell = spectrum.omega, spectrum.k, spectrum.cell
    free = dispersion(k, *spectrum.water) + current[0] * spectrum.kx + current[1] * spectrum.ky
    slope = np.abs(group_velocity(np.maximum(k, cell), *spectrum.water))
    slope += np.hypot(current[0], current[1])
    reach = 2 * cell * slope + 2 * abs(omega[1] - omega[0])
    return np.asarray(np.abs(omega[:, None] - free) < reach)


def contrast(spectrum: PlaneSpectrum, lines: Array, current: Array) -> float:
    """Return the mean energy near the dispersion relation, over that of the same wave vectors at other
    frequencies. White noise gives about 1. `lines` is a mask of the frequencies used."""
    near = _near_relation(spectrum, current)[lines]
    near[:, spectrum.k < MIN_CELLS_FROM_ZERO * spectrum.cell] = False
    energy = spectrum.energy[lines]
    on, count = (energy * near).sum(axis=0, dtype=float), near.sum(axis=0)
    on_both = (count > 0) & (count < near.shape[0])
    off = (energy.sum(axis=0, dtype=float) - on)[on_both] / (near.shape[0] - count[on_both])
    expected = float((off * count[on_both]).sum())
    if expected > 0:
        return float(on[on_both].sum()) / expected
    return np.inf if on_both.any() else 1.0


def fraction(spectrum: PlaneSpectrum, current: Array) -> float:
    """Return the fraction of energy near the dispersion relation on `current`; NaN if there is no energy."""
    near = _near_relation(spectrum, current)
    total = float(spectrum.energy.sum(dtype=float))
    return float((spectrum.energy * near).sum(dtype=float)) / total if total > 0 else float("nan")


WAVES_PER_AXIS = 2  # simulated waves per cell and axis; a single one bends the relation by 4 %
ROUNDS = 8  # rounds that adjust the energy of these waves; after four, narrow seas are still too wide
FLOOR = 1e-9  # chosen: cells with less energy, relative to the strongest, have no waves


def windowed_waves(spectrum: PlaneSpectrum, current: Array) -> Array:
    """Return the spectrum (frequencies, wave vectors) of simulated free waves, broadened by Hann windows.
    Deconvolution fits the energies of four waves per wave vector to the measured energy above the noise."""
    near, ky, kx = _near_relation(spectrum, current), *spectrum.axes
    shape = spectrum.omega.size, ky.size, kx.size

    def on_relation(energy: Array) -> Array:
        return np.asarray(np.where(near, np.maximum(energy, 0.0), 0.0).sum(axis=0).reshape(shape[1:]))

    measured = on_relation(spectrum.energy - spectrum.noise)
    # deconvolved, since a sea that is too wide has too little leakage from strong into weak directions
    offsets = (np.arange(WAVES_PER_AXIS) + 0.5) / WAVES_PER_AXIS - 0.5
    rows, columns = np.indices(shape[1:])
    places = np.array([(rows + a, columns + b) for a in offsets for b in offsets])
    row, column = places.reshape(WAVES_PER_AXIS**2, 2, -1).swapaxes(0, 1).reshape(2, -1)
    wave_y, wave_x = ky[0] + row * (ky[1] - ky[0]), kx[0] + column * (kx[1] - kx[0])
    frequency = (
        dispersion(np.hypot(wave_y, wave_x), *spectrum.water) + wave_x * current[0] + wave_y * current[1]
    )
    line = (frequency - spectrum.omega[0]) / (spectrum.omega[1] - spectrum.omega[0])
    floor = FLOOR * max(float(measured.max()), 1e-300)
    used = (line > -REACH) & (line < shape[0] + REACH)
    used &= np.tile(measured.ravel() > floor, WAVES_PER_AXIS**2)
    place = np.array([line[used], row[used], column[used]])
    cell = np.tile(np.arange(measured.size), WAVES_PER_AXIS**2)[used]
    first = np.rint(place).astype(np.int64)
    offset = np.arange(-REACH, REACH + 1)
    weights = hann_power(first[..., None] + offset - place[..., None])  # (3, waves, cells or lines)

    def spread(power: Array) -> Array:
        out = np.zeros(shape)
        kernels.spread_waves(first - REACH, weights, power, out)
        return out.reshape(shape[0], -1)

    logs = np.log(np.maximum(measured, floor))
    power = richardson_lucy(
        measured,
        np.exp(ndimage.map_coordinates(logs, place[1:], order=1, mode="nearest")),
        lambda power: np.maximum(on_relation(spread(power)), floor * 1e-3),
        lambda power, ratio: power * ratio.ravel()[cell],
        ROUNDS,
    )
    return spread(power)


# half width of the window around the relation: relative to k, for a start that is wrong by a tenth of the
# phase velocity; and in cells, because a Hann window spreads a wave over two cells on either side
HALF_WIDTH, MIN_HALF_WIDTH = 0.22, 2.2
MIN_CELLS = 5  # in the window of a centroid: a Hann window spreads a wave over five
# smallest group velocity on a current, relative to still water: slower waves are smeared over all k
MIN_SPEED_ON_CURRENT = 0.5
CELL_VARIANCE = 0.3  # relative variance of a cell's energy, with the correlation of its neighbours
CENTROID_ERROR = 0.03  # error, in cells of k, in the strongest sector; leakage adds to it in weaker ones
LEAKAGE_ERROR = 0.3  # chosen: relative error of the simulated displacement by the windows
MAX_DISPLACEMENT = 0.3  # chosen, in cells of k: points that are displaced further contain only leakage


@dataclass(frozen=True)
class RelationPoints:
    """Measured points of the dispersion relation: centroids in k, at most one per frequency and sector."""

    omega: Array  # rad/s
    k: Array  # rad/m
    angle: Array  # of k, counted from the x axis, rad
    energy: Array  # above the noise, in the window of the centroid
    key: Array  # unique number of the line and sector
    k_std: Array  # rad/m
    signal_to_noise: Array

    def __len__(self) -> int:
        return self.omega.size

    def __getitem__(self, chosen: Array) -> "RelationPoints":
        return RelationPoints(*(getattr(self, field.name)[chosen] for field in fields(self)))

    def along(self, current: Array) -> Array:
        """Return the component of `current` along the wave vector of each point, (points,), m/s."""
        return np.asarray(current[0] * np.cos(self.angle) + current[1] * np.sin(self.angle))


def sectors_of(spectrum: PlaneSpectrum, count: int) -> Sectors:
    """Return `count` sectors of direction as (direction in rad, indices of wave vectors sorted by |k|)."""
    by_k = np.argsort(spectrum.k, kind="stable")
    half_width = np.pi / count
    middles = np.arange(count) * 2 * half_width
    off = [np.abs((spectrum.angle[by_k] - theta + np.pi) % (2 * np.pi) - np.pi) for theta in middles]
    return [(theta, by_k[part < half_width]) for theta, part in zip(middles.tolist(), off)]


def centroids(spectrum: PlaneSpectrum, sectors: Sectors, current: Array) -> RelationPoints:
    """Return centroids in k of the energy above the noise near the dispersion relation on `current`, one for
    each frequency and sector. Those of under five wave vectors, or with more noise than signal, are
    omitted."""
    omega, water = spectrum.omega, spectrum.water
    k_table = np.linspace(0.1, 1.2 * spectrum.k.max(), 4000)
    free = dispersion(k_table, *water)
    speed = np.gradient(free, k_table)
    largest_k = SHORTEST_WAVES * min(spectrum.kx.max(), spectrum.ky.max())
    # the Hann window broadens a wave with weights 1, 4, 1, whose variance is a third of a cell squared;
    # across the wave vector, this increases |k| by spread / 2k on average
    spread = float(np.mean(np.square(spectrum.sides))) / 3
    parts = []
    for number, (theta, cells) in enumerate(sectors):
        along = current[0] * np.cos(theta) + current[1] * np.sin(theta)
        k_cells, angles = spectrum.k[cells], spectrum.angle[cells]
        centres = _relation_in_k(omega, k_table, free, speed, along)
        reach = np.maximum(HALF_WIDTH * centres, MIN_HALF_WIDTH * spectrum.cell)
        known = np.isfinite(centres)
        middle, reach = np.where(known, centres, 0.0), np.where(known, reach, 0.0)
        first = np.searchsorted(k_cells, middle - reach, "right")
        last = np.searchsorted(k_cells, middle + reach, "left")
        place = np.arange(cells.size)
        inside = (place >= first[:, None]) & (place < last[:, None])
        energy, noise = (
            np.where(inside, part[:, cells].astype(float), 0.0) for part in (spectrum.energy, spectrum.noise)
        )
        by = np.array([np.ones(place.size), k_cells, np.cos(angles), np.sin(angles)])
        # einsum, because the last bit of a BLAS product may depend on the number of threads
        above = np.einsum("lc,ic->il", energy - noise, by)
        squares = np.einsum("lc,ic->il", energy**2, np.array([by[0], k_cells, k_cells**2]))
        sums = np.concatenate([above, squares, noise.sum(axis=1)[None]])
        usable = (last - first >= MIN_CELLS) & (sums[0] > sums[7]) & (sums[0] > 0)
        usable &= centres < largest_k
        weight, weight_k, cosine, sine, square, square_k, square_k2, noise = sums[:, usable]
        k = weight_k / weight
        second_moment = square_k2 - 2 * k * square_k + k**2 * square
        k_std = np.sqrt(CELL_VARIANCE * np.maximum(second_moment, 0)) / weight
        k -= spread / (2 * k)
        key = np.flatnonzero(usable) * len(sectors) + number
        signal_to_noise = weight / np.maximum(noise, 1e-9 * weight)
        angle = np.arctan2(sine, cosine)
        points = RelationPoints(omega[usable], k, angle, weight, key, k_std, signal_to_noise)
        # k < 0 for waves about as long as the rectangle, whose correction exceeds k
        parts.append(points[(k > 0) & (np.abs(k - centres[usable]) < reach[usable])])
    names = [field.name for field in fields(RelationPoints)]
    points = RelationPoints(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))
    strongest = _strongest_sector(points)
    leakage = CENTROID_ERROR * spectrum.cell * np.sqrt(strongest / points.energy)
    return replace(points, k_std=np.hypot(points.k_std, leakage))


def _relation_in_k(omega: Array, k: Array, free: Array, speed: Array, along: float) -> Array:
    """Return the k, rad/m, that solves omega = free(k) + k along at each `omega`; NaN if waves are blocked.
    `free` and `speed` are still-water frequency and group velocity at `k`; `along` is the current, m/s."""
    doppler = free + k * along
    blocked = speed + along < MIN_SPEED_ON_CURRENT * speed
    last = int(blocked.argmax()) if blocked.any() else k.size
    if last < 2:
        return np.full(omega.size, np.nan)
    return np.interp(omega, doppler[:last], k[:last], right=np.nan)


def _strongest_sector(points: RelationPoints) -> Array:
    """Return the largest energy of any sector at or next to the frequency of each point, (points,)."""
    if not len(points):
        return points.energy
    _, line = np.unique(points.omega, return_inverse=True)
    top = np.zeros(line.max() + 1)
    np.maximum.at(top, line, points.energy)
    return np.asarray(ndimage.maximum_filter1d(top, 3)[line])


def window_displacement(
    spectrum: PlaneSpectrum, band: Array, sectors: Sectors, current: Array
) -> tuple[Array, Array]:
    """Simulate free waves, and return by how much Hann windows displace the centroids in k, as two arrays
    (points,). The first holds the keys of the centroids (`RelationPoints.key`), the second their
    displacements, rad/m. Only frequencies in the mask `band` are used."""
    free_waves = windowed_waves(spectrum, current)[band]
    simulated = replace(spectrum.on_lines(band), energy=free_waves, noise=np.zeros_like(free_waves))
    points = centroids(simulated, sectors, current)
    along = points.along(current)
    off = points.omega - dispersion(points.k, *spectrum.water) - points.k * along
    displacement = -off / (group_velocity(points.k, *spectrum.water) + along)
    near = np.abs(displacement) < MAX_DISPLACEMENT * spectrum.cell
    return points.key[near], displacement[near]


def undisplaced(points: RelationPoints, by: tuple[Array, Array], part: float = 1.0) -> RelationPoints:
    """Return `points` with k corrected by the fraction `part` of the displacement due to Hann windows. `by`
    is a result of `window_displacement`. Points whose key is not in `by` are left out."""
    _, measured, simulated = np.intersect1d(points.key, by[0], assume_unique=True, return_indices=True)
    points, displacement = points[measured], by[1][simulated]
    k_std = np.hypot(points.k_std, LEAKAGE_ERROR * displacement)
    points = replace(points, k=points.k - part * displacement, k_std=k_std)
    return points[points.k > 0]
