"""Probability of a score by chance, from the scores of surrogates."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

TAIL = 0.02  # of the surrogates: their tail is extrapolated by an exponential


def probabilities(score: Array, null: Array) -> Array:
    """Probability that chance gives a score at least as high."""
    null = np.sort(null)
    edge = null[int((1 - TAIL) * (null.size - 1))]
    scale = float((null[null > edge] - edge).mean())
    count = null.size - np.searchsorted(null, score, "left")
    return np.where(score > edge, TAIL * np.exp(-(score - edge) / scale), (count + 1) / (null.size + 1))
