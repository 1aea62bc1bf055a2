"""The measured ridge of the dispersion relation: current and surface tension fitted to it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.optimize import least_squares

from wavefield.errors import CubeError
from wavefield.variables import annotate
from wavefield.water import GAMMA, dispersion, group_velocity, wavenumber
from wavefield.waves import kernels
from wavefield.waves.current_scan import LONGEST, Plane, plane_of, scan_current
from wavefield.waves.ridge_contrast import contrast, explained, fraction
from wavefield.waves.ridge_error import against_theory
from wavefield.waves.ridge_windows import Cells, as_seen
from wavefield.waves.welch import k_coords

Array = NDArray[Any]

_ASTRAY = 0.1  # of k: a ridge lies within 3 %, what is taken for one by mistake within 8 to 70 %
_LEAST = 1e-3  # of the strongest sector on a line: what is weaker has leaked
_LEAST_POINTS = 6
_HELD_UP = 0.5  # of the free group velocity: waves that a current slows more smear over all k
_FAST = 0.7  # of the free group velocity: what the fit changes by without slower waves is doubt
_EXPLAINED = 0.5  # of the energy above the noise: a relation that holds less is not that of the waves
_ROBUST = 0.05  # of a misfit over sqrt(k): larger ones count less
_LEANING = 0.3  # cells of the k plane: what the windows move further is theirs
_WHOLE = 0.8  # of the grid's shortest waves' k: shorter ones are seen in part
_FILM = 0.3  # of the surface tension: so far water may differ from what is given
_UNKNOWN = 0.02  # m/s: a current that is known no better is not stated
_TENSION = 0.02  # of the surface tension: what noisy seas leave wrong in it
_CONTRAST = 1.5  # energy on the ridge over what its cells hold at other frequencies: noise has .9 to 1.2
_MENDS = 8  # rounds at most in which the windows' doing is taken off, two at least
_SETTLED, _UNSETTLED = 3e-4, 2e-3  # m/s: they end where the current changes by less; are refused by more


@dataclass(frozen=True)
class FitSettings:
    """How the ridge is followed.

    Parameters
    ----------
    lowest, highest : float
        Band of frequencies used, Hz, and further up those waves that pass faster on a current; waves longer
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

    lowest: float = 1.5
    highest: float = 5.0
    sectors: int = 16
    half_width: float = 0.22
    least_width: float = 2.2
    rounds: int = 4


@dataclass(frozen=True)
class _Sector:
    theta: float
    cells: Array  # of the plane, by rising k
    k: Array
    heading: Array  # (2, cells), cosine and sine of the angle


def _sectors(plane: Plane, count: int) -> list[_Sector]:
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
    plane: Plane,
    sectors: list[_Sector],
    depth: float,
    fit: Array,
    settings: FitSettings,
) -> Array:
    # rows: omega, k, angle, weight, number of cells, key of line and sector
    parts = []
    table = np.linspace(0.1, 1.2 * plane.k.max(), 4000)
    free = dispersion(table, depth, fit[2])
    whole = _WHOLE * min(plane.kx.max(), plane.ky.max())
    highest = 2 * np.pi * settings.highest
    limit = np.where(omega <= highest, whole, min(whole, wavenumber(highest, depth, fit[2])))
    for number, sector in enumerate(sectors):
        centres = _branch(omega, table, free, fit[0] * np.cos(sector.theta) + fit[1] * np.sin(sector.theta))
        reach = np.maximum(settings.half_width * centres, settings.least_width * plane.cell)
        reach = np.nan_to_num(reach)
        first = np.searchsorted(sector.k, np.nan_to_num(centres) - reach, "right")
        last = np.searchsorted(sector.k, np.nan_to_num(centres) + reach, "left")
        sums = np.empty((4, omega.size))  # weight, of k, of the heading
        kernels.windowed_sums(energy, noise, sector.cells, sector.k, sector.heading, first, last, sums)
        count = last - first
        held = (count >= 5) & (sums[0] > 0) & (centres < limit)
        weight = sums[0, held]
        k = sums[1, held] / weight
        k -= plane.spread / (2 * k)
        key = np.flatnonzero(held) * len(sectors) + number
        angle = np.arctan2(sums[3, held], sums[2, held])
        rows = np.stack([omega[held], k, angle, weight, count[held], key], 1)
        parts.append(rows[k > 0])  # waves about as long as the rectangle: the window's spread exceeds them
    points = np.concatenate(parts)
    return points[points[:, 3] > _LEAST * _strongest(points)]


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
    # energy of the strongest sector on each point's line
    _, number = np.unique(points[:, 0], return_inverse=True)
    top = np.zeros(number.max(initial=-1) + 1)
    np.maximum.at(top, number, points[:, 3])
    return np.asarray(top[number])


