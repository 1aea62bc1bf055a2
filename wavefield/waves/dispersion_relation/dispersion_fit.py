"""The measured ridge of the dispersion relation: current and surface tension fitted to it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage
from scipy.optimize import least_squares

from wavefield.errors import CubeError
from wavefield.variables import annotate
from wavefield.water import GAMMA, dispersion, group_velocity, wavenumber
from wavefield.waves.dispersion_relation.current_scan import LONGEST, WavenumberPlane, plane_of, scan_current
from wavefield.waves.dispersion_relation.noise_floor import noise_level
from wavefield.waves.dispersion_relation.shell_contrast import contrast, explained, fraction
from wavefield.waves.dispersion_relation.shell_error import against_theory
from wavefield.waves.estimation import wave_kernels
from wavefield.waves.estimation.welch import k_coords
from wavefield.waves.estimation.windowed_dispersion import SpectralCells, as_seen

Array = NDArray[Any]
Vector = tuple[float, float]
CURRENT_NAMES = ("current_x", "current_y")

_ASTRAY = 0.1  # of k: a ridge lies within 3 %, what is taken for one by mistake within 8 to 70 %
_LEAST = 3e-3  # of the strongest sector on a line: what is weaker has leaked
_LEAST_POINTS = 6
_HELD_UP = 0.5  # of the free group velocity: waves that a current slows more smear over all k
_FAST = 0.7  # of the free group velocity: what the fit changes by without slower waves is doubt
_EXPLAINED = 0.5  # of the energy above the noise: a relation that holds less is not that of the waves
OUTLYING_DEVIATIONS = 3.0  # standard deviations of the points: larger misfits count less
MIN_SIGNAL_TO_NOISE = 1.0  # of a point: weaker ones are left out
CELL_VARIANCE = 0.3  # relative variance of a cell's energy, with its neighbours' share
DOUBTED_NOISE = 1.2  # times the level: by so much it may be wrong, locally
NOISE_LEVEL_ERROR = 0.03  # relative: what is left of the noise pulls a centroid to the middle of its window
CENTROID_ERROR = 0.03  # of a cell of the k plane, of the strongest sector; leakage adds to weaker ones
LEAKAGE_ERROR = 0.3  # of the displacement of a centroid by the windows: what is left when it is undone
FREQUENCY_BLOCKS = 5  # that are left out in turn
MAX_CHANGE = 0.015  # m/s: a current that changes by more without one of these blocks depends on the band
STRONG_LINE = 20.0  # energy near the dispersion relation over the noise there: the band of a second try
MAX_CONDITION = 1e4  # of the normal equations of a current: those of waves of one direction exceed it
MIN_SLOPE = 0.15  # of the group velocity: waves that a current slows more count as these
_LEANING = 0.3  # cells of the k plane: what the windows move further is theirs
_WHOLE = 0.8  # of the grid's shortest waves' k: shorter ones are seen in part
_FILM = 0.3  # of the surface tension: so far water may differ from what is given
_UNKNOWN = 0.012  # m/s: a current that is known no better is not stated
_TENSION = 0.02  # of the surface tension: what noisy seas leave wrong in it
_CONTRAST = 1.5  # energy on the ridge over what its cells hold at other frequencies: noise has .9 to 1.2
_MIN_IMPROVEMENT = 12  # rounds at most in which the windows' doing is taken off, two at least
DAMPED_FROM = 3  # round
_SETTLED, _UNSETTLED = 3e-4, 5e-3  # m/s: they end where the current changes by less; are refused by more


@dataclass(frozen=True)
class FitSettings:
    """How the ridge is followed.

    Parameters
    ----------
    lowest, highest : float, optional
        Band of frequencies used, Hz, and further up those waves that pass faster on a current. If not given,
        all that the spectrum resolves, each line weighted by how far its waves exceed the noise. Waves longer
        than two fifths of the shorter side of the rectangle are left out besides.
    sectors : int
        Sectors of angle.
    half_width : float
        Of the window around the ridge, relative to k.
    least_width : float
        The same in cells of the k plane: a Hann window spreads a wave over two on either side.
    rounds : int
        How often the window is re-centred on the fit.
    """

    lowest: float | None = None
    highest: float | None = None
    sectors: int = 24
    half_width: float = 0.22
    least_width: float = 2.2
    rounds: int = 4


@dataclass(frozen=True)
class _Sector:
    theta: float
    cells: Array  # of the plane, by rising k
    k: Array
    heading: Array  # (2, cells), cosine and sine of the angle


def _sectors(plane: WavenumberPlane, count: int) -> list[_Sector]:
    out = []
    width = np.pi / count
    rising = np.argsort(plane.k, kind="stable")
    for t in np.arange(count) * 2 * width:
        off = np.abs((plane.angle[rising] - t + np.pi) % (2 * np.pi) - np.pi)
        cells = rising[off < width]
        heading = np.array([np.cos(plane.angle[cells]), np.sin(plane.angle[cells])])
        out.append(_Sector(t, cells, plane.k[cells], heading))
    return out


def _centroids(
    energy: Array,
    omega: Array,
    noise: Array,
    plane: WavenumberPlane,
    sectors: list[_Sector],
    depth: float,
    fit: Array,
    settings: FitSettings,
) -> Array:
    # rows: omega, k, angle, energy, number of cells, key of line and sector, standard deviation of k, energy
    # over that of the noise
    parts = []
    table = np.linspace(0.1, 1.2 * plane.k.max(), 4000)
    free = dispersion(table, depth, fit[2])
    whole = _WHOLE * min(plane.kx.max(), plane.ky.max())
    highest = 2 * np.pi * (settings.highest or np.inf)
    limit = np.full(omega.size, whole)
    if np.isfinite(highest):
        limit[omega > highest] = min(whole, wavenumber(highest, depth, fit[2]))
    for number, sector in enumerate(sectors):
        centres = _branch(omega, table, free, fit[0] * np.cos(sector.theta) + fit[1] * np.sin(sector.theta))
        reach = np.maximum(settings.half_width * centres, settings.least_width * plane.cell)
        reach = np.nan_to_num(reach)
        first = np.searchsorted(sector.k, np.nan_to_num(centres) - reach, "right")
        last = np.searchsorted(sector.k, np.nan_to_num(centres) + reach, "left")
        sums = np.empty((8, omega.size))
        wave_kernels.windowed_sums(energy, noise, sector.cells, sector.k, sector.heading, first, last, sums)
        count = last - first
        held = (count >= 5) & (sums[0] > MIN_SIGNAL_TO_NOISE * sums[7]) & (sums[0] > 0) & (centres < limit)
        weight, level = sums[0, held], sums[7, held]
        k = sums[1, held] / weight
        second = sums[6, held] - 2 * k * sums[5, held] + k**2 * sums[4, held]
        pull = NOISE_LEVEL_ERROR * level * reach[held]
        std = np.sqrt(CELL_VARIANCE * np.maximum(second, 0) + pull**2) / weight
        k -= plane.spread / (2 * k)
        key = np.flatnonzero(held) * len(sectors) + number
        angle = np.arctan2(sums[3, held], sums[2, held])
        ratio = weight / np.maximum(level, 1e-9 * weight)
        rows = np.stack([omega[held], k, angle, weight, count[held], key, std, ratio], 1)
        # waves about as long as the rectangle: the window's spread exceeds them
        parts.append(rows[(k > 0) & (np.abs(k - centres[held]) < reach[held])])
    points = np.concatenate(parts)
    top = _strongest(points)
    points[:, 6] = np.hypot(points[:, 6], CENTROID_ERROR * plane.cell * np.sqrt(top / points[:, 3]))
    return points[points[:, 3] > _LEAST * top]


def _branch(omega: Array, table: Array, free: Array, along: float) -> Array:
    # k of the waves that the current along them does not hold up, NaN where there are none: against a current
    # omega rises with k only as far as the group velocity exceeds it
    doppler = free + table * along
    slope = np.gradient(doppler, table)
    held_up = np.flatnonzero(slope < _HELD_UP * np.gradient(free, table))
    last = int(held_up[0]) if held_up.size else table.size
    if last < 2:
        return np.full(omega.size, np.nan)
    return np.interp(omega, doppler[:last], table[:last], right=np.nan)


def _strongest(points: Array) -> Array:
    # energy of the strongest sector on each point's line and its neighbours
    _, number = np.unique(points[:, 0], return_inverse=True)
    top = np.zeros(number.max(initial=-1) + 1)
    np.maximum.at(top, number, points[:, 3])
    return np.asarray(ndimage.maximum_filter1d(top, 3)[number]) if top.size else top


def _misfit(points: Array, depth: float, around: Array) -> Callable[[Array], Array]:
    # of current and surface tension in 1e-5 m3/s2, in standard deviations of the points, (points,);
    # `around` is a fit that gives the slope of the ridge
    omega, k, angle = points[:, 0], points[:, 1], points[:, 2]
    kx, ky = k * np.cos(angle), k * np.sin(angle)
    speed = group_velocity(k, depth, around[2])
    slope = speed + (around[0] * kx + around[1] * ky) / k
    std = points[:, 6] * np.maximum(slope, MIN_SLOPE * speed)

    def misfit(p: Array) -> Array:
        model = dispersion(k, depth, max(p[2], 0.0) * 1e-5) + p[0] * kx + p[1] * ky
        return np.asarray((model - omega) / std)

    return misfit


def _outlying(misfit: Array) -> float:
    # misfits beyond this count less
    return OUTLYING_DEVIATIONS * max(float(np.median(np.abs(misfit))) / 0.6745, 1e-9)


def _solve(points: Array, depth: float, start: Array) -> Array:
    scaled = np.array([start[0], start[1], start[2] * 1e5])
    misfit = _misfit(points, depth, start)
    result = least_squares(
        misfit, scaled, loss="soft_l1", f_scale=_outlying(misfit(scaled)), x_scale=[0.01, 0.01, 1.0]
    )
    return np.array([result.x[0], result.x[1], max(result.x[2], 0.0) * 1e-5])


def _current_of(points: Array, depth: float, fit: Array) -> Array:
    # current of some of the points with the surface tension of the fit, (2,); NaN if they do not determine it
    misfit = _misfit(points, depth, fit)
    f_scale = _outlying(misfit(fit * [1, 1, 1e5]))
    result = least_squares(
        lambda u: misfit(np.array([u[0], u[1], fit[2] * 1e5])), fit[:2], loss="soft_l1", f_scale=f_scale
    )
    normal = result.jac.T @ result.jac
    return np.asarray(result.x) if np.linalg.cond(normal) < MAX_CONDITION else np.full(2, np.nan)


def _without_blocks(points: Array, depth: float, fit: Array) -> tuple[Array, Array]:
    # changes of the current, (blocks, 2), without one of some blocks of lines that determine it equally well,
    # and the first and last frequency of each block, (blocks, 2), Hz
    order = np.argsort(points[:, 0], kind="stable")
    speed = group_velocity(points[order, 1], depth, fit[2])
    share = np.cumsum((points[order, 1] / (points[order, 6] * speed)) ** 2)
    block = np.minimum((share / share[-1] * FREQUENCY_BLOCKS).astype(int), FREQUENCY_BLOCKS - 1)
    whole = _current_of(points, depth, fit)
    changes, bands = [], []
    for b in np.unique(block):
        out, left = order[block == b], order[block != b]
        enough = len(left) >= _LEAST_POINTS
        changes.append(_current_of(points[left], depth, fit) - whole if enough else np.full(2, np.nan))
        bands.append(points[out[[0, -1]], 0] / (2 * np.pi))
    return np.array(changes), np.array(bands)


def _jackknife(points: Array, depth: float, fit: Array) -> Array:
    # standard uncertainty of the current from fits without one block of lines each, (2,)
    changes, blocks = _without_blocks(points, depth, fit)
    size = np.hypot(*changes.T)
    worst = int(np.argmax(np.where(np.isfinite(size), size, np.inf)))
    if not size[worst] <= MAX_CHANGE:
        how_far = f"changes by {size[worst]:.3f} m/s" if np.isfinite(size[worst]) else "is not determined"
        raise CubeError(
            f"the current depends on the band: without the waves between {blocks[worst][0]:.2g} and"
            f" {blocks[worst][1]:.2g} Hz it {how_far} (the fit is {fit[0]:.2f}, {fit[1]:.2f} m/s); choose a"
            " band with `fit: {lowest, highest}` or a longer record"
        )
    return np.asarray(np.sqrt((changes**2).mean(axis=0) * (len(changes) - 1)))


def _covariance(points: Array, depth: float, fit: Array) -> Array:
    # of the fit, from the scatter of the points about it, those of half a hertz and an octant of directions
    # taken together: they share waves, and whatever else is wrong with them (sandwich of clusters)
    misfit, scaled = _misfit(points, depth, fit), fit * [1, 1, 1e5]
    steps = np.diag([1e-4, 1e-4, 1e-2])
    slopes = np.stack([(misfit(scaled + d) - misfit(scaled - d)) / (2 * d.sum()) for d in steps], axis=1)
    left = misfit(scaled)
    robust = 1 / np.sqrt(1 + (left / _outlying(left)) ** 2)
    octant = np.round(points[:, 2] / (np.pi / 4)) % 8
    _, cluster = np.unique(np.floor(points[:, 0] / np.pi) * 8 + octant, return_inverse=True)
    count = int(cluster.max()) + 1
    normal = (slopes * robust[:, None]).T @ slopes
    if count <= 3 or np.linalg.cond(normal) > 1e12:
        return np.full((3, 3), np.nan)
    pulls = np.zeros((count, 3))
    np.add.at(pulls, cluster, slopes * (robust * left)[:, None])
    inverse = np.linalg.inv(normal)
    covariance = inverse @ (pulls.T @ pulls) @ inverse * count / (count - 3)
    return np.asarray(covariance * np.outer([1, 1, 1e-5], [1, 1, 1e-5]))


def _of_water(fit: Array, covariance: Array, gamma: float) -> tuple[Array, Array]:
    # knowing that water has nearly this surface tension: on a fast current waves are too long to tell it
    if not np.isfinite(covariance).all():
        return fit, covariance
    pull = covariance[:, 2] / (covariance[2, 2] + (_FILM * gamma) ** 2)
    return fit + pull * (gamma - fit[2]), covariance - np.outer(pull, covariance[2])


def fit_dispersion(
    density: xr.DataArray,
    depth: float = np.inf,
    *,
    gamma: float = GAMMA,
    settings: FitSettings | None = None,
) -> xr.Dataset:
    """Follow the ridge of E(ky, kx, omega) and fit current and surface tension to it.

    Parameters
    ----------
    density : DataArray, (omega, ky, kx)
        Spectrum, best of w: its ridge is the clearest.
    depth : float
        Depth of the water, m. It is kept fixed: waves this short do not feel it.
    gamma : float
        Surface tension over density, m3/s2, to start from and to compare the ridge with.
    settings : FitSettings, optional
        Band, sectors and window.

    Returns
    -------
    Dataset
        ``ridge_k``, ``ridge_omega``, ``ridge_angle``, ``ridge_weight`` (point); ``current_x``, ``current_y``
        (m/s), ``gamma`` (m3/s2) and their ``_std``; ``ridge_fraction``, the fraction of the variance
        within the ridge; ``ridge_error`` (band): the ridge's k against the theory with the fitted current and
        the water's gamma, relative; ``depth``. Of each line: ``line_frequency``, Hz,
        ``line_signal_to_noise``, ``line_weight``, its share of what determines the current, and
        ``line_misfit``, the mean misfit of its points over its standard deviation.

    Raises
    ------
    CubeError
        If no energy stands out in the band, or it lies on the ridge of no current, or the ridge hardly stands
        out of what the same wave vectors hold at other frequencies: noise has a best current, too; or if less
        than half of the energy lies on it, the fit does not converge or depends on the band, or the standard
        uncertainty of the current exceeds 12 mm/s.

    Notes
    -----
    The fit starts from the current that gathers most energy on the ridge (`scan_current`). k-centroids at
    fixed omega in sectors of angle, the window re-centred on the fit. The noise (`noise_level`) is
    subtracted without clipping, so that it does not pull centroids to the middle of the window; a
    centroid's weight is the inverse of its variance, which follows from the energies of the cells in its
    window, the signal-to- noise ratio, leakage from stronger sectors and 0.3 of what the windows move it.
    Points without a signal as large as the noise or below 0.3 % of the strongest sector are left out. What
    the windows do to a centroid (leakage along a falling spectrum and from strong directions into weak
    ones, the curvature of the ridge) is subtracted: free waves of the measured energy on the fitted
    relation pass through the same windows and are followed likewise (`ridge_windows.as_seen`), in rounds
    until the current settles. Centroids in omega at fixed k would be biased by up to 8 %.

    The uncertainty is the larger of two: from the scatter of the points about the fit, those of half a
    hertz and an octant of directions taken together, increased where the ridge stands out little; and from
    a jackknife over five blocks of lines of equal information. It is joined with half of what the fit
    changes by when a fifth more noise is subtracted, with what it changes by without the waves that the
    current slows most and in the last round, and 2 % of the surface tension, which is taken to be within 30
    % of what is given where the waves determine it less well. A fit that changes by more than 15 mm/s
    without one of the blocks is refused. Where the fit to all lines is refused and no ``highest`` is given,
    it is tried once more with the lines whose waves far exceed the noise.

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
    try:
        return _fit_band(density, depth, gamma, settings)
    except CubeError as refusal:
        highest = None if settings.highest else _end_of_strong_lines(density, depth, gamma)
        if highest is None:
            raise
        try:
            return _fit_band(density, depth, gamma, replace(settings, highest=highest))
        except CubeError:
            raise refusal from None


