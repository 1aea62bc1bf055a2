"""First estimate of the current from a spectrum: a histogram of the Doppler velocities of its cells."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from wavefield.water import dispersion
from wavefield.waves.dispersion_relation.plane_spectrum import MIN_CELLS_FROM_ZERO, PlaneSpectrum

Array = NDArray[Any]

MAX_SPEED = 0.8  # m/s
SPEED_STEP = 0.02  # m/s
SECTORS = 48


def scan_current(spectrum: PlaneSpectrum, gamma: float) -> Array:
    """Current along x and y, (2,), to 0.02 m/s, whose dispersion relation holds most energy.
    Cells give (omega -+ sigma(k)) / k along k; a current U appears in the sector theta at U cos(theta - phi).
    """
    plane, omega = spectrum.plane, spectrum.omega
    used = plane.k > MIN_CELLS_FROM_ZERO * plane.cell
    used &= plane.k < 0.9 * plane.k[plane.ky == 0].max()
    k = plane.k[used]
    sector = np.rint(plane.angle[used] / (2 * np.pi) * SECTORS).astype(int) % SECTORS
    bins = round(2 * MAX_SPEED / SPEED_STEP) + 1
    histogram = np.zeros(SECTORS * bins)
    # omega + sigma: waves that a current carries backwards
    sigma = dispersion(k, spectrum.depth, gamma)
    # energy above the noise, each line over its total, and times k: short waves determine the current better
    for line_omega, energy, noise in zip(omega, spectrum.energy, spectrum.noise):
        weight = np.maximum(energy[used] - 3 * noise[used], 0.0)
        total = weight.sum() + noise[used].sum()
        if not total > 0:
            continue
        for free in (sigma, -sigma):
            speed_bin = np.rint(((line_omega - free) / k + MAX_SPEED) / SPEED_STEP).astype(int)
            inside = (speed_bin >= 0) & (speed_bin < bins) & (weight > 0)
            place = sector[inside] * bins + speed_bin[inside]
            histogram += np.bincount(place, weight[inside] * k[inside] / total, histogram.size)
    histogram = ndimage.gaussian_filter1d(histogram.reshape(SECTORS, bins), 1.0, axis=1)
    speeds = np.arange(-(bins // 2), bins // 2 + 1) * SPEED_STEP
    ux, uy = np.meshgrid(speeds, speeds, indexing="ij")
    score = np.zeros(ux.shape)
    for theta, row in zip(np.arange(SECTORS) * 2 * np.pi / SECTORS, histogram):
        place = (ux * np.cos(theta) + uy * np.sin(theta) + MAX_SPEED) / SPEED_STEP
        score += np.interp(place, np.arange(bins), row, left=0.0, right=0.0)
    speed = np.hypot(ux, uy)
    nearly_best = score >= 0.98 * score[speed <= MAX_SPEED].max()
    slowest = np.argmin(np.where(nearly_best, speed, np.inf))
    return np.array([ux.flat[slowest], uy.flat[slowest]])
