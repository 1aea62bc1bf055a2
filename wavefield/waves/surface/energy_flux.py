"""Flux of wave energy through scales, from how the energy of a decaying record goes down in time."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.errors import CubeError
from wavefield.variables import annotate, validate
from wavefield.water import DENSITY, dispersion, water_of, wavenumber
from wavefield.waves.estimation.inputs import a_cube, takes
from wavefield.waves.estimation.segments import short_segments
from wavefield.waves.estimation.wave_record import Record, find_record
from wavefield.waves.estimation.welch import frames_of
from wavefield.waves.surface.energy_budget import BANDS, VISCOSITY, EnergyBlocks, WaterProperties

Array = NDArray[Any]

MIN_SEGMENTS = 8  # with fewer the scatter about the decay is unknown
MIN_LINES = 2.0  # of a segment's spectrum in a band: narrower ones are mixed by the window
ENERGY_ERROR = 0.05  # of the energy: windows mix neighbouring bands
CORRELATED = 1.3  # of the uncertainties: neighbouring segments hold waves that are still in the field
NOISE_ERROR = 0.2  # of the noise that is taken off
MIN_RATE = 3.0  # standard uncertainties that the decay of all waves must have


@takes(a_cube)
def energy_flux(
    cube: xr.Dataset,
    *,
    frequencies: tuple[float, ...] = BANDS,
    current: tuple[float, float] = (0.0, 0.0),
    depth: float | None = None,
    density: float = DENSITY,
    viscosity: float = VISCOSITY,
    segment: int | None = None,
    record: Record | None = None,
) -> xr.Dataset:
    """Decay of the waves by bands of frequency, and the flux of energy through scales that follows from it.

    Parameters
    ----------
    cube : Dataset
        w over (time, y, x), m/s, of waves that decay: after the forcing has stopped. Computed at once.
    frequencies : tuple of float
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
        Steps of a Welch segment; chosen so that the record holds eight blocks if not given.
    record : Record, optional
        Rectangle and runs; found from the cube if not given.

    Returns
    -------
    Dataset
        Over ``band`` (Hz, its middle): ``energy`` (J m-2) in the middle of the record and ``decay_rate``
        -d ln E/dt (s-1). Over ``edge`` (Hz; wavenumber ``edge_k``, rad/m), the upper end of each band: the
        ``flux`` (W m-2) through it in the middle of the record, towards shorter waves, and ``loss_below``
        (W m-2), what viscosity takes of longer ones. All but the last with ``_std``. ``total_decay_rate`` and
        ``total_decay_rate_std``. Attributes ``segments``, ``lowest`` (Hz).

    Raises
    ------
    CubeError
        If w is missing, the record holds fewer than eight segments, bands are narrower than two of
        their lines or all of waves longer than half the field, or the energy does not go down by three
        standard uncertainties.

    Notes
    -----
    Of homogeneous waves that are forced no more, Pi(f) = -d/dt E_<(f) - D_<(f), E_< the energy and
    D_< = sum 4 nu k^2 E the viscous loss (Lamb; clean water, no walls) of the bands from ``lowest`` up to f;
    energy that longer waves pass on, losses by a film and by breaking count as flux. E is that of
    `energy_budget`, in segments that overlap by half; -d/dt is its logarithm's slope, by least squares, times
    the energy: exact for an exponential, else a mean rate with the weight 6 t (T - t) / T^3. Uncertainties
    follow from the scatter of the segments about the line (Student), a fifth of the noise and 5 % of the
    energy. NaN where a band holds more noise than waves. Waves that enter and leave the field are no decay:
    `energy_budget` gives the divergence of their flux.

    Examples
    --------
    A wave whose energy decays at 0.04 per second, with less than 1 % of that by viscosity.

    >>> axes = {"time": np.arange(800) * 0.05, "y": np.arange(32) * 0.08, "x": np.arange(40) * 0.08}
    >>> t, k, omega = axes["time"][:, None, None], 12.3, float(dispersion(12.3))
    >>> w = 0.01 * omega * np.exp(-0.02 * t) * np.sin(k * axes["x"] - omega * t + 0 * axes["y"][:, None])
    >>> cube = xr.Dataset({"w": (("time", "y", "x"), w)}, axes, {"velocity": "instantaneous"})
    >>> found = energy_flux(cube, frequencies=(1.2, 3.0))
    >>> print(f"{float(found.total_decay_rate):.3f} 1/s, {float(found.flux[0]):.4f} W/m2")
    0.040 1/s, 0.0088 W/m2
    """
    field = validate(cube, "w")["w"]
    record = find_record(field) if record is None else record
    depth, gamma = water_of(cube.attrs, depth)
    water = WaterProperties(depth, gamma, current, density, viscosity)
    edges = np.asarray(frequencies, float)
    segment, starts = short_segments(record, segment)
    line, count = 1 / (segment * record.dt), len(starts)
    if count < MIN_SEGMENTS or np.diff(edges).min() < MIN_LINES * line:
        raise CubeError(
            f"the record holds {count} segments of {segment} steps, whose lines are {line:.2g} Hz apart:"
            f" a decay needs {MIN_SEGMENTS} segments and bands of {MIN_LINES:g} lines; choose wider bands,"
            " another segment or a longer record"
        )
    blocks = [(a, a + segment) for a in starts]
    field = field.assign_coords(path_frames=frames_of(cube))
    energies = EnergyBlocks(field, record, segment, blocks, water, edges)
    lowest = float(dispersion(energies.least_k, depth, gamma)) / (2 * np.pi)
    first = int(np.searchsorted(edges, lowest))
    if first > edges.size - 2:
        raise CubeError(
            f"waves below {lowest:.2g} Hz are longer than half the field: choose frequencies above it"
        )
    sums = energies.sums(record)[:, :, first:]
    return _label(sums, energies.time, edges[first:], (depth, gamma))


@dataclass(frozen=True)
class _Decay:
    """Value in the middle of the record and its relative error, rate of decay and its error, each (n,)."""

    level: Array
    level_std: Array
    rate: Array
    rate_std: Array

    @classmethod
    def of(cls, time: Array, energy: Array, noise: Array) -> "_Decay":
        """Of energies (segments, n), from which noise was taken off."""
        from scipy import stats

        t = time - (time[0] + time[-1]) / 2
        design = np.column_stack([np.ones(t.size), t])
        normal = np.linalg.inv(design.T @ design)
        with np.errstate(all="ignore"):  # NaN of bands without waves at some time, or less than noise
            energy = np.where(energy.mean(axis=0) > noise.mean(axis=0), energy, np.nan)
            logs = np.log(np.array([energy, energy - NOISE_ERROR * noise]))
        level, slope = np.einsum("it,nte->ine", normal @ design.T, logs)
        rest = logs[0] - level[0] - t[:, None] * slope[0]
        # of few segments the scatter is uncertain: 68 % are within this many of its estimate
        student = CORRELATED * float(stats.t.ppf(stats.norm.cdf(1.0), t.size - 2))
        scatter = student * np.sqrt((rest**2).sum(axis=0) / (t.size - 2))
        by_noise = np.abs(np.array([level, slope])[:, 1] - np.array([level, slope])[:, 0])
        level_std = np.hypot(scatter * np.sqrt(normal[0, 0]), np.hypot(ENERGY_ERROR, by_noise[0]))
        return cls(
            np.exp(level[0]), level_std, -slope[0], np.hypot(scatter * np.sqrt(normal[1, 1]), by_noise[1])
        )


def _label(sums: Array, time: Array, edges: Array, water: tuple[float, float]) -> xr.Dataset:
    energy, loss, noise = sums[:, 0], sums[:, 3], sums[:, 4]
    band = _Decay.of(time, energy, noise)
    below = _Decay.of(time, np.cumsum(energy, axis=1), np.cumsum(noise, axis=1))
    rate, rate_std = below.rate[-1], below.rate_std[-1]
    if not rate > MIN_RATE * rate_std:
        raise CubeError(
            f"the energy of the waves decays at {rate:.2g} 1/s with a standard uncertainty of {rate_std:.2g}"
            " 1/s: the record is stationary, forced or mostly noise, and no flux follows from its decay"
        )
    loss_below = below.level * np.cumsum(loss.mean(axis=0)) / np.cumsum(energy.mean(axis=0))
    flux = below.rate * below.level - loss_below
    k = wavenumber(2 * np.pi * edges[1:], *water)
    out = {
        "energy": ("band", band.level),
        "energy_std": ("band", band.level * band.level_std),
        "decay_rate": ("band", band.rate),
        "decay_rate_std": ("band", band.rate_std),
        "flux": ("edge", flux),
        "flux_std": ("edge", np.hypot(below.rate_std * below.level, flux * below.level_std)),
        "loss_below": ("edge", loss_below),
        "total_decay_rate": ((), rate),
        "total_decay_rate_std": ((), rate_std),
    }
    coords = {"band": (edges[:-1] + edges[1:]) / 2, "edge": edges[1:], "edge_k": ("edge", k)}
    attrs = {"segments": time.size, "lowest": float(edges[0])}
    return annotate(xr.Dataset(out, coords, attrs), "energy_flux")
