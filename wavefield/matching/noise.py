"""Noise of the blocks' scores, from the variance of clusters of blocks, and holes without information."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Float = NDArray[Any]
Mask = NDArray[np.bool_]

F = np.float32
CLUSTER = 5  # blocks: closer neighbours share beads (25 px), and so have correlated noise
SMOOTHING_RADIUS = 6.0  # blocks over which noise is averaged
HOLE_INFORMATION = 0.15  # of the typical information, mean of 7 x 7 blocks: below is a hole
# a cluster's squared score over that expected from its surroundings; an exponential exceeds it once in 10^13
MAX_MISFIT = 30.0
LEAST_NOISE = 0.3  # of the median noise: lower bound of the noise expected from the surroundings


def noise_of_scores(
    score: Float, trace: Float, counts: Float, freedom: float, with_mismatches: bool = False
) -> Float:
    """Variance nu of the scores (c, ny, nx) per unit of their Hessian, (ny, nx), from clusters of blocks.

    The squared scores and the Hessians of clusters of 5 x 5 usable blocks are smoothed over 6 blocks and
    divided. `trace` is the sum of the Hessian's diagonal, `counts` is 1 for usable blocks and 0 for others,
    `freedom` is the fraction of the variance that remains after the fit (`Modes.freedom`). A fifth of the
    mean information, with the typical noise, is added to regularize the ratio. The typical noise is the mean,
    or the median where parts of the images may not match, as where beads leave the image between two frames.
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
    """Weight of each block, (ny, nx), at most 1: lower in clusters whose scores far exceed those around.
    That happens at edges of objects and where beads enter or leave. Arguments as for `noise_of_scores`.
    """
    square = np.sum([np.square(_clusters(part * counts)) for part in score], axis=0)
    information = _clusters(trace * counts)
    least = F(HOLE_INFORMATION) * information.mean()
    ratio = square / np.maximum(information, F(1e-20))
    # medians over 5 x 5 disjoint clusters: an object does not raise them; their squares are exponential
    # with a median of log 2 times the mean.
    apart, known = (field[:: CLUSTER - 1, :: CLUSTER - 1] for field in (ratio, information > least))
    typical = np.median(apart[known]) if known.any() else F(0)
    around = cv2.medianBlur(np.where(known, apart, typical).astype(np.float32), CLUSTER) / F(np.log(2))
    around = cv2.resize(np.maximum(around, F(LEAST_NOISE) * typical), trace.shape[::-1])
    limit = np.where(information > least, F(MAX_MISFIT) * around, np.inf)
    trust = np.square(np.minimum(limit / np.maximum(ratio, F(1e-30)), F(1)))
    return cv2.erode(trust.astype(np.float32), np.ones((CLUSTER, CLUSTER), np.uint8))


def hole_mask(information: Float, typical_information: float) -> Mask:
    """Mask (ny, nx) of blocks in holes, from the information (ny, nx) around them."""
    return np.asarray(
        cv2.blur(np.asarray(information, np.float32), (7, 7)) <= HOLE_INFORMATION * typical_information
    )


def _clusters(field: Float) -> Float:
    size = (CLUSTER, CLUSTER)
    return cv2.boxFilter(field, cv2.CV_32F, size, normalize=False, borderType=cv2.BORDER_REFLECT)


def _smoothed(field: Float) -> Float:
    ny, nx = field.shape  # neighbouring blocks are correlated: every second one suffices
    half = cv2.resize(field, ((nx + 1) // 2, (ny + 1) // 2), interpolation=cv2.INTER_AREA)
    return cv2.GaussianBlur(half, (0, 0), 0.5 * SMOOTHING_RADIUS, borderType=cv2.BORDER_REFLECT)
