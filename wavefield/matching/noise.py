"""Noise of the blocks' scores, blocks that do not match, and holes without information.

Blocks up to five apart share beads, so the noise of their scores is correlated. It is therefore measured from
sums of the scores over clusters of 5 x 5 blocks.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Float = NDArray[Any]
Mask = NDArray[np.bool_]

F = np.float32
CLUSTER = 5  # blocks along each side: the noise of closer blocks is correlated, because they share beads
SMOOTHING_RADIUS = 6.0  # blocks: standard deviation of the Gaussian that averages the noise
HOLE_INFORMATION = 0.15  # a hole has less than this fraction of the typical information, over 7 x 7 blocks
# largest squared score of a cluster over its expected value; noise (an exponential variable) exceeds it once
# in 10^13
MAX_MISFIT = 30.0
LEAST_NOISE = 0.3  # lower bound of the noise expected around a cluster, over the median noise of the image


def noise_of_scores(
    score: Float, trace: Float, counts: Float, freedom: float, with_mismatches: bool = False
) -> Float:
    """Return the noise nu of the scores of blocks, (ny, nx): their variance per unit of their Hessian.

    `score` is (c, ny, nx), `trace` (ny, nx) that of the Hessian, `counts` 1 for usable blocks. nu is the
    squared score of clusters of 5 x 5 blocks over their trace, smoothed over 6 blocks, over the fraction
    `freedom` that a fit leaves. Where the trace is small, nu approaches the image's mean, or median if
    `with_mismatches`.
    """
    complete = (_clusters(counts) > CLUSTER**2 - 0.5).astype(np.float32)
    square = np.zeros_like(trace)
    for part in score:
        square += np.square(_clusters(part * counts))
    square *= complete
    expected = _clusters(trace * counts) * complete
    total = float(square.sum(dtype=np.float64)) / max(float(expected.sum(dtype=np.float64)), 1e-30)
    if not complete.any():  # fall back to single blocks
        total = float(np.square(score * counts).sum()) / max(float((trace * counts).sum()), 1e-30)
    least_information = F(max(0.2 * float(expected.mean()), 1e-20))
    square, expected = _smoothed(square), _smoothed(expected)
    known = expected > least_information
    if with_mismatches and known.any():
        total = float(np.median(square[known] / expected[known]))
    out = (square + least_information * F(total)) / ((expected + least_information) * F(freedom))
    ny, nx = trace.shape
    return cv2.resize(np.maximum(out, F(1e-12)), (nx, ny), interpolation=cv2.INTER_LINEAR)


def trust_in_scores(score: Float, trace: Float, counts: Float) -> Float:
    """Return a weight of each block, (ny, nx), below 1 where scores are far above the noise around.
    That is at edges of objects and where beads enter or leave. Arguments: see `noise_of_scores`."""
    square = np.sum([np.square(_clusters(part * counts)) for part in score], axis=0)
    information = _clusters(trace * counts)
    least = F(HOLE_INFORMATION) * information.mean()
    ratio = square / np.maximum(information, F(1e-20))
    # The median of 5 x 5 disjoint clusters is not raised by a small object. Squared scores are exponential
    # variables, whose median is log 2 times the mean.
    apart, known = (field[:: CLUSTER - 1, :: CLUSTER - 1] for field in (ratio, information > least))
    typical = np.median(apart[known]) if known.any() else F(0)
    around = cv2.medianBlur(np.where(known, apart, typical).astype(np.float32), CLUSTER) / F(np.log(2))
    around = cv2.resize(np.maximum(around, F(LEAST_NOISE) * typical), trace.shape[::-1])
    limit = np.where(information > least, F(MAX_MISFIT) * around, np.inf)
    trust = np.square(np.minimum(limit / np.maximum(ratio, F(1e-30)), F(1)))
    return cv2.erode(trust.astype(np.float32), np.ones((CLUSTER, CLUSTER), np.uint8))


def hole_mask(information: Float, typical_information: float) -> Mask:
    """Return a mask (ny, nx) of blocks in holes, where 7 x 7 blocks have little information on average.
    That is at most 0.15 of the typical one. `information` (ny, nx) is the inverse variance of each block."""
    return np.asarray(
        cv2.blur(np.asarray(information, np.float32), (7, 7)) <= HOLE_INFORMATION * typical_information
    )


def _clusters(field: Float) -> Float:
    """Return the sums of a field (ny, nx) over 5 x 5 blocks around every block, (ny, nx)."""
    size = (CLUSTER, CLUSTER)
    return cv2.boxFilter(field, cv2.CV_32F, size, normalize=False, borderType=cv2.BORDER_REFLECT)


def _smoothed(field: Float) -> Float:
    """Smooth a field (ny, nx) with a Gaussian of 6 blocks; the result has half as many rows and columns."""
    ny, nx = field.shape  # clusters around neighbouring blocks overlap, so every second one suffices
    half = cv2.resize(field, ((nx + 1) // 2, (ny + 1) // 2), interpolation=cv2.INTER_AREA)
    return cv2.GaussianBlur(half, (0, 0), 0.5 * SMOOTHING_RADIUS, borderType=cv2.BORDER_REFLECT)
