"""Fit of current and surface tension to the measured dispersion relation."""

from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.errors import CubeError
from wavefield.variables import annotate
from wavefield.water import GAMMA, dispersion, wavenumber
from wavefield.waves.dispersion_relation import relation_solution
from wavefield.waves.dispersion_relation.current_scan import scan_current
from wavefield.waves.dispersion_relation.fit_settings import FitSettings, fit_settings
from wavefield.waves.dispersion_relation.plane_spectrum import MIN_CELLS_FROM_ZERO, PlaneSpectrum
from wavefield.waves.dispersion_relation.relation_points import (
    LEAKAGE_ERROR,
    RelationPoints,
    WindowDisplacement,
    centroids,
    sectors_of,
)
from wavefield.waves.dispersion_relation.shell_contrast import contrast, explained, fraction
from wavefield.waves.estimation.inputs import takes
from wavefield.waves.estimation.welch import Welch, k_coords
from wavefield.waves.estimation.windowed_dispersion import SpectralCells
from wavefield.waves.products import Product, register
from wavefield.waves.spectra.plane_input import plane_of

Array = NDArray[Any]

MAX_RELATIVE_DISTANCE = 0.1  # of k: points of waves lie within 3 % of the relation, of other energy 8 to 70 %
MIN_EXPLAINED = 0.5  # of the energy above the noise: a relation that holds less is not that of the waves
MIN_CONTRAST = 1.5  # energy near the relation over that at other frequencies: noise has 0.9 to 1.2
MAX_CURRENT_STD = 0.012  # m/s
NOISE_FACTOR = 1.2  # by which the level of the noise may be wrong locally
TENSION_ERROR = 0.02  # of the surface tension: the error that remains in noisy seas
MAX_ROUNDS = 12  # in which the displacement by the windows is removed; at least two
DAMPED_FROM = 3  # round
CONVERGED, NOT_CONVERGED = 3e-4, 5e-3  # m/s: the rounds end at a smaller change; a larger one is refused
STRONG_LINE = 20.0  # energy near the dispersion relation over the noise there: the band of a second fit


