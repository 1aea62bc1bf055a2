"""Covariances of the energies of sectors of a ring of the k plane, and what follows from them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from wavefield.water import group_velocity
from wavefield.waves.estimation.crossing import correlation_at
from wavefield.waves.estimation.segment_correlation import expected_segment_correlation

Array = NDArray[Any]

LINES_AROUND = 6  # to either side of a band, from which waves leak into it
_HANN = np.array([1 / 36, 4 / 9, 1, 4 / 9, 1 / 36])  # squared correlation of neighbouring lines or cells
_HANN_VARIANCE = 4 / 7  # of these five, cells squared
_LINE_VARIANCE = 1 / 3  # of the power that a Hann window leaves of one wave, cells squared


def segments_of(dof: float) -> float:
    """Number of segments, overlapping by half, that give a cell so many degrees of freedom."""
    return max(19 * dof / 36, 1.0)


def packet_correlation(
    ky: Array, kx: Array, omega: Array, water: tuple[float, float], current: tuple[float, float], dof: float
) -> Array:
    """Variance of a mean of segments over that of independent ones, of free waves in each cell, (ky, kx).
    Water is depth, m, and surface tension over density, m3/s2; current is m/s. White segments have 1.
    """
    k = np.maximum(np.hypot(ky[:, None], kx), 1e-9)
    speed = group_velocity(k, *water) / k
    velocity = speed * kx + current[0], speed * ky[:, None] + current[1]
    lengths = 2 * np.pi / (kx[1] - kx[0]), 2 * np.pi / (ky[1] - ky[0])
    count = segments_of(dof)
    crossing = correlation_at(velocity, 2 * np.pi / (omega[1] - omega[0]), lengths, round(count))
    return np.maximum(crossing / _white(count), 1.0)


def _white(count: float) -> float:
    return 1 + (1 - 1 / count) / 18


def sector_covariances(
    shares: Array, around: Array, inside: NDArray[np.bool_], off: Array, packets: Array, dof: float
) -> Array:
    """Covariances of the energies of sectors from shares of cells, (sectors, cells), and the energy around.
    That is (lines, ky, kx); `off` (lines inside, cells) is in cells. Chance, 2 / dof, is taken off.
    """
    ring, energy = shares.sum(axis=0), around[inside]
    weight = ring * energy.reshape(len(energy), -1)
    count = segments_of(dof)
    # neighbouring cells and lines are correlated, sectors share cells, and segments share waves that keep
    # their phase, as at the end of a sea
    line = expected_segment_correlation((around.reshape(len(around), -1) @ ring)[None], round(count))[0]
    share = weight.sum(axis=1) ** 2
    kept = (line[inside] * share).sum() / max(share.sum(), 1e-300) / _white(count)
    dof_of_sum = (dof + 2) / (_correlation_across(weight, off) * kept)
    return _covariances(shares, energy * np.sqrt(packets), dof_of_sum)


def _covariances(shares: Array, energy: Array, dof: float) -> Array:
    lines, ny, nx = energy.shape
    reach = min(2, lines - 1)
    over_lines = ndimage.convolve1d(energy, _HANN[2 - reach : 3 + reach], axis=0, mode="constant")
    planes = shares.reshape(-1, ny, nx)
    out = np.zeros((shares.shape[0],) * 2)
    for s, part in enumerate(planes):
        used = np.flatnonzero(part.any(axis=1)), np.flatnonzero(part.any(axis=0))
        if not used[0].size:
            continue
        box = tuple(slice(max(int(some[0]) - 2, 0), int(some[-1]) + 3) for some in used)
        smoothed = part[box] * over_lines[:, *box]
        for axis in (1, 2):
            smoothed = ndimage.convolve1d(smoothed, _HANN, axis=axis, mode="constant")
        product = (smoothed * energy[:, *box]).sum(axis=0)
        out[s] = 2 / dof * (planes[:, *box] * product).sum(axis=(1, 2))
    return out


def _correlation_across(weight: Array, off: Array) -> float:
    """By what factor waves (lines, cells) across the relation are fewer than by the windows' correlation.
    `off` is the distance from the relation in cells. Cells count as correlated for even energy.
    """
    total = weight.sum()
    if not total > 0:
        return 1.0
    mean = (weight * off).sum(axis=1, keepdims=True) / np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
    measured = 2 * float((weight * (off - mean) ** 2).sum() / total)
    # where the relation is narrower than the window all cells across it are one sample: for Gaussian shapes
    # the number is that of the width without the window's
    own = max(measured - 2 * _LINE_VARIANCE, 0.0)
    return float(np.sqrt((measured + _HANN_VARIANCE) / (own + _HANN_VARIANCE)))


def sector_freedom(levels: Array, covariances: Array) -> Array:
    """Degrees of freedom of each sector's part of the sum over all, (sectors,)."""
    total = max(levels.sum(), 1e-300)
    with np.errstate(divide="ignore", invalid="ignore"):
        own = np.diag(covariances) / levels**2 - 2 * covariances.sum(axis=1) / (levels * total)
    return np.asarray(2 / np.maximum(own + covariances.sum() / total**2, 1e-12))


def harmonic_stds(levels: Array, covariances: Array, theta: Array) -> tuple[float, float]:
    """Standard uncertainties of the first harmonic of D along its direction and across it."""
    total = max(levels.sum(), 1e-300)
    turned = np.exp(1j * theta)
    first = (levels * turned).sum() / total
    by_level = (turned - first) / total * np.exp(-1j * np.angle(first))
    along, across = (float(part @ covariances @ part) for part in (by_level.real, by_level.imag))
    return np.sqrt(max(along, 0.0)), np.sqrt(max(across, 0.0))
