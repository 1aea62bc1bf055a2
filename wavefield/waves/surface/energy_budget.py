"""Energy budget of the waves over a field: what it holds, what flows through, and what is left to explain."""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.errors import CubeError
from wavefield.variables import annotate, validate
from wavefield.water import DENSITY, GRAVITY, dispersion, group_velocity, water_of
from wavefield.waves.estimation.segments import segment_length
from wavefield.waves.estimation.transfer_functions import elevation_from_w
from wavefield.waves.estimation.wave_record import Record, find_record
from wavefield.waves.estimation.welch import frames_of
from wavefield.waves.spectra.field_spectra import spectrum

Array = NDArray[Any]

VISCOSITY = 1.0e-6  # m2 s-1, water at 20 C
BANDS = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0)  # Hz
_LEAST_CELLS = 2.0  # of the k plane: longer waves lie within the window's reach of those that come back
_FEWEST, _MOST = 4, 16  # blocks of time


@dataclass(frozen=True)
class _WaterProperties:
    depth: float
    gamma: float
    current: tuple[float, float]
    density: float
    viscosity: float


def _sums(E: xr.DataArray, water: _WaterProperties, least: float, edges: Array, frames: int) -> Array:
    # energy J m-2, flux W m-1 along x and y, viscous loss W m-2 of each band, (4, bands)
    ky, kx = np.meshgrid(E["ky"].values, E["kx"].values, indexing="ij")
    omega, k = E["omega"].values, np.hypot(ky, kx)
    used = k > least
    safe = np.maximum(k, least)
    sigma = dispersion(safe, water.depth, water.gamma)
    speed = group_velocity(safe, water.depth, water.gamma)
    cells = [float(E[name][1] - E[name][0]) for name in ("ky", "kx")]
    drift = kx * water.current[0] + ky * water.current[1]
    reach = 2 * max(cells) * (speed + np.hypot(*water.current)) + 2 * omega[1]
    flow = [speed * part / safe + moved for part, moved in zip((kx, ky), water.current)]
    weight = water.density * (GRAVITY + water.gamma * safe**2) * omega[1] * cells[0] * cells[1]
    weights = [weight, weight * flow[0], weight * flow[1], weight * 4 * water.viscosity * safe**2]
    out = np.zeros((4, edges.size - 1))
    for line, o in zip(E.values, omega):
        still = o - drift  # as the water sees it: w is the rise of a particle that the current carries
        band = np.digitize(still / (2 * np.pi), edges) - 1
        on_ridge = used & (np.abs(o - sigma - drift) < reach) & (band >= 0) & (band < edges.size - 1)
        if on_ridge.any():
            z = line[on_ridge] * elevation_from_w(still[on_ridge], np.pi / omega[-1], frames)
            out += [np.bincount(band[on_ridge], z * part[on_ridge], edges.size - 1) for part in weights]
    return out


def _halves(record: Record) -> dict[str, Record]:
    (y0, y1), (x0, x1) = record.y, record.x
    ny, nx = (y1 - y0) // 2, (x1 - x0) // 2
    return {
        "left": replace(record, x=(x0, x0 + nx)),
        "right": replace(record, x=(x1 - nx, x1)),
        "bottom": replace(record, y=(y0, y0 + ny)),
        "top": replace(record, y=(y1 - ny, y1)),
    }


