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
    WindowDisplacement,
    centroids,
    contrast,
    fraction,
    scan_current,
    sectors_of,
)
from wavefield.waves.inputs import takes
from wavefield.waves.products import Noted, WaveProduct, register
from wavefield.waves.spectra import plane_of
from wavefield.waves.welch import Welch, k_coords

Array = NDArray[Any]

MIN_POINTS = 6  # three times the unknowns
OUTLIER_STDS = 3.0  # standard deviations of the points: larger misfits count less
MAX_CONDITION = 1e4  # of the normal equations of a current: those of waves of one direction exceed it
TENSION_ERROR = 0.1  # of the surface tension: its standard uncertainty; a film lowers that of clean water
BAND_WIDTH = 0.5  # Hz, over which points are compared with theory


def _misfit(points: RelationPoints, water: Water, around: Array) -> Callable[[Array], Array]:
    """Misfit of the points in standard deviations, (points,), for a current.
    Errors in k become errors in omega by the slope of the relation for the current `around`.
    """
    kx, ky = points.k * np.cos(points.angle), points.k * np.sin(points.angle)
    free, speed = dispersion(points.k, *water), group_velocity(points.k, *water)
    slope = speed + (around[0] * kx + around[1] * ky) / points.k
    std = points.k_std * np.maximum(slope, MIN_SPEED_ON_CURRENT * speed)
    return lambda current: np.asarray((free + current[0] * kx + current[1] * ky - points.omega) / std)


def _outlier_limit(misfit: Array) -> float:
    """Misfit beyond which points get less weight."""
    return OUTLIER_STDS * max(float(np.median(np.abs(misfit))) / 0.6745, 1e-9)


def solve(points: RelationPoints, water: Water, start: Array) -> Array:
    """The current of the points, (2,), m/s; outliers count less."""
    misfit = _misfit(points, water, start)
    result = least_squares(misfit, start, loss="soft_l1", f_scale=_outlier_limit(misfit(start)))
    return np.asarray(result.x)


def covariance_of(points: RelationPoints, water: Water, current: Array) -> Array:
    """Covariance (2, 2) of the current, from the misfit of all points; NaN where they do not determine it.
    Neighbouring points share their error, so half of them count.
    """
    misfit = _misfit(points, water, current)
    residual = misfit(current)
    slopes = np.stack([misfit(current + unit) - residual for unit in np.eye(2)], axis=1)  # it is linear
    robust = 1 / np.sqrt(1 + (residual / _outlier_limit(residual)) ** 2)
    normal = (slopes * robust[:, None]).T @ slopes
    if not np.linalg.cond(normal) < MAX_CONDITION:
        return np.full((2, 2), np.nan)
    independent = (len(points) - 2) / 2
    variance = (robust * residual**2).sum() / independent
    return np.asarray(variance * np.linalg.inv(normal))


def distance_from_relation(points: RelationPoints, water: Water, current: Array) -> Array:
    """Distance of the points from the fitted relation in k, rad/m; to first order."""
    along = points.along(current)
    speed = group_velocity(points.k, *water)
    model = dispersion(points.k, *water) + points.k * along
    return np.asarray((model - points.omega) / np.maximum(speed + along, MIN_SPEED_ON_CURRENT * speed))


def against_theory(points: RelationPoints, water: Water, current: Array) -> dict[str, Any]:
    """Variables ``ridge_error`` and ``band_frequency``, Hz, (band,): points against theory by bands.
    The error is the mean of k over the theory's k for that omega and direction, less 1, weighted as in the
    fit.
    """
    distance = distance_from_relation(points, water, current)
    band = np.floor(points.omega / (2 * np.pi) / BAND_WIDTH)
    numbers, inverse = np.unique(band, return_inverse=True)
    weight = 1 / points.k_std**2
    errors = np.bincount(inverse, weight * distance / points.k) / np.bincount(inverse, weight)
    return {"ridge_error": ("band", errors), "band_frequency": ("band", (numbers + 0.5) * BAND_WIDTH)}


