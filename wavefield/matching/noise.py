"""How noisy the scores of blocks are, from how clusters of them scatter, and where blocks tell nothing."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Float = NDArray[Any]
Mask = NDArray[np.bool_]

F = np.float32
CLUSTER = 5  # blocks: neighbours closer than this share pixels, gradients and noise
_AROUND = 6.0  # blocks over which noise is taken as alike
_BARE = 0.15  # of the typical information, over 7 x 7 blocks: less is a hole
_UNEVEN = 0.25  # between the noise of both components: more is no noise, as of images that do not match
_RIM, _SOFT = 6, 2.0  # blocks: how far the surroundings of a hole reach, and how softly they end


def noise_of_scores(score: Float, trace: Float, counts: Float, freedom: float, torn: bool = False) -> Float:
    """The noise nu that scores have, from how clusters of them scatter.

    Parameters
    ----------
    score : ndarray of float32, (c, ny, nx)
        Scores of the blocks.
    trace : ndarray of float32, (ny, nx)
        Sum of the Hessian's diagonal.
    counts : ndarray of float32, (ny, nx)
        1 for blocks that count, else 0.
    freedom : float
        Fraction of the scores' variance that the fit itself has left in them (`Modes.freedom`).
    torn : bool, default False
        Some places may not match at all, as where beads leave the picture between two frames.

    Returns
    -------
    ndarray of float32, (ny, nx)
        Variance of a score over its Hessian.

    Notes
    -----
    Clusters are of 5 x 5 blocks, all of which count; their squares and Hessians are smoothed over 6 blocks. A
    tenth of the usual belongs to every place: few residuals say little. The usual is the mean; the median
    where some places do not match, which must not make the rest of them noisy.
    """
    full = (_clusters(counts) > CLUSTER**2 - 0.5).astype(np.float32)
    square = np.zeros_like(trace)
    for part in score:
        square += np.square(_clusters(part * counts))
    square *= full
    expected = _clusters(trace * counts) * full
    total = float(square.sum(dtype=np.float64)) / max(float(expected.sum(dtype=np.float64)), 1e-30)
    if not full.any():  # single blocks must do
        total = float(np.square(score * counts).sum()) / max(float((trace * counts).sum()), 1e-30)
    few = F(max(0.2 * float(expected.mean()), 1e-20))
    square, expected = _around(square), _around(expected)
    known = expected > few
    if torn and known.any():
        total = float(np.median(square[known] / expected[known]))
    out = (square + few * F(total)) / ((expected + few) * F(freedom))
    ny, nx = trace.shape
    return cv2.resize(np.maximum(out, F(1e-12)), (nx, ny), interpolation=cv2.INTER_LINEAR)


def along_each(score: Float, hessian: Float, counts: Float) -> tuple[float, float]:
    """How much more uncertain one component of a displacement is than the mean of both.

    Parameters
    ----------
    score : ndarray of float32, (2, ny, nx)
        Scores of the blocks.
    hessian : ndarray of float32, (3, ny, nx)
        H_xx, H_xy, H_yy.
    counts : ndarray of float32, (ny, nx)
        1 for blocks that count, else 0.

    Returns
    -------
    float, float
        Factors on the variance along columns and along rows, .75 to 1.25; their mean is 1.

    Notes
    -----
    A component's variance goes as med s^2 / (sum H)^2, s of clusters of 5 x 5 blocks, over the whole lattice:
    in a sum a corner where images do not match would outweigh all others.
    """
    full = _clusters(counts)[::2, ::2] > CLUSTER**2 - 0.5  # neighbours tell the same
    if not full.any():
        return 1.0, 1.0
    square = [float(np.median(np.square(_clusters(part * counts)[::2, ::2][full]))) for part in score]
    hessian_sums = [float((part * counts).sum(dtype=np.float64)) for part in hessian[::2]]
    if not all(value > 0 for value in (*square, *hessian_sums)):
        return 1.0, 1.0
    x, y = (noise / much**2 for noise, much in zip(square, hessian_sums, strict=True))
    more = min(max((x - y) / (x + y), -_UNEVEN), _UNEVEN)
    return 1.0 + more, 1.0 - more


def bare(information: Float, usual: float) -> Mask:
    """Blocks around which next to nothing is known.

    With information (ny, nx); returns (ny, nx).
    """
    return np.asarray(cv2.blur(np.asarray(information, np.float32), (7, 7)) <= _BARE * usual)


def around_holes(information: Float, factor: float) -> Float:
    """Factor on the noise of the scores that is larger around holes.

    Parameters
    ----------
    information : ndarray of float32, (ny, nx)
        A of the blocks.
    factor : float
        At the rim of a hole; it falls to 1 within some eight blocks.

    Returns
    -------
    ndarray of float32, (ny, nx)
        1 where there is no hole near; the lattice's edge is none.

    Notes
    -----
    Errors of blocks that show the same beads go together, but A thinks each block to err on its own. Inside a
    sea of blocks that matters little; a field that goes on into a hole goes on with such errors, and they
    grow with the distance.
    """
    hole = bare(information, float(information.mean())).view(np.uint8)
    hole[:_RIM] = hole[-_RIM:] = 0
    hole[:, :_RIM] = hole[:, -_RIM:] = 0
    if not hole.any():
        return np.ones_like(information)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _RIM + 3, 2 * _RIM + 3))
    rim = cv2.GaussianBlur(cv2.dilate(hole, disc).astype(np.float32), (0, 0), _SOFT)
    return np.asarray(F(1) + F(factor - 1) * rim)


def _clusters(field: Float) -> Float:
    size = (CLUSTER, CLUSTER)
    return cv2.boxFilter(field, cv2.CV_32F, size, normalize=False, borderType=cv2.BORDER_REFLECT)


def _around(field: Float) -> Float:
    ny, nx = field.shape  # every second block tells as much
    half = cv2.resize(field, ((nx + 1) // 2, (ny + 1) // 2), interpolation=cv2.INTER_AREA)
    return cv2.GaussianBlur(half, (0, 0), 0.5 * _AROUND, borderType=cv2.BORDER_REFLECT)
