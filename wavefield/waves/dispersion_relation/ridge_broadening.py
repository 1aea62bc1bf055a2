"""Shift and width of the dispersion ridge by wavenumber: what waves have beyond linear theory."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.errors import CubeError
from wavefield.variables import annotate
from wavefield.water import GAMMA, dispersion, group_velocity
from wavefield.waves.dispersion_relation.dispersion_fit import fit_dispersion
from wavefield.waves.dispersion_relation.plane_spectrum import PlaneSpectrum
from wavefield.waves.estimation.inputs import a_field, takes
from wavefield.waves.estimation.segments import short_segments
from wavefield.waves.estimation.wave_record import Record, find_record
from wavefield.waves.estimation.windowed_dispersion import SpectralCells, windowed_waves
from wavefield.waves.spectra.field_spectra import spectrum

Array = NDArray[Any]

MIN_SEGMENTS = 8  # for an uncertainty
GROUPS = 12  # of segments, each left out in turn for the uncertainty
FIRST_CELLS = 3.0  # of the k plane: nearer to zero the windows mix waves k and -k
RING_CELLS = 1.5  # width of a ring
HIGHEST = 0.8  # of the Nyquist wavenumber
REACH = 4.0  # cells and lines around the relation
LAGS = 24
LEAST_CORRELATION, SHORTEST_LAG = 0.3, 0.2  # of what the windows leave; of the longest lag
MIN_LAGS = 4
MODEL_ERROR = 0.025  # of the windows' variance of frequency, that of a ring
MODEL_SHIFT = 0.03  # of its square root
MIN_FREE = 0.8  # of the energy: the rest of a ring is bound waves, or leaks
WEAKEST = 1e-12  # of the strongest cell
LEAKED = 0.2  # of the energy of the next ring: a weaker one holds what leaks from that
MIN_SIGNIFICANCE = 3.0  # standard uncertainties that the squared width exceeds zero by
MAX_RESULTANT = 0.3  # of a ring's directions: of narrower seas a fitted current has taken the shift up


@dataclass(frozen=True)
class _RidgeRings:
    """Cells of the k plane in rings, and what of the lines near the relation is correlated."""

    omega: Array  # (lines,)
    free: Array  # (cells,): frequency of free waves in the frame of the cameras
    ring: Array  # (cells,): number of the ring, `count` outside of all
    near: Array  # (lines, cells)
    lags: Array  # s
    count: int
    gamma: float

    @classmethod
    def of(cls, spectrum: PlaneSpectrum, cells: SpectralCells, fit: Array) -> "_RidgeRings":
        plane = spectrum.plane
        edges = np.arange(FIRST_CELLS, HIGHEST * plane.nyquist / plane.cell, RING_CELLS) * plane.cell
        if edges.size < 2:
            raise CubeError("the field is too small for its nodes: no ring of wavenumbers is resolved")
        ring = np.digitize(plane.k, edges) - 1
        count = edges.size - 1
        ring = np.where((ring < 0) | (ring >= count), count, ring)
        ky, kx = np.meshgrid(cells.ky, cells.kx, indexing="ij")
        free = cells.frequency(ky, kx, spectrum.depth, fit).ravel()
        speed = group_velocity(np.maximum(plane.k, plane.cell), spectrum.depth, fit[2])
        speed = speed + np.hypot(fit[0], fit[1])
        line = cells.steps[0]
        near = np.abs(spectrum.omega[:, None] - free) < REACH * (plane.cell * speed + line)
        slowest = np.sqrt(((plane.cell * speed[ring < count]) ** 2 + line**2) / 3).min()
        longest = np.sqrt(-2 * np.log(LEAST_CORRELATION)) / slowest
        return cls(
            spectrum.omega, free, ring, near, longest * np.arange(LAGS + 1) / LAGS, count, float(fit[2])
        )

    def sums(self, energy: Array) -> Array:
        """Sum over a ring's cells and lines of energy exp(i (omega - free) lag), (rings, lags)."""
        turned = np.exp(1j * np.outer(self.lags, self.omega)) @ np.where(self.near, energy, 0.0)
        turned = turned * np.exp(-1j * np.outer(self.lags, self.free))
        parts = [
            np.bincount(self.ring, part, self.count + 1)[:-1]
            for row in turned
            for part in (row.real, row.imag)
        ]
        values = np.array(parts).reshape(self.lags.size, 2, self.count)
        return np.asarray((values[:, 0] + 1j * values[:, 1]).T)


