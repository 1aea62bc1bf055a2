"""Fit of the current to the measured dispersion relation."""

from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.optimize import least_squares

from wavefield.errors import CubeError
from wavefield.variables import annotate
from wavefield.water import GAMMA, dispersion, group_velocity
from wavefield.waves.dispersion_points import (
    LEAKAGE_ERROR,
    MIN_CELLS_FROM_ZERO,
    MIN_SPEED_ON_CURRENT,
    SECTORS,
    PlaneSpectrum,
    RelationPoints,
    Water,
    centroids,
    contrast,
    fraction,
    scan_current,
    sectors_of,
    undisplaced,
    window_displacement,
)
from wavefield.waves.inputs import takes
from wavefield.waves.products import Noted, WaveProduct, register
from wavefield.waves.spectra import a_plane
from wavefield.waves.welch import Welch, k_coords

Array = NDArray[Any]

MIN_POINTS = 6  # chosen: three times the number of unknowns
TENSION_ERROR = 0.1  # chosen: relative standard uncertainty of the surface tension, which films lower
BAND_WIDTH = 0.5  # Hz, chosen: width of the bands in which the points are compared with theory


def _misfit(points: RelationPoints, water: Water, around: Array) -> Callable[[Array], Array]:
    """Return a function that maps a current (2,), m/s, to misfits: (model - measured omega) / uncertainty.
    The uncertainty is that of k, converted to omega by the slope of the relation on the current `around`."""
    kx, ky = points.k * np.cos(points.angle), points.k * np.sin(points.angle)
    free, speed = dispersion(points.k, *water), group_velocity(points.k, *water)
    slope = speed + (around[0] * kx + around[1] * ky) / points.k
    std = points.k_std * np.maximum(slope, MIN_SPEED_ON_CURRENT * speed)
    return lambda current: np.asarray((free + current[0] * kx + current[1] * ky - points.omega) / std)


def _outlier_limit(misfit: Array) -> float:
    """Return three robust standard deviations of `misfit`; points with a larger misfit get less weight."""
    return 3.0 * max(float(np.median(np.abs(misfit))) / 0.6745, 1e-9)


def solve(points: RelationPoints, water: Water, start: Array) -> Array:
    """Return the current (2,), m/s, fitted to points of the dispersion relation, from a guess `start`."""
    misfit = _misfit(points, water, start)
    result = least_squares(misfit, start, loss="soft_l1", f_scale=_outlier_limit(misfit(start)))
    return np.asarray(result.x)


def covariance_of(points: RelationPoints, water: Water, current: Array) -> Array:
    """Return the covariance (2, 2) of a fitted current, (m/s)^2; NaN if `points` do not determine the
    current. Only half of the points count as independent, because neighbouring points share errors."""
    misfit = _misfit(points, water, current)
    residual = misfit(current)
    slopes = np.stack([misfit(current + unit) - residual for unit in np.eye(2)], axis=1)  # it is linear
    robust = 1 / np.sqrt(1 + (residual / _outlier_limit(residual)) ** 2)
    normal = (slopes * robust[:, None]).T @ slopes
    if not np.linalg.cond(normal) < 1e4:  # waves of a single direction exceed it
        return np.full((2, 2), np.nan)
    independent = (len(points) - 2) / 2
    variance = (robust * residual**2).sum() / independent
    return np.asarray(variance * np.linalg.inv(normal))


def distance_from_relation(points: RelationPoints, water: Water, current: Array) -> Array:
    """Return measured k minus k of the dispersion relation at the same omega, (points,), rad/m."""
    along = points.along(current)
    speed = group_velocity(points.k, *water)
    model = dispersion(points.k, *water) + points.k * along
    return np.asarray((model - points.omega) / np.maximum(speed + along, MIN_SPEED_ON_CURRENT * speed))


def against_theory(points: RelationPoints, water: Water, current: Array) -> dict[str, Any]:
    """Return ``ridge_error`` and ``band_frequency`` of `fit_dispersion`, as (dimension, values) by name."""
    distance = distance_from_relation(points, water, current)
    band = np.floor(points.omega / (2 * np.pi) / BAND_WIDTH)
    numbers, inverse = np.unique(band, return_inverse=True)
    weight = 1 / points.k_std**2
    errors = np.bincount(inverse, weight * distance / points.k) / np.bincount(inverse, weight)
    return {"ridge_error": ("band", errors), "band_frequency": ("band", (numbers + 0.5) * BAND_WIDTH)}


