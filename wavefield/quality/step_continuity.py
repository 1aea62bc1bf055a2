"""How each step continues its neighbours: the factor between its velocities and those that they predict.

A wave that turns by the phase p from step to step has v(k) = a (v(k-1) + v(k+1)) + b (v(k-2) + v(k+2)), with
c = cos p, a = 2 c / (2 c^2 + 1) and b = -1 / (2 (2 c^2 + 1)); a wave of another phase p' departs from it by
2 (cos p' - c)^2 / (2 c^2 + 1) only, and c is the correlation of consecutive steps. The mean over the field
has a c of its own, for long waves turn less, and beside it a current, which does not turn.
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
MIN_STEPS = 3  # with fewer factors none departs
_SIGNIFICANCE = 4.0  # standard deviations by which a factor has to depart


@dataclass(frozen=True)
class StepFactors:
    """Factor of each step, (n,), its variance by what differs within the field, and the weights, (n, 5), by
    which an error of steps k - 2 to k + 2 changes it; NaN where unknown.
    """

    factor: Array
    variance: Array
    weights: Array

    def discontinuous(self, limit: float) -> NDArray[np.intp]:
        """Steps whose factor departs from the median around it by more than a part of it, significantly."""
        median = np.full(self.factor.size, np.nan)
        for k in np.flatnonzero(np.isfinite(self.factor)):
            near = self.factor[max(k - _REACH, 0) : k + _REACH + 1]
            if np.isfinite(near).sum() >= MIN_STEPS:
                median[k] = np.nanmedian(near)
        off = np.abs(self.factor - median)
        return np.flatnonzero((off > limit * np.abs(median)) & (off > _SIGNIFICANCE * np.sqrt(self.variance)))

    def without(self, steps: NDArray[np.intp], reach: int = 2) -> "StepFactors":
        """Without some steps and those beside them, up to `reach` steps away."""
        apart = np.abs(np.subtract.outer(np.arange(self.factor.size), steps))
        return replace(
            self, factor=np.where(apart.min(axis=1, initial=reach + 1) <= reach, np.nan, self.factor)
        )


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
    factor, variance = np.full((2, steps), np.nan)
    weights = np.full((steps, 5), np.nan)
    if steps < 5 or min(means.shape[-2:]) < _CELLS:
        return StepFactors(factor, variance, weights)
    pairs = [_split(means[k : k + 2]) for k in range(steps - 1)]
    level = np.array([one[0] for one, _ in pairs] + [pairs[-1][0][1]])
    turned = np.array([_correlations(rest.reshape(2, -1)).item() for _, rest in pairs])
    for k in range(2, steps - 2):
        first, last = max(k - _REACH, 0), min(k + _REACH, steps - 1)
        cosine = _cosine(turned[first:last])
        of_level, constant = _level_waves(level[first : last + 1], cosine)
        of_rest = _weights(cosine)
        factor[k], variance[k], weights[k] = _factor(means[k - 2 : k + 3], of_level, constant, of_rest)
    return StepFactors(factor, variance, weights)


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
    rows, columns = (np.linspace(0, n, _CELLS + 1).astype(int)[:-1] for n in usable.shape)
    product, square = (
        np.add.reduceat(np.add.reduceat(part.sum(axis=0), rows, 0), columns, 1)
        for part in (here * expected, np.square(expected))
    )
    cells = int((square > 0).sum())
    if cells < MIN_CELLS:
        return np.nan, np.nan, np.full(5, np.nan)
    factor = float(product.sum() / square.sum())
    rest_of_cells = (product - factor * square) / square.sum()
    shares = np.array([float(np.sum(expected * part)) for part in parts]) / float(square.sum())
    return factor, cells / (cells - 1) * float(np.sum(np.square(rest_of_cells))), np.eye(5)[2] - shares
