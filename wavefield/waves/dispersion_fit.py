"""Fit of current and surface tension to the measured dispersion relation."""

from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.optimize import least_squares

from wavefield.errors import CubeError
from wavefield.variables import annotate
from wavefield.water import GAMMA, dispersion, group_velocity, wavenumber
from wavefield.waves.dispersion_points import (
    LEAKAGE_ERROR,
    MIN_CELLS_FROM_ZERO,
    PlaneSpectrum,
    RelationPoints,
    WindowDisplacement,
    centroids,
    contrast,
    fit_settings,
    fraction,
    scan_current,
    sectors_of,
)
from wavefield.waves.inputs import takes
from wavefield.waves.products import Noted, WaveProduct, register
from wavefield.waves.spectra import plane_of
from wavefield.waves.welch import Welch, k_coords

Array = NDArray[Any]

MIN_POINTS = 6  # twice the unknowns
OUTLIER_STDS = 3.0  # standard deviations of the points: larger misfits count less
MIN_SLOPE = 0.15  # of the group velocity: waves that a current slows more count as these
FREQUENCY_BLOCKS = 5  # that are left out in turn: each must hold enough waves to change the fit
MAX_CHANGE = 0.015  # m/s: a current that changes by more without one of these blocks depends on the band
MAX_CONDITION = 1e4  # of the normal equations of a current: those of waves of one direction exceed it
TENSION_RANGE = 0.3  # of the surface tension: how far that of the water may differ from what is given
BAND_WIDTH = 0.5  # Hz, over which points are compared with theory
_UNITS = np.array([1, 1, 1e5])  # the solver's unit of surface tension is 1e-5 m3/s2


