"""Deconvolution of spectra from windows, by the method of Richardson (1972) and Lucy (1974)."""

from collections.abc import Callable
from typing import Any

from numpy.typing import NDArray

Array = NDArray[Any]


def richardson_lucy(
    measured: Array,
    estimate: Array,
    through_window: Callable[[Array], Array],
    corrected: Callable[[Array, Array], Array],
    rounds: int,
) -> Array:
    """Non-negative estimate that a window turns into what was measured.

    In each round ``corrected(estimate, ratio)`` multiplies the estimate by the ratio of the measured values
    to ``through_window(estimate)``, averaged with the window's weights.
    """
    for _ in range(rounds):
        estimate = corrected(estimate, measured / through_window(estimate))
    return estimate