MAX_RELATIVE_DISTANCE = 0.1  # of k: points of waves lie within 3 % of the relation, of other energy 8 to 70 %
MIN_CONTRAST = 1.5  # energy near the relation over that at other frequencies: noise has 0.9 to 1.2
MAX_CURRENT_STD = 0.012  # m/s: more is of no use, and found where waves are blocked
MAX_ROUNDS = 12  # in which the displacement by the windows is removed; at least two
CONVERGED = 3e-4  # m/s: the rounds end at a smaller change


@takes(plane_of("w"))
def fit_dispersion(
    density: xr.DataArray,
    depth: float = np.inf,
    *,
    gamma: float = GAMMA,
) -> xr.Dataset:
    """Fit the current to the dispersion relation of E(ky, kx, omega).

    Parameters
    ----------
    density : DataArray or Dataset
        Spectrum (omega, ky, kx), best of w, which shows the relation most clearly, or the result of
        `spectrum`; of a field (time, y, x) or of the w of a cube it is computed.
    depth : float
        Depth of the water, m; by default that of the cube, or deep. It is kept fixed: waves this
        short do not determine it.
    gamma : float
        Surface tension over density, m3/s2; by default that of the cube, or of clean water. It is kept
        fixed, too.

    Returns
    -------
    Dataset
        The points: ``ridge_k``, ``ridge_omega``, ``ridge_angle`` (point). The fit:
        ``current_x``, ``current_y`` (m/s) and their ``_std``; ``ridge_fraction``, the fraction of the
        variance near the relation; ``ridge_error`` (band), k of the points against the theory with the fitted
        current, relative; ``depth``.

    Raises
    ------
    CubeError
        If the band has too few points, they lie on the relation of no current, or the energy near the
        relation hardly exceeds that of the same wave vectors at other frequencies (noise has a best current,
        too); or if the standard uncertainty of the current exceeds 12 mm/s.

    Notes
    -----
    The fit starts from the current whose relation holds most energy (`scan_current`). The points are
    centroids in k at fixed omega in sectors of angle, in a window that is centred on the fit in each round;
    centroids in omega at fixed k would be biased by up to 8 %. The noise (`noise_level`) is subtracted
    without clipping, so that it does not move centroids to the middle of the window. The weight of a point is
    its inverse variance, from the energies of the cells in its window, the signal-to-noise ratio, leakage
    from stronger sectors and 0.3 of its displacement by the windows. Points without a signal as large as the
    noise are left out. The displacement by the spectral windows
    (leakage along a falling spectrum and from strong directions into weak ones, the curvature of the
    relation) is that of simulated free waves of the measured energy on the fitted relation
    (`windowed_waves`); it is subtracted in rounds until the current converges.

    The uncertainty is that of least squares, from the misfit of all points, increased where the contrast of
    the relation is low. Added in quadrature are the changes of the current with three tenths of the
    displacement by the windows left, with a tenth more surface tension, and in the last round.

    Examples
    --------
    Three hundred waves on water that flows along x at 5 cm/s.

    >>> from wavefield.waves.spectra import spectrum
    >>> rng = np.random.default_rng(0)
    >>> k, angle = rng.uniform(6, 40, 300), rng.uniform(-np.pi, np.pi, 300)
    >>> kx, ky = k * np.cos(angle), k * np.sin(angle)
    >>> omega = dispersion(k) + 0.05 * kx
    >>> t, y, x = np.arange(256) * 0.05, np.arange(32) * 0.05, np.arange(40) * 0.05
    >>> place = np.exp(1j * (kx[:, None, None] * x + ky[:, None, None] * y[:, None]))
    >>> phase = np.exp(2j * np.pi * rng.random(300) - 1j * np.outer(t, omega))
    >>> w = np.tensordot(phase / k, place, 1).real
    >>> field = xr.DataArray(w, {"time": t, "y": y, "x": x}, ("time", "y", "x"), attrs={"units": "m s-1"})
    >>> fit = fit_dispersion(spectrum(field, segment=128).E)
    >>> bool(abs(fit.current_x - 0.05) < 0.005), bool(abs(fit.current_y) < 0.005)
    (True, True)
    >>> bool(fit.ridge_fraction > 0.98)
    True
    """
    density, water = density.compute(), (depth, gamma)
    spectrum = PlaneSpectrum.of(density, water)
    omega, plane = spectrum.omega, spectrum.plane
    limits = float(dispersion(MIN_CELLS_FROM_ZERO * plane.cell, depth)), 0.97 * omega[-1]
    in_band = (omega >= limits[0]) & (omega <= limits[1])
    band = spectrum.on_lines(in_band)
    fit = scan_current(band)
    sectors = sectors_of(plane, SECTORS)
    for correction in range(MAX_ROUNDS):
        before = fit
        measured = _refuse_few(centroids(band, sectors, fit), limits)
        windows = WindowDisplacement.measure(spectrum, in_band, sectors, fit)
        points = _refuse_few(windows.removed_from(measured), limits)
        fit = solve(points, water, fit)
        change = fit - before
        if correction > 0 and np.hypot(*change) < CONVERGED:
            break
    contrast_of_fit = _check_fit(spectrum, points, fit, limits)

    by_leakage = solve(windows.removed_from(measured, 1 - LEAKAGE_ERROR), water, fit) - fit
    by_tension = solve(points, (depth, (1 + TENSION_ERROR) * gamma), fit) - fit
    # 1 / contrast of the energy in the points is noise
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
    """The frequency limits, rad/s, as text for a message."""
    return f"between {limits[0] / (2 * np.pi):.2g} and {limits[1] / (2 * np.pi):.2g} Hz"


