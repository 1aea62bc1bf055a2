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
    """Non-negative estimate that a window turns into what was measured, after some rounds.
    ``corrected(estimate, ratio)`` multiplies it by measured / ``through_window(estimate)``, window-averaged.
    """
    for _ in range(rounds):
        estimate = corrected(estimate, measured / through_window(estimate))
    return estimate
