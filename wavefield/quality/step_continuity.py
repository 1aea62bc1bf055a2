"""How each step continues its neighbours: the factor between its velocities and those that they predict.

A wave that turns by the phase p from step to step has v(k) = a (v(k-1) + v(k+1)) + b (v(k-2) + v(k+2)), with
c = cos p, a = 2 c / (2 c^2 + 1) and b = -1 / (2 (2 c^2 + 1)); a wave of another phase p' departs from it by
2 (cos p' - c)^2 / (2 c^2 + 1) only, and c is the correlation of consecutive steps. The mean over the field
has a c of its own, for long waves turn less, and beside it a current, which does not turn.

From v(k-1) + v(k+1) = 2 c v(k) every step has a cosine of its own, which hardly varies in a sound record.
Over a lost frame water moves by 2 cos(p/2) as much and both neighbours are 1.5 intervals away: the cosine of
such a step is c - 1/2, whatever the phase, and that of its neighbours c + c^2 - 1/2, so that it shows in few
steps and where waves turn fast. Of waves longer than the field the cosine is small as well when their slope
vanishes in it, but then so is the motion.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]

_PATCHES = 12  # along the shorter side of the field: means over them leave long waves
_CELLS = 3  # along either side: parts of the field whose factors are compared
MIN_CELLS = 4  # with fewer the factor of a step is unknown
_REACH = 8  # steps to either side which the phase is determined from
_PREDICTING = 2  # steps to either side which a step is predicted from
_LEAST_RATIO = 1e-6  # of factors: of no motion
_NEAR = 4  # steps to either side which a cosine is compared with
MIN_STEPS = 3  # with fewer factors none departs
_SIGNIFICANCE = 4.0  # standard deviations by which a factor has to depart
_MIN_MOTION = 0.85  # mean square of a step over a lost frame, over that of its neighbours
_MIN_NEIGHBOUR_DROP = 0.33  # of what waves of one phase have
_MIN_COSINE_DROP = 0.2  # of a step, below those around it: 0.5 over a lost frame, less with noise


@dataclass(frozen=True)
class StepFactors:
    """Factor of each step, (n,), its variance by what differs within the field, and the weights, (n, 5), by
    which an error of steps k - 2 to k + 2 changes it; its cosine, the variance of that, and the mean square
    of its motion over that of both neighbours; NaN where unknown.
    """

    factor: Array
    variance: Array
    weights: Array
    cosine: Array
    cosine_variance: Array
    motion: Array

    def discontinuous(self, limit: float) -> NDArray[np.intp]:
        """Steps whose factor departs by more than a part of it, or that have the cosine of a lost frame;
        of those within two steps, which such a step predicts wrongly, the one that departs most.
        """
        departure = self._uneven(limit)
        departure[self._over_lost_frames()] = np.inf
        around = sliding_window_view(np.pad(departure, _PREDICTING), 2 * _PREDICTING + 1).max(axis=1)
        return np.flatnonzero((departure > 0) & (departure == around))

    def _uneven(self, limit: float) -> Array:
        """Logarithm of the factor over the median around it, (n,), where it departs by more than a part of
        it, significantly; else 0.
        """
        median = np.full(self.factor.size, np.nan)
        for k in np.flatnonzero(np.isfinite(self.factor)):
            near = self.factor[max(k - _REACH, 0) : k + _REACH + 1]
            if np.isfinite(near).sum() >= MIN_STEPS:
                median[k] = np.nanmedian(near)
        off = np.abs(self.factor - median)
        uneven = (off > limit * np.abs(median)) & (off > _SIGNIFICANCE * np.sqrt(self.variance))
        ratio = np.divide(self.factor, median, where=uneven, out=np.ones(median.size))
        return np.asarray(np.abs(np.log(np.maximum(ratio, _LEAST_RATIO))))

    def _over_lost_frames(self) -> NDArray[np.intp]:
        """Steps whose cosine is less than the median around and those two steps away, significantly, and
        whose motion is not. Where waves turn by more than an eighth of a circle, the cosines beside them have
        to be less as well. Of the two steps at either end too few are known.
        """
        around, beside = np.full((2, self.cosine.size), np.nan)
        for k in range(2, self.cosine.size - 2):
            apart = abs(np.arange(self.cosine.size) - k)
            near = self.cosine[(apart > 1) & (apart <= _NEAR) & np.isfinite(self.cosine)]
            if near.size >= MIN_STEPS:
                # beside other lost frames cosines exceed 1
                around[k] = np.nanmin([1.0, np.median(near), *self.cosine[apart == 2]])
                beside[k] = np.mean(self.cosine[apart == 1])
        least = np.maximum(_MIN_COSINE_DROP, _SIGNIFICANCE * np.sqrt(self.cosine_variance))
        found = (around - self.cosine > least) & (self.motion > _MIN_MOTION)
        of_neighbours = 0.5 - np.square(around)  # by how much the cosines beside a lost frame are less
        shown = (of_neighbours < 0) | (around - beside > _MIN_NEIGHBOUR_DROP * of_neighbours)
        return np.flatnonzero(found & shown)

    def without(self, steps: NDArray[np.intp]) -> "StepFactors":
        """Without what is known of some steps."""
        left = ~np.isin(np.arange(self.factor.size), steps)
        factor, cosine = (np.where(left, one, np.nan) for one in (self.factor, self.cosine))
        return replace(self, factor=factor, cosine=cosine)


def patch_means(fields: Array, measured: Mask) -> Array:
    """Means of fields (..., ny, nx) over patches, (..., rows, columns); NaN where half or less of a patch is
    `measured`, (ny, nx).
    """
    size = max(min(measured.shape) // _PATCHES, 1)
    rows, columns = (n // size for n in measured.shape)

    def sums(values: Array) -> Array:
        cut = values[..., : rows * size, : columns * size]
        return np.asarray(cut.reshape(*cut.shape[:-2], rows, size, columns, size).sum(axis=(-3, -1)))

    count = sums(measured.astype(np.float64))
    with np.errstate(divide="ignore", invalid="ignore"):
        means = sums(np.where(measured, fields, 0.0)) / count
    return np.asarray(np.where(count > 0.5 * size**2, means, np.nan), np.float32)


def step_factors(means: Array) -> StepFactors:
    """Factors of steps from means over patches of their velocities, (n, 3, rows, columns), NaN in holes."""
    steps = len(means)
    factor, variance, own_cosine, cosine_variance, motion = np.full((5, steps), np.nan)
    weights = np.full((steps, 5), np.nan)
    if steps < 5 or min(means.shape[-2:]) < _CELLS:
        return StepFactors(factor, variance, weights, own_cosine, cosine_variance, motion)
    pairs = [_split(means[k : k + 2]) for k in range(steps - 1)]
    level = np.array([one[0] for one, _ in pairs] + [pairs[-1][0][1]])
    turned = np.array([_correlations(rest.reshape(2, -1)).item() for _, rest in pairs])
    for k in range(1, steps - 1):
        before, here, after = _split(means[k - 1 : k + 2])[1]
        own_cosine[k], cosine_variance[k] = _slope(0.5 * (before + after), here)
        beside = 0.5 * float(np.sum(np.square(before) + np.square(after)))
        if beside > 0:
            motion[k] = float(np.sum(np.square(here))) / beside
    for k in range(2, steps - 2):
        first, last = max(k - _REACH, 0), min(k + _REACH, steps - 1)
        cosine = _cosine(turned[first:last])
        of_level, constant = _level_waves(level[first : last + 1], cosine)
        of_rest = _weights(cosine)
        factor[k], variance[k], weights[k] = _factor(means[k - 2 : k + 3], of_level, constant, of_rest)
    return StepFactors(factor, variance, weights, own_cosine, cosine_variance, motion)


def _level_waves(level: Array, cosine: float) -> tuple[Array, Array]:
    """Weights of five steps for the waves in means over the field, (n, 3, 1, 1), and what does not turn.
    The cosine of shorter waves is the least: of half a wave, the median is not what does not turn.
    """
    turned = _correlations((level - np.median(level, axis=0)).reshape(len(level), -1))
    weights = _weights(max(_cosine(turned), cosine))
    waves = np.tensordot(sliding_window_view(level, 5, axis=0), weights, 1)
    return weights, np.median(level[2:-2] - waves, axis=0)


def _split(means: Array) -> tuple[Array, Array]:
    """Means over the field, (n, 3, 1, 1), and what departs from them; zero where any step has a hole."""
    usable = np.isfinite(means).all(axis=(0, 1))
    values = np.where(usable, means, 0.0).astype(np.float64)
    level = values.sum(axis=(-2, -1), keepdims=True) / max(int(usable.sum()), 1)
    return level, np.where(usable, values - level, 0.0)


def _correlations(values: Array) -> Array:
    """Correlations of consecutive rows of values, (n - 1,); NaN of zeros."""
    square = np.sum(np.square(values), axis=1)
    mean = 0.5 * (square[1:] + square[:-1])
    product = np.sum(values[1:] * values[:-1], axis=1)
    return np.asarray(np.divide(product, mean, np.full(mean.size, np.nan), where=mean > 0))


def _cosine(correlations: Array) -> float:
    """Cosine of the phase by which waves turn, from correlations of consecutive steps (n,)."""
    known = correlations[np.isfinite(correlations)]
    return float(np.clip(np.median(known), -1.0, 1.0)) if known.size else 1.0


def _weights(cosine: float) -> Array:
    """Of the steps k - 2 to k + 2, in what waves of this cosine of their phase have at step k."""
    return np.array([-0.5, 2.0 * cosine, 0.0, 2.0 * cosine, -0.5]) / (2.0 * cosine**2 + 1.0)


def _factor(means: Array, of_level: Array, constant: Array, of_rest: Array) -> tuple[float, float, Array]:
    """Factor of the third of five steps, its variance, and the weights of the steps in it."""
    usable = np.isfinite(means).all(axis=(0, 1))
    level, rest = _split(means)
    parts = of_level[:, None, None, None] * level + of_rest[:, None, None, None] * rest
    here = np.where(usable, level[2] + rest[2], 0.0)
    expected = np.where(usable, parts.sum(axis=0) + constant, 0.0)
    factor, spread = _slope(here, expected)
    square = float(np.sum(np.square(expected)))
    shares = np.array([float(np.sum(expected * part)) for part in parts])
    return factor, spread, np.eye(5)[2] - np.divide(shares, square, np.full(5, np.nan), where=square > 0)


def _slope(values: Array, on: Array) -> tuple[float, float]:
    """Slope of values on others, both (3, rows, columns), and its variance by what differs between cells of
    the field; NaN with few cells.
    """
    rows, columns = (np.linspace(0, n, _CELLS + 1).astype(int)[:-1] for n in values.shape[-2:])
    product, square = (
        np.add.reduceat(np.add.reduceat(part.sum(axis=0), rows, 0), columns, 1)
        for part in (values * on, np.square(on))
    )
    cells = int((square > 0).sum())
    if cells < MIN_CELLS:
        return np.nan, np.nan
    slope = float(product.sum() / square.sum())
    rest = (product - slope * square) / square.sum()
    return slope, cells / (cells - 1) * float(np.sum(np.square(rest)))