def _misfit(points: RelationPoints, depth: float, around: Array) -> Callable[[Array], Array]:
    """Misfit of the points in standard deviations, (points,), for a scaled fit.
    Errors in k become errors in omega by the slope of the relation for the fit `around`.
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
    """Misfit beyond which points get less weight."""
    return OUTLIER_STDS * max(float(np.median(np.abs(misfit))) / 0.6745, 1e-9)


def solve(points: RelationPoints, depth: float, start: Array) -> Array:
    """The fit to the points, (3,)."""
    misfit, scaled = _misfit(points, depth, start), start * _UNITS
    limit = _outlier_limit(misfit(scaled))
    result = least_squares(misfit, scaled, loss="soft_l1", f_scale=limit, x_scale=[0.01, 0.01, 1.0])
    return np.array([result.x[0], result.x[1], max(result.x[2], 0.0) * 1e-5])


def _solve_current(points: RelationPoints, depth: float, fit: Array) -> Array:
    """Current of a subset of points with the surface tension of the fit, (2,); NaN if undetermined."""
    misfit = _misfit(points, depth, fit)
    tension = fit[2] * 1e5
    limit = _outlier_limit(misfit(fit * _UNITS))
    result = least_squares(
        lambda current: misfit(np.array([*current, tension])), fit[:2], loss="soft_l1", f_scale=limit
    )
    normal = result.jac.T @ result.jac
    return np.asarray(result.x) if np.linalg.cond(normal) < MAX_CONDITION else np.full(2, np.nan)


def _information(points: RelationPoints, depth: float, fit: Array) -> Array:
    """Contribution of each point to the inverse variance of the current, (points,)."""
    return np.asarray((points.k / (points.k_std * group_velocity(points.k, depth, fit[2]))) ** 2)


def jackknife(points: RelationPoints, depth: float, fit: Array) -> Array:
    """Standard uncertainty of the current, (2,), by leaving out one frequency band at a time.
    The bands determine the current equally well. Raises CubeError if one band changes it much.
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
    """Covariance (3, 3) of the least-squares fit, from the misfit of all points; NaN if there are few.
    Multiplied by the variance of Student's distribution.
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
    """The fit and its covariance with the surface tension constrained to be near `gamma`.
    On a fast current the measured waves are too long to determine it.
    """
    if not np.isfinite(covariance).all():
        return fit, covariance
    gain = covariance[:, 2] / (covariance[2, 2] + (TENSION_RANGE * gamma) ** 2)
    return fit + gain * (gamma - fit[2]), covariance - np.outer(gain, covariance[2])


def distance_from_relation(points: RelationPoints, depth: float, fit: Array) -> Array:
    """Distance of the points from the fitted relation in k, rad/m; to first order."""
    along = points.along(fit)
    speed = group_velocity(points.k, depth, fit[2])
    model = dispersion(points.k, depth, fit[2]) + points.k * along
    return np.asarray((model - points.omega) / np.maximum(speed + along, MIN_SLOPE * speed))


def against_theory(points: RelationPoints, depth: float, fit: Array, gamma: float) -> dict[str, Any]:
    """Variables ``ridge_error`` and ``band_frequency``, Hz, (band,): points against theory by bands.
    The error is the mean of k over the theory's k for that omega and direction, less 1, weighted as in the
    fit.
    """
    distance = distance_from_relation(points, depth, np.array([fit[0], fit[1], gamma]))
    band = np.floor(points.omega / (2 * np.pi) / BAND_WIDTH)
    numbers, inverse = np.unique(band, return_inverse=True)
    weight = 1 / points.k_std**2
    errors = np.bincount(inverse, weight * distance / points.k) / np.bincount(inverse, weight)
    return {"ridge_error": ("band", errors), "band_frequency": ("band", (numbers + 0.5) * BAND_WIDTH)}


MAX_RELATIVE_DISTANCE = 0.1  # of k: points of waves lie within 3 % of the relation, of other energy 8 to 70 %
MIN_CONTRAST = 1.5  # energy near the relation over that at other frequencies: noise has 0.9 to 1.2
MAX_CURRENT_STD = 0.012  # m/s: more is of no use, and found where waves are blocked
TENSION_ERROR = 0.02  # of the surface tension: the error that remains in noisy seas
FIT_SECTORS = 24  # of direction; each must hold several cells of the shortest waves' ring
MAX_ROUNDS = 12  # in which the displacement by the windows is removed; at least two
DAMPED_FROM = 3  # round
CONVERGED, NOT_CONVERGED = 3e-4, 5e-3  # m/s: the rounds end at a smaller change; a larger one is refused


@takes(plane_of("w"))
def fit_dispersion(
    density: xr.DataArray,
    depth: float = np.inf,
    *,
    gamma: float = GAMMA,
    lowest: float | None = None,
    highest: float | None = None,
) -> xr.Dataset:
    """Fit current and surface tension to the dispersion relation of E(ky, kx, omega).

    Parameters
    ----------
    density : DataArray or Dataset
        Spectrum (omega, ky, kx), best of w, which shows the relation most clearly, or the result of
        `spectrum`; of a field (time, y, x) or of the w of a cube it is computed.
    depth : float
        Depth of the water, m; by default that of the cube, or deep. It is kept fixed: waves this
        short do not determine it.
    gamma : float
        Surface tension over density, m3/s2, to start from and for the theory of ``ridge_error``.
    lowest, highest : float, optional
        Band of frequencies used, Hz, and higher ones of waves that a current carries past faster. If not
        given, all that the spectrum resolves, each line weighted by how far its waves exceed the noise. Waves
        longer than two fifths of the shorter side of the rectangle are always left out.

    Returns
    -------
    Dataset
        The points: ``ridge_k``, ``ridge_omega``, ``ridge_angle``, ``ridge_weight`` (point). The fit:
        ``current_x``, ``current_y`` (m/s), ``gamma`` (m3/s2) and their ``_std``; ``ridge_fraction``, the
        fraction of the variance near the relation; ``ridge_error`` (band), k of the points against the theory
        with the fitted current and the water's gamma, relative; ``depth``.

    Raises
    ------
    CubeError
        If the band has too few points, they lie on the relation of no current, or the energy near the
        relation hardly exceeds that of the same wave vectors at other frequencies (noise has a best current,
        too); if the fit does not converge or depends on the band, or the standard uncertainty of the current
        exceeds 12 mm/s.

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
    (`windowed_dispersion.windowed_waves`); it is subtracted in rounds until the current converges.

    The uncertainty is the larger of two: that of least squares, from the misfit of all points, increased
    where the contrast of the relation is low; and a jackknife over five blocks of lines of equal
    information. Added in quadrature are its change with three tenths of the displacement by the windows left,
    and 2 % of the surface tension, which is taken to be within 30 % of `gamma` where the waves determine it
    less well.

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
    density = density.compute()
    spectrum = PlaneSpectrum.of(density, depth)
    omega, plane = spectrum.omega, spectrum.plane
    top = min(
        2 * np.pi * (highest or np.inf), 0.92 * dispersion(0.9 * plane.nyquist, depth), 0.97 * omega[-1]
    )
    bottom = max(2 * np.pi * (lowest or 0.0), dispersion(MIN_CELLS_FROM_ZERO * plane.cell, depth))
    start = scan_current(spectrum.on_lines((omega >= bottom) & (omega <= top)), gamma)
    # the same waves pass faster with the current
    top = max(top, min(top + np.hypot(*start) * wavenumber(top, depth, gamma), 0.97 * omega[-1]))
    limits = bottom, top
    in_band = (omega >= bottom) & (omega <= top)
    band = spectrum.on_lines(in_band)
    sectors = sectors_of(plane, FIT_SECTORS)
    fit = np.array([*start, gamma])
    for correction in range(MAX_ROUNDS):
        before = fit
        measured = _refuse_few(centroids(band, sectors, fit, highest), limits)
        windows = WindowDisplacement.measure(spectrum, in_band, sectors, fit, highest)
        points = _refuse_few(windows.removed_from(measured), limits)
        fit = solve(points, depth, fit)
        if correction >= DAMPED_FROM:  # rounds that overshoot in turn converge half-way
            fit = (fit + before) / 2
        change = float(np.hypot(*(fit - before)[:2]))
        if correction > 0 and change < CONVERGED:
            break
    contrast_of_fit = _check_fit(spectrum, points, fit, change, limits)

    by_leakage = solve(windows.removed_from(measured, 1 - LEAKAGE_ERROR), depth, fit) - fit
    # 1 / contrast of the energy in the points is noise
    covariance = covariance_of(points, depth, fit) / (1 - 1 / contrast_of_fit) ** 2
    fit, covariance = with_surface_tension(fit, covariance, gamma)
    std = np.sqrt(np.diag(covariance))
    std[:2] = np.maximum(std[:2], jackknife(points, depth, fit))
    std = np.sqrt(std**2 + by_leakage**2 + np.square([0.0, 0.0, TENSION_ERROR * gamma]))
    _refuse_uncertain(float(np.hypot(*std[:2])), limits)

    out: dict[str, Any] = {}
    for name, value, error in zip(("current_x", "current_y", "gamma"), fit, std):
        out[name], out[f"{name}_std"] = ((), value), ((), error)
    out |= {
        "ridge_omega": ("point", points.omega),
        "ridge_k": ("point", points.k),
        "ridge_angle": ("point", points.angle),
        "ridge_weight": ("point", points.energy, {"units": density.attrs.get("units", "1")}),
        "ridge_fraction": ((), fraction(spectrum, fit)),
        "depth": ((), depth),
    }
    out |= against_theory(points, depth, fit, gamma)
    attrs = {"lowest": float(bottom / (2 * np.pi)), "highest": float(top / (2 * np.pi))}
    return annotate(xr.Dataset(out, attrs=attrs).set_coords("band_frequency"), "dispersion")