def _end_of_strong_lines(density: xr.DataArray, depth: float, gamma: float) -> float | None:
    """Frequency, Hz, up to which the waves near the dispersion relation far exceed the noise."""
    omega, plane = density["omega"].values, plane_of(density)
    nyquist_k = min(abs(float(density[name].min())) for name in ("ky", "kx"))
    energy = density.values.reshape(omega.size, -1)
    noise = noise_level(energy, plane, nyquist_k)
    k = wavenumber(np.maximum(omega, omega[1]), depth, gamma)
    near = np.abs(plane.k - k[:, None]) < np.maximum(0.1 * k[:, None], 2.0 * plane.cell)
    ratio = (energy * near).sum(axis=1) / np.maximum((noise * near).sum(axis=1), np.finfo(float).tiny)
    strongest = int(np.argmax((energy * near).sum(axis=1)))
    weak = np.flatnonzero(ratio[strongest:] < STRONG_LINE)
    if not weak.size or weak[0] < 2:
        return None
    return float(omega[strongest + weak[0] - 1] / (2 * np.pi))


def _fit_band(density: xr.DataArray, depth: float, gamma: float, settings: FitSettings) -> xr.Dataset:
    """The fit of `fit_dispersion` in the band of the settings; raises CubeError where it is refused."""
    omega = density["omega"].values
    nyquist_k = min(abs(float(density[name].min())) for name in ("ky", "kx"))
    highest = 2 * np.pi * (settings.highest or np.inf)
    top = min(highest, 0.92 * dispersion(0.9 * nyquist_k, depth), 0.97 * omega[-1])
    plane = plane_of(density)
    bottom = max(2 * np.pi * (settings.lowest or 0.0), dispersion(LONGEST * plane.cell, depth))
    energy = density.values.reshape(omega.size, -1)
    noise = noise_level(energy, plane, nyquist_k)
    band = (omega >= bottom) & (omega <= top)
    start = scan_current(energy[band], omega[band], noise[band], plane, depth, gamma)
    # the same waves pass faster with the current
    top = max(top, min(top + np.hypot(*start) * wavenumber(top, depth, gamma), 0.97 * omega[-1]))
    band = (omega >= bottom) & (omega <= top)
    used, floor = energy[band], noise[band]
    sectors = _sectors(plane, settings.sectors)
    fit = np.array([*start, gamma])
    points = np.empty((0, 8))
    for _ in range(settings.rounds):
        points = _centroids(used, omega[band], floor, plane, sectors, depth, fit, settings)
        points = _enough(points, bottom, top)
        fit = _solve(points, depth, fit)
    lean, change = np.zeros((2, 0)), np.inf
    for correction in range(_MIN_IMPROVEMENT):
        before = fit
        lean = _windows_lean(density, noise, band, sectors, plane, depth, fit, settings)
        points = _centroids(used, omega[band], floor, plane, sectors, depth, fit, settings)
        points = _enough(_straightened(points, lean), bottom, top)
        fit = _solve(points, depth, fit)
        if correction >= DAMPED_FROM:  # rounds that overshoot in turn settle half-way
            fit = (fit + before) / 2
        change = float(np.hypot(*(fit - before)[:2]))
        if correction > 0 and change < _SETTLED:
            break

    band_words = f"the waves between {bottom / (2 * np.pi):.2g} and {top / (2 * np.pi):.2g} Hz"
    astray = _astray(points, depth, fit, plane.cell)
    if astray > _ASTRAY:
        raise CubeError(
            f"{band_words} lie {100 * astray:.0f} % of their wavenumber beside the dispersion relation,"
            f" whatever the current (the best is {fit[0]:.2f}, {fit[1]:.2f} m/s): check depth, frame rate and"
            " grid step, or choose another band"
        )
    contrast_found = contrast(energy, omega, (omega > bottom / 2) & (omega < 1.5 * top), plane, depth, fit)
    if contrast_found < _CONTRAST:
        raise CubeError(
            f"no ridge stands out between {bottom / (2 * np.pi):.2g} and {top / (2 * np.pi):.2g} Hz: the best"
            f" one holds {contrast_found:.2f} times what the same wave vectors hold at other frequencies, "
            f"where"
            " noise has 1"
        )
    if change > _UNSETTLED:
        raise CubeError(
            f"the current fit did not converge ({bottom / (2 * np.pi):.1f}-{top / (2 * np.pi):.1f} Hz; last"
            f" estimate {fit[0]:.2f}, {fit[1]:.2f} m/s); choose a band with `fit: {{lowest, highest}}`"
        )
    held = explained(energy, omega, noise, (omega > bottom / 2) & (omega < 1.5 * top), plane, depth, fit)
    if held < _EXPLAINED:
        raise CubeError(
            f"{band_words} hold {100 * held:.0f} % of their energy on the dispersion relation, whatever the"
            f" current (the best is {fit[0]:.2f}, {fit[1]:.2f} m/s), as where it holds them up: check depth,"
            " frame rate and grid step, or choose another band"
        )
    quieter = _centroids(used, omega[band], DOUBTED_NOISE * floor, plane, sectors, depth, fit, settings)
    doubt = 0.5 * np.abs(_solve(_straightened(quieter, lean), depth, fit) - fit)
    doubt = np.hypot(doubt, np.hypot(_solve(_fast(points, depth, fit), depth, fit) - fit, fit - before))
    # of what the points say 1 / contrast is noise
    covariance = _covariance(points, depth, fit) / (1 - 1 / contrast_found) ** 2
    fit, covariance = _of_water(fit, covariance, gamma)
    chance = np.sqrt(np.diag(covariance))
    chance[:2] = np.maximum(chance[:2], _jackknife(points, depth, fit))
    spreads = np.hypot(chance, np.hypot(doubt, [0.0, 0.0, _TENSION * gamma]))
    _refuse_uncertain(float(np.hypot(*spreads[:2])), band_words)
    out: dict[str, Any] = {}
    for i, name in enumerate(("current_x", "current_y", "gamma")):
        out[name], out[f"{name}_std"] = ((), fit[i]), ((), spreads[i])
    for i, name in enumerate(("ridge_omega", "ridge_k", "ridge_angle", "ridge_weight")):
        out[name] = ("point", points[:, i])
    out |= against_theory(points, depth, fit, gamma)
    out |= _line_quality(points, depth, fit)
    out["ridge_fraction"] = ((), fraction(energy, omega, plane, depth, fit))
    out["depth"] = ((), depth)
    attrs = {"lowest": float(bottom / (2 * np.pi)), "highest": float(top / (2 * np.pi))}
    out_set = annotate(
        xr.Dataset(out, attrs=attrs).set_coords(["band_frequency", "line_frequency"]), "dispersion"
    )
    out_set["ridge_weight"].attrs["units"] = density.attrs.get("units", "1")
    return out_set


