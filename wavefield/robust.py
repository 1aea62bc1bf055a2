"""Estimators that are insensitive to outliers."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

PER_MEDIAN = 1.4826  # standard deviation of a normal distribution over its median absolute deviation


def robust_std(values: NDArray[np.floating]) -> float:
    """Return a standard deviation about 0 that ignores outliers: 1.4826 times the median absolute value.
    It is 0 if `values` is empty."""
    return PER_MEDIAN * float(np.median(np.abs(values))) if values.size else 0.0


def reweighted_lstsq(
    design: NDArray[np.float64],
    values: NDArray[np.float64],
    weight: NDArray[np.float64],
    reweight: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    iterations: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fit `design` (n, p) @ solution = `values` (n, ...) by repeated weighted least squares.
    Equations are multiplied by `weight` (n,) in the first fit, by ``reweight(residual)`` in later ones.
    Returns the solution (p, ...) and the unweighted residuals (n, ...) of the last of `iterations` fits."""
    for _ in range(iterations):
        rows = weight.reshape(-1, *[1] * (values.ndim - 1))
        solution = np.asarray(np.linalg.lstsq(design * weight[:, None], values * rows, rcond=None)[0])
        residual = values - design @ solution
        weight = reweight(residual)
    return solution, residual
