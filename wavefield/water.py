"""Water and its free waves: constants, dispersion relation, wavenumber, group velocity."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wavefield.errors import CubeError

Array = NDArray[np.float64]

GRAVITY = 9.81  # m s-2
SURFACE_TENSION = 0.0728  # N m-1, clean water at 20 C
DENSITY = 1000.0  # kg m-3
GAMMA = SURFACE_TENSION / DENSITY  # m3 s-2
WATER = ("water_depth", "surface_tension_over_density")  # attributes of a cube and of its fields


def tension_over_density(surface_tension: float | None = None, density: float | None = None) -> float:
    """Return surface tension (N/m) over density (kg/m3), in m3/s2; None stands for clean water at 20 C."""
    tension = SURFACE_TENSION if surface_tension is None else surface_tension
    return float(tension) / float(density or DENSITY)


def water_of(attributes: Mapping[str, str | float], depth: float | None = None) -> tuple[float, float]:
    """Return (depth, m, surface tension over density, m3/s2) of the water, from the attributes of a cube.
    The argument `depth` replaces the depth in the attributes; without either it is infinite. The default
    surface tension is that of clean water."""
    if depth is None:
        stated = attributes.get("water_depth")
        depth = np.inf if not stated or stated == "deep" else float(stated)
    return float(depth), float(attributes.get("surface_tension_over_density", GAMMA))


def stated_water(attributes: Mapping[str, Any]) -> dict[str, float]:
    """Return, by attribute name, the water depth (m) and surface tension over density (m3/s2) of a cube.
    Attributes that are absent, infinite or, for the depth, "deep" are left out."""
    given = {name: attributes[name] for name in WATER if attributes.get(name) not in (None, "", "deep")}
    return {name: float(value) for name, value in given.items() if np.isfinite(float(value))}


def dispersion(k: ArrayLike, depth: float = np.inf, gamma: float = GAMMA, g: float = GRAVITY) -> Any:
    """Return the angular frequency of free waves without current, sqrt((g k + gamma k^3) tanh k h).

    Parameters
    ----------
    k : array_like
        Wavenumber, rad/m, 0 or more.
    depth : float, optional
        Depth h of the water, m; by default infinite, for deep water.
    gamma, g : float, optional
        Surface tension over density, m3/s2, by default of clean water at 20 C; gravity, 9.81 m/s2 by default.

    Returns
    -------
    float or ndarray
        Angular frequency, rad/s, in the shape of `k`.

    Raises
    ------
    CubeError
        If the depth is not positive.

    Examples
    --------
    A wave of k / 2 pi = 20 1/m on water 0.7 m deep has a frequency of 5.9 Hz:

    >>> from wavefield.waves import dispersion
    >>> round(float(dispersion(125.66, 0.7)) / 6.2832, 1)
    5.9
    """
    if not depth > 0:
        raise CubeError(f"the depth of the water is {depth} m: give a positive number, or inf")
    k = np.asarray(k, float)
    # an infinite depth times k = 0 is no number; 1e300 m is deep
    return np.sqrt((g * k + gamma * k**3) * np.tanh(k * min(depth, 1e300)))


def group_velocity(k: ArrayLike, depth: float = np.inf, gamma: float = GAMMA, g: float = GRAVITY) -> Any:
    """Return the group velocity of free waves without current, d omega / d k.

    Parameters
    ----------
    k : array_like
        Wavenumber, rad/m, above 0.
    depth, gamma, g : float, optional
        Depth of the water, m, surface tension over density, m3/s2, and gravity, m/s2, with the defaults of
        `dispersion`.

    Returns
    -------
    float or ndarray
        Group velocity, m/s, in the shape of `k`.

    Raises
    ------
    CubeError
        If the depth is not positive.

    Examples
    --------
    Half the phase velocity for gravity waves on deep water:

    >>> from wavefield.waves import dispersion, group_velocity
    >>> k = 2.0
    >>> round(float(group_velocity(k, gamma=0.0) / (dispersion(k, gamma=0.0) / k)), 6)
    0.5
    """
    k = np.asarray(k, float)
    omega = dispersion(k, depth, gamma, g)
    kh = np.minimum(k * min(depth, 1e300), 350.0)  # beyond it cosh overflows
    felt = (g * k + gamma * k**3) * kh / (np.maximum(k, 1e-300) * np.cosh(kh) ** 2)
    return ((g + 3 * gamma * k**2) * np.tanh(kh) + felt) / (2 * omega)


def wavenumber(omega: ArrayLike, depth: float = np.inf, gamma: float = GAMMA) -> Array:
    """Return the wavenumber of free waves without current, the inverse of `dispersion`.

    Parameters
    ----------
    omega : array_like
        Angular frequency, rad/s, 0 or more.
    depth, gamma : float, optional
        Depth of the water, m, and surface tension over density, m3/s2, with the defaults of `dispersion`.

    Returns
    -------
    ndarray
        Wavenumber, rad/m, in the shape of `omega`.

    Raises
    ------
    CubeError
        If the depth is not positive.

    Examples
    --------
    >>> from wavefield.waves import dispersion, wavenumber
    >>> round(float(wavenumber(dispersion(30.0, 0.7), 0.7)), 6)
    30.0
    """
    omega = np.asarray(omega, float)
    low, high = np.zeros_like(omega), np.full_like(omega, 1.0)
    while np.any(short := dispersion(high, depth, gamma) < omega):
        high = np.where(short, 2 * high, high)
    for _ in range(60):
        middle = (low + high) / 2
        below = dispersion(middle, depth, gamma) < omega
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.asarray((low + high) / 2)