@takes(a_field)
def ridge_broadening(
    field: xr.DataArray,
    *,
    current: tuple[float, float] | None = None,
    depth: float = np.inf,
    gamma: float = GAMMA,
    segment: int | None = None,
    record: Record | None = None,
) -> xr.Dataset:
    """Shift of the waves' frequency from linear theory, and its width, by wavenumber.

    Parameters
    ----------
    field : DataArray, (time, y, x)
        w or z of a cube, m and s. Computed at once.
    current : tuple of float, optional
        Velocity of the water, m/s; fitted if not given (`fit_dispersion`).
    depth : float
        Depth of the water, m; that of the field, or deep.
    gamma : float
        Surface tension over density, m3/s2.
    segment : int, optional
        Steps of a segment; chosen so that the record holds twelve if not given.
    record : Record, optional
        Rectangle and runs; found from the field if not given.

    Returns
    -------
    Dataset
        Over ``k`` (rad/m): ``frequency_shift`` and ``width``, the standard deviation of the line (rad/s),
        each with ``_std``; ``width_limit``, which the width does not exceed (95 %); ``tau_linear`` 1/sigma
        and ``tau_nonlinear`` 1/width with ``_std``, s; ``longest_lag``, s, over which waves are followed. All
        are NaN in rings of noise, of a fifth or more of bound waves, and of less than a fifth of the next
        ring's energy.
        Attribute ``current``.

    Raises
    ------
    CubeError
        If the record holds fewer than eight segments, or no current is found.

    Notes
    -----
    The energy of a cell of E(ky, kx, omega) is taken over delta = omega - sigma(k) - k . U, so that neither
    current nor spread of k in a ring widens it, and correlated: R(t) = sum E exp(i delta t). The same of free
    waves of the measured energy, passed through the windows, is what a line without width leaves. The ratio
    is a exp(i shift t - width^2 t^2 / 2) of a Gaussian line (Aubourg and Mordant 2015); an amplitude with an
    exponential memory of T shows width^2 = 1.8 / (T longest_lag). Uncertainties: jackknife over the segments,
    the misfit, 2.5 % of the windows' variance (3 % of its root for the shift), the current. The width is NaN
    where its square is below three standard uncertainties: waves leave the field before they lose their
    phase; the shift, where the current was fitted and waves have one direction: the fit has taken it up.
    Long waves that carry short ones to and fro, and a current that changes, widen the line as well.
    Where two wave systems cross in a field of few wavelengths, shifts are less certain than stated: leakage
    from one into the other's cells has left them up to three standard uncertainties off.

    References
    ----------
    Q. Aubourg and N. Mordant, Phys. Rev. Lett. 114 (2015); A. Campagne et al., Phys. Rev. Fluids 3 (2018).

    Examples
    --------
    Waves in all directions whose frequencies scatter by 5 % about values 3 % above linear theory.

    >>> from wavefield.water import dispersion
    >>> rng, n = np.random.default_rng(0), 300
    >>> t, y, x = np.arange(700) * 0.05, np.arange(36) * 0.05, np.arange(40) * 0.05
    >>> k, angle = rng.uniform(8, 35, n), 2 * np.pi * rng.random(n)
    >>> omega = dispersion(k) * (1.03 + 0.05 * rng.standard_normal(n))
    >>> turned = rng.standard_normal(n) / k * np.exp(-1j * np.outer(t, omega))
    >>> e_y, e_x = np.exp(1j * np.outer(y, k * np.sin(angle))), np.exp(1j * np.outer(k * np.cos(angle), x))
    >>> w = ((turned[:, None] * e_y).reshape(-1, n) @ e_x).real.reshape(700, 36, 40)
    >>> field = xr.DataArray(w, {"time": t, "y": y, "x": x}, ("time", "y", "x"))
    >>> found = ridge_broadening(field, current=(0.0, 0.0)).sel(k=slice(15, 30))
    >>> omega = dispersion(found.k)
    >>> print(f"{float((found.width / omega).mean()):.2f}")
    0.05
    >>> bool(abs(found.frequency_shift / omega - 0.03).max() < 0.02)
    True
    """
    record = find_record(field) if record is None else record
    segment, starts = short_segments(record, segment)
    if len(starts) < MIN_SEGMENTS:
        raise CubeError(
            f"the record holds {len(starts)} segments of {segment} steps, and the width of the ridge needs"
            f" {MIN_SEGMENTS}: choose a shorter segment or a longer record"
        )
    whole = spectrum(field, segment=segment, record=record)["E"].compute()
    error = 0.0
    fitted = current is None
    if current is None:
        fit = fit_dispersion(whole, depth, gamma=gamma)
        current = float(fit["current_x"]), float(fit["current_y"])
        error = float(np.hypot(fit["current_x_std"], fit["current_y_std"])) / np.sqrt(2)
    water = np.array([*current, gamma])
    plane = PlaneSpectrum.of(whole, depth)
    cells = SpectralCells(plane.omega, whole["ky"].values, whole["kx"].values)
    rings = _RidgeRings.of(plane, cells, water)
    model = windowed_waves(plane.energy, plane.noise, cells, depth, water)
    noise = rings.sums(plane.noise)
    parts = []
    for a in starts:
        E = spectrum(field, segment=segment, record=record.part(a, a + segment))["E"].values
        parts.append(rings.sums(E.reshape(plane.omega.size, -1)) - noise)
    out = _label(np.array(parts), rings, plane, model, noise)
    resultant = out["resultant"]
    if fitted:
        out["frequency_shift"] = out["frequency_shift"].where(resultant < MAX_RESULTANT)
    variance = out["frequency_shift_std"] ** 2 + (error * out["k"] * resultant) ** 2
    out["frequency_shift_std"] = (variance**0.5).where(out["frequency_shift"].notnull())
    return annotate(out.drop_vars("resultant").assign_attrs(current=list(current)), "ridge")