def _refuse_uncertain(std: float, band_words: str) -> None:
    if std <= _UNKNOWN:
        return
    how_well = f"tell the current to {std:.2f} m/s only"
    if not np.isfinite(std):
        how_well = "are too few to tell the current"
    raise CubeError(
        f"{band_words} {how_well}, as where it holds them up: choose a longer record or another band"
    )


def _line_quality(points: Array, depth: float, fit: Array) -> dict[str, Any]:
    # of each line: signal over noise, share of what is known of the current, and mean misfit in its own
    # standard deviations
    omega, k, std = points[:, 0], points[:, 1], points[:, 6]
    lines, number = np.unique(omega, return_inverse=True)
    misfit = _misfit(points, depth, fit)(fit * [1, 1, 1e5])
    level = np.bincount(number, points[:, 3] / points[:, 7])
    share = np.bincount(number, (k / (std * group_velocity(k, depth, fit[2]))) ** 2)
    quality = {
        "frequency": lines / (2 * np.pi),
        "signal_to_noise": np.bincount(number, points[:, 3]) / level,
        "weight": share / share.sum(),
        "misfit": np.bincount(number, misfit) / np.sqrt(np.bincount(number)),
    }
    return {f"line_{name}": ("line", values) for name, values in quality.items()}


def fit_settings(fit: "FitSettings | Mapping[str, Any] | None") -> tuple[FitSettings, Vector | None]:
    """Settings of the fit, and the current to use where it is refused, from what a user gives.

    With fit, m/s.

    Examples
    --------
    >>> fit_settings({"lowest": "1", "current_x": 0.1})[1]
    (0.1, 0.0)
    """
    if fit is None or isinstance(fit, FitSettings):
        return fit or FitSettings(), None
    kinds = {field.name: field.type for field in fields(FitSettings)} | dict.fromkeys(CURRENT_NAMES, "float")
    values: dict[str, Any] = {}
    for name, value in fit.items():
        if name not in kinds:
            raise CubeError(f"`fit` has no setting {name!r}; it has {', '.join(kinds)}")
        try:
            values[name] = int(value) if kinds[name] == "int" else float(value)
        except (TypeError, ValueError):
            raise CubeError(f"`fit` needs a number for {name}, not {value!r}") from None
        if not np.isfinite(values[name]) or (name not in CURRENT_NAMES and values[name] <= 0):
            raise CubeError(f"`fit` needs a positive number for {name}, not {value!r}")
    if values.get("lowest", 0.0) >= values.get("highest", np.inf):
        raise CubeError(
            f"`fit` needs lowest below highest, not {values['lowest']:g} and {values['highest']:g}"
        )
    given = [values.pop(name, None) for name in CURRENT_NAMES]
    current = None if given == [None, None] else (given[0] or 0.0, given[1] or 0.0)
    return FitSettings(**values), current


