"""Current and surface tension from points of the dispersion relation by least squares, with uncertainty.

`fit` is everywhere an array (3,): current along x and y, m/s, and surface tension over density, m3/s2.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from wavefield.errors import CubeError
from wavefield.water import dispersion, group_velocity
from wavefield.waves.dispersion_relation.relation_points import RelationPoints

Array = NDArray[Any]

MIN_POINTS = 6
OUTLIER_STDS = 3.0  # standard deviations of the points: larger misfits count less
MIN_SLOPE = 0.15  # of the group velocity: waves that a current slows more count as these
FAST_WAVES = 0.7  # of the free group velocity: the change of the fit without slower waves is an uncertainty
FREQUENCY_BLOCKS = 5  # that are left out in turn
MAX_CHANGE = 0.015  # m/s: a current that changes by more without one of these blocks depends on the band
MAX_CONDITION = 1e4  # of the normal equations of a current: those of waves of one direction exceed it
TENSION_RANGE = 0.3  # of the surface tension: how far that of the water may differ from what is given
BAND_WIDTH = 0.5  # Hz, over which points are compared with theory
_NEWTON_ROUNDS = 20
_UNITS = np.array([1, 1, 1e5])  # the solver's unit of surface tension is 1e-5 m3/s2


def _misfit(points: RelationPoints, depth: float, around: Array) -> Callable[[Array], Array]:
    """Misfit of a scaled fit in standard deviations of the points, (points,).
    The slope of the relation, which turns an error in k into one in omega, is that of the fit `around`.
    """
    kx, ky = points.k * np.cos(points.angle), points.k * np.sin(points.angle)
    speed = group_velocity(points.k, depth, around[2])
    slope = speed + (around[0] * kx + around[1] * ky) / points.k
    std = points.k_std * np.maximum(slope, MIN_SLOPE * speed)

    def misfit(scaled: Array) -> Array:
        model = dispersion(points.k, depth, max(scaled[2], 0.0) * 1e-5) + scaled[0] * kx + scaled[1] * ky
        return np.asarray((model - points.omega) / std)

    return misfit


def _outlier_limit(misfit: Array) -> float:
    """Misfit beyond which points count less."""
    return OUTLIER_STDS * max(float(np.median(np.abs(misfit))) / 0.6745, 1e-9)


def solve(points: RelationPoints, depth: float, start: Array) -> Array:
    """The fit to the points, (3,)."""
    misfit, scaled = _misfit(points, depth, start), start * _UNITS
    limit = _outlier_limit(misfit(scaled))
    result = least_squares(misfit, scaled, loss="soft_l1", f_scale=limit, x_scale=[0.01, 0.01, 1.0])
    return np.array([result.x[0], result.x[1], max(result.x[2], 0.0) * 1e-5])


def _solve_current(points: RelationPoints, depth: float, fit: Array) -> Array:
    """Current of some points with the surface tension of the fit, (2,); NaN if they do not determine it."""
    misfit = _misfit(points, depth, fit)
    tension = fit[2] * 1e5
    limit = _outlier_limit(misfit(fit * _UNITS))
    result = least_squares(
        lambda current: misfit(np.array([*current, tension])), fit[:2], loss="soft_l1", f_scale=limit
    )
    normal = result.jac.T @ result.jac
    return np.asarray(result.x) if np.linalg.cond(normal) < MAX_CONDITION else np.full(2, np.nan)


def _information(points: RelationPoints, depth: float, fit: Array) -> Array:
    """What each point contributes to the inverse variance of the current, (points,)."""
    return np.asarray((points.k / (points.k_std * group_velocity(points.k, depth, fit[2]))) ** 2)


def jackknife(points: RelationPoints, depth: float, fit: Array) -> Array:
    """Standard uncertainty of the current, (2,), from fits without one band of frequency each.
    Bands determine the current equally well. Raises CubeError where it changes much without one.
    """
    order = np.argsort(points.omega, kind="stable")
    share = np.cumsum(_information(points[order], depth, fit))
    block = np.minimum((share / share[-1] * FREQUENCY_BLOCKS).astype(int), FREQUENCY_BLOCKS - 1)
    complete = _solve_current(points, depth, fit)
    changes, bands = [], []
    for number in np.unique(block):
        left_out, used = order[block == number], order[block != number]
        current = _solve_current(points[used], depth, fit) if len(used) >= MIN_POINTS else np.full(2, np.nan)
        changes.append(current - complete)
        bands.append(points.omega[left_out[[0, -1]]] / (2 * np.pi))
    change = np.array(changes)
    size = np.hypot(*change.T)
    worst = int(np.argmax(np.where(np.isfinite(size), size, np.inf)))
    if not size[worst] <= MAX_CHANGE:
        how_far = f"changes by {size[worst]:.3f} m/s" if np.isfinite(size[worst]) else "is not determined"
        raise CubeError(
            f"the current depends on the band: without the waves between {bands[worst][0]:.2g} and"
            f" {bands[worst][1]:.2g} Hz it {how_far} (the fit is {fit[0]:.2f}, {fit[1]:.2f} m/s); choose a"
            " band with `fit: {lowest, highest}` or a longer record"
        )
    return np.asarray(np.sqrt((change**2).mean(axis=0) * (len(change) - 1)))


def covariance_of(points: RelationPoints, depth: float, fit: Array) -> Array:
    """Covariance of the fit, (3, 3), of least squares, from the misfit of all points; NaN if there are few.
    Times Student's variance. Narrow seas have too few points of one direction for an estimate of its own.
    """
    misfit, scaled = _misfit(points, depth, fit), fit * _UNITS
    steps = np.diag([1e-4, 1e-4, 1e-2])
    slopes = np.stack([(misfit(scaled + d) - misfit(scaled - d)) / (2 * d.sum()) for d in steps], axis=1)
    residual = misfit(scaled)
    robust = 1 / np.sqrt(1 + (residual / _outlier_limit(residual)) ** 2)
    normal = (slopes * robust[:, None]).T @ slopes
    freedom = len(points) - 3
    if freedom <= 2 or np.linalg.cond(normal) > 1e12:
        return np.full((3, 3), np.nan)
    # neighbouring points share their error: half of them count for how well the misfit itself is known
    independent = max(freedom / 2, 3.0)
    variance = (robust * residual**2).sum() / freedom * independent / (independent - 2)
    return np.asarray(variance * np.linalg.inv(normal) * np.outer([1, 1, 1e-5], [1, 1, 1e-5]))


def with_surface_tension(fit: Array, covariance: Array, gamma: float) -> tuple[Array, Array]:
    """The fit and its covariance, given that the surface tension is near `gamma`.
    On a fast current the measured waves are too long to determine it.
    """
    if not np.isfinite(covariance).all():
        return fit, covariance
    gain = covariance[:, 2] / (covariance[2, 2] + (TENSION_RANGE * gamma) ** 2)
    return fit + gain * (gamma - fit[2]), covariance - np.outer(gain, covariance[2])


def fast_waves(points: RelationPoints, depth: float, fit: Array) -> RelationPoints:
    """Points of waves that the current slows little; all where few remain."""
    speed = group_velocity(points.k, depth, fit[2])
    fast = speed + points.along(fit) > FAST_WAVES * speed
    return points[fast] if fast.sum() >= MIN_POINTS else points


def distance_from_relation(points: RelationPoints, depth: float, fit: Array, least_k: float) -> float:
    """Rms distance of the points from the fitted relation in k over their wavenumber, weighted as in the fit.
    Shorter wavenumbers than `least_k`, rad/m, count as that.
    """
    model = dispersion(points.k, depth, fit[2]) + points.k * points.along(fit)
    distance = (points.omega - model) / group_velocity(points.k, depth, fit[2])
    relative = distance / np.maximum(points.k, least_k)
    return float(np.sqrt(np.average(relative**2, weights=1 / points.k_std**2)))


def line_quality(points: RelationPoints, depth: float, fit: Array) -> dict[str, tuple[str, Array]]:
    """Variables of each line: signal to noise, share of the information on the current, and mean misfit."""
    lines, number = np.unique(points.omega, return_inverse=True)
    misfit = _misfit(points, depth, fit)(fit * _UNITS)
    energy = np.bincount(number, points.energy)
    information = np.bincount(number, _information(points, depth, fit))
    return {
        "line_frequency": ("line", lines / (2 * np.pi)),
        "line_signal_to_noise": (
            "line",
            energy / np.bincount(number, points.energy / points.signal_to_noise),
        ),
        "line_weight": ("line", information / information.sum()),
        "line_misfit": ("line", np.bincount(number, misfit) / np.sqrt(np.bincount(number))),
    }


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