@takes(plane_of("w"))
def fit_dispersion(
    density: xr.DataArray,
    depth: float = np.inf,
    *,
    gamma: float = GAMMA,
    settings: FitSettings | None = None,
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
    settings : FitSettings, optional
        Band, sectors and window.

    Returns
    -------
    Dataset
        The points: ``ridge_k``, ``ridge_omega``, ``ridge_angle``, ``ridge_weight`` (point). The fit:
        ``current_x``, ``current_y`` (m/s), ``gamma`` (m3/s2) and their ``_std``; ``ridge_fraction``, the
        fraction of the variance near the relation; ``ridge_error`` (band), k of the points against the theory
        with the fitted current and the water's gamma, relative; ``depth``. Of each line: ``line_frequency``,
        Hz, ``line_signal_to_noise``, ``line_weight``, its share of the information on the current, and
        ``line_misfit``, the mean misfit of its points over its standard deviation.

    Raises
    ------
    CubeError
        If the band has too few points, they lie on the relation of no current, or the energy near the
        relation hardly exceeds that of the same wave vectors at other frequencies (noise has a best current,
        too); if less than half of the energy is near it, the fit does not converge or depends on the band, or
        the standard uncertainty of the current exceeds 12 mm/s.

    Notes
    -----
    The fit starts from the current whose relation holds most energy (`scan_current`). The points are
    centroids in k at fixed omega in sectors of angle, in a window that is centred on the fit again;
    centroids in omega at fixed k would be biased by up to 8 %. The noise (`noise_level`) is subtracted
    without clipping, so that it does not move centroids to the middle of the window. The weight of a point is
    its inverse variance, from the energies of the cells in its window, the signal-to-noise ratio, leakage
    from stronger sectors and 0.3 of its displacement by the windows. Points without a signal as large as the
    noise or below 0.3 % of the strongest sector are left out. The displacement by the spectral windows
    (leakage along a falling spectrum and from strong directions into weak ones, the curvature of the
    relation) is that of simulated free waves of the measured energy on the fitted relation
    (`windowed_dispersion.windowed_waves`); it is subtracted in rounds until the current converges.

    The uncertainty is the larger of two: that of least squares, from the misfit of all points, increased
    where the contrast of the relation is low; and a jackknife over five blocks of lines of equal
    information. Added in quadrature are half of the change of the fit when a fifth more noise is subtracted,
    its changes with three tenths of the displacement by the windows left and without the waves that the
    current slows most, its change in the last round, and 2 % of the surface tension, which is taken to be
    within 30 % of `gamma` where the waves determine it less well. Where the fit to all lines is refused and
    no ``highest`` is given, the lines whose waves far exceed the noise are tried.

    Examples
    --------
    Three hundred waves on water that flows along x at 5 cm/s.

    >>> from wavefield.waves.spectra.field_spectra import spectrum
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
    settings = settings or FitSettings()
    density = density.compute()
    spectrum = PlaneSpectrum.of(density, depth)
    cells = SpectralCells(*(density[name].values for name in ("omega", "ky", "kx")))
    try:
        out = _fit_band(spectrum, cells, gamma, settings)
    except CubeError as refusal:
        highest = None if settings.highest else _end_of_strong_lines(spectrum, gamma)
        if highest is None:
            raise
        try:
            out = _fit_band(spectrum, cells, gamma, replace(settings, highest=highest))
        except CubeError:
            raise refusal from None
    out["ridge_weight"].attrs["units"] = density.attrs.get("units", "1")
    return out


def _end_of_strong_lines(spectrum: PlaneSpectrum, gamma: float) -> float | None:
    """Frequency, Hz, up to which the waves near the dispersion relation far exceed the noise."""
    omega, plane = spectrum.omega, spectrum.plane
    k = wavenumber(np.maximum(omega, omega[1]), spectrum.depth, gamma)
    near = np.abs(plane.k - k[:, None]) < np.maximum(0.1 * k[:, None], 2.0 * plane.cell)
    energy = (spectrum.energy * near).sum(axis=1)
    ratio = energy / np.maximum((spectrum.noise * near).sum(axis=1), np.finfo(float).tiny)
    strongest = int(np.argmax(energy))
    weak = np.flatnonzero(ratio[strongest:] < STRONG_LINE)
    if not weak.size or weak[0] < 2:
        return None
    return float(omega[strongest + weak[0] - 1] / (2 * np.pi))


def _fit_band(
    spectrum: PlaneSpectrum, cells: SpectralCells, gamma: float, settings: FitSettings
) -> xr.Dataset:
    """The fit of `fit_dispersion` in the band of the settings; raises CubeError where it is refused."""
    omega, plane, depth = spectrum.omega, spectrum.plane, spectrum.depth
    highest = 2 * np.pi * (settings.highest or np.inf)
    top = min(highest, 0.92 * dispersion(0.9 * plane.nyquist, depth), 0.97 * omega[-1])
    bottom = max(2 * np.pi * (settings.lowest or 0.0), dispersion(MIN_CELLS_FROM_ZERO * plane.cell, depth))
    start = scan_current(spectrum.on_lines((omega >= bottom) & (omega <= top)), gamma)
    # the same waves pass faster with the current
    top = max(top, min(top + np.hypot(*start) * wavenumber(top, depth, gamma), 0.97 * omega[-1]))
    limits = bottom, top
    in_band = (omega >= bottom) & (omega <= top)
    band = spectrum.on_lines(in_band)
    sectors = sectors_of(plane, settings.sectors)
    fit = np.array([*start, gamma])
    for _ in range(settings.rounds):
        points = _refuse_few(centroids(band, sectors, fit, settings), limits)
        fit = relation_solution.solve(points, depth, fit)
    for correction in range(MAX_ROUNDS):
        before = fit
        windows = WindowDisplacement.measure(spectrum, cells, in_band, sectors, fit, settings)
        measured = centroids(band, sectors, fit, settings)
        points = _refuse_few(windows.removed_from(measured), limits)
        fit = relation_solution.solve(points, depth, fit)
        if correction >= DAMPED_FROM:  # rounds that overshoot in turn converge half-way
            fit = (fit + before) / 2
        change = float(np.hypot(*(fit - before)[:2]))
        if correction > 0 and change < CONVERGED:
            break
    contrast_of_fit = _check_fit(spectrum, points, fit, change, limits)

    noisier = replace(band, noise=NOISE_FACTOR * band.noise)
    quieter = windows.removed_from(centroids(noisier, sectors, fit, settings))
    by_noise = 0.5 * np.abs(relation_solution.solve(quieter, depth, fit) - fit)
    fast = relation_solution.fast_waves(points, depth, fit)
    by_slow_waves = relation_solution.solve(fast, depth, fit) - fit
    displaced = windows.removed_from(measured, 1 - LEAKAGE_ERROR)
    by_leakage = relation_solution.solve(displaced, depth, fit) - fit
    systematic = np.sqrt(by_noise**2 + by_slow_waves**2 + by_leakage**2 + (fit - before) ** 2)
    # 1 / contrast of the energy in the points is noise
    covariance = relation_solution.covariance_of(points, depth, fit) / (1 - 1 / contrast_of_fit) ** 2
    fit, covariance = relation_solution.with_surface_tension(fit, covariance, gamma)
    std = np.sqrt(np.diag(covariance))
    std[:2] = np.maximum(std[:2], relation_solution.jackknife(points, depth, fit))
    std = np.hypot(std, np.hypot(systematic, [0.0, 0.0, TENSION_ERROR * gamma]))
    _refuse_uncertain(float(np.hypot(*std[:2])), limits)

    out: dict[str, Any] = {}
    for name, value, error in zip(("current_x", "current_y", "gamma"), fit, std):
        out[name], out[f"{name}_std"] = ((), value), ((), error)
    out |= {
        "ridge_omega": ("point", points.omega),
        "ridge_k": ("point", points.k),
        "ridge_angle": ("point", points.angle),
        "ridge_weight": ("point", points.energy),
        "ridge_fraction": ((), fraction(spectrum, fit)),
        "depth": ((), depth),
    }
    out |= relation_solution.against_theory(points, depth, fit, gamma) | relation_solution.line_quality(
        points, depth, fit
    )
    attrs = {"lowest": float(bottom / (2 * np.pi)), "highest": float(top / (2 * np.pi))}
    return annotate(
        xr.Dataset(out, attrs=attrs).set_coords(["band_frequency", "line_frequency"]), "dispersion"
    )


def _between(limits: tuple[float, float]) -> str:
    """The limits, rad/s, in words."""
    return f"between {limits[0] / (2 * np.pi):.2g} and {limits[1] / (2 * np.pi):.2g} Hz"


def _refuse_few(points: RelationPoints, limits: tuple[float, float]) -> RelationPoints:
    """The points, if they are enough for a fit."""
    if len(points) < relation_solution.MIN_POINTS:
        raise CubeError(
            f"no dispersion relation was found {_between(limits)}: choose a longer segment or another band"
        )
    return points


def _check_fit(
    spectrum: PlaneSpectrum, points: RelationPoints, fit: Array, change: float, limits: tuple[float, float]
) -> float:
    """Contrast of the fitted relation; raises CubeError for a fit that is not that of the waves."""
    between = _between(limits)
    best = f"{fit[0]:.2f}, {fit[1]:.2f} m/s"
    # a window spreads a wave over more than a cell of the k plane: in a small field that distance is no error
    least_k = spectrum.plane.cell / MAX_RELATIVE_DISTANCE
    distance = relation_solution.distance_from_relation(points, spectrum.depth, fit, least_k)
    if distance > MAX_RELATIVE_DISTANCE:
        raise CubeError(
            f"the waves {between} are {100 * distance:.0f} % of their wavenumber away from the dispersion"
            f" relation of any current (the best is {best}): check depth, frame rate and grid step, or choose"
            " another band"
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
    near = explained(spectrum, lines, fit)
    if near < MIN_EXPLAINED:
        raise CubeError(
            f"the waves {between} have {100 * near:.0f} % of their energy near the dispersion relation of any"
            f" current (the best is {best}); a current may block them: check depth, frame rate and grid step,"
            " or choose another band"
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
    density: xr.DataArray, k: Array, depth: float, gamma: float, settings: FitSettings | None = None
) -> xr.Dataset:
    """The theory over k (rad/m) and the fit, or why it was refused."""
    theory = xr.Dataset({"omega_theory": ("k", dispersion(k, depth, gamma))}, k_coords(k))
    try:
        out = fit_dispersion(density, depth, gamma=gamma, settings=settings)
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
    settings: tuple[FitSettings, tuple[float, float] | None],
) -> xr.Dataset:
    return dispersion_group(density, welch.table.k, depth, gamma, settings[0])


register(
    Product("fit_settings", ("fit",), fit_settings),
    Product("dispersion_fit", ("density_w", "welch", "depth", "gamma", "fit_settings"), _product, cost=3),
)