MAX_RELATIVE_DISTANCE = 0.1  # relative to k: points of waves are within 3 % of the relation, others 8 to 70 %
MIN_CONTRAST = 1.5  # energy near the relation relative to other frequencies; noise has 0.9 to 1.2
MAX_CURRENT_STD = 0.012  # m/s, chosen: a less certain current is useless, and a sign of blocked waves
MAX_ROUNDS = 12  # chosen: limit of the rounds that remove the displacement by the windows
CONVERGED = 3e-4  # m/s, chosen: the rounds stop at a smaller change of the current


@takes(a_plane)
def fit_dispersion(density: xr.DataArray, depth: float = np.inf, *, gamma: float = GAMMA) -> xr.Dataset:
    """Fit the current to the dispersion relation of the waves in E(omega, ky, kx).

    Parameters
    ----------
    density : DataArray or Dataset
        Spectrum E(omega, ky, kx), best of w; or a result of `spectrum`; or a field over (time, y, x) or a
        cube, whose spectrum (of w) is computed first. ``E.sel(omega=slice(low, high))`` restricts the band.
    depth : float, optional
        Depth of the water, m; by default that of the cube, or deep. It is not fitted.
    gamma : float, optional
        Surface tension over density, m3/s2; by default that of the cube, or of clean water.

    Returns
    -------
    Dataset
        ``current_x``, ``current_y`` (m/s) and their standard uncertainties ``_std``; ``ridge_k`` (rad/m),
        ``ridge_omega`` (rad/s) and ``ridge_angle`` (rad), the measured points of the relation, each (point);
        ``ridge_fraction``, the fraction of the variance near the relation; ``ridge_error`` (band), the
        mean relative difference of the measured k from the k of the relation in bands 0.5 Hz wide around
        ``band_frequency``, Hz; ``depth``, m.

    Raises
    ------
    CubeError
        If the input is of another kind, there are fewer than six points, points or energy are not near the
        dispersion relation of any current, or the current is uncertain by more than 12 mm/s.

    Notes
    -----
    The relation is omega = sqrt((g k + gamma k^3) tanh k h) + k . U, with the depth h. The fit starts from
    the current U whose relation contains most energy. Points are centroids in k of the energy above the
    noise, at each frequency and in 24 sectors of direction, weighted by their inverse variance. Hann windows
    displace the centroids; this displacement is simulated and subtracted, until the current changes by less
    than 0.3 mm/s. Uncertainties are from least squares, spectral leakage and the surface tension.

    Examples
    --------
    Waves on water that flows along x at 5 cm/s.

    >>> import wavefield as wf
    >>> fit = wf.fit_dispersion(wf.open_cube("sea.zarr"))
    >>> bool(abs(fit.current_x - 0.05) < 0.005), bool(abs(fit.current_y) < 0.005)
    (True, True)
    """
    density, water = density.compute(), (depth, gamma)
    spectrum = PlaneSpectrum.of(density, water)
    omega = spectrum.omega
    limits = float(dispersion(MIN_CELLS_FROM_ZERO * spectrum.cell, depth)), 0.97 * omega[-1]
    in_band = (omega >= limits[0]) & (omega <= limits[1])
    band = spectrum.on_lines(in_band)
    fit = scan_current(band)
    sectors = sectors_of(spectrum, SECTORS)
    for correction in range(MAX_ROUNDS):
        before = fit
        measured = _refuse_few(centroids(band, sectors, fit), limits)
        windows = window_displacement(spectrum, in_band, sectors, fit)
        points = _refuse_few(undisplaced(measured, windows), limits)
        fit = solve(points, water, fit)
        change = fit - before
        if correction > 0 and np.hypot(*change) < CONVERGED:
            break
    contrast_of_fit = _check_fit(spectrum, points, fit, limits)

    by_leakage = solve(undisplaced(measured, windows, 1 - LEAKAGE_ERROR), water, fit) - fit
    by_tension = solve(points, (depth, (1 + TENSION_ERROR) * gamma), fit) - fit
    # the fraction 1 / contrast of the energy near the relation is noise
    std = np.sqrt(np.diag(covariance_of(points, water, fit))) / (1 - 1 / contrast_of_fit)
    std = np.sqrt(std**2 + by_leakage**2 + by_tension**2 + change**2)
    _refuse_uncertain(float(np.hypot(*std)), limits)

    out: dict[str, Any] = {}
    for name, value, error in zip(("current_x", "current_y"), fit, std):
        out[name], out[f"{name}_std"] = ((), value), ((), error)
    out |= {
        "ridge_omega": ("point", points.omega),
        "ridge_k": ("point", points.k),
        "ridge_angle": ("point", points.angle),
        "ridge_fraction": ((), fraction(spectrum, fit)),
        "depth": ((), depth),
    }
    out |= against_theory(points, water, fit)
    return annotate(xr.Dataset(out).set_coords("band_frequency"), "dispersion")


