"""What a displacement is worth: correlation, influence of each block, reasons to reject."""

from __future__ import annotations

import numpy as np

from wavefield.compiled import compiled
from wavefield.matching.displacement import Displacement, Reason
from wavefield.matching.kernels import BLOCK
from wavefield.matching.lattice import block_weights
from wavefield.matching.prepared import Level
from wavefield.matching.settings import Settings

F = np.float32
# `Reason` in numbers that the compiler knows
MASKED, EDGE, TEXTURE, CORRELATION, NEIGHBOURS = (
    int(r) for r in (Reason.MASKED, Reason.EDGE, Reason.TEXTURE, Reason.CORRELATION, Reason.NEIGHBOURS)
)
_ALIKE = 0.3  # correlation of windows below which a block says nothing

njit = compiled(error_model="numpy")


@njit
def _measures(
    sums: np.ndarray,
    windowed: np.ndarray,
    share: np.ndarray,
    du: np.ndarray,
    dv: np.ndarray,
    least: np.float32,
    ridge: np.float32,
    out: np.ndarray,
    score: np.ndarray,
    hessian: np.ndarray,
    block: int = BLOCK,  # given, not read: numba keeps what it compiled by its arguments
) -> None:
    """Correlation, gain, matched gradient energy and the two influences of every block; score and Hessian.

    The Hessian in ``sums`` is that of a alone, the gain that of the mean of both images: what they share of
    the gradients is gain / (2 - gain). Where the images hardly look alike they share nothing.

    sums, windowed (12, ny, nx) are those of `final_sums`, per block and over windows; share (ny, nx) is the
    seen share of each window; du, dv (ny, nx) the step taken since the sums were made; out (5, ny, nx),
    score (2, ny, nx) and hessian (3, ny, nx) output.
    """
    ny, nx = du.shape
    for j in range(ny):
        for i in range(nx):
            n = F(1) / (max(share[j, i], F(1e-3)) * F(block * block))
            a, r = windowed[6, j, i] * n, windowed[8, j, i] * n
            var_a = max(windowed[7, j, i] * n - a * a, F(0))
            var_r = windowed[5, j, i] * n - r * r
            cov = windowed[9, j, i] * n - a * r
            var_b = max(var_a - F(2) * cov + var_r, F(0))
            out[0, j, i] = min(max((var_a - cov) / np.sqrt(max(var_a * var_b, least)), F(-1)), F(1))
            gain = min(max(windowed[10, j, i] / max(windowed[11, j, i], F(1e-12)), F(0.3)), F(1.05))
            out[1, j, i] = gain
            out[2, j, i] = windowed[10, j, i] * n
            x, y = du[j, i], dv[j, i]
            sx = sums[0, j, i] - gain * (sums[2, j, i] * x + sums[3, j, i] * y)
            sy = sums[1, j, i] - gain * (sums[3, j, i] * x + sums[4, j, i] * y)
            xx, xy, yy = (
                windowed[2, j, i] * gain + ridge,
                windowed[3, j, i] * gain,
                windowed[4, j, i] * gain + ridge,
            )
            scale = F(1) / max(xx * yy - xy * xy, F(1e-30))
            out[3, j, i] = (yy * sx - xy * sy) * scale
            out[4, j, i] = (xx * sy - xy * sx) * scale
            common = min(max(windowed[10, j, i] / max(windowed[11, j, i], F(1e-12)), F(0)), F(1))
            if out[0, j, i] <= F(_ALIKE):
                common = F(0)
            common /= F(2) - common
            xx, xy, yy = sums[2, j, i] * common, sums[3, j, i] * common, sums[4, j, i] * common
            hessian[0, j, i], hessian[1, j, i], hessian[2, j, i] = xx, xy, yy
            score[0, j, i] = sums[0, j, i] - (xx * x + xy * y)
            score[1, j, i] = sums[1, j, i] - (xy * x + yy * y)


