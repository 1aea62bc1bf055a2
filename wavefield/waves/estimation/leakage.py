"""Leakage between the lines of a windowed spectrum, and its effect on an integration in time.

A line of the spectrum of w holds waves of the frequencies around it, mostly of the stronger side, and each
has its own factor to the elevation. Which frequencies a line holds follows from the spectrum itself.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.waves.estimation.transfer_functions import elevation_from_w
from wavefield.waves.estimation.welch import LOWEST
from wavefield.waves.estimation.windows import hann, richardson_lucy

Array = NDArray[Any]

FREQUENCIES_PER_LINE = 4
ROUNDS = 60
MAIN_LOBE = 2.0  # lines: half the width of the window's main lobe
FLOOR = 1e-12  # of the strongest line


@dataclass(frozen=True)
class Leakage:
    """Other frequencies in the lines of E(omega) of w; all (omega,)."""

    # Factors of the elevation's spectrum from w, and from the cross spectrum of w with z, that follow the
    # factor of the line's own frequency
    w: Array
    cross: Array
    # Fraction of the line from within the window's main lobe; below the strongest line at most that of the
    # lines between
    own: Array


def leakage(energy: Array, dt: float, frames: int) -> Leakage:
    """Leakage into the lines of a spectrum of w, (n // 2 + 1,), by 60 rounds of `richardson_lucy`.
    That spectrum times the elevation's factor, through the window again, is the spectrum of the elevation.
    """
    half = energy.size - 1
    lines = np.pi * np.arange(half + 1) / (half * dt)
    ones = np.ones(half + 1)
    # the two lowest lines, from which mean and trend are removed, are left as they are
    strongest = float(energy[LOWEST:].max(initial=0.0))
    if not strongest > 0:
        return Leakage(ones, ones, ones)
    fine = (np.arange(half * FREQUENCIES_PER_LINE) + 0.5) * lines[1] / FREQUENCIES_PER_LINE
    response, main_lobe = _response(lines, fine)
    given = np.maximum(energy, FLOOR * strongest)
    used = response[LOWEST:]
    area = used.sum(axis=0)
    spectrum = richardson_lucy(
        given[LOWEST:],
        np.interp(fine, lines, given),
        lambda estimate: _sum(used, estimate),
        lambda estimate, ratio: estimate * np.einsum("lf,l->f", used, ratio) / area,
        ROUNDS,
    )
    inner = slice(LOWEST, -1)
    factor, line_factor = elevation_from_w(fine, dt, frames), elevation_from_w(lines[inner], dt, frames)
    elevation, cross_power, power = (
        _sum(response, spectrum * weight)[inner] for weight in (factor, np.sqrt(factor), np.ones_like(factor))
    )
    w, cross, own = ones.copy(), ones.copy(), ones.copy()
    w[inner] = elevation / power / line_factor
    cross[inner] = elevation / cross_power / np.sqrt(line_factor)
    own[inner] = _sum(response * main_lobe, spectrum)[inner] / power
    peak = LOWEST + int(np.argmax(energy[LOWEST:]))
    own[: peak + 1] = np.minimum.accumulate(own[peak::-1])[::-1]
    return Leakage(w, cross, own)


def _sum(response: Array, spectrum: Array) -> Array:
    # not a matrix product: that of BLAS may depend on the number of threads in the last bit
    return np.asarray(np.einsum("lf,f->l", response, spectrum))


def _response(lines: Array, fine: Array) -> tuple[Array, Array]:
    """Response of each line to each frequency and its negative, and its main lobe, (lines, fine)."""
    n = 2 * (lines.size - 1)
    window = hann(n)
    resolution = 2 * FREQUENCIES_PER_LINE
    power = np.abs(np.fft.fft(window, resolution * n)) ** 2 / (window**2).sum()
    difference = np.subtract.outer(lines, fine) / lines[1]
    total = np.add.outer(lines, fine) / lines[1]
    response = sum(power[np.rint(resolution * off).astype(int) % power.size] for off in (difference, total))
    return np.asarray(response), np.abs(difference) < MAIN_LOBE
