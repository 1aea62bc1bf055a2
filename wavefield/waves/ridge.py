"""The measured ridge of the dispersion relation: current and surface tension fitted to it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage
from scipy.optimize import least_squares

from wavefield.errors import CubeError
from wavefield.variables import annotate
from wavefield.water import GAMMA, dispersion, group_velocity, wavenumber
from wavefield.waves import kernels
from wavefield.waves.welch import k_coords

Array = NDArray[Any]

_LONGEST = 2.5  # cells of the k plane: longer waves lie within the window's reach of those that come back
_ASTRAY = 0.1  # of k: a ridge lies within 3 %, what is taken for one by mistake within 8 to 70 %
_LEAST = 1e-3  # of the strongest sector on a line: what is weaker has leaked
_HELD_UP = 0.3  # of the free group velocity: waves that a current slows more smear over all k
_FASTEST, _SCAN_STEP, _SCAN_SECTORS = 0.8, 0.02, 48  # m/s
_SLOPE_OVER = 0.3  # Hz to either side: the slope of the spectrum is taken over this


@dataclass(frozen=True)
class FitSettings:
    """How the ridge is followed.

    Parameters
    ----------
    lowest, highest : float
        Band of frequencies used, Hz; waves longer than two fifths of the shorter side of the rectangle are
        left out besides.
    sectors : int
        Sectors of angle.
    half_width : float
        Of the window around the ridge, relative to k.
    least_width : float
        The same in cells of the k plane: a Hann window spreads a wave over two on either side.
    rounds : int
        How often the window is re-centred on the fit.
    bootstrap : int
        Number of synthetic spectra for the uncertainty.
    """

    lowest: float = 1.5
    highest: float = 5.0
    sectors: int = 16
    half_width: float = 0.22
    least_width: float = 2.2
    rounds: int = 4
    bootstrap: int = 24


@dataclass(frozen=True)
class _Plane:
    kx: Array  # (cells,)
    ky: Array
    k: Array
    angle: Array
    cell: float  # larger side of a cell, rad/m
    spread: float  # variance along k that the window lends to a single wave, (rad/m)^2


def _plane(density: xr.DataArray) -> _Plane:
    ky, kx = np.meshgrid(density["ky"].values, density["kx"].values, indexing="ij")
    cells = [float(density[name][1] - density[name][0]) for name in ("ky", "kx")]
    # second moment of a Hann line |W|^2 (weights 1, 4, 1 over 6) is a third of a cell squared; across the ray
    # it lengthens |k| on average by spread / 2k
    spread = float(np.mean(np.square(cells))) / 3
    return _Plane(
        kx.ravel(), ky.ravel(), np.hypot(kx, ky).ravel(), np.arctan2(ky, kx).ravel(), max(cells), spread
    )


@dataclass(frozen=True)
class _Sector:
    theta: float
    cells: Array  # of the plane, by rising k
    k: Array
    heading: Array  # (2, cells), cosine and sine of the angle


def _sectors(plane: _Plane, count: int) -> list[_Sector]:
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
    plane: _Plane,
    sectors: list[_Sector],
    depth: float,
    fit: Array,
    settings: FitSettings,
) -> Array:
    # rows: omega, k, angle, weight, number of cells
    parts = []
    table = np.linspace(0.1, 1.2 * plane.k.max(), 4000)
    free = dispersion(table, depth, fit[2])
    for sector in sectors:
        centres = _branch(omega, table, free, fit[0] * np.cos(sector.theta) + fit[1] * np.sin(sector.theta))
        reach = np.maximum(settings.half_width * centres, settings.least_width * plane.cell)
        reach = np.nan_to_num(reach)
        first = np.searchsorted(sector.k, np.nan_to_num(centres) - reach, "right")
        last = np.searchsorted(sector.k, np.nan_to_num(centres) + reach, "left")
        sums = np.empty((4, omega.size))  # weight, of k, of the heading
        kernels.windowed_sums(energy, noise, sector.cells, sector.k, sector.heading, first, last, sums)
        count = last - first
        held = (count >= 5) & (sums[0] > 0) & np.isfinite(centres)
        weight = sums[0, held]
        k = sums[1, held] / weight
        k -= plane.spread / (2 * k)
        rows = np.stack([omega[held], k, np.arctan2(sums[3, held], sums[2, held]), weight, count[held]], 1)
        parts.append(rows[k > 0])  # waves about as long as the rectangle: the window's spread exceeds them
    points = np.concatenate(parts)
    points = points[points[:, 3] > _LEAST * _strongest(points)]
    if len(points) and omega.size > 1:
        points[:, 0] += _leaning(points, omega[1] - omega[0])
    return points


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


def _leaning(points: Array, step: float) -> Array:
    # a Hann window mixes waves of neighbouring lines, variance step^2 / 3: where energy falls steeply a line
    # holds more of the slower ones, which are longer
    lines, number = np.unique(points[:, 0], return_inverse=True)
    energy = np.log(np.bincount(number, points[:, 3]))
    reach = max(3, round(2 * np.pi * _SLOPE_OVER / step))
    slope = np.zeros(lines.size)
    for i in range(lines.size):
        near = slice(max(i - reach, 0), i + reach + 1)
        if lines[near].size > 2:
            apart = lines[near] - lines[near].mean()
            slope[i] = apart @ energy[near] / (apart @ apart)
    return (step**2 / 3 * slope)[number]


def _strongest(points: Array) -> Array:
    # energy of the strongest sector on each point's line
    _, number = np.unique(points[:, 0], return_inverse=True)
    top = np.zeros(number.max(initial=-1) + 1)
    np.maximum.at(top, number, points[:, 3])
    return np.asarray(top[number])


def scan_current(
    energy: Array, omega: Array, noise: Array, plane: _Plane, depth: float, gamma: float
) -> Array:
    """Current that gathers most energy on the ridge, to start the fit from.

    Parameters
    ----------
    energy : ndarray, (lines, cells)
        Spectrum.
    omega, noise : ndarray, (lines,)
        Angular frequency, rad/s, and the level of the noise.
    plane : _Plane
        Cells.
    depth, gamma : float
        Depth, m, and surface tension over density, m3/s2.

    Returns
    -------
    ndarray, (2,)
        Along x and y, m/s, to .02 m/s; of currents that serve alike the weakest.

    Notes
    -----
    Each cell asks for a current (omega - sigma(k)) / k along its direction. All votes are counted, each
    line's energy as one and short waves, which know it better, more; those of a current U lie on
    U cos(theta - phi).
    """
    kept = (plane.k > _LONGEST * plane.cell) & (plane.k < 0.9 * plane.k[plane.ky == 0].max())
    k, angle = plane.k[kept], plane.angle[kept]
    sector = np.rint(angle / (2 * np.pi) * _SCAN_SECTORS).astype(int) % _SCAN_SECTORS
    slots = round(2 * _FASTEST / _SCAN_STEP) + 1
    votes = np.zeros(_SCAN_SECTORS * slots)
    sigma = dispersion(k, depth, gamma)
    for o, line, floor in zip(omega, energy, noise):
        weight = np.maximum(line[kept] - 3 * floor, 0.0)
        total = weight.sum()
        wanted = np.rint(((o - sigma) / k + _FASTEST) / _SCAN_STEP).astype(int)
        inside = (wanted >= 0) & (wanted < slots) & (weight > 0)
        if total > 0:
            place = sector[inside] * slots + wanted[inside]
            votes += np.bincount(place, weight[inside] * k[inside] / total, votes.size)
    votes = ndimage.gaussian_filter1d(votes.reshape(_SCAN_SECTORS, slots), 1.0, axis=1)
    speeds = np.arange(-(slots // 2), slots // 2 + 1) * _SCAN_STEP
    ux, uy = np.meshgrid(speeds, speeds, indexing="ij")
    theta = np.arange(_SCAN_SECTORS) * 2 * np.pi / _SCAN_SECTORS
    score = np.zeros(ux.shape)
    for t, row in zip(theta, votes):
        along = (ux * np.cos(t) + uy * np.sin(t) + _FASTEST) / _SCAN_STEP
        score += np.interp(along, np.arange(slots), row, left=0.0, right=0.0)
    speed = np.hypot(ux, uy)
    alike = score >= 0.98 * score[speed <= _FASTEST].max()
    best = np.argmin(np.where(alike, speed, np.inf))
    return np.array([ux.flat[best], uy.flat[best]])


def _solve(points: Array, depth: float, start: Array) -> Array:
    omega, k, angle = points[:, 0], points[:, 1], points[:, 2]
    kx, ky = k * np.cos(angle), k * np.sin(angle)

    def misfit(p: Array) -> Array:
        model = dispersion(k, depth, max(p[2], 0.0) * 1e-5) + p[0] * kx + p[1] * ky
        out: Array = weight * (model - omega) / np.sqrt(k)
        return out

    # every line alike, on a line by energy: what leaks into empty sectors says nothing of the waves there
    weight = np.sqrt(points[:, 3] / _strongest(points))
    scaled = np.array([start[0], start[1], start[2] * 1e5])
    result = least_squares(misfit, scaled, loss="soft_l1", f_scale=0.05, x_scale=[0.01, 0.01, 1.0])
    return np.array([result.x[0], result.x[1], max(result.x[2], 0.0) * 1e-5])


def fit_dispersion(
    density: xr.DataArray,
    depth: float = np.inf,
    *,
    dof: float | None = None,
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
    dof : float, optional
        Degrees of freedom of a cell, for the uncertainty; from ``spectrum(...).dof``. Without it none is
        given.
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
        If no energy stands out in the band, or it lies on the ridge of no current.

    Notes
    -----
    The fit starts from the current that gathers most energy on the ridge (`scan_current`). k-centroids at
    fixed omega in sectors of angle, sectors below a thousandth of the strongest left out, a line's points
    weighted by energy; the window re-centred on the fit, |k| averaged and
    corrected by sigma_k^2 / 2k for the curvature of the ridge; a line's omega is corrected likewise, by
    sigma_omega^2 d ln E / d omega, for what neighbouring lines lend it: on a steep spectrum up to 1 % of k.
    Centroids in omega at fixed k would be biased by up to 8 %. The uncertainty joins the scatter of fits to
    spectra drawn from chi-squared distributions around the measured one and that of fits without one band of
    half a hertz, or one octant of directions, at a time.
    """
    settings = settings or FitSettings()
    density = density.compute()
    omega = density["omega"].values
    nyquist_k = min(abs(float(density[name].min())) for name in ("ky", "kx"))
    top = min(2 * np.pi * settings.highest, 0.92 * dispersion(0.9 * nyquist_k, depth), 0.97 * omega[-1])
    plane = _plane(density)
    bottom = max(2 * np.pi * settings.lowest, dispersion(_LONGEST * plane.cell, depth))
    band = (omega >= bottom) & (omega <= top)
    energy = density.values.reshape(omega.size, -1)
    outer = plane.k > 0.8 * nyquist_k
    noise = np.median(energy[:, outer], axis=1) if outer.any() else np.zeros(omega.size)
    used, floor = energy[band], noise[band]
    sectors = _sectors(plane, settings.sectors)
    fit = np.array([*scan_current(used, omega[band], floor, plane, depth, gamma), gamma])
    points = np.empty((0, 5))
    for _ in range(settings.rounds):
        points = _centroids(used, omega[band], floor, plane, sectors, depth, fit, settings)
        if len(points) < 6:
            raise CubeError(
                f"no ridge stands out between {bottom / (2 * np.pi):.2g} and {top / (2 * np.pi):.2g} Hz:"
                " choose a longer segment or another band"
            )
        fit = _solve(points, depth, fit)

    astray = _astray(points, depth, fit, plane.cell)
    if astray > _ASTRAY:
        raise CubeError(
            f"the waves between {bottom / (2 * np.pi):.2g} and {top / (2 * np.pi):.2g} Hz lie"
            f" {100 * astray:.0f} % of their wavenumber beside the dispersion relation, whatever the current"
            f" (the best is {fit[0]:.2f}, {fit[1]:.2f} m/s): check depth, frame rate and grid step, or choose"
            " another band"
        )
    spreads = np.full(3, np.nan)
    if dof is not None and settings.bootstrap > 1:
        rng = np.random.default_rng(0)
        # neighbouring cells and segments share a Hann window: draw in blocks of 2 x 2 x 2 to keep that
        trials = []
        for _ in range(settings.bootstrap):
            shape = ((used.shape[0] + 1) // 2, (density.sizes["ky"] + 1) // 2, (density.sizes["kx"] + 1) // 2)
            draw = (rng.chisquare(dof, shape) / dof).astype(energy.dtype)
            draw = draw.repeat(2, 0).repeat(2, 1).repeat(2, 2)
            draw = draw[: used.shape[0], : density.sizes["ky"], : density.sizes["kx"]]
            drawn = used * draw.reshape(used.shape)
            again = _centroids(drawn, omega[band], floor, plane, sectors, depth, fit, settings)
            if len(again) >= 6:
                trials.append(_solve(again, depth, fit))
        if len(trials) > 1:
            spreads = np.hypot(np.std(trials, axis=0, ddof=1), _misfit_spread(points, depth, fit))

    out: dict[str, Any] = {}
    for i, name in enumerate(("current_x", "current_y", "gamma")):
        out[name], out[f"{name}_std"] = ((), fit[i]), ((), spreads[i])
    for i, name in enumerate(("ridge_omega", "ridge_k", "ridge_angle", "ridge_weight")):
        out[name] = ("point", points[:, i])
    out |= _against_theory(points, depth, fit, gamma)
    out["ridge_fraction"] = ((), _fraction(energy, omega, plane, depth, fit))
    out["depth"] = ((), depth)
    attrs = {"lowest": float(bottom / (2 * np.pi)), "highest": float(top / (2 * np.pi))}
    out_set = annotate(xr.Dataset(out, attrs=attrs).set_coords("band_frequency"), "dispersion")
    out_set["ridge_weight"].attrs["units"] = density.attrs.get("units", "1")
    return out_set


def _astray(points: Array, depth: float, fit: Array, cell: float) -> float:
    # rms distance of the points from the fitted ridge over their wavenumber, weighted as in the fit; in a
    # small field what a cell of the k plane allows is no fault: a window spreads a wave over more than one
    k, angle = points[:, 1], points[:, 2]
    model = dispersion(k, depth, fit[2]) + k * (fit[0] * np.cos(angle) + fit[1] * np.sin(angle))
    apart = (points[:, 0] - model) / group_velocity(k, depth, fit[2]) / np.maximum(k, cell / _ASTRAY)
    return float(np.sqrt(np.average(apart**2, weights=points[:, 3] / _strongest(points))))


def _misfit_spread(points: Array, depth: float, fit: Array) -> Array:
    # what the fit owes to single bands of frequency or to single directions (jackknife): the ridge has errors
    # besides chance, and a sea of few waves repeats itself
    variance = np.zeros(3)
    for group in (np.floor(points[:, 0] / np.pi), np.round(points[:, 2] / (np.pi / 4)) % 8):
        kept = [group != g for g in np.unique(group)]
        again = [_solve(points[keep], depth, fit) for keep in kept if keep.sum() >= 6]
        if len(again) > 1:
            variance += np.var(again, axis=0) * (len(again) - 1)
    return np.sqrt(variance)


def _against_theory(points: Array, depth: float, fit: Array, gamma: float) -> dict[str, Any]:
    # by bands of half a hertz: energy-weighted mean of k over the theory's k for that omega and direction
    omega, k, angle, weight = points.T[:4]
    along = fit[0] * np.cos(angle) + fit[1] * np.sin(angle)
    theory = wavenumber(omega, depth, gamma)
    for _ in range(20):
        theory = wavenumber(np.maximum(omega - theory * along, 1e-6), depth, gamma)
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


def _near_ridge(omega: Array, plane: _Plane, depth: float, fit: Array) -> Array:
    # within two cells in k and two lines in omega of the fitted relation, (lines, cells)
    free = dispersion(plane.k, depth, fit[2]) + fit[0] * plane.kx + fit[1] * plane.ky
    slope = np.abs(group_velocity(np.maximum(plane.k, plane.cell), depth, fit[2]))
    slope += np.hypot(fit[0], fit[1])
    reach = 2 * plane.cell * slope + 2 * (omega[1] - omega[0])
    return np.asarray(np.abs(omega[:, None] - free) < reach)


def _fraction(energy: Array, omega: Array, plane: _Plane, depth: float, fit: Array) -> float:
    near = _near_ridge(omega, plane, depth, fit)
    total = float(energy.sum(dtype=float))
    return float((energy * near).sum(dtype=float)) / total if total > 0 else float("nan")


def dispersion_group(
    density: xr.DataArray, k: Array, depth: float, gamma: float, dof: float
) -> tuple[xr.Dataset, str]:
    """The theory and the fitted ridge.

    Parameters
    ----------
    density : DataArray, (omega, ky, kx)
        Spectrum of w.
    k : ndarray, (k,)
        Wavenumbers of the theory, rad/m.
    depth, gamma : float
        Depth, m, and surface tension over density, m3/s2, of the water.
    dof : float
        Degrees of freedom of a cell.

    Returns
    -------
    group : Dataset
        ``omega_theory``, ``omega_fit`` (k) and what `fit_dispersion` gives.
    note : str
        Why no ridge was fitted; empty where one was.
    """
    theory = xr.Dataset({"omega_theory": ("k", dispersion(k, depth, gamma))}, k_coords(k))
    try:
        out = fit_dispersion(density, depth, dof=dof, gamma=gamma)
    except CubeError as error:
        return annotate(theory, "dispersion"), f"No ridge was fitted: {error}."
    fitted = ("k", dispersion(k, depth, float(out["gamma"])))
    out = out.assign(theory.data_vars).assign_coords(theory.coords).assign(omega_fit=fitted)
    return annotate(out, "dispersion"), ""