def assess(
    a: Level,
    b: Level,
    u: np.ndarray,
    v: np.ndarray,
    sums: np.ndarray,
    windowed: np.ndarray,
    share: np.ndarray,
    moved: tuple[np.ndarray, np.ndarray],
    outlier: np.ndarray,
    settings: Settings,
) -> Displacement:
    """Make the result of a match from the last displacement and the last sums.

    Parameters
    ----------
    a, b : Level
        Finest levels of the two images.
    u, v : (ny, nx) float32
        Displacement, px.
    sums, windowed : (12, ny, nx) float32
        Sums of `final_sums` per block, and filtered with the window.
    share : (ny, nx) float32
        Share of each block's window that is seen.
    moved : pair of (ny, nx) float32
        Change of u, v since the sums were made, px.
    outlier : (ny, nx) bool
        Blocks replaced by the median of their neighbours.
    settings : Settings
        Those of the match.

    Returns
    -------
    Displacement
    """
    measures = np.empty((5, *u.shape), np.float32)
    n = F(BLOCK * BLOCK)
    power = float(windowed[7].mean() / n)
    least = F((1e-4 * power + 1e-12) ** 2)
    ridge = F(1e-4 * float((windowed[2] + windowed[4]).mean()) + 1e-12)
    score, hessian = np.empty((2, *u.shape), np.float32), np.empty((3, *u.shape), np.float32)
    _measures(sums, windowed, share, *moved, least, ridge, measures, score, hessian)
    correlation, gain, energy = measures[:3]
    reason = _reasons(a, b, u, v, outlier, correlation, energy, settings)
    valid = reason == 0
    ny, nx = u.shape
    return Displacement(
        x=np.arange(nx) * float(BLOCK) + (BLOCK - 1) / 2,
        y=np.arange(ny) * float(BLOCK) + (BLOCK - 1) / 2,
        u=u,
        v=v,
        correlation=correlation,
        reason=reason,
        influence_u=measures[3],
        influence_v=measures[4],
        gain=_typical(gain, valid, 1.0),
        settings=settings,
        score=score,
        hessian=hessian,
    )


@njit
def _why(
    inside: np.ndarray,
    weight: np.ndarray,
    energy: np.ndarray,
    least: np.float32,
    correlation: np.ndarray,
    smallest: np.float32,
    outlier: np.ndarray,
    out: np.ndarray,
) -> None:
    for j in range(out.shape[0]):
        for i in range(out.shape[1]):
            bits = 0
            if inside[j, i] == 0:
                bits |= EDGE
            elif weight[j, i] == 0:
                bits |= MASKED
            if energy[j, i] <= least:
                bits |= TEXTURE
            if correlation[j, i] < smallest:
                bits |= CORRELATION
            if outlier[j, i]:
                bits |= NEIGHBOURS
            out[j, i] = bits


def _typical(field: np.ndarray, known: np.ndarray, otherwise: float) -> float:
    """Median of a field where it is known, of every third block each way: windows overlap that much."""
    some = field[::3, ::3][known[::3, ::3]]
    return float(np.median(some)) if some.size else otherwise


def _reasons(
    a: Level,
    b: Level,
    u: np.ndarray,
    v: np.ndarray,
    outlier: np.ndarray,
    correlation: np.ndarray,
    energy: np.ndarray,
    settings: Settings,
) -> np.ndarray:
    """Bits of `Reason` per block."""
    inside, weight = np.empty((2, *u.shape), np.float32)
    nothing = np.empty((0, 0), np.uint8)
    block_weights(nothing, nothing, u, v, *b.shape, inside)
    if a.good.size or b.good.size:
        block_weights(a.good, b.good, u, v, *b.shape, weight)
    else:
        weight = inside
    least = max(settings.min_gradient_energy * _typical(energy, weight > 0, 0.0), 1e-12)
    reason = np.empty(u.shape, np.uint8)
    _why(inside, weight, energy, F(least), correlation, F(settings.min_correlation), outlier, reason)
    if settings.search_x is not None and settings.search_y is not None:
        slack = 2.0 ** (settings.levels - 1)  # px: one of the coarsest level
        for field, (low, high) in ((u, settings.search_x), (v, settings.search_y)):
            reason[(field < low - slack) | (field > high + slack)] |= np.uint8(Reason.RANGE)
    return reason
