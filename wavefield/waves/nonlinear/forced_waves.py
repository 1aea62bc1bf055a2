"""Elevation of the waves that pairs of free waves force at second order, in water of any depth."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.water import GRAVITY

Array = NDArray[Any]
Waves = tuple[Array, Array, Array]  # kx, ky, rad/m, and frequency in still water, rad/s

# relative to the square of a free wave's frequency: nearer to resonance, pairs exchange energy
MIN_DETUNING = 0.1


def forced_elevation(first: Waves, second: Waves, sign: int, depth: float, gamma: float) -> Array:
    """Elevation at the sum (sign 1) or difference (-1) of two waves over the product of theirs, 1/m.
    Second order at z = 0, with surface tension in linear terms (Sharma & Dean 1981); 0 near resonance.
    """
    (xi, yi, si), (xj, yj, sj) = first, second
    ki, kj = np.hypot(xi, yi), np.hypot(xj, yj)
    deep = min(depth, 1e3)
    pi, pj = si / (ki * np.tanh(ki * deep)), sj / (kj * np.tanh(kj * deep))  # potential over elevation
    dot = xi * xj + yi * yj
    length = np.hypot(xi + sign * xj, yi + sign * yj)
    frequency = si + sign * sj
    kinematic = 0.5 * (pi * (ki**2 + sign * dot) + sign * pj * (kj**2 + sign * dot))
    dynamic = 0.5 * (si**2 + sj**2 + sign * si * sj - dot * pi * pj)
    stiffness, q = GRAVITY + gamma * length**2, length * np.tanh(length * deep)
    detuning = q * stiffness - frequency**2
    gain = (q * dynamic - frequency * kinematic) / detuning
    return np.where(np.abs(detuning) > MIN_DETUNING * q * stiffness, gain, 0.0)