def _between(limits: tuple[float, float]) -> str:
    """The frequency limits, rad/s, as text for a message."""
    return f"between {limits[0] / (2 * np.pi):.2g} and {limits[1] / (2 * np.pi):.2g} Hz"


def _refuse_few(points: RelationPoints, limits: tuple[float, float]) -> RelationPoints:
    """Return the points; raise CubeError if they are too few for a fit."""
    if len(points) < MIN_POINTS:
        raise CubeError(
            f"no dispersion relation was found {_between(limits)}: choose a longer segment or another band"
        )
    return points


def _check_fit(
    spectrum: PlaneSpectrum, points: RelationPoints, fit: Array, change: float, limits: tuple[float, float]
) -> float:
    """Contrast of the fitted relation; raises CubeError if the fit does not describe the waves."""
    between = _between(limits)
    best = f"{fit[0]:.2f}, {fit[1]:.2f} m/s"
    # a window spreads a wave over more than a cell of the k plane: in a small field that distance is no error
    least_k = spectrum.plane.cell / MAX_RELATIVE_DISTANCE
    relative = distance_from_relation(points, spectrum.depth, fit) / np.maximum(points.k, least_k)
    distance = float(np.sqrt(np.average(relative**2, weights=1 / points.k_std**2)))
    if distance > MAX_RELATIVE_DISTANCE:
        raise CubeError(
            f"the waves {between} are {100 * distance:.0f} % of their wavenumber away from the dispersion"
            f" relation of any current (the best is {best}); a current may block them: check depth, frame"
            " rate and grid step, or choose another band"
        )
    lines = (spectrum.omega > limits[0] / 2) & (spectrum.omega < 1.5 * limits[1])
    contrast_of_fit = contrast(spectrum, lines, fit)
    if contrast_of_fit < MIN_CONTRAST:
        raise CubeError(
            f"no dispersion relation was found {between}: the best one holds {contrast_of_fit:.2f} times the"
            " energy of the same wave vectors at other frequencies, where noise has 1"
        )
    if change > NOT_CONVERGED:
        raise CubeError(
            f"the current fit did not converge {between} (last estimate {best}); choose a band with"
            " `fit: {lowest, highest}`"
        )
    return contrast_of_fit