def _fit(ratio: Array, rest: Array, lags: Array) -> tuple[Array, Array, Array, Array]:
    """Squared width and shift, (..., rings), from correlations over those of the windows, (..., rings, lags),
    and their errors by the misfit; `rest` (rings, lags), what windows leave, is 0 where it is too little.
    """
    weight = rest**2
    with np.errstate(all="ignore"):
        logs = np.log(np.abs(ratio))
    x = -(lags**2) / 2
    total = weight.sum(axis=-1)
    mean_x = (weight * x).sum(axis=-1) / total
    off = x - mean_x[:, None]
    width2 = (weight * off * logs).sum(axis=-1) / (weight * off**2).sum(axis=-1)
    phase = np.unwrap(np.angle(ratio), axis=-1)
    shift = (weight * lags * phase).sum(axis=-1) / (weight * lags**2).sum(axis=-1)
    misfits = logs - (weight * logs).sum(axis=-1, keepdims=True) / total[:, None] - width2[..., None] * off
    rms = [
        np.sqrt((weight * part**2).sum(axis=-1) / total)
        for part in (misfits, phase - shift[..., None] * lags)
    ]
    longest = ((rest > 0) * lags).max(axis=-1)
    return width2, shift, 4 * rms[0] / longest**2, 2 * rms[1] / longest


def _label(parts: Array, rings: _RidgeRings, plane: PlaneSpectrum, model: Array, noise: Array) -> xr.Dataset:
    # of rings without waves something remains, which is compared with nothing
    of_model, mean = rings.sums(np.maximum(model, WEAKEST * model.max())), parts.mean(axis=0)
    rest = np.abs(of_model) / np.abs(of_model[:, :1])
    kept = np.logical_and.accumulate(rest >= LEAST_CORRELATION, axis=1)
    longest = (kept * rings.lags).max(axis=1)
    used = kept & (rings.lags >= SHORTEST_LAG * longest[:, None]) & (rings.lags > 0)
    energy = mean[:, 0].real
    beside = np.maximum(np.r_[energy[1:], 0.0], np.r_[0.0, energy[:-1]])
    enough = (used.sum(axis=1) >= MIN_LAGS) & (energy > noise[:, 0].real) & (energy > LEAKED * beside)
    enough &= of_model[:, 0].real > MIN_FREE * energy
    rest = np.where(used, rest, 0.0)
    rest[~enough, 1:3] = 1.0
    width2, shift, *misfits = _fit(mean / of_model, rest, rings.lags)
    groups = np.array_split(np.arange(len(parts)), min(len(parts), GROUPS))
    without = [np.delete(parts, group, axis=0).mean(axis=0) / of_model for group in groups]
    deviations = [part - part.mean(axis=0) for part in _fit(np.array(without), rest, rings.lags)[:2]]
    chance = [np.sqrt((len(groups) - 1) / len(groups) * (part**2).sum(axis=0)) for part in deviations]
    windows = np.sqrt(-2 * np.log(LEAST_CORRELATION)) / np.maximum(longest, 1e-9)  # their width, rad/s
    width2_std = np.hypot(np.hypot(chance[0], misfits[0]), MODEL_ERROR * windows**2)
    shift_std = np.hypot(np.hypot(chance[1], misfits[1]), MODEL_SHIFT * windows)
    cell = np.where(rings.near, np.maximum(model, WEAKEST * model.max()), 0.0).sum(axis=0)
    angle = plane.plane.angle
    weights = cell, cell * plane.plane.k, cell * np.cos(angle), cell * np.sin(angle)
    sums = np.array([np.bincount(rings.ring, part, rings.count + 1)[:-1] for part in weights])
    k, x, y = sums[1:] / sums[0]
    width = np.sqrt(np.where(width2 > MIN_SIGNIFICANCE * width2_std, width2, np.nan))
    width_std = width2_std / (2 * width)
    sigma = dispersion(k, plane.depth, rings.gamma)
    rows = {
        "frequency_shift": shift,
        "frequency_shift_std": shift_std,
        "width": width,
        "width_std": width_std,
        "width_limit": np.sqrt(np.maximum(width2, 0.0) + 1.645 * width2_std),
        "tau_linear": 1 / sigma,
        "tau_nonlinear": 1 / width,
        "tau_nonlinear_std": width_std / width**2,
        "longest_lag": longest,
        "resultant": np.hypot(x, y),
    }
    return xr.Dataset({name: ("k", np.where(enough, row, np.nan)) for name, row in rows.items()}, {"k": k})
