"""The measured points against the theory with the fitted current and the water's surface tension."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.water import dispersion, group_velocity
from wavefield.waves.dispersion_relation.relation_points import RelationPoints
from wavefield.waves.dispersion_relation.relation_solution import MIN_SLOPE

Array = NDArray[Any]

BAND_WIDTH = 0.5  # Hz
_NEWTON_ROUNDS = 20


def against_theory(points: RelationPoints, depth: float, fit: Array, gamma: float) -> dict[str, Any]:
    """Variables ``ridge_error`` and ``band_frequency``, Hz, (band,): points against theory by bands.
    The error is the energy-weighted mean of k over the theory's k for that omega and direction, less 1.
    """
    along = points.along(fit)
    theory = points.k.copy()
    for _ in range(_NEWTON_ROUNDS):
        off = dispersion(theory, depth, gamma) + theory * along - points.omega
        speed = group_velocity(theory, depth, gamma)
        slope = np.maximum(speed + along, MIN_SLOPE * speed)
        theory = np.clip(theory - off / slope, 0.5 * theory, 2 * theory)
    relative = points.k / theory - 1
    band = np.floor(points.omega / (2 * np.pi) / BAND_WIDTH)
    centres, errors = [], []
    for number in np.unique(band):
        inside = band == number
        # each line on its own scale: energy falls by decades within a band
        omega, energy = points.omega[inside], points.energy[inside]
        lines = np.unique(omega)
        means = np.array([energy[omega == line].mean() for line in lines])
        centres.append((number + 0.5) * BAND_WIDTH)
        errors.append(float(np.average(relative[inside], weights=energy / np.interp(omega, lines, means))))
    return {"ridge_error": ("band", np.array(errors)), "band_frequency": ("band", np.array(centres))}