def _refuse_uncertain(std: float, limits: tuple[float, float]) -> None:
    if std <= MAX_CURRENT_STD:
        return
    reason = f"determine the current to {std:.2f} m/s only"
    if not np.isfinite(std):
        reason = "are too few to determine the current"
    raise CubeError(
        f"the waves {_between(limits)} {reason}; it may block them: choose a longer record or another band"
    )


def dispersion_group(
    density: xr.DataArray, k: Array, depth: float, gamma: float, **band: float
) -> xr.Dataset:
    """Group `dispersion`: the theory over k, rad/m, and the fit or the reason for its refusal."""
    theory = xr.Dataset({"omega_theory": ("k", dispersion(k, depth, gamma))}, k_coords(k))
    try:
        out = fit_dispersion(density, depth, gamma=gamma, **band)
    except CubeError as error:
        return annotate(theory, "dispersion").assign_attrs(refused=str(error))
    fitted = ("k", dispersion(k, depth, float(out["gamma"])))
    out = out.assign(theory.data_vars).assign_coords(theory.coords).assign(omega_fit=fitted)
    return annotate(out, "dispersion")


def _product(
    density: xr.DataArray,
    welch: Welch,
    depth: float,
    gamma: float,
    settings: tuple[dict[str, float], tuple[float, float] | None],
) -> xr.Dataset:
    return dispersion_group(density, welch.table.k, depth, gamma, **settings[0])


MIN_SEGMENTS_FOR_TENSION = 4  # before a fitted surface tension is more than noise
MAX_TENSION_STD = 0.05  # standard uncertainty of the surface tension, relative


def without_uncertain_tension(fit: xr.Dataset, welch: Welch) -> Noted:
    """A dispersion fit, without the surface tension if the waves do not determine it."""
    if "refused" in fit.attrs:
        return Noted(fit, [f"The dispersion relation was not fitted: {fit.attrs['refused']}."])
    gamma, std = float(fit["gamma"]), float(fit["gamma_std"])
    if welch.count < MIN_SEGMENTS_FOR_TENSION:
        count = welch.count
        reason = f"the record holds {count} segment{'s' if count > 1 else ''}; four are needed"
    elif not np.isfinite(std):
        reason = "the dispersion fit does not determine it"
    elif not std < MAX_TENSION_STD * gamma:
        reason = f"its uncertainty is {1e6 * std:.2g}e-6 of {1e6 * gamma:.2g}e-6 m3/s2"
    else:
        return Noted(fit, [])
    fit = fit.drop_vars(["gamma", "gamma_std", "omega_fit"], errors="ignore")
    return Noted(fit, [f"No surface tension was fitted: {reason}."])


register(
    WaveProduct("fit_settings", ("fit",), fit_settings),
    WaveProduct("dispersion_fit", ("density_w", "welch", "depth", "gamma", "fit_settings"), _product, cost=3),
)
register(
    WaveProduct("dispersion", ("dispersion_fit", "welch"), without_uncertain_tension, group="dispersion")
)
