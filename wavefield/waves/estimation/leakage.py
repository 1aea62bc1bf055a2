"""What a window lets through of neighbouring frequencies, where a spectrum is integrated in time.

A line of the spectrum of w holds waves of frequencies around it, steeply more of some than of others, and
each has its own factor to the elevation. Which frequencies it holds follows from the spectrum itself.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.waves.estimation.transfer_functions import elevation_from_w
from wavefield.waves.estimation.welch import LOWEST
from wavefield.waves.estimation.windows import hann

Array = NDArray[Any]

_FINE = 4  # frequencies to a line
_ROUNDS = 60
_LOBE = 2.0  # lines: half the width of the window's main lobe
_NOTHING = 1e-12  # of the strongest line


@dataclass(frozen=True)
class Leakage:
    """What lines of E(omega) of w hold."""

    # (omega,): Factors for the spectrum of the elevation from w, and for that from its cross spectrum with z,
    # after the factor of the line's own frequency
    w: Array
    cross: Array
    # (omega,): Fraction of the line that comes from within the window's main lobe; below the strongest line
    # never more than of those between
    own: Array


def leakage(energy: Array, dt: float, frames: int) -> Leakage:
    """What the lines of a spectrum of w hold of other frequencies than their own.

    The spectrum before the window, on four frequencies to a line, is found by 60 rounds of Richardson's and
    Lucy's method; multiplied by the elevation's factor and seen through the window again it gives the
    elevation's. The two lowest lines, from which mean and trend are taken off, are left as they are.

    With energy (n // 2 + 1,).

    Examples
    --------
    Of a single wave at 1 Hz the lines beside it hold nothing but that wave: their factor is that of 1 Hz.

    >>> energy = np.zeros(65)
    >>> energy[5:8] = 1, 4, 1  # 6.4 s: the wave has .94 Hz
    >>> leakage(energy, 0.05, 2).w[5:8].round(2)
    array([0.72, 1.  , 1.32])
    """
    half = energy.size - 1
    lines = np.pi * np.arange(half + 1) / (half * dt)
    ones = np.ones(half + 1)
    strongest = float(energy[LOWEST:].max(initial=0.0))
    if not strongest > 0:
        return Leakage(ones, ones, ones)
    fine = (np.arange(half * _FINE) + 0.5) * lines[1] / _FINE
    seen, near = _window(lines, fine)
    given = np.maximum(energy, _NOTHING * strongest)
    spectrum = np.interp(fine, lines, given)
    used = seen[LOWEST:]
    area = used.sum(axis=0)
    for _ in range(_ROUNDS):
        ratio = given[LOWEST:] / _sum(used, spectrum)
        spectrum = spectrum * np.einsum("lf,l->f", used, ratio) / area
    factor, own = elevation_from_w(fine, dt, frames), elevation_from_w(lines[LOWEST:-1], dt, frames)
    whole, half_way, all_ = (
        _sum(seen, spectrum * each)[LOWEST:-1] for each in (factor, np.sqrt(factor), np.ones_like(factor))
    )
    w, cross, of_own = ones.copy(), ones.copy(), ones.copy()
    inner = slice(LOWEST, -1)
    w[inner] = whole / all_ / own
    cross[inner] = whole / half_way / np.sqrt(own)
    of_own[inner] = _sum(seen * near, spectrum)[inner] / all_
    peak = LOWEST + int(np.argmax(energy[LOWEST:]))
    of_own[: peak + 1] = np.minimum.accumulate(of_own[peak::-1])[::-1]
    return Leakage(w, cross, of_own)


def _sum(seen: Array, spectrum: Array) -> Array:
    # not a matrix product: that of BLAS may depend on the number of threads in the last bit
    return np.asarray(np.einsum("lf,f->l", seen, spectrum))


def _window(lines: Array, fine: Array) -> tuple[Array, Array]:
    # what each line sees of each frequency and of its negative, and which are in the main lobe
    n = 2 * (lines.size - 1)
    window = hann(n)
    power = np.abs(np.fft.fft(window, 2 * _FINE * n)) ** 2 / (window**2).sum()
    apart = np.subtract.outer(lines, fine) / lines[1]
    together = np.add.outer(lines, fine) / lines[1]
    seen = sum(power[np.rint(2 * _FINE * off).astype(int) % power.size] for off in (apart, together))
    return np.asarray(seen), np.abs(apart) < _LOBE
