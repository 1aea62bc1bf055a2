"""Cameras and pairs that contradict each other: which to leave out, and which nodes not to trust."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.measurement.pair import PairMatch

Float = NDArray[np.floating]
Mask = NDArray[np.bool_]

MAX_MISFIT = 12.0  # chi^2 per degree of freedom, median over the nodes: more, and a camera is an outlier
MAX_NODE_MISFIT = 36.0  # the same of a single node
MAX_PAIR_DIFFERENCE_PX = 1.5  # of two pairs' parallax for one surface
_PAIR_MEAN_BLOCKS = (5, 5)
_SCORE_MEAN_BLOCKS = (9, 9)  # over so many the pairs' own noise is below a third of the following limit
_MAX_SCORE_DIFFERENCE_PX = 0.75  # between the corrections of parallax by two pairs to one surface
_MIN_RELATIVE_HESSIAN = 0.3  # of the mean: blocks with less determine no height
_WINDOW_REACH = np.ones((5, 5), np.uint8)  # blocks affected by one
MIN_NODES = 50  # for a median misfit


def outlier_camera(n_cameras: int, misfit: float, misfit_without: Callable[[int], float]) -> int | None:
    """The camera without which the others agree; None if there is none.

    For three cameras on a line only one displacement is redundant: whichever is left out, the other two
    agree, so the camera that moved along the line cannot be identified.

    Examples
    --------
    >>> outlier_camera(3, 500.0, lambda n: 1.0 if n == 1 else 400.0)
    1
    >>> outlier_camera(3, 500.0, lambda n: 400.0 if n == 1 else 1.0) is None
    True
    """
    if n_cameras < 3 or not misfit > MAX_MISFIT:
        return None
    limit = min(MAX_MISFIT, 0.1 * misfit)
    explain = [n for n in range(n_cameras) if misfit_without(n) < limit]
    return explain[0] if len(explain) == 1 else None


def median_misfit(misfit: Float, measured: Mask) -> float:
    """Median misfit (ny, nx) over the nodes measured by all cameras; 0 if there are few."""
    good = measured & np.isfinite(misfit)
    return float(np.median(misfit[good])) if good.sum() >= MIN_NODES else 0.0


def inconsistent_pairs(matches: Sequence[PairMatch], pixel: float) -> Mask:
    """Blocks at which pairs of cameras give different surfaces, (ny, nx); pixel in metres.
    Means over 5 x 5 blocks differ by more than 1.5 px of parallax; two blocks around are included.
    """
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
    """Blocks (ny, nx), and two around, where sum s / sum H over 9 x 9 differs by over 0.75 px of parallax.
    Scores s, Hessians H and parallax lengths (px per metre) of the pairs are (ny, nx).
    """
    means = [
        (cv2.blur(s, _SCORE_MEAN_BLOCKS), cv2.blur(h, _SCORE_MEAN_BLOCKS))
        for s, h in zip(scores, hessians, strict=True)
    ]
    # at the surface to which both are brought only noise is left: a std of 0.02 to 0.07 px on bright and on
    # dark images, 0.36 px at most; complete matches may differ by much more and yet a bead's width hides it
    out = np.zeros(scores[0].shape, bool)
    for ((s, h), a), ((t, g), b) in pairwise(zip(means, lengths, strict=True)):
        least = np.float32(_MIN_RELATIVE_HESSIAN)
        usable = (h > least * h.mean()) & (g > least * g.mean())
        heights = [np.divide(p, q, out=np.zeros_like(p), where=usable) for p, q in ((s, h), (t, g))]
        difference = (heights[0] - heights[1]) * np.minimum(a, b)
        out |= np.abs(difference) > np.float32(_MAX_SCORE_DIFFERENCE_PX)
    return widened(out)


def widened(where: Mask) -> Mask:
    """Blocks and their neighbours within two blocks, the reach of windows."""
    return np.asarray(cv2.dilate(where.view(np.uint8), _WINDOW_REACH) > 0)