def _misfit(points: Array, depth: float) -> Callable[[Array], Array]:
    # of current and surface tension in 1e-5 m3/s2, (points,)
    omega, k, angle = points[:, 0], points[:, 1], points[:, 2]
    kx, ky = k * np.cos(angle), k * np.sin(angle)
    # every line alike, on a line by amplitude: weak sectors say less of the waves there
    weight = (points[:, 3] / _strongest(points)) ** 0.25 / np.sqrt(k)

    def misfit(p: Array) -> Array:
        model = dispersion(k, depth, max(p[2], 0.0) * 1e-5) + p[0] * kx + p[1] * ky
        return np.asarray(weight * (model - omega))

    return misfit


def _solve(points: Array, depth: float, start: Array) -> Array:
    scaled = np.array([start[0], start[1], start[2] * 1e5])
    result = least_squares(
        _misfit(points, depth), scaled, loss="soft_l1", f_scale=_ROBUST, x_scale=[0.01, 0.01, 1.0]
    )
    return np.array([result.x[0], result.x[1], max(result.x[2], 0.0) * 1e-5])


def _covariance(points: Array, depth: float, fit: Array) -> Array:
    # of the fit, from the scatter of the points about it, those of half a hertz and an octant of directions
    # taken together: they share waves, and whatever else is wrong with them (sandwich of clusters)
    misfit, scaled = _misfit(points, depth), fit * [1, 1, 1e5]
    steps = np.diag([1e-4, 1e-4, 1e-2])
    slopes = np.stack([(misfit(scaled + d) - misfit(scaled - d)) / (2 * d.sum()) for d in steps], axis=1)
    left = misfit(scaled)
    robust = 1 / np.sqrt(1 + (left / _ROBUST) ** 2)
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
        the water's gamma, relative; ``depth``.

    Raises
    ------
    CubeError
        If no energy stands out in the band, or it lies on the ridge of no current, or the ridge hardly stands
        out of what the same wave vectors hold at other frequencies: noise has a best current, too; or if less
        than half of the energy lies on it, the fit does not settle, or the current is not told to 2 cm/s.

    Notes
    -----
    The fit starts from the current that gathers most energy on the ridge (`scan_current`). k-centroids at
    fixed omega in sectors of angle, sectors below a thousandth of the strongest left out, a line's points
    weighted by amplitude; the window re-centred on the fit. What the windows do to a centroid (leakage along
    a falling spectrum and from strong directions into weak ones, the curvature of the ridge) is taken off:
    free waves of the measured energy on the fitted relation are seen through the same windows and followed
    likewise (`ridge_windows.as_seen`), and what lies beside the relation there is subtracted, in rounds until
    the current settles. Centroids in omega at fixed k would be biased by up to 8 %. The uncertainty follows
    from the scatter of the points about the fit, those of half a hertz and an octant of directions taken
    together, larger the less the ridge stands out, joined with half of what the fit changes by when twice the
    noise is taken off, with what it changes by without the waves that the current slows most and in the last
    round, and 2 % of the surface tension, which is taken to be within 30 % of what is given where the waves
    tell less.

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
    settings = settings or FitSettings()
    density = density.compute()
    omega = density["omega"].values
    nyquist_k = min(abs(float(density[name].min())) for name in ("ky", "kx"))
    highest = 2 * np.pi * settings.highest
    top = min(highest, 0.92 * dispersion(0.9 * nyquist_k, depth), 0.97 * omega[-1])
    plane = plane_of(density)
    bottom = max(2 * np.pi * settings.lowest, dispersion(LONGEST * plane.cell, depth))
    energy = density.values.reshape(omega.size, -1)
    outer = plane.k > 0.8 * nyquist_k
    noise = np.median(energy[:, outer], axis=1) if outer.any() else np.zeros(omega.size)
    band = (omega >= bottom) & (omega <= top)
    start = scan_current(energy[band], omega[band], noise[band], plane, depth, gamma)
    # the same waves pass faster with the current
    top = max(top, min(highest + np.hypot(*start) * wavenumber(highest, depth, gamma), 0.97 * omega[-1]))
    band = (omega >= bottom) & (omega <= top)
    used, floor = energy[band], noise[band]
    sectors = _sectors(plane, settings.sectors)
    fit = np.array([*start, gamma])
    points = np.empty((0, 6))
    for _ in range(settings.rounds):
        points = _centroids(used, omega[band], floor, plane, sectors, depth, fit, settings)
        points = _enough(points, bottom, top)
        fit = _solve(points, depth, fit)
    lean, change = np.zeros((2, 0)), np.inf
    for mend in range(_MENDS):
        before = fit
        lean = _windows_lean(density, noise, band, sectors, plane, depth, fit, settings)
        points = _centroids(used, omega[band], floor, plane, sectors, depth, fit, settings)
        points = _enough(_straightened(points, lean), bottom, top)
        fit = _solve(points, depth, fit)
        change = float(np.hypot(*(fit - before)[:2]))
        if mend > 0 and change < _SETTLED:
            break

    band_words = f"the waves between {bottom / (2 * np.pi):.2g} and {top / (2 * np.pi):.2g} Hz"
    astray = _astray(points, depth, fit, plane.cell)
    if astray > _ASTRAY:
        raise CubeError(
            f"{band_words} lie {100 * astray:.0f} % of their wavenumber beside the dispersion relation,"
            f" whatever the current (the best is {fit[0]:.2f}, {fit[1]:.2f} m/s): check depth, frame rate and"
            " grid step, or choose another band"
        )
    stands_out = contrast(energy, omega, (omega > bottom / 2) & (omega < 1.5 * top), plane, depth, fit)
    if stands_out < _CONTRAST:
        raise CubeError(
            f"no ridge stands out between {bottom / (2 * np.pi):.2g} and {top / (2 * np.pi):.2g} Hz: the best"
            f" one holds {stands_out:.2f} times what the same wave vectors hold at other frequencies, where"
            " noise has 1"
        )
    if change > _UNSETTLED:
        raise CubeError(
            f"{band_words} settle on no current (the last is {fit[0]:.2f}, {fit[1]:.2f} m/s), as where it"
            " holds them up: choose a longer record or another band"
        )
    held = explained(energy, omega, noise, (omega > bottom / 2) & (omega < 1.5 * top), plane, depth, fit)
    if held < _EXPLAINED:
        raise CubeError(
            f"{band_words} hold {100 * held:.0f} % of their energy on the dispersion relation, whatever the"
            f" current (the best is {fit[0]:.2f}, {fit[1]:.2f} m/s), as where it holds them up: check depth,"
            " frame rate and grid step, or choose another band"
        )
    quieter = _centroids(used, omega[band], 2 * floor, plane, sectors, depth, fit, settings)
    doubt = 0.5 * np.abs(_solve(_straightened(quieter, lean), depth, fit) - fit)
    doubt = np.hypot(doubt, np.hypot(_solve(_fast(points, depth, fit), depth, fit) - fit, fit - before))
    # of what the points say 1 / contrast is noise
    covariance = _covariance(points, depth, fit) / (1 - 1 / stands_out) ** 2
    fit, covariance = _of_water(fit, covariance, gamma)
    chance = np.sqrt(np.diag(covariance))
    spreads = np.hypot(chance, np.hypot(doubt, [0.0, 0.0, _TENSION * gamma]))
    known = np.hypot(*spreads[:2])
    if not known <= _UNKNOWN:
        how_well = f"tell the current to {known:.2f} m/s only"
        if not np.isfinite(known):
            how_well = "are too few to tell the current"
        raise CubeError(
            f"{band_words} {how_well}, as where it holds them up: choose a longer record or another band"
        )
    out: dict[str, Any] = {}
    for i, name in enumerate(("current_x", "current_y", "gamma")):
        out[name], out[f"{name}_std"] = ((), fit[i]), ((), spreads[i])
    for i, name in enumerate(("ridge_omega", "ridge_k", "ridge_angle", "ridge_weight")):
        out[name] = ("point", points[:, i])
    out |= against_theory(points, depth, fit, gamma)
    out["ridge_fraction"] = ((), fraction(energy, omega, plane, depth, fit))
    out["depth"] = ((), depth)
    attrs = {"lowest": float(bottom / (2 * np.pi)), "highest": float(top / (2 * np.pi))}
    out_set = annotate(xr.Dataset(out, attrs=attrs).set_coords("band_frequency"), "dispersion")
    out_set["ridge_weight"].attrs["units"] = density.attrs.get("units", "1")
    return out_set


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
    plane: Plane,
    depth: float,
    fit: Array,
    settings: FitSettings,
) -> Array:
    # keys of points (see `_centroids`) and how far in k they lie beside the relation by the windows' doing;
    # without those that lie where they do for the windows: beyond the end of a sea all is leakage
    cells = Cells(*(density[name].values for name in ("omega", "ky", "kx")))
    values = density.values.reshape(cells.omega.size, -1)
    seen = as_seen(values, noise, cells, depth, fit)[band]
    quiet = np.zeros(int(band.sum()))
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
    return out[out[:, 1] > 0]


