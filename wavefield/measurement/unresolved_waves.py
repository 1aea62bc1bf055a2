"""Waves that are too short for the blocks: how far they move single beads, in all cameras alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wavefield.matching import Displacement, Evaluation
from wavefield.matching.matching_kernels import BLOCK
from wavefield.measurement.flow import FlowEstimate
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.regrid import BlockLattice
from wavefield.measurement.velocity import SHORT_WAVE_VARIANCES
from wavefield.water import dispersion

Float = NDArray[Any]
Blocks = NDArray[np.intp]

WAVELENGTH_BLOCKS = 2.5  # of waves that are taken for all that blocks do not resolve
LONGEST_BLOCKS = 4.0  # of those: they rise slowest, so that the same rise is of the highest waves
SHORTEST_BLOCKS = 1.0  # of those: they move fastest, so that the same rise from frame to frame is of more
SHORTEST_RIPPLES = 0.01  # metres: blocks may be smaller, but shorter ripples are damped fast
_COMMON_OF_BEADS = 0.05  # of a block's variance: clustered beads without any short waves
_COMMON_IN_LITTLE_NOISE = 0.04  # the same, of the steps with the least noise: in sound seas 0.015 to 0.05
_BY_CHANCE = 2.0  # standard deviations of what noise alone has in common
_COMMON_OF_CURVATURE = 0.001  # of a displacement's squared, per block: beads do not fill blocks evenly
_SEEN_IN_COMMON = 0.11  # of short waves' variance, the least of 0.11 to 0.30: blocks hold different beads
_COMMON_AT_FIRST = 0.3  # of a block's variance beside fields of the first spectra: waves resolved later
_FIRST_FACTOR = 4.0  # from what they have in common beyond it to the variance of unresolved waves, 2 to 6
_SEEN_OF_REMOVED = 0.5  # of the variance of waves that the prior removes: of three to four blocks
_LEAST_IN_COMMON = 0.13  # of a block's variance: less, and later fields resolve the waves
_RIDGE = 0.1  # of the typical Hessian
_MAX_STD = 3.0  # single blocks are limited to so many standard deviations
_MIN_BLOCKS = 50
MIN_SINE = 0.3  # between sight lines: nearer cameras share changes of light
_MEDIAN_SQUARE = 0.455  # of a standard normal variable


class InCommon(NamedTuple):
    """What blocks of two cameras have in common in one step, beside the fields, as variance of the rise."""

    shared: float  # m^2 per frame; by chance it may be negative
    total: float  # variance of the blocks, m^2
    curvature: float  # part of what is shared that resolved waves cause where they curve, m^2
    removed: float  # part of it by waves that the prior removes, m^2
    wavelength: float  # of unresolved waves, metres; 0 where cameras share changes of light as well
    blocks: int


def in_common(
    found: Mapping[str, FlowEstimate],
    missing: Mapping[str, Float],
    curvature: Mapping[str, float],
    z: Float,
    geometry: GridGeometry,
) -> tuple[InCommon, ...]:
    """What the blocks of every pair of cameras have in common beside the fields of one step.
    Cameras that look from the same side share changes of light as well, which are an error of velocities and
    no wave: only where all do are they compared.
    Short waves of variance c give the blocks of two cameras the covariance J_a diag(1/2, 1/2, 1) J_b^T c.
    So do waves that the prior removes, whose variance per block, px^2, is missing (1 or 2, ny, nx), and
    resolved waves, of which the beads of a block do not show the mean: as the mean square curvature of the
    displacement, px^2 per block to the fourth power.
    """
    motions, jacobians, removed, bent, scales = {}, {}, {}, {}, []
    for name, one in found.items():
        sight = geometry.sights[name]
        x, y, *jacobian = sight.at(z).reshape(8, -1)
        columns, rows, inside = _blocks_at(sight.lattice, x, y)
        motions[name] = np.where(inside, _block_motion(one.found)[:, rows, columns], np.nan)
        jacobians[name] = J = np.reshape(jacobian, (2, 3, -1)).astype(np.float64)
        size = 2.0 * np.mean(missing[name], axis=0)[rows, columns] / np.einsum("iin->n", _covariance(J, J))
        removed[name] = float(np.median(size[inside])) if inside.any() else 0.0
        bent[name] = curvature[name] / float(np.mean(np.einsum("iin->n", _covariance(J, J))))
        scales.append(np.median(np.linalg.norm(jacobians[name][:, :2], axis=(0, 1))) / np.sqrt(2.0))
    parts, pairs = [], list(combinations(motions, 2))
    apart = [(a, b) for a, b in pairs if sine_between(jacobians[a], jacobians[b]) > MIN_SINE]
    wavelength = float(WAVELENGTH_BLOCKS * BLOCK / np.mean(scales)) if apart else 0.0
    for a, b in apart or pairs:
        both = np.isfinite(motions[a]).all(axis=0) & np.isfinite(motions[b]).all(axis=0)
        if both.sum() < _MIN_BLOCKS:
            continue
        (p, J), (q, K) = ((_limited(motions[n][:, both]), jacobians[n][..., both]) for n in (a, b))
        expected = _covariance(J, K)
        own = [np.sum(np.square(r)) / np.einsum("iin->", _covariance(M, M)) for r, M in ((p, J), (q, K))]
        shared = float(np.sum(expected * (p[:, None] * q)) / np.sum(np.square(expected)))
        total = max(float(np.sqrt(own[0] * own[1])), 1e-30)
        of_curvature = _COMMON_OF_CURVATURE * float(np.sqrt(bent[a] * bent[b]))
        known = _SEEN_OF_REMOVED * min(removed[a], removed[b])
        parts.append(InCommon(shared, total, of_curvature, known, wavelength, int(both.sum())))
    return tuple(parts)


def stated_rise(first: Sequence[InCommon], last: Sequence[InCommon]) -> tuple[float, float]:
    """Standard deviation of the rise per frame by unresolved waves, and their wavelength, metres.
    From what all pairs and steps have in common beside the fields of the first and of the last spectra: the
    larger of their mean and of that weighted by their noise, as some ripples show in the brightest frames
    alone. It is shared among unresolved waves and those that the prior removes, by their sizes.
    Fields that follow much noise hide steep waves from the last estimate, but not from the first, which
    counts where blocks still have much in common beside the last fields: beside the first fields they also
    have waves that later ones resolve.
    """
    if not last:
        return 0.0, 0.0
    shared, total, curvature, removed, wavelength, blocks = np.array(last).T
    chance = np.square(total) / (2.0 * blocks)
    variance = 0.0
    for beads, weight in ((_COMMON_OF_BEADS, np.ones_like(total)), (_COMMON_IN_LITTLE_NOISE, 1.0 / chance)):
        weight /= weight.sum()
        excess = weight @ (shared - beads * total - curvature) - _BY_CHANCE * np.sqrt(weight**2 @ chance)
        if excess > 0:
            unstated = excess * excess / (excess + weight @ removed)
            variance = max(variance, unstated / ((1.0 - beads) * _SEEN_IN_COMMON))
    hidden = np.clip((np.mean(shared / total) - _LEAST_IN_COMMON) / _LEAST_IN_COMMON, 0.0, 1.0)
    if first:
        at_first = np.mean([one.shared - _COMMON_AT_FIRST * one.total for one in first])
        variance = max(variance, hidden * _FIRST_FACTOR * at_first)
    return float(np.sqrt(variance)), float(wavelength.mean())


def sine_between(J: Float, K: Float) -> float:
    """Sine of the angle between the sight lines of two cameras in the middle, from Jacobians (2, 3, n)."""
    a, b = (np.cross(middle[0], middle[1]) for middle in (np.median(J, axis=-1), np.median(K, axis=-1)))
    return float(np.linalg.norm(np.cross(a, b)) / (np.linalg.norm(a) * np.linalg.norm(b)))


def _blocks_at(lattice: BlockLattice, x: Float, y: Float) -> tuple[Blocks, Blocks, NDArray[np.bool_]]:
    """Column and row of the blocks nearest to places x, y (n,), px, and whether places are on the lattice."""
    ny, nx = lattice.shape
    column, row = (np.rint((v - v0) / lattice.step) for v, v0 in ((x, lattice.x0), (y, lattice.y0)))
    inside = (column >= 0) & (column < nx) & (row >= 0) & (row < ny)
    return column.clip(0, nx - 1).astype(np.intp), row.clip(0, ny - 1).astype(np.intp), inside


def _covariance(J: Float, K: Float) -> Float:
    """Covariance of displacements in two images, (2, 2, n), of short waves whose rise has the variance 1."""
    return np.asarray(np.einsum("ikn,k,jkn->ijn", J, np.array(SHORT_WAVE_VARIANCES), K))


def _block_motion(found: Displacement | Evaluation) -> Float:
    """Displacement of every block beside the field at which it was evaluated, (2, ny, nx), px.
    NaN where a block has little texture in either direction.
    """
    xx, xy, yy = found.hessian
    trace = (xx + yy)[found.valid]
    ridge = np.float32(_RIDGE * np.median(trace)) if trace.size else np.float32(1)
    scale = np.float32(1) / np.maximum((xx + ridge) * (yy + ridge) - xy * xy, np.float32(1e-30))
    x, y = found.score
    out = np.stack([(yy + ridge) * x - xy * y, (xx + ridge) * y - xy * x]) * scale
    out[:, ~(found.valid & (xx > 2 * ridge) & (yy > 2 * ridge))] = np.nan
    return np.asarray(out)


def _limited(values: Float) -> Float:
    """Values (2, n) within some standard deviations."""
    limit = _MAX_STD * float(np.sqrt(np.median(np.square(values)) / _MEDIAN_SQUARE))
    return np.clip(values, -limit, limit)


def unresolved_std(rise: float, wavelength: float, frame_rate: float) -> tuple[float, float]:
    """Std of z and of the rise per step at mid-time by unresolved waves, metres, from their rise per frame.
    With the std a and the phase p per frame of waves: 2 a^2 (1 - cos p), or 2 a^2 for even phases; (a p)^2.
    z is that of the longest ones, the rise that of the shortest.
    """
    if wavelength == 0:
        return 0.0, rise
    block = wavelength / WAVELENGTH_BLOCKS
    shortest = max(SHORTEST_BLOCKS * block, min(wavelength, SHORTEST_RIPPLES))
    phases = dispersion(2.0 * np.pi / np.array([LONGEST_BLOCKS * block, shortest])) / frame_rate
    z = rise / np.sqrt(2.0 * (1.0 - np.cos(np.minimum(phases, 0.5 * np.pi))))
    return float(z[0]), float(z[1] * phases[1])
