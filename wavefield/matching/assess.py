"""Quality of a displacement: correlation, own score of each block, reasons to reject it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wavefield.matching.block_lattice import block_weights
from wavefield.matching.displacement import Displacement, Evaluation, Reason
from wavefield.matching.matching_kernels import BLOCK
from wavefield.matching.matching_settings import MatchSettings
from wavefield.matching.prepared import NO_MASK, Level

F = np.float32
MIN_CORRELATION = 0.3  # of windows: below, a block has no score and no Hessian


@dataclass(frozen=True)
class LastStep:
    """The last step of a match, and the sums it was made of."""

    sums: np.ndarray  # (12, ny, nx): those of `final_sums`, per block
    windowed: np.ndarray  # (12, ny, nx): over windows
    coverage: np.ndarray  # (ny, nx): usable fraction of each window
    du: np.ndarray  # (ny, nx): the step, px
    dv: np.ndarray
    outlier: np.ndarray  # (ny, nx) bool: where the step was replaced by that of the neighbours


def assess(
    a: Level, b: Level, u: np.ndarray, v: np.ndarray, last: LastStep, settings: MatchSettings
) -> Displacement:
    """The result of a match at its last displacement u, v (ny, nx), px."""
    found = evaluation(a, b, u, v, last, settings)
    ny, nx = u.shape
    return Displacement(
        x=np.arange(nx) * float(BLOCK) + (BLOCK - 1) / 2,
        y=np.arange(ny) * float(BLOCK) + (BLOCK - 1) / 2,
        u=u,
        v=v,
        correlation=found.correlation,
        reason=found.reason,
        settings=settings,
        score=found.score,
        hessian=found.hessian,
    )


def evaluation(
    a: Level, b: Level, u: np.ndarray, v: np.ndarray, last: LastStep, settings: MatchSettings
) -> Evaluation:
    """Scores and validity of the blocks at a displacement; reads the windowed sums from the sixth on."""
    correlation, energy = _correlation(last)
    score, hessian = _own_scores(last, correlation)
    reason = _reasons(a, b, u, v, last.outlier, correlation, energy, settings)
    return Evaluation(score, hessian, correlation, reason)


def _correlation(last: LastStep) -> tuple[np.ndarray, np.ndarray]:
    """Normalised correlation and matched gradient energy of the windows, (ny, nx)."""
    rr, sa, aa, sr, ar, ab = last.windowed[5:11]
    power = float(aa.mean() / F(BLOCK * BLOCK))
    least = F((1e-4 * power + 1e-12) ** 2)
    n = F(1) / (np.maximum(last.coverage, F(1e-3)) * F(BLOCK * BLOCK))
    a, r = sa * n, sr * n
    var_a = np.maximum(aa * n - a * a, F(0))
    covariance = ar * n - a * r
    var_b = np.maximum(var_a - F(2) * covariance + (rr * n - r * r), F(0))
    correlation = (var_a - covariance) / np.sqrt(np.maximum(var_a * var_b, least))
    return np.clip(correlation, F(-1), F(1)), ab * n


def _own_scores(last: LastStep, correlation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Score (2, ny, nx) and Hessian (3, ny, nx) of every block after the step."""
    # the Hessian in `sums` is that of a alone, the ratio that of the mean of both images: what they share of
    # the gradients is ratio / (2 - ratio), and 0 where their correlation is too low
    shared, of_mean = last.windowed[10:12]
    ratio = np.clip(shared / np.maximum(of_mean, F(1e-12)), F(0), F(1))
    ratio[correlation <= F(MIN_CORRELATION)] = 0
    hessian = last.sums[2:5] * (ratio / (F(2) - ratio))
    xx, xy, yy = hessian
    step = np.stack([xx * last.du + xy * last.dv, xy * last.du + yy * last.dv])
    return last.sums[:2] - step, hessian


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
    """Bits of `Reason` per block, (ny, nx) uint8."""
    inside, weight = np.empty((2, *u.shape), np.float32)
    block_weights(NO_MASK, NO_MASK, u, v, *b.shape, inside)
    if a.good.size or b.good.size:
        block_weights(a.good, b.good, u, v, *b.shape, weight)
    else:
        weight = inside
    least = F(max(settings.min_gradient_energy * _sparse_median(energy, weight > 0), 1e-12))
    rejected = {
        Reason.EDGE: inside == 0,
        Reason.MASKED: (weight == 0) & (inside > 0),
        Reason.TEXTURE: energy <= least,
        Reason.CORRELATION: correlation < F(settings.min_correlation),
        Reason.NEIGHBOURS: outlier,
    }
    if settings.search_x is not None and settings.search_y is not None:
        slack = 2.0 ** (settings.levels - 1)  # px: one of the coarsest level
        limits = (u, settings.search_x), (v, settings.search_y)
        rejected[Reason.RANGE] = np.logical_or.reduce(
            [(field < low - slack) | (field > high + slack) for field, (low, high) in limits]
        )
    reason = np.zeros(u.shape, np.uint8)
    for bit, blocks in rejected.items():
        reason[blocks] |= np.uint8(bit)
    return reason


def _sparse_median(field: np.ndarray, usable: np.ndarray) -> float:
    """Median of a field over usable blocks, of every third block each way: windows overlap that much."""
    every_third = field[::3, ::3][usable[::3, ::3]]
    return float(np.median(every_third)) if every_third.size else 0.0