def _fast(points: Array, depth: float, fit: Array) -> Array:
    # points of waves that the current slows little; all where few are left
    speed = group_velocity(points[:, 1], depth, fit[2])
    along = fit[0] * np.cos(points[:, 2]) + fit[1] * np.sin(points[:, 2])
    fast = speed + along > _FAST * speed
    return points[fast] if fast.sum() >= _LEAST_POINTS else points


def _enough(points: Array, bottom: float, top: float) -> Array:
    if len(points) < _LEAST_POINTS:
        raise CubeError(
            f"no ridge stands out between {bottom / (2 * np.pi):.2g} and {top / (2 * np.pi):.2g} Hz:"
            " choose a longer segment or another band"
        )
    return points


def _windows_lean(
    density: xr.DataArray,
    noise: Array,
    band: Array,
    sectors: list[_Sector],
    plane: WavenumberPlane,
    depth: float,
    fit: Array,
    settings: FitSettings,
) -> Array:
    # keys of points (see `_centroids`) and how far in k they lie beside the relation by the windows' doing;
    # without those that lie where they do for the windows: beyond the end of a sea all is leakage
    cells = SpectralCells(*(density[name].values for name in ("omega", "ky", "kx")))
    values = density.values.reshape(cells.omega.size, -1)
    seen = as_seen(values, noise, cells, depth, fit)[band]
    quiet = np.zeros_like(seen)
    points = _centroids(seen, cells.omega[band], quiet, plane, sectors, depth, fit, settings)
    k, along = points[:, 1], fit[0] * np.cos(points[:, 2]) + fit[1] * np.sin(points[:, 2])
    beside = points[:, 0] - dispersion(k, depth, fit[2]) - k * along
    lean = -beside / (group_velocity(k, depth, fit[2]) + along)
    own = np.abs(lean) < _LEANING * plane.cell
    return np.array([points[own, 5], lean[own]])