def _pieces(record: Record, segment: int) -> list[tuple[int, int]]:
    # blocks of time of one segment and a half at least, equally long
    steps = sum(b - a for a, b in record.runs)
    length = max(steps // _MOST, 3 * segment // 2)
    return [(a, a + length) for first, last in record.runs for a in range(first, last - length + 1, length)]


def energy_budget(
    cube: xr.Dataset,
    *,
    bands: tuple[float, ...] = BANDS,
    current: tuple[float, float] = (0.0, 0.0),
    depth: float | None = None,
    density: float = DENSITY,
    viscosity: float = VISCOSITY,
    segment: int | None = None,
    record: Record | None = None,
) -> xr.Dataset:
    """Energy of the waves, its flux, its change in time and what viscosity takes, by bands of frequency.

    Parameters
    ----------
    cube : Dataset
        w over (time, y, x), m/s. Read five times; computed at once.
    bands : tuple of float
        Edges of the bands, Hz as the water sees it.
    current : tuple of float
        Velocity of the water, m/s (`fit_dispersion`).
    depth : float, optional
        Depth of the water, m; the attribute ``water_depth`` of the cube, or deep, if not given.
    density : float
        Of the water, kg/m3.
    viscosity : float
        Kinematic, m2/s.
    segment : int, optional
        Steps of a Welch segment; chosen so that the record holds four blocks if not given.
    record : Record, optional
        Rectangle and runs; found from the cube if not given.

    Returns
    -------
    Dataset
        Over ``band`` (Hz, its middle): ``energy`` (J m-2), ``flux_x``, ``flux_y`` (W m-1), ``growth``
        dE/dt, ``divergence`` of the flux, ``viscous`` (W m-2) and ``unexplained``, growth + divergence +
        viscous: what wind and other waves give less what breaking and a film on the water take; each but
        ``viscous`` with ``_std``. ``longest_decay``: the decay length of the energy, m, that the divergence
        would just show at two standard deviations; ``shortest_growth``: likewise the time of growth, s.
        Attribute ``blocks``.

    Raises
    ------
    CubeError
        If w is missing, or the record holds fewer than four blocks of one and a half segments.

    Notes
    -----
    E = rho (g + gamma k^2) <z^2> over the cells of E(ky, kx, omega) near the ridge, z from w; flux
    E (c_g k/|k| + U); viscous loss 4 nu k^2 E (Lamb), of clean water. The divergence is the difference of the
    fluxes of the right and left half of the rectangle over half its side, and of the upper and lower; growth
    is the slope of the energy over blocks of time. Their errors are the scatter between blocks. What the size
    of a field forbids is NaN: bands with waves longer than half its shorter side, and the divergence of bands
    with waves longer than a quarter of it. A decay length far above ``longest_decay`` cannot be told from
    none, which is why the balance of a wave tank seldom closes within one field.

    Examples
    --------
    A wave of 1 cm amplitude holds rho g a^2 / 2, and this travels at the group velocity.

    >>> axes = {"time": np.arange(512) * 0.05, "y": np.arange(32) * 0.08, "x": np.arange(40) * 0.08}
    >>> k, omega = 12.3, float(dispersion(12.3))
    >>> phase = k * axes["x"] - omega * axes["time"][:, None, None] + 0 * axes["y"][:, None]
    >>> w = 0.01 * omega * np.sin(phase)
    >>> cube = xr.Dataset({"w": (("time", "y", "x"), w, {"units": "m s-1"})}, axes)
    >>> found = energy_budget(cube, bands=(1.2, 3.0))
    >>> bool(abs(found.energy[0] / (DENSITY * GRAVITY * 0.01**2 / 2) - 1) < 0.1)
    True
    >>> bool(abs(found.flux_x[0] / found.energy[0] / group_velocity(k) - 1) < 0.02)
    True
    """
    field = validate(cube, "w")["w"]
    record = find_record(field) if record is None else record
    if segment is None:
        requested = min(record.longest * 2 // (3 * _FEWEST), 256)
        segment = max(requested - requested % 2, 8)
    segment = segment_length(record, segment)
    pieces = _pieces(record, segment)
    if len(pieces) < _FEWEST:
        raise CubeError(
            f"the record holds {len(pieces)} blocks of one and a half segments of {segment} steps, and an"
            f" energy budget wants {_FEWEST}: choose a shorter segment or a longer record"
        )
    depth, gamma = water_of(cube.attrs, depth)
    water = _WaterProperties(depth, gamma, current, density, viscosity)
    areas = {"whole": record} | _halves(record)
    shorter = min(n * h for n, h in zip(record.shape, (record.dy, record.dx)))
    least = _LEAST_CELLS * 2 * np.pi / shorter
    edges, frames = np.asarray(bands, float), frames_of(field)
    found = np.empty((len(areas), len(pieces), 4, edges.size - 1))
    for i, area in enumerate(areas.values()):
        for j, piece in enumerate(pieces):
            bridged = tuple(n for n in area.bridged if piece[0] <= n < piece[1])
            some = replace(area, runs=(piece,), bridged=bridged)
            E = spectrum(field, segment=segment, record=some)["E"].compute()
            found[i, j] = _sums(E, water, least, edges, frames)
    middle = np.array([(a + b) / 2 for a, b in pieces]) * record.dt
    sides = [n * h / 2 for n, h in zip(record.shape, (record.dy, record.dx))]
    reached = _reached(edges, least, water), _reached(edges, 2 * least, water)
    return _label(found, middle, (sides[0], sides[1]), edges, reached)


def _reached(edges: Array, least: float, water: _WaterProperties) -> Array:
    # whether the waves of a band are all shorter than that
    lowest = float(dispersion(least, water.depth, water.gamma)) / (2 * np.pi)
    return np.array([low >= lowest for low, _ in pairwise(edges)])


def _mean(values: Array) -> tuple[Array, Array]:
    # over blocks, with its error
    return values.mean(axis=0), values.std(axis=0, ddof=1) / np.sqrt(len(values))


def _slope(time: Array, values: Array) -> tuple[Array, Array]:
    apart = time - time.mean()
    slope = apart @ values / (apart @ apart)
    left = values - values.mean(axis=0) - apart[:, None] * slope
    return slope, np.sqrt((left**2).sum(axis=0) / max(time.size - 2, 1) / (apart @ apart))


def _label(
    found: Array, time: Array, sides: tuple[float, float], edges: Array, reached: tuple[Array, Array]
) -> xr.Dataset:
    whole, left, right, bottom, top = found
    energy, flux_x, flux_y, viscous = (whole[:, i] for i in range(4))
    across = (right[:, 1] - left[:, 1]) / sides[1] + (top[:, 2] - bottom[:, 2]) / sides[0]
    rows = {
        "energy": _mean(energy),
        "flux_x": _mean(flux_x),
        "flux_y": _mean(flux_y),
        "growth": _slope(time, energy),
        "divergence": _mean(across),
    }
    loss = viscous.mean(axis=0)
    parts = rows["growth"], rows["divergence"]
    rows["unexplained"] = parts[0][0] + parts[1][0] + loss, np.hypot(parts[0][1], parts[1][1])
    out: dict[str, Any] = {}
    for name, (value, std) in rows.items():
        inside = reached[name in ("divergence", "unexplained")]
        out[name] = ("band", np.where(inside, value, np.nan))
        out[f"{name}_std"] = ("band", np.where(inside, std, np.nan))
    out["viscous"] = ("band", np.where(reached[0], loss, np.nan))
    with np.errstate(divide="ignore", invalid="ignore"):
        flow = np.hypot(out["flux_x"][1], out["flux_y"][1])
        out["longest_decay"] = ("band", flow / (2 * out["divergence_std"][1]))
        out["shortest_growth"] = ("band", out["energy"][1] / (2 * out["growth_std"][1]))
    coords = {"band": (edges[:-1] + edges[1:]) / 2}
    return annotate(xr.Dataset(out, coords, {"blocks": len(time), "edges": list(edges)}), "budget")
