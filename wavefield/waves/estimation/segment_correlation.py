"""How alike overlapping segments are, by the spectrum of what they hold."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.waves.estimation.windowed_dispersion import hann_power

Array = NDArray[Any]

_FINE = 2  # frequencies a line
_REACH = 4.0  # lines to either side that a wave is seen in
_ROUNDS = 4  # in which the spectrum is sharpened
_FLOOR = 1e-12  # of the strongest line


def expected_segment_correlation(power: Array, count: int, furthest: int = 2) -> Array:
    """How many times as large the variance of a mean of segments is as if none were alike.

    A line that sees one frequency, as beside the end of a sea, has the same power in segments that follow
    each other; one in the midst of an even spectrum has 1/36 in common. S is the spectrum given, sharpened in
    four rounds (Richardson and Lucy) at two frequencies a line; waves that stay alike for longer than the
    window tells make segments more alike than this.

    With power (n, lines); returns (n, lines): 1 + 2 sum_L (1 - L / K) |int S W^2 exp(i omega L T / 2)
    domega|^2 / (int S W^2 domega)^2, T the length of a segment, W^2 the window's power about the line.

    Examples
    --------
    An even spectrum, and the flank of a single wave between two lines.

    >>> flat = expected_segment_correlation(np.ones((1, 64)), 9)[0, 32]
    >>> wave = expected_segment_correlation(hann_power(np.arange(64.0) - 30.5)[None], 9)[0, 32]
    >>> round(float(flat), 2), bool(wave > 2)
    (1.05, True)
    """
    lines = np.arange(power.shape[1])
    place = np.arange(_FINE * (lines.size - 1) + 1) / _FINE
    apart = np.abs(lines[:, None] - place)
    seen = np.where(apart <= _REACH, hann_power(apart), 0.0)
    measured = np.maximum(power, max(_FLOOR * float(power.max()), 1e-300))
    sharp = np.exp([np.interp(place, lines, np.log(spectrum)) for spectrum in measured])
    for _ in range(_ROUNDS):
        sharp *= (measured / (sharp @ seen.T)) @ seen / seen.sum(axis=0)
    whole = sharp @ seen.T
    out = np.ones(power.shape)
    for behind in range(1, furthest + 1):
        turned = (sharp * np.exp(1j * np.pi * behind * place)) @ seen.T
        out += 2 * max(1 - behind / count, 0.0) * np.abs(turned) ** 2 / whole**2
    return np.asarray(out)