def _straightened(points: Array, lean: Array) -> Array:
    # points with what the windows did to them taken off; without those whose like no free wave would show
    _, mine, theirs = np.intersect1d(points[:, 5], lean[0], assume_unique=True, return_indices=True)
    out = points[mine]
    out[:, 1] -= lean[1, theirs]
    out[:, 6] = np.hypot(out[:, 6], LEAKAGE_ERROR * lean[1, theirs])
    return out[out[:, 1] > 0]


def _astray(points: Array, depth: float, fit: Array, cell: float) -> float:
    # rms distance of the points from the fitted ridge over their wavenumber, weighted as in the fit; in a
    # small field what a cell of the k plane allows is no fault: a window spreads a wave over more than one
    k, angle = points[:, 1], points[:, 2]
    model = dispersion(k, depth, fit[2]) + k * (fit[0] * np.cos(angle) + fit[1] * np.sin(angle))
    apart = (points[:, 0] - model) / group_velocity(k, depth, fit[2]) / np.maximum(k, cell / _ASTRAY)
    return float(np.sqrt(np.average(apart**2, weights=1 / points[:, 6] ** 2)))


def dispersion_group(
    density: xr.DataArray, k: Array, depth: float, gamma: float, settings: FitSettings | None = None
) -> tuple[xr.Dataset, str]:
    """The theory and the fitted ridge.

    With density (omega, ky, kx); k (k,), rad/m.
    """
    theory = xr.Dataset({"omega_theory": ("k", dispersion(k, depth, gamma))}, k_coords(k))
    try:
        out = fit_dispersion(density, depth, gamma=gamma, settings=settings)
    except CubeError as error:
        theory = annotate(theory, "dispersion").assign_attrs(refused=str(error))
        return theory, f"No ridge was fitted: {error}."
    fitted = ("k", dispersion(k, depth, float(out["gamma"])))
    out = out.assign(theory.data_vars).assign_coords(theory.coords).assign(omega_fit=fitted)
    return annotate(out, "dispersion"), ""
