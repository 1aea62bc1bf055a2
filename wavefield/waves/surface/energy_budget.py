"""Energy budget of the waves over a field: energy, flux, growth, viscous loss and the unexplained rest."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.errors import CubeError
from wavefield.variables import annotate, validate
from wavefield.water import DENSITY, GRAVITY, dispersion, group_velocity, water_of
from wavefield.waves.estimation.inputs import a_cube, takes
from wavefield.waves.estimation.segments import segment_length
from wavefield.waves.estimation.transfer_functions import elevation_from_w
from wavefield.waves.estimation.wave_record import Record, find_record
from wavefield.waves.estimation.welch import frames_of
from wavefield.waves.spectra.field_spectra import spectrum

Array = NDArray[Any]

VISCOSITY = 1.0e-6  # m2 s-1, water at 20 C
BANDS = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0)  # Hz
MIN_CELLS_FROM_ZERO = 2.0  # of the k plane: nearer to zero the window mixes waves k and -k
MIN_BLOCKS, MAX_BLOCKS = 4, 16  # of time


@dataclass(frozen=True)
class _WaterProperties:
    depth: float
    gamma: float
    current: tuple[float, float]
    density: float
    viscosity: float


def _sums(E: xr.DataArray, water: _WaterProperties, least_k: float, edges: Array, frames: int) -> Array:
    """Energy J m-2, flux W m-1 along x and y, viscous loss W m-2 of each band, (4, bands), from E of w."""
    ky, kx = np.meshgrid(E["ky"].values, E["kx"].values, indexing="ij")
    omega, k = E["omega"].values, np.hypot(ky, kx)
    safe = np.maximum(k, least_k)
    sigma = dispersion(safe, water.depth, water.gamma)
    speed = group_velocity(safe, water.depth, water.gamma)
    cells = [float(E[name][1] - E[name][0]) for name in ("ky", "kx")]
    doppler_shift = kx * water.current[0] + ky * water.current[1]
    reach = 2 * max(cells) * (speed + np.hypot(*water.current)) + 2 * omega[1]
    transport = [speed * part / safe + current for part, current in zip((kx, ky), water.current)]
    energy = water.density * (GRAVITY + water.gamma * safe**2) * omega[1] * cells[0] * cells[1]
    weights = [energy, energy * transport[0], energy * transport[1], energy * 4 * water.viscosity * safe**2]
    bands = edges.size - 1
    out = np.zeros((4, bands))
    for line, o in zip(E.values, omega):
        intrinsic = o - doppler_shift  # w is the rise of a particle that the current carries
        band = np.digitize(intrinsic / (2 * np.pi), edges) - 1
        near = (k > least_k) & (np.abs(o - sigma - doppler_shift) < reach) & (band >= 0) & (band < bands)
        if near.any():
            z = line[near] * elevation_from_w(intrinsic[near], np.pi / omega[-1], frames)
            out += [np.bincount(band[near], z * weight[near], bands) for weight in weights]
    return out


def _areas(record: Record) -> list[Record]:
    """The complete rectangle and its left, right, lower and upper half."""
    (y0, y1), (x0, x1) = record.y, record.x
    ny, nx = (y1 - y0) // 2, (x1 - x0) // 2
    return [
        record,
        replace(record, x=(x0, x0 + nx)),
        replace(record, x=(x1 - nx, x1)),
        replace(record, y=(y0, y0 + ny)),
        replace(record, y=(y1 - ny, y1)),
    ]


def _blocks_of_time(record: Record, segment: int) -> list[tuple[int, int]]:
    """Blocks of one segment and a half at least, equally long."""
    steps = sum(b - a for a, b in record.runs)
    length = max(steps // MAX_BLOCKS, 3 * segment // 2)
    return [(a, a + length) for first, last in record.runs for a in range(first, last - length + 1, length)]


@takes(a_cube)
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
    """Energy of the waves, its flux, its change in time and its viscous loss, by bands of frequency.

    Parameters
    ----------
    cube : Dataset
        w over (time, y, x), m/s. Read five times; computed at once.
    bands : tuple of float
        Edges of the bands, Hz in the frame of the water.
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
        viscous: the input by wind and other waves less the loss by breaking and by a film on the water; each
        but ``viscous`` with ``_std``. ``longest_decay``: the decay length of the energy, m, at which the
        divergence is two standard deviations; ``shortest_growth``: likewise the time of growth, s.
        Attribute ``blocks``.

    Raises
    ------
    CubeError
        If w is missing, or the record holds fewer than four blocks of one and a half segments.

    Notes
    -----
    E = rho (g + gamma k^2) <z^2> over the cells of E(ky, kx, omega) near the dispersion relation, z from w;
    flux E (c_g k/|k| + U); viscous loss 4 nu k^2 E (Lamb), of clean water. The divergence is the difference
    of the fluxes of the right and left half of the rectangle over half its side, and of the upper and lower;
    growth is the slope of the energy over blocks of time. Their errors are the standard errors over blocks.
    Values that the size of a field does not allow are NaN: bands with waves longer than half its shorter
    side, and the divergence of bands with waves longer than a quarter of it. A decay length far above
    ``longest_decay`` cannot be distinguished from none, which is why the balance of a wave tank seldom closes
    within one field.

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
        longest = min(record.longest * 2 // (3 * MIN_BLOCKS), 256)
        segment = max(longest - longest % 2, 8)
    segment = segment_length(record, segment)
    blocks = _blocks_of_time(record, segment)
    if len(blocks) < MIN_BLOCKS:
        raise CubeError(
            f"the record holds {len(blocks)} blocks of one and a half segments of {segment} steps, and an"
            f" energy budget needs {MIN_BLOCKS}: choose a shorter segment or a longer record"
        )
    depth, gamma = water_of(cube.attrs, depth)
    water = _WaterProperties(depth, gamma, current, density, viscosity)
    lengths = [n * h for n, h in zip(record.shape, (record.dy, record.dx))]
    least_k = MIN_CELLS_FROM_ZERO * 2 * np.pi / min(lengths)
    edges, frames = np.asarray(bands, float), frames_of(field)
    sums = np.empty((5, len(blocks), 4, edges.size - 1))
    for i, area in enumerate(_areas(record)):
        for j, block in enumerate(blocks):
            bridged = tuple(n for n in area.bridged if block[0] <= n < block[1])
            part = replace(area, runs=(block,), bridged=bridged)
            E = spectrum(field, segment=segment, record=part)["E"].compute()
            sums[i, j] = _sums(E, water, least_k, edges, frames)
    time = np.array([(a + b) / 2 for a, b in blocks]) * record.dt
    # bands of short enough waves for the field, and for the difference of its halves
    lowest = [float(dispersion(k, depth, gamma)) / (2 * np.pi) for k in (least_k, 2 * least_k)]
    allowed = [edges[:-1] >= frequency for frequency in lowest]
    return _label(sums, time, (lengths[0] / 2, lengths[1] / 2), edges, allowed)


def _mean(values: Array) -> tuple[Array, Array]:
    """Mean over blocks, with its error."""
    return values.mean(axis=0), values.std(axis=0, ddof=1) / np.sqrt(len(values))


def _slope(time: Array, values: Array) -> tuple[Array, Array]:
    """Slope over time, with its error."""
    t = time - time.mean()
    slope = t @ values / (t @ t)
    residual = values - values.mean(axis=0) - t[:, None] * slope
    return slope, np.sqrt((residual**2).sum(axis=0) / max(time.size - 2, 1) / (t @ t))


def _label(
    sums: Array, time: Array, sides: tuple[float, float], edges: Array, allowed: list[Array]
) -> xr.Dataset:
    complete, left, right, lower, upper = sums
    energy, flux_x, flux_y, viscous = (complete[:, i] for i in range(4))
    divergence = (right[:, 1] - left[:, 1]) / sides[1] + (upper[:, 2] - lower[:, 2]) / sides[0]
    rows = {
        "energy": _mean(energy),
        "flux_x": _mean(flux_x),
        "flux_y": _mean(flux_y),
        "growth": _slope(time, energy),
        "divergence": _mean(divergence),
    }
    loss = viscous.mean(axis=0)
    parts = rows["growth"], rows["divergence"]
    rows["unexplained"] = parts[0][0] + parts[1][0] + loss, np.hypot(parts[0][1], parts[1][1])
    out: dict[str, Any] = {"viscous": ("band", np.where(allowed[0], loss, np.nan))}
    for name, (value, std) in rows.items():
        inside = allowed[name in ("divergence", "unexplained")]
        out[name] = ("band", np.where(inside, value, np.nan))
        out[f"{name}_std"] = ("band", np.where(inside, std, np.nan))
    with np.errstate(divide="ignore", invalid="ignore"):
        flux = np.hypot(out["flux_x"][1], out["flux_y"][1])
        out["longest_decay"] = ("band", flux / (2 * out["divergence_std"][1]))
        out["shortest_growth"] = ("band", out["energy"][1] / (2 * out["growth_std"][1]))
    coords = {"band": (edges[:-1] + edges[1:]) / 2}
    return annotate(xr.Dataset(out, coords, {"blocks": len(time), "edges": list(edges)}), "budget")
