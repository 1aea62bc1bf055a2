"""How far a ridge stands out of what lies beside it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.water import dispersion, group_velocity
from wavefield.waves.dispersion_relation.current_scan import LONGEST, WavenumberPlane

Array = NDArray[Any]


def _near_ridge(omega: Array, plane: WavenumberPlane, depth: float, fit: Array) -> Array:
    # within two cells in k and two lines in omega of the fitted relation, (lines, cells)
    free = dispersion(plane.k, depth, fit[2]) + fit[0] * plane.kx + fit[1] * plane.ky
    slope = np.abs(group_velocity(np.maximum(plane.k, plane.cell), depth, fit[2]))
    slope += np.hypot(fit[0], fit[1])
    reach = 2 * plane.cell * slope + 2 * abs(omega[1] - omega[0])
    return np.asarray(np.abs(omega[:, None] - free) < reach)


def contrast(
    energy: Array, omega: Array, lines: Array, plane: WavenumberPlane, depth: float, fit: Array
) -> float:
    """Energy on the ridge over what the same cells of the k plane would hold there if all lines were alike.

    With energy (lines, cells); omega (lines,); lines (lines,); fit (3,), m/s.
    """
    near = _near_ridge(omega, plane, depth, fit)[lines]
    near[:, plane.k < LONGEST * plane.cell] = False
    energy = energy[lines]
    on, count = (energy * near).sum(axis=0, dtype=float), near.sum(axis=0)
    there = (count > 0) & (count < near.shape[0])
    rest = (energy.sum(axis=0, dtype=float) - on)[there] / (near.shape[0] - count[there])
    expected = float((rest * count[there]).sum())
    if expected > 0:
        return float(on[there].sum()) / expected
    return np.inf if there.any() else 1.0


def fraction(energy: Array, omega: Array, plane: WavenumberPlane, depth: float, fit: Array) -> float:
    """Fraction of the energy that lies within the ridge.

    With energy (lines, cells); omega (lines,); fit (3,), m/s.
    """
    near = _near_ridge(omega, plane, depth, fit)
    total = float(energy.sum(dtype=float))
    return float((energy * near).sum(dtype=float)) / total if total > 0 else float("nan")


def explained(
    energy: Array, omega: Array, noise: Array, lines: Array, plane: WavenumberPlane, depth: float, fit: Array
) -> float:
    """Fraction of the energy above the noise that lies within the ridge, whichever way waves are seen to go.

    Waves that a current carries back are seen with the opposite wave vector: omega = k.U - sigma(k).

    With energy (lines, cells); omega (lines,); noise (lines, cells); lines (lines,); fit (3,), m/s.
    """
    counted = plane.k > LONGEST * plane.cell
    above = np.maximum(energy[lines] - 3 * noise[lines], 0.0)[:, counted]
    near = _near_ridge(omega, plane, depth, fit) | _near_ridge(-omega, plane, depth, fit * [-1, -1, 1])
    total = float(above.sum(dtype=float))
    return float((above * near[lines][:, counted]).sum(dtype=float)) / total if total > 0 else 1.0
