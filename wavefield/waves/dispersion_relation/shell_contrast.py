"""Energy near a dispersion relation compared with the energy elsewhere."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.water import dispersion, group_velocity
from wavefield.waves.dispersion_relation.plane_spectrum import MIN_CELLS_FROM_ZERO, PlaneSpectrum

Array = NDArray[Any]


def _near_relation(spectrum: PlaneSpectrum, fit: Array) -> Array:
    """Cells within two cells in k and two lines in omega of the relation `fit`, (lines, cells)."""
    omega, plane, depth = spectrum.omega, spectrum.plane, spectrum.depth
    free = dispersion(plane.k, depth, fit[2]) + fit[0] * plane.kx + fit[1] * plane.ky
    slope = np.abs(group_velocity(np.maximum(plane.k, plane.cell), depth, fit[2]))
    slope += np.hypot(fit[0], fit[1])
    reach = 2 * plane.cell * slope + 2 * abs(omega[1] - omega[0])
    return np.asarray(np.abs(omega[:, None] - free) < reach)


def contrast(spectrum: PlaneSpectrum, lines: Array, fit: Array) -> float:
    """Energy near the relation over the energy there if each cell had the same energy on all lines."""
    near = _near_relation(spectrum, fit)[lines]
    near[:, spectrum.plane.k < MIN_CELLS_FROM_ZERO * spectrum.plane.cell] = False
    energy = spectrum.energy[lines]
    on, count = (energy * near).sum(axis=0, dtype=float), near.sum(axis=0)
    on_both = (count > 0) & (count < near.shape[0])
    off = (energy.sum(axis=0, dtype=float) - on)[on_both] / (near.shape[0] - count[on_both])
    expected = float((off * count[on_both]).sum())
    if expected > 0:
        return float(on[on_both].sum()) / expected
    return np.inf if on_both.any() else 1.0


def fraction(spectrum: PlaneSpectrum, fit: Array) -> float:
    """Fraction of the energy near the relation."""
    near = _near_relation(spectrum, fit)
    total = float(spectrum.energy.sum(dtype=float))
    return float((spectrum.energy * near).sum(dtype=float)) / total if total > 0 else float("nan")


def explained(spectrum: PlaneSpectrum, lines: Array, fit: Array) -> float:
    """Fraction of the energy above the noise near the relation, of waves carried backwards as well.
    Waves that a current carries backwards appear at the opposite wave vector: omega = k.U - sigma(k).
    """
    counted = spectrum.plane.k > MIN_CELLS_FROM_ZERO * spectrum.plane.cell
    above = np.maximum(spectrum.energy[lines] - 3 * spectrum.noise[lines], 0.0)[:, counted]
    backwards = replace(spectrum, omega=-spectrum.omega)
    near = _near_relation(spectrum, fit) | _near_relation(backwards, fit * [-1, -1, 1])
    total = float(above.sum(dtype=float))
    return float((above * near[lines][:, counted]).sum(dtype=float)) / total if total > 0 else 1.0
