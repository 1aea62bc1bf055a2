"""The measured ridge against the theory with the fitted current and the water's surface tension."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.water import dispersion, group_velocity

Array = NDArray[Any]

_SLOWEST = 0.15  # of the free group velocity: waves that a current slows more are not followed


def against_theory(points: Array, depth: float, fit: Array, gamma: float) -> dict[str, Any]:
    """Compare the ridge with theory by bands of half a hertz.

    With points (points, 4 or more), rad/s; fit (3,), m/s; returns ``ridge_error``, the energy-weighted mean
    of k over the theory's k for that omega and direction, less 1, and ``band_frequency``, Hz, (band).
    """
    omega, k, angle, weight = points.T[:4]
    along = fit[0] * np.cos(angle) + fit[1] * np.sin(angle)
    theory = k.copy()
    for _ in range(20):
        beside = dispersion(theory, depth, gamma) + theory * along - omega
        speed = group_velocity(theory, depth, gamma)
        slope = np.maximum(speed + along, _SLOWEST * speed)
        theory = np.clip(theory - beside / slope, 0.5 * theory, 2 * theory)
    frequency = omega / (2 * np.pi)
    band = np.floor(frequency / 0.5)
    centres, errors = [], []
    for b in np.unique(band):
        inside = band == b
        # each line on its own scale: energy falls by decades within a band
        scale = weight[inside] / np.interp(omega[inside], *_line_means(omega[inside], weight[inside]))
        centres.append((b + 0.5) * 0.5)
        errors.append(float(np.average(k[inside] / theory[inside] - 1, weights=scale)))
    return {"ridge_error": ("band", np.array(errors)), "band_frequency": ("band", np.array(centres))}


def _line_means(omega: Array, weight: Array) -> tuple[Array, Array]:
    lines = np.unique(omega)
    return lines, np.array([weight[omega == line].mean() for line in lines])
