"""Quality of a displacement: correlation, influence of each block, reasons to reject it."""

from __future__ import annotations

import numpy as np

from wavefield.compiled import compiled
from wavefield.matching.block_lattice import block_weights
from wavefield.matching.displacement import Displacement, Reason
from wavefield.matching.matching_kernels import BLOCK
from wavefield.matching.matching_settings import MatchSettings
from wavefield.matching.prepared import Level

F = np.float32
# `Reason` as integers for compiled code
MASKED, EDGE, TEXTURE, CORRELATION, NEIGHBOURS = (
    int(r) for r in (Reason.MASKED, Reason.EDGE, Reason.TEXTURE, Reason.CORRELATION, Reason.NEIGHBOURS)
)
MIN_CORRELATION = 0.3  # of windows: below, a block has no score and no Hessian

njit = compiled(error_model="numpy")


@njit
def _block_measures(
    sums: np.ndarray,
    windowed: np.ndarray,
    coverage: np.ndarray,
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
    the gradients is gain / (2 - gain), and 0 where their correlation is below `MIN_CORRELATION`.

    sums, windowed (12, ny, nx) are those of `final_sums`, per block and over windows; share (ny, nx) is the
    usable fraction of each window; du, dv (ny, nx) the step taken since the sums were made; out (5, ny, nx),
    score (2, ny, nx) and hessian (3, ny, nx) output.
    """
    work = np.empty((4, du.shape[1]), np.float32)
    for j in range(len(du)):
        _correlation_row(j, windowed, coverage[j], F(block * block), least, out, work)
        _influence_row(j, sums, windowed, du[j], dv[j], ridge, out, work)
        _score_row(j, sums, windowed, du[j], dv[j], out[0, j], score, hessian, work)


# Loops with one output and few inputs, which LLVM vectorizes.


@njit
def _correlation_row(
    j: int,
    windowed: np.ndarray,
    coverage: np.ndarray,
    area: np.float32,
    least: np.float32,
    out: np.ndarray,
    work: np.ndarray,
) -> None:
    """Correlation, gain and energy of a row of blocks."""
    rr, sa, aa, sr, ar = windowed[5, j], windowed[6, j], windowed[7, j], windowed[8, j], windowed[9, j]
    ab, mm, scale = windowed[10, j], windowed[11, j], work[0]
    correlation, gain, energy = out[0, j], out[1, j], out[2, j]
    for i in range(len(scale)):
        scale[i] = F(1) / (max(coverage[i], F(1e-3)) * area)
    for i in range(len(scale)):
        n = scale[i]
        a, r = sa[i] * n, sr[i] * n
        var_a = max(aa[i] * n - a * a, F(0))
        var_r = rr[i] * n - r * r
        cov = ar[i] * n - a * r
        var_b = max(var_a - F(2) * cov + var_r, F(0))
        correlation[i] = min(max((var_a - cov) / np.sqrt(max(var_a * var_b, least)), F(-1)), F(1))
    for i in range(len(scale)):
        gain[i] = min(max(ab[i] / max(mm[i], F(1e-12)), F(0.3)), F(1.05))
    for i in range(len(scale)):
        energy[i] = ab[i] * scale[i]


@njit
def _influence_row(
    j: int,
    sums: np.ndarray,
    windowed: np.ndarray,
    du: np.ndarray,
    dv: np.ndarray,
    ridge: np.float32,
    out: np.ndarray,
    work: np.ndarray,
) -> None:
    """Influences of a row of blocks, below its gains."""
    s0, s1, s2, s3, s4 = sums[0, j], sums[1, j], sums[2, j], sums[3, j], sums[4, j]
    w2, w3, w4 = windowed[2, j], windowed[3, j], windowed[4, j]
    gain, to_u, to_v, sx, sy, scale = out[1, j], out[3, j], out[4, j], work[0], work[1], work[2]
    for i in range(len(sx)):
        sx[i] = s0[i] - gain[i] * (s2[i] * du[i] + s3[i] * dv[i])
    for i in range(len(sx)):
        sy[i] = s1[i] - gain[i] * (s3[i] * du[i] + s4[i] * dv[i])
    for i in range(len(sx)):
        xx, xy, yy = w2[i] * gain[i] + ridge, w3[i] * gain[i], w4[i] * gain[i] + ridge
        scale[i] = F(1) / max(xx * yy - xy * xy, F(1e-30))
    for i in range(len(sx)):
        to_u[i] = ((w4[i] * gain[i] + ridge) * sx[i] - w3[i] * gain[i] * sy[i]) * scale[i]
    for i in range(len(sx)):
        to_v[i] = ((w2[i] * gain[i] + ridge) * sy[i] - w3[i] * gain[i] * sx[i]) * scale[i]


@njit
def _score_row(
    j: int,
    sums: np.ndarray,
    windowed: np.ndarray,
    du: np.ndarray,
    dv: np.ndarray,
    correlation: np.ndarray,
    score: np.ndarray,
    hessian: np.ndarray,
    work: np.ndarray,
) -> None:
    """Score and Hessian of a row of blocks."""
    s0, s1, s2, s3, s4 = sums[0, j], sums[1, j], sums[2, j], sums[3, j], sums[4, j]
    ab, mm, shared = windowed[10, j], windowed[11, j], work[3]
    xx, xy, yy, sx, sy = hessian[0, j], hessian[1, j], hessian[2, j], score[0, j], score[1, j]
    for i in range(len(shared)):
        part = min(max(ab[i] / max(mm[i], F(1e-12)), F(0)), F(1))
        part = F(0) if correlation[i] <= F(MIN_CORRELATION) else part
        shared[i] = part / (F(2) - part)
    for i in range(len(shared)):
        xx[i] = s2[i] * shared[i]
    for i in range(len(shared)):
        xy[i] = s3[i] * shared[i]
    for i in range(len(shared)):
        yy[i] = s4[i] * shared[i]
    for i in range(len(shared)):
        sx[i] = s0[i] - (xx[i] * du[i] + xy[i] * dv[i])
    for i in range(len(shared)):
        sy[i] = s1[i] - (xy[i] * du[i] + yy[i] * dv[i])


def assess(
    a: Level,
    b: Level,
    u: np.ndarray,
    v: np.ndarray,
    sums: np.ndarray,
    windowed: np.ndarray,
    coverage: np.ndarray,
    last_step: tuple[np.ndarray, np.ndarray],
    outlier: np.ndarray,
    settings: MatchSettings,
) -> Displacement:
    """Make the result of a match from the last displacement and the last sums.

    With u, v (ny, nx), px; sums, windowed (12, ny, nx); share (ny, nx); moved (ny, nx), px; outlier (ny, nx).
    """
    measures = np.empty((5, *u.shape), np.float32)
    n = F(BLOCK * BLOCK)
    power = float(windowed[7].mean() / n)
    least = F((1e-4 * power + 1e-12) ** 2)
    ridge = F(1e-4 * float((windowed[2] + windowed[4]).mean()) + 1e-12)
    score, hessian = np.empty((2, *u.shape), np.float32), np.empty((3, *u.shape), np.float32)
    _block_measures(sums, windowed, coverage, *last_step, least, ridge, measures, score, hessian)
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
        gain=_sparse_median(gain, valid, 1.0),
        settings=settings,
        score=score,
        hessian=hessian,
    )


@njit
def _reason_bits(
    inside: np.ndarray,
    weight: np.ndarray,
    energy: np.ndarray,
    least: np.float32,
    correlation: np.ndarray,
    min_correlation: np.float32,
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
            if correlation[j, i] < min_correlation:
                bits |= CORRELATION
            if outlier[j, i]:
                bits |= NEIGHBOURS
            out[j, i] = bits


def _sparse_median(field: np.ndarray, known: np.ndarray, otherwise: float) -> float:
    """Median of a field where it is known, of every third block each way: windows overlap that much."""
    every_third = field[::3, ::3][known[::3, ::3]]
    return float(np.median(every_third)) if every_third.size else otherwise


def _reasons(
    a: Level,
    b: Level,
    u: np.ndarray,
    v: np.ndarray,
    outlier: np.ndarray,
    correlation: np.ndarray,
    energy: np.ndarray,
    settings: MatchSettings,
) -> np.ndarray:
    """Bits of `Reason` per block."""
    inside, weight = np.empty((2, *u.shape), np.float32)
    nothing = np.empty((0, 0), np.uint8)
    block_weights(nothing, nothing, u, v, *b.shape, inside)
    if a.good.size or b.good.size:
        block_weights(a.good, b.good, u, v, *b.shape, weight)
    else:
        weight = inside
    least = max(settings.min_gradient_energy * _sparse_median(energy, weight > 0, 0.0), 1e-12)
    reason = np.empty(u.shape, np.uint8)
    _reason_bits(inside, weight, energy, F(least), correlation, F(settings.min_correlation), outlier, reason)
    if settings.search_x is not None and settings.search_y is not None:
        slack = 2.0 ** (settings.levels - 1)  # px: one of the coarsest level
        for field, (low, high) in ((u, settings.search_x), (v, settings.search_y)):
            reason[(field < low - slack) | (field > high + slack)] |= np.uint8(Reason.RANGE)
    return reason
