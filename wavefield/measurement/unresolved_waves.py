"""Waves that are too short for the blocks: how far they move single beads, in all cameras alike."""

from __future__ import annotations

from collections.abc import Mapping
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
_COMMON_OF_BEADS = 0.08  # of a block's variance: unsteady, clustered beads without any short waves
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


class Unresolved(NamedTuple):
    """Variance of the rise per frame by waves that blocks do not resolve, m^2, their wavelength, metres,
    and the part of the blocks' variance that cameras have in common.
    """

    variance: float = 0.0
    wavelength: float = 0.0
    in_common: float = 0.0


def unresolved_rise(
    found: Mapping[str, FlowEstimate],
    missing: Mapping[str, Float],
    curvature: Mapping[str, float],
    z: Float,
    geometry: GridGeometry,
    first: bool,
) -> Unresolved:
    """Waves that blocks do not resolve, from what they move beside the fields of the first or later spectra.
    By chance the variance may be negative; steps are averaged. Cameras that look from the same side share
    changes of light as well, which are an error of velocities and no wave: their wavelength is 0.
    Short waves of variance c give the blocks of two cameras the covariance J_a diag(1/2, 1/2, 1) J_b^T c.
    So do waves that the prior removes, whose variance per block, px^2, is missing (1 or 2, ny, nx): what is
    in common is shared among both by their sizes. So do resolved waves, of which the beads of a block do not
    show the mean: as the mean square curvature of the displacement, px^2 per block to the fourth power.
    Beside fields of the first spectra blocks also have waves that later fields resolve.
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
    common, shares, pairs = [], [], list(combinations(motions, 2))
    apart = [(a, b) for a, b in pairs if sine_between(jacobians[a], jacobians[b]) > MIN_SINE]
    for a, b in apart or pairs:
        both = np.isfinite(motions[a]).all(axis=0) & np.isfinite(motions[b]).all(axis=0)
        if both.sum() < _MIN_BLOCKS:
            continue
        (p, J), (q, K) = ((_limited(motions[n][:, both]), jacobians[n][..., both]) for n in (a, b))
        expected = _covariance(J, K)
        own = [np.sum(np.square(r)) / np.einsum("iin->", _covariance(M, M)) for r, M in ((p, J), (q, K))]
        shared = float(np.sum(expected * (p[:, None] * q)) / np.sum(np.square(expected)))
        total = float(np.sqrt(own[0] * own[1]))
        shares.append(shared / max(total, 1e-30))
        if first:
            common.append(_FIRST_FACTOR * (shared - _COMMON_AT_FIRST * total))
            continue
        shared -= _COMMON_OF_BEADS * total
        shared -= _COMMON_OF_CURVATURE * float(np.sqrt(bent[a] * bent[b]))
        known = _SEEN_OF_REMOVED * min(removed[a], removed[b])
        unstated = shared * shared / (shared + known) if shared > 0 else shared
        common.append(unstated / ((1.0 - _COMMON_OF_BEADS) * _SEEN_IN_COMMON))
    if not common:
        return Unresolved()
    wavelength = float(WAVELENGTH_BLOCKS * BLOCK / np.mean(scales)) if apart else 0.0
    return Unresolved(float(np.mean(common)), wavelength, float(np.mean(shares)))


def stated_rise(first: Unresolved, last: Unresolved) -> tuple[float, float]:
    """Standard deviation of the rise per frame by unresolved waves, and their wavelength, metres.
    Fields that follow much noise hide steep waves from the last estimate, but not from the first, which
    counts where blocks still have much in common beside the last fields.
    """
    hidden = np.clip((last.in_common - _LEAST_IN_COMMON) / _LEAST_IN_COMMON, 0.0, 1.0)
    return float(np.sqrt(max(0.0, last.variance, hidden * first.variance))), last.wavelength


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