def _between(limits: tuple[float, float]) -> str:
    return f"between {limits[0] / (2 * np.pi):.2g} and {limits[1] / (2 * np.pi):.2g} Hz"


def _refuse_few(points: RelationPoints, limits: tuple[float, float]) -> RelationPoints:
    """Return `points` unchanged; CubeError if fewer than six. `limits` is the frequency band, rad/s."""
    if len(points) < MIN_POINTS:
        raise CubeError(f"no dispersion relation was found {_between(limits)}: choose a longer segment")
    return points


def _check_fit(
    spectrum: PlaneSpectrum, points: RelationPoints, fit: Array, limits: tuple[float, float]
) -> float:
    """Return the `contrast` of the fitted relation. CubeError if the contrast is low or points are far from
    the relation. `fit` is the current (2,), m/s, and `limits` the frequency band, rad/s."""
    between = _between(limits)
    best = f"{fit[0]:.2f}, {fit[1]:.2f} m/s"
    # windows spread a wave over more than a cell of the k plane: for long waves, that is not an error
    least_k = spectrum.cell / MAX_RELATIVE_DISTANCE
    relative = distance_from_relation(points, spectrum.water, fit) / np.maximum(points.k, least_k)
    distance = float(np.sqrt(np.average(relative**2, weights=1 / points.k_std**2)))
    if distance > MAX_RELATIVE_DISTANCE:
        raise CubeError(
            f"the waves {between} are {100 * distance:.0f} % of their wavenumber away from the dispersion"
            f" relation of any current (the best is {best}); a current may block them: check depth, frame"
            " rate and grid step"
        )
    lines = (spectrum.omega > limits[0] / 2) & (spectrum.omega < 1.5 * limits[1])
    contrast_of_fit = contrast(spectrum, lines, fit)
    if contrast_of_fit < MIN_CONTRAST:
        raise CubeError(
            f"no dispersion relation was found {between}: the best one contains {contrast_of_fit:.2f} times"
            " the energy of the same wave vectors at other frequencies (noise: 1)"
        )
    return contrast_of_fit


def _refuse_uncertain(std: float, limits: tuple[float, float]) -> None:
    """Raise CubeError if `std`, the standard uncertainty of the current, is NaN or exceeds 0.012 m/s."""
    if std <= MAX_CURRENT_STD:
        return
    reason = f"determine the current to {std:.2f} m/s only"
    if not np.isfinite(std):
        reason = "are too few to determine the current"
    raise CubeError(f"the waves {_between(limits)} {reason}; it may block them: choose a longer record")


def dispersion_group(density: xr.DataArray, k: Array, depth: float, gamma: float) -> xr.Dataset:
    """Return the result of `fit_dispersion`, and ``omega_theory`` (k), the frequency in still water, rad/s.
    If the fit fails, return only ``omega_theory``, with the reason in the attribute ``refused``."""
    theory = xr.Dataset({"omega_theory": ("k", dispersion(k, depth, gamma))}, k_coords(k))
    try:
        out = fit_dispersion(density, depth, gamma=gamma)
    except CubeError as error:
        return annotate(theory, "dispersion").assign_attrs(refused=str(error))
    return annotate(out.assign(theory.data_vars).assign_coords(theory.coords), "dispersion")


def _group(density: xr.DataArray, welch: Welch, depth: float, gamma: float) -> Noted:
    fit = dispersion_group(density, welch.table.k, depth, gamma)
    refused = fit.attrs.get("refused")
    return Noted(fit, [f"The dispersion relation was not fitted: {refused}."] if refused else [])


register(WaveProduct("dispersion", ("density_w", "welch", "depth", "gamma"), _group, "dispersion", cost=3))
