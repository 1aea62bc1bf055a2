"""Energy budget of the waves over a field: energy, flux, growth, viscous loss and the unexplained rest."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.errors import CubeError
from wavefield.variables import annotate, validate
from wavefield.water import DENSITY, GRAVITY, dispersion, group_velocity, water_of
from wavefield.waves.dispersion_relation.plane_spectrum import WavenumberPlane, noise_level
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
PARTS_OF_LINE = 4  # that the bands share
MIN_BLOCKS, MAX_BLOCKS = 4, 16  # of time


@dataclass(frozen=True)
class WaterProperties:
    """Of the water that waves run on."""

    depth: float  # m
    gamma: float  # surface tension over density, m3/s2
    current: tuple[float, float]  # m/s
    density: float  # kg/m3
    viscosity: float  # kinematic, m2/s


def _sums(E: xr.DataArray, water: WaterProperties, least_k: float, edges: Array, frames: int) -> Array:
    """Energy J m-2, flux W m-1 along x and y, viscous loss W m-2 of each band, (4, bands), from E of w."""
    ky, kx = np.meshgrid(E["ky"].values, E["kx"].values, indexing="ij")
    omega, k = E["omega"].values, np.hypot(ky, kx)
    safe = np.maximum(k, least_k)  # waves of it are spread over cells on either side
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
    parts = ((np.arange(PARTS_OF_LINE) + 0.5) / PARTS_OF_LINE - 0.5) * omega[1]
    for line, o in zip(E.values, omega):
        intrinsic = o - doppler_shift  # w is the rise of a particle that the current carries
        near = (k > least_k) & (np.abs(o - sigma - doppler_shift) < reach) & (intrinsic > omega[1])
        if not near.any():
            continue
        z = line[near] * elevation_from_w(intrinsic[near], np.pi / omega[-1], frames) / PARTS_OF_LINE
        for part in parts:  # a line on the edge of two bands is shared between them
            band = np.digitize((intrinsic[near] + part) / (2 * np.pi), edges) - 1
            inside = (band >= 0) & (band < bands)
            out += [np.bincount(band[inside], (z * weight[near])[inside], bands) for weight in weights]
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


@dataclass(frozen=True)
class EnergyBlocks:
    """Energy of the waves of a record by bands of frequency, in blocks of time."""

    field: xr.DataArray  # w
    record: Record
    segment: int  # steps of a Welch segment
    blocks: list[tuple[int, int]]  # first step and one past the last
    water: WaterProperties
    edges: Array  # of the bands, Hz

    @property
    def time(self) -> Array:
        """Middle of the blocks, s from the first step."""
        return np.array([(a + b) / 2 for a, b in self.blocks]) * self.record.dt

    @property
    def least_k(self) -> float:
        """Smallest wavenumber that the field separates from its mirror image, rad/m."""
        sides = [n * h for n, h in zip(self.record.shape, (self.record.dy, self.record.dx))]
        return MIN_CELLS_FROM_ZERO * 2 * np.pi / min(sides)

    def sums(self, area: Record) -> Array:
        """Energy, flux along x and y, viscous loss and noise of each band in an area, (blocks, 5, bands)."""
        frames, out = frames_of(self.field), []
        for block in self.blocks:
            E = spectrum(self.field, segment=self.segment, record=area.part(*block))["E"].compute()
            level = noise_level(E.values.reshape(E.sizes["omega"], -1), WavenumberPlane.of(E))
            noise = E.copy(data=level.reshape(E.shape))
            both = [_sums(e, self.water, self.least_k / 2, self.edges, frames) for e in (E - noise, noise)]
            out.append([*both[0], both[1][0]])
        return np.array(out)


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
    E = rho (g + gamma k^2) <z^2> over the cells of E(ky, kx, omega) near the dispersion relation, z from w,
    the noise of the shortest waves taken off;
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
    water = WaterProperties(depth, gamma, current, density, viscosity)
    edges = np.asarray(bands, float)
    field = field.assign_coords(path_frames=frames_of(cube))
    energies = EnergyBlocks(field, record, segment, blocks, water, edges)
    sums = np.array([energies.sums(area) for area in _areas(record)])
    # bands of short enough waves for the field, and for the difference of its halves
    lowest = [float(dispersion(n * energies.least_k, depth, gamma)) / (2 * np.pi) for n in (1, 2)]
    allowed = [edges[:-1] >= frequency for frequency in lowest]
    sides = record.shape[0] * record.dy / 2, record.shape[1] * record.dx / 2
    return _label(sums, energies.time, sides, edges, allowed)


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
