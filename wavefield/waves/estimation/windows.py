"""Windows, degrees of freedom and confidence intervals of Welch's method; deconvolution from windows."""

from collections.abc import Callable

import numpy as np
from scipy import fft, special  # scipy.stats takes half a second to import

DEFAULT_SEGMENT = 512  # steps: 25.6 s at 20 Hz
CORRELATED_CELLS = 1 + 2 * (4 / 9 + 1 / 36)  # along an axis of a spectrum under a Hann window

CONFIDENCE = 0.95  # of the intervals of all spectra


def hann(n: int) -> np.ndarray:
    """Hann window with a half-sample offset, (n,): periodic, symmetric and without a zero sample."""
    return 0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(n) + 0.5) / n)


def hann_power(distance: np.ndarray) -> np.ndarray:
    """Energy of a long Hann window's line at distances from it, in lines; 1 at none."""
    off = np.where(np.abs(np.abs(distance) - 1) < 1e-9, 0.0, 1 - distance**2)
    with np.errstate(divide="ignore", invalid="ignore"):
        amplitude = np.where(off == 0, 0.5, np.sinc(distance) / off)
    return np.asarray(amplitude**2)


def segment_count(steps: int, segment: int) -> int:
    """Segments of length `segment`, overlapping by half, in `steps` steps."""
    half = segment // 2
    return max(steps // half - 1, 0)


def choose_segment(steps: int) -> int:
    """Segment length, even, for a record of so many steps."""
    longest = min(DEFAULT_SEGMENT, max(steps // 4, min(64, steps)))
    even = longest - longest % 2
    while even > 4 and fft.next_fast_len(even // 2, real=True) != even // 2:
        even -= 2
    return even


def degrees_of_freedom(segments: float) -> float:
    """Degrees of freedom of a spectral cell: neighbours have a squared correlation of 1/36 (Welch 1967)."""
    return 2 * segments / (1 + (1 - 1 / segments) / 18)


def effective_duration(segments: float, length: float) -> float:
    """Length of a record, weighted as by its Hann-windowed, half-overlapping segments, of this length."""
    return length * 18 * segments**2 / (38 * segments - 3)


def interval(dof: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """Confidence interval of a spectrum as factors."""
    dof = np.asarray(dof, float)
    unique, index = np.unique(dof, return_inverse=True)  # rings of all frequencies have the same
    tails = 0.5 + CONFIDENCE / 2, 0.5 - CONFIDENCE / 2
    low, high = (unique / (2 * special.gammaincinv(unique / 2, tail)) for tail in tails)  # of chi squared
    return low[index].reshape(dof.shape), high[index].reshape(dof.shape)


def richardson_lucy(
    measured: np.ndarray,
    estimate: np.ndarray,
    through_window: Callable[[np.ndarray], np.ndarray],
    corrected: Callable[[np.ndarray, np.ndarray], np.ndarray],
    rounds: int,
) -> np.ndarray:
    """Non-negative estimate that a window turns into what was measured (Richardson 1972, Lucy 1974).
    ``corrected(estimate, ratio)`` multiplies it by measured / ``through_window(estimate)``, window-averaged.
    """
    for _ in range(rounds):
        estimate = corrected(estimate, measured / through_window(estimate))
    return estimate