def _refuse_few(points: RelationPoints, limits: tuple[float, float]) -> RelationPoints:
    """Return the points; raise CubeError if they are too few for a fit."""
    if len(points) < MIN_POINTS:
        raise CubeError(f"no dispersion relation was found {_between(limits)}: choose a longer segment")
    return points


def _check_fit(
    spectrum: PlaneSpectrum, points: RelationPoints, fit: Array, limits: tuple[float, float]
) -> float:
    """Contrast of the fitted relation; raises CubeError if the fit does not describe the waves."""
    between = _between(limits)
    best = f"{fit[0]:.2f}, {fit[1]:.2f} m/s"
    # a window spreads a wave over more than a cell of the k plane: in a small field that distance is no error
    least_k = spectrum.plane.cell / MAX_RELATIVE_DISTANCE
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
            f"no dispersion relation was found {between}: the best one holds {contrast_of_fit:.2f} times the"
            " energy of the same wave vectors at other frequencies, where noise has 1"
        )
    return contrast_of_fit


def _refuse_uncertain(std: float, limits: tuple[float, float]) -> None:
    if std <= MAX_CURRENT_STD:
        return
    reason = f"determine the current to {std:.2f} m/s only"
    if not np.isfinite(std):
        reason = "are too few to determine the current"
    raise CubeError(f"the waves {_between(limits)} {reason}; it may block them: choose a longer record")


def dispersion_group(density: xr.DataArray, k: Array, depth: float, gamma: float) -> xr.Dataset:
    """Group `dispersion`: the theory over k, rad/m, and the fit or the reason for its refusal."""
    theory = xr.Dataset({"omega_theory": ("k", dispersion(k, depth, gamma))}, k_coords(k))
    try:
        out = fit_dispersion(density, depth, gamma=gamma)
    except CubeError as error:
        return annotate(theory, "dispersion").assign_attrs(refused=str(error))
    return annotate(out.assign(theory.data_vars).assign_coords(theory.coords), "dispersion")


def _product(density: xr.DataArray, welch: Welch, depth: float, gamma: float) -> xr.Dataset:
    return dispersion_group(density, welch.table.k, depth, gamma)


def _noted(fit: xr.Dataset) -> xr.Dataset | Noted:
    if "refused" not in fit.attrs:
        return fit
    return Noted(fit, [f"The dispersion relation was not fitted: {fit.attrs['refused']}."])


register(
    WaveProduct("dispersion_fit", ("density_w", "welch", "depth", "gamma"), _product, cost=3),
    WaveProduct("dispersion", ("dispersion_fit",), _noted, group="dispersion"),
)