def _astray(points: Array, depth: float, fit: Array, cell: float) -> float:
    # rms distance of the points from the fitted ridge over their wavenumber, weighted as in the fit; in a
    # small field what a cell of the k plane allows is no fault: a window spreads a wave over more than one
    k, angle = points[:, 1], points[:, 2]
    model = dispersion(k, depth, fit[2]) + k * (fit[0] * np.cos(angle) + fit[1] * np.sin(angle))
    apart = (points[:, 0] - model) / group_velocity(k, depth, fit[2]) / np.maximum(k, cell / _ASTRAY)
    return float(np.sqrt(np.average(apart**2, weights=points[:, 3] / _strongest(points))))


def dispersion_group(density: xr.DataArray, k: Array, depth: float, gamma: float) -> tuple[xr.Dataset, str]:
    """The theory and the fitted ridge.

    Parameters
    ----------
    density : DataArray, (omega, ky, kx)
        Spectrum of w.
    k : ndarray, (k,)
        Wavenumbers of the theory, rad/m.
    depth, gamma : float
        Depth, m, and surface tension over density, m3/s2, of the water.

    Returns
    -------
    group : Dataset
        ``omega_theory``, ``omega_fit`` (k) and what `fit_dispersion` gives.
    note : str
        Why no ridge was fitted; empty where one was.
    """
    theory = xr.Dataset({"omega_theory": ("k", dispersion(k, depth, gamma))}, k_coords(k))
    try:
        out = fit_dispersion(density, depth, gamma=gamma)
    except CubeError as error:
        return annotate(theory, "dispersion"), f"No ridge was fitted: {error}."
    fitted = ("k", dispersion(k, depth, float(out["gamma"])))
    out = out.assign(theory.data_vars).assign_coords(theory.coords).assign(omega_fit=fitted)
    return annotate(out, "dispersion"), ""
