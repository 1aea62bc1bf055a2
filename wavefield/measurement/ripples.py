"""Ripples shorter than a block, found from residual motion that all cameras share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wavefield.matching import Displacement
from wavefield.matching.kernels import BLOCK
from wavefield.measurement.displacement import FlowEstimate
from wavefield.measurement.error_budget import RIPPLE_BLOCKS
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.regrid import BlockLattice
from wavefield.measurement.velocity import WAVE_VARIANCES

Float = NDArray[Any]
Blocks = NDArray[np.intp]

# Of the variance of the blocks' residuals, that two cameras share: 0.29 to 0.47 in seas with ripples, at most
# 0.13 in gaps, on short steep waves and of other renderers
MIN_SHARED = 0.2
SHARED_BY_BEADS = 0.05  # of a block's variance: clustered beads without ripples
SEEN_BY_BLOCKS = 0.11  # of the ripples' variance, the least of 0.11 to 0.30: blocks hold different beads
SEEN_OF_REMOVED = 0.5  # of the variance of waves that the prior removes: of three to four blocks
RIDGE = 0.1  # of the typical Hessian
MAX_STD = 3.0  # single blocks are limited to so many standard deviations
MIN_BLOCKS = 50
MIN_SINE = 0.3  # between sight lines: nearer cameras share changes of light
MEDIAN_SQUARE = 0.455  # of a standard normal variable


class SharedMotion(NamedTuple):
    """Residual displacements that two cameras share in one step, as variance of the rise, m^2."""

    shared: float  # per frame; by chance it may be negative
    total: float  # variance of the blocks
    removed: float  # part of what is shared that the prior removed from longer waves
    wavelength: float  # of the ripples, metres; 0 where cameras side by side share changes of light as well


def shared_motion(
    found: Mapping[str, FlowEstimate], missing: Mapping[str, Float], z: Float, geometry: GridGeometry
) -> tuple[SharedMotion, ...]:
    """Residual motion that every pair of cameras shares in one step on the surface z (ny, nx).

    Ripples whose rise has the variance c give the blocks of two cameras the covariance
    J_a diag(1/2, 1/2, 1) J_b^T c. So do waves that the prior removes, whose variance per block is `missing`
    (1 or 2, ny, nx), px^2. Cameras that look from the same side share changes of light as well: only where
    all do are they compared.
    """
    moved, jacobians, removed, scales = {}, {}, {}, []
    for name, one in found.items():
        sight = geometry.sights[name]
        x, y, *jacobian = sight.at(z).reshape(8, -1)
        columns, rows, inside = blocks_at(sight.lattice, x, y)
        moved[name] = np.where(inside, block_residuals(one.found)[:, rows, columns], np.nan)
        jacobians[name] = J = np.reshape(jacobian, (2, 3, -1)).astype(np.float64)
        size = 2.0 * np.mean(missing[name], axis=0)[rows, columns] / np.einsum("iin->n", covariance(J, J))
        removed[name] = float(np.median(size[inside])) if inside.any() else 0.0
        scales.append(np.median(np.linalg.norm(J[:, :2], axis=(0, 1))) / np.sqrt(2.0))
    out, pairs = [], list(combinations(moved, 2))
    apart = [(a, b) for a, b in pairs if sine_between(jacobians[a], jacobians[b]) > MIN_SINE]
    wavelength = float(RIPPLE_BLOCKS * BLOCK / np.mean(scales)) if apart else 0.0
    for a, b in apart or pairs:
        both = np.isfinite(moved[a]).all(axis=0) & np.isfinite(moved[b]).all(axis=0)
        if both.sum() < MIN_BLOCKS:
            continue
        (p, J), (q, K) = ((limited(moved[n][:, both]), jacobians[n][..., both]) for n in (a, b))
        expected = covariance(J, K)
        own = [np.sum(np.square(r)) / np.einsum("iin->", covariance(M, M)) for r, M in ((p, J), (q, K))]
        shared = float(np.sum(expected * (p[:, None] * q)) / np.sum(np.square(expected)))
        total = max(float(np.sqrt(own[0] * own[1])), 1e-30)
        known = SEEN_OF_REMOVED * min(removed[a], removed[b])
        out.append(SharedMotion(shared, total, known, wavelength))
    return tuple(out)


def ripple_rise(shared: Sequence[SharedMotion]) -> tuple[float, float]:
    """Standard deviation of the rise of ripples per frame, and their wavelength, metres; 0 without ripples.
    The shared variance is divided between ripples and waves that the prior removed, in proportion.
    """
    if not shared:
        return 0.0, 0.0
    common, total, removed, wavelength = np.mean(shared, axis=0)
    excess = common - SHARED_BY_BEADS * total
    if common < MIN_SHARED * total or excess <= 0:
        return 0.0, 0.0
    variance = excess**2 / (excess + removed) / ((1.0 - SHARED_BY_BEADS) * SEEN_BY_BLOCKS)
    return float(np.sqrt(variance)), float(wavelength)


def sine_between(J: Float, K: Float) -> float:
    """Sine of the angle between the sight lines of two cameras in the middle, from Jacobians (2, 3, n)."""
    a, b = (np.cross(middle[0], middle[1]) for middle in (np.median(J, axis=-1), np.median(K, axis=-1)))
    return float(np.linalg.norm(np.cross(a, b)) / (np.linalg.norm(a) * np.linalg.norm(b)))


def blocks_at(lattice: BlockLattice, x: Float, y: Float) -> tuple[Blocks, Blocks, NDArray[np.bool_]]:
    """Column and row of the blocks nearest to places x, y (n,), px, and whether places are on the lattice."""
    ny, nx = lattice.shape
    column, row = (np.rint((v - v0) / lattice.step) for v, v0 in ((x, lattice.x0), (y, lattice.y0)))
    inside = (column >= 0) & (column < nx) & (row >= 0) & (row < ny)
    return column.clip(0, nx - 1).astype(np.intp), row.clip(0, ny - 1).astype(np.intp), inside


def covariance(J: Float, K: Float) -> Float:
    """Covariance of the displacements in two images, (2, 2, n), from waves with unit variance of the rise."""
    return np.asarray(np.einsum("ikn,k,jkn->ijn", J, WAVE_VARIANCES, K))


def block_residuals(found: Displacement) -> Float:
    """Displacement of every block relative to the field at which it was evaluated, (2, ny, nx), px.
    NaN where a block has little texture in either direction.
    """
    xx, xy, yy = found.hessian
    trace = (xx + yy)[found.valid]
    ridge = np.float32(RIDGE * np.median(trace)) if trace.size else np.float32(1)
    scale = np.float32(1) / np.maximum((xx + ridge) * (yy + ridge) - xy * xy, np.float32(1e-30))
    x, y = found.score
    out = np.stack([(yy + ridge) * x - xy * y, (xx + ridge) * y - xy * x]) * scale
    out[:, ~(found.valid & (xx > 2 * ridge) & (yy > 2 * ridge))] = np.nan
    return np.asarray(out)


def limited(values: Float) -> Float:
    """Values (2, n) clipped to some standard deviations."""
    limit = MAX_STD * float(np.sqrt(np.median(np.square(values)) / MEDIAN_SQUARE))
    return np.clip(values, -limit, limit)
