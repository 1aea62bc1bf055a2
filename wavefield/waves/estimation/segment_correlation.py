"""Correlation of overlapping segments, from the spectrum that they hold."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.waves.estimation.windows import hann_power, richardson_lucy

Array = NDArray[Any]

FREQUENCIES_PER_LINE = 2
REACH = 4.0  # lines to either side that respond to a wave
ROUNDS = 4
FLOOR = 1e-12  # of the strongest line


def expected_segment_correlation(power: Array, count: int, furthest: int = 2) -> Array:
    """Variance of a mean of segments over that of independent segments, from their power (n, lines).
    1 + 2 sum_L (1 - L / K) |int S W^2 exp(i omega L T / 2) domega|^2 / (int S W^2 domega)^2, (n, lines).
    """
    lines = np.arange(power.shape[1])
    fine = np.arange(FREQUENCIES_PER_LINE * (lines.size - 1) + 1) / FREQUENCIES_PER_LINE
    distance = np.abs(lines[:, None] - fine)
    response = np.where(distance <= REACH, hann_power(distance), 0.0)
    measured = np.maximum(power, max(FLOOR * float(power.max()), 1e-300))
    # S, sharpened in four rounds, is the spectrum, W^2 the window's power about the line, T the length of a
    # segment; waves that keep their phase for longer than a window resolves correlate segments more
    sharp = richardson_lucy(
        measured,
        np.exp([np.interp(fine, lines, np.log(spectrum)) for spectrum in measured]),
        lambda estimate: estimate @ response.T,
        lambda estimate, ratio: estimate * (ratio @ response / response.sum(axis=0)),
        ROUNDS,
    )
    total = sharp @ response.T
    out = np.ones(power.shape)
    for lag in range(1, furthest + 1):
        shifted = (sharp * np.exp(1j * np.pi * lag * fine)) @ response.T
        out += 2 * max(1 - lag / count, 0.0) * np.abs(shifted) ** 2 / total**2
    return out
