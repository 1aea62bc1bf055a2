"""Which of many tests are significant: probabilities from surrogates, and false discoveries held low."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

_TAIL = 0.02  # of the surrogates, to which the tail of the null is fitted


def probabilities(score: Array, null: Array) -> Array:
    """Probability that chance gives a score at least as high."""
    null = np.sort(null)
    edge = null[int((1 - _TAIL) * (null.size - 1))]
    scale = float((null[null > edge] - edge).mean())
    count = null.size - np.searchsorted(null, score, "left")
    return np.where(score > edge, _TAIL * np.exp(-(score - edge) / scale), (count + 1) / (null.size + 1))


def significant_tests(p: Array, false: float) -> Array:
    """Which of many tests are significant (Benjamini and Hochberg 1995).

    With p (n,); returns (n,).

    Examples
    --------
    >>> significant_tests(np.array([0.001, 0.5, 0.02, 0.9]), 0.05).tolist()
    [True, False, True, False]
    """
    order = np.argsort(p)
    below = np.flatnonzero(p[order] <= false * np.arange(1, p.size + 1) / max(p.size, 1))
    out = np.zeros(p.size, bool)
    if below.size:
        out[order[: below[-1] + 1]] = True
    return out
