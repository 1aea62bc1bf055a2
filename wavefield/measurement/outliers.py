"""Cameras that contradict each other: find the one to leave out, and the nodes where pairs disagree."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.measurement.pair import PairMatch

Float = NDArray[np.floating]
Mask = NDArray[np.bool_]

MAX_MISFIT = 12.0  # largest median over the nodes of chi^2 per degree of freedom; above, cameras contradict
MAX_NODE_MISFIT = 3 * MAX_MISFIT  # the same for a single node
MAX_PAIR_DIFFERENCE_PX = 1.5  # largest difference between the elevations of two pairs, as parallax
_PAIR_MEAN_BLOCKS = (5, 5)  # blocks over which it is averaged
_SCORE_MEAN_BLOCKS = (9, 9)  # blocks over which scores are averaged: noise is below a third of the next limit
_MAX_SCORE_DIFFERENCE_PX = 0.75  # largest difference between two pairs' corrections, as parallax
_MIN_RELATIVE_HESSIAN = 0.3  # over the mean: blocks with less do not determine an elevation
_WINDOW_REACH = np.ones((5, 5), np.uint8)  # blocks that share the window of one block
MIN_NODES = 50  # fewest nodes for a median


def outlier_camera(n_cameras: int, misfit: float, misfit_without: Callable[[int], float]) -> int | None:
    """Return the index of the only camera without which the others agree; None if not exactly one.

    `misfit` is the median chi^2 per degree of freedom with all cameras, `misfit_without(n)` that without
    camera n. In a line of three cameras the one that moved along it is not found: any two agree.
    """
    if n_cameras < 3 or not misfit > MAX_MISFIT:
        return None
    limit = min(MAX_MISFIT, 0.1 * misfit)
    explain = [n for n in range(n_cameras) if misfit_without(n) < limit]
    return explain[0] if len(explain) == 1 else None


def median_misfit(misfit: Float, measured: Mask) -> float:
    """Median of the misfit (ny, nx) over nodes that all cameras measured; 0 if there are too few."""
    good = measured & np.isfinite(misfit)
    return float(np.median(misfit[good])) if good.sum() >= MIN_NODES else 0.0


def inconsistent_pairs(matches: Sequence[PairMatch], pixel: float) -> Mask:
    """Return a mask (ny, nx) of blocks at which the z of successive pairs, matched alone, differ by > 1.5 px.
    This finds errors larger than a bead, which scores do not show. `pixel` is in metres."""
    out = np.zeros(matches[0].eps_y.shape, bool)
    for one, other in pairwise(matches):
        lengths = (np.sqrt(np.sum(np.square(m.parallax), axis=0)) for m in (one, other))
        both = (one.valid & other.valid).astype(np.float32)
        difference = (one.height - other.height) * np.minimum(*lengths) / np.float32(pixel)
        mean = cv2.blur(np.where(both > 0, difference, np.float32(0)), _PAIR_MEAN_BLOCKS)
        limit = np.float32(MAX_PAIR_DIFFERENCE_PX)
        out |= np.abs(mean) > limit * np.maximum(cv2.blur(both, _PAIR_MEAN_BLOCKS), np.float32(0.2))
    return widened(out)


def inconsistent_scores(scores: Sequence[Float], hessians: Sequence[Float], lengths: Sequence[Float]) -> Mask:
    """Return a mask (ny, nx) of blocks where successive pairs would correct the common z differently.
    Scores and Hessians are for z; `lengths` (ny, nx) are parallaxes, px/m. This finds shifts of one pixel."""
    means = [
        (cv2.blur(s, _SCORE_MEAN_BLOCKS), cv2.blur(h, _SCORE_MEAN_BLOCKS))
        for s, h in zip(scores, hessians, strict=True)
    ]
    # At the common surface only noise is left. Its std is 0.02 to 0.07 px on bright and on dark images, at
    # most 0.36 px. Matches may differ by more than a bead's width, which scores do not show.
    out = np.zeros(scores[0].shape, bool)
    for ((s, h), a), ((t, g), b) in pairwise(zip(means, lengths, strict=True)):
        least = np.float32(_MIN_RELATIVE_HESSIAN)
        usable = (h > least * h.mean()) & (g > least * g.mean())
        heights = [np.divide(p, q, out=np.zeros_like(p), where=usable) for p, q in ((s, h), (t, g))]
        difference = (heights[0] - heights[1]) * np.minimum(a, b)
        out |= np.abs(difference) > np.float32(_MAX_SCORE_DIFFERENCE_PX)
    return widened(out)


def widened(where: Mask) -> Mask:
    """Return the mask (ny, nx) with its True area extended by two blocks, the reach of a window."""
    return np.asarray(cv2.dilate(where.view(np.uint8), _WINDOW_REACH) > 0)
