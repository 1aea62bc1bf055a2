"""Spread of values among which there are blunders: once, for every room."""

import numpy as np
from numpy.typing import NDArray

PER_MEDIAN = 1.4826  # standard deviation of a normal distribution over its median absolute value


def robust_std(values: NDArray[np.floating]) -> float:
    """Standard deviation that a few blunders do not move: 1.4826 times the median of absolute values.

    Examples
    --------
    >>> robust_std(np.array([-1.0, 1.0, 1.0, 1000.0]))
    1.4826
    """
    return PER_MEDIAN * float(np.median(np.abs(values))) if values.size else 0.0
