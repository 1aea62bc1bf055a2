"""Jitter of the frame times, from stored velocities that are too large and too small in turn.

All cameras share the time of a frame. Where it comes late, all displacements of the step before it are too
large and those of the step after it too small, by one factor over the whole field. The factor of a step shows
beside its four neighbours in what moves slowly: in means over parts of the field. What waves change in a step
differs from place to place, jitter does not.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special  # scipy.stats takes half a second to import

from wavefield.variables import PATH_WEIGHTS

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]

_PATCHES = 12  # along the shorter side of the field: means over them leave long waves
_CELLS = 3  # along either side: parts of the field whose factors are compared
_MIN_CELLS = 4
_MIN_STEPS = 3
_CHANCE = 1e-3  # of a sound record with as large a difference between steps
_MAX_MISFIT = 0.15  # of the median factor from 1: waves are too fast for neighbours to predict
_NEIGHBOURS = np.array([-1.0, 4.0, 0.0, 4.0, -1.0]) / 6.0


@dataclass(frozen=True)
class FrameJitter:
    """Jitter of the frame times, rms, in frame intervals, and the relative error of velocities by it."""

    intervals: float
    velocity: float


def step_factor(velocity: Sequence[Array], measured: Sequence[Mask]) -> tuple[float, float] | None:
    """Factor of a step beside its neighbours, and its variance by what differs within the field.
    Velocities (3, ny, nx) and masks (ny, nx) of five steps; None where too little is measured.
    """
    there = np.logical_and.reduce(measured)
    size = max(min(there.shape) // _PATCHES, 1)
    rows, columns = (n // size for n in there.shape)
    if min(rows, columns) < _CELLS:
        return None

    def patches(field: Array) -> Array:
        cut = field[..., : rows * size, : columns * size]
        return np.asarray(cut.reshape(*cut.shape[:-2], rows, size, columns, size).sum(axis=(-3, -1)))

    count = patches(there.astype(np.float64))
    usable = count > 0.5 * size**2
    means = np.stack([patches(np.where(there, one, 0.0)) for one in velocity]) / np.maximum(count, 1.0)
    expected = np.tensordot(_NEIGHBOURS, means, 1)
    products = np.where(usable, (means[2] * expected).sum(axis=0), 0.0)
    squares = np.where(usable, np.square(expected).sum(axis=0), 0.0)
    edges = [np.linspace(0, n, _CELLS + 1).astype(int)[:-1] for n in (rows, columns)]
    product, square = (
        np.add.reduceat(np.add.reduceat(f, edges[0], 0), edges[1], 1) for f in (products, squares)
    )
    cells = int((square > 0).sum())
    if cells < _MIN_CELLS:
        return None
    factor = float(product.sum() / square.sum())
    rest = (product - factor * square) / square.sum()
    return factor, cells / (cells - 1) * float(np.sum(np.square(rest)))


def frame_jitter(factors: Array, variances: Array, path_frames: int) -> FrameJitter | None:
    """Jitter from the factors of steps and their variances (n,), NaN where unknown; None where none shows."""
    known = np.isfinite(factors)
    if known.sum() < _MIN_STEPS:
        return None
    misfit = float(np.median(factors[known])) - 1.0
    if abs(misfit) > _MAX_MISFIT:
        return None
    between, within = float(np.var(factors[known], ddof=1)), float(np.mean(variances[known]))
    freedom = int(known.sum()) - 1, int(known.sum()) * (_MIN_CELLS - 1)
    # how fast waves turn, and with it the misfit, varies as well, by less than half of it
    unexplained = max(within * float(special.fdtri(*freedom, 1.0 - _CHANCE)), 0.25 * misfit**2)
    if between <= unexplained:
        return None
    own, factor = _gains(path_frames)
    sigma = np.sqrt((between - within) / factor)
    return FrameJitter(float(sigma), float(sigma * np.sqrt(own)))


def _gains(path_frames: int) -> tuple[float, float]:
    """Variances of a step's velocity and of its factor, for frame times of variance 1."""
    half = PATH_WEIGHTS[path_frames]
    velocity = np.convolve([*half[:0:-1], *half], [1.0, -1.0])
    factor = np.convolve(np.eye(5)[2] - _NEIGHBOURS, velocity)
    return float(velocity @ velocity), float(factor @ factor)
