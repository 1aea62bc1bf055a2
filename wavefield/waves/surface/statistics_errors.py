"""Standard uncertainties of Hs, slopes, spectral peak and steepness, and the gain of finite differences."""

import dask
import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from wavefield.errors import CubeError
from wavefield.parabola import parabola_vertex
from wavefield.water import group_velocity
from wavefield.waves.estimation import rings
from wavefield.waves.estimation.degrees_of_freedom import hann_correlation, sum_freedom
from wavefield.waves.estimation.segments import spatial_window
from wavefield.waves.estimation.wave_record import Record, piece
from wavefield.waves.estimation.welch import Welch
from wavefield.waves.estimation.windows import CORRELATED_CELLS
from wavefield.waves.spectra.field_spectra import E_omega, komega

Array = NDArray[np.float64]

NODES_A_WAVE = 3.0  # shortest waves whose slope is corrected
SAMPLED_STEPS = 32  # whose spectrum in space gives the gain of the slopes
PEAK_DRAWS = 400


def difference_gain(k: Array, step: float) -> Array:
    """Amplitude gain of central differences of sixth order over nodes a step apart, k in rad/m."""
    x = np.where(k == 0, 1e-12, k * step)
    return np.asarray((1.5 * np.sin(x) - 0.3 * np.sin(2 * x) + np.sin(3 * x) / 30) / x)


def power_gain_of_slopes(power: Array, ky: Array, kx: Array, dy: float, dx: float) -> float:
    """Power gain of the mean square slope by finite differences, for a spectrum (ky, kx) of the elevation.
    Waves of less than three nodes count as the differences have them: what is there is mostly noise.
    """
    true = taken = 0.0
    for k, step, axis in ((ky, dy, 0), (kx, dx, 1)):
        squares = np.expand_dims(k**2, 1 - axis) * power
        gain = difference_gain(k, step) ** 2
        kept = np.where(np.abs(k) * step <= 2 * np.pi / NODES_A_WAVE * (1 + 1e-9), 1.0, gain)
        true += float((squares * np.expand_dims(kept, 1 - axis)).sum())
        taken += float((squares * np.expand_dims(gain, 1 - axis)).sum())
    return taken / true if true > 0 else 1.0


def sampled_slope_gain(z: xr.DataArray, record: Record) -> float:
    """The gain of `power_gain_of_slopes` from the spectrum of some steps of a field (time, y, x)."""
    missing = set(record.bridged)
    steps = [t for a, b in record.runs for t in range(a, b) if t not in missing]
    chosen = sorted({steps[i] for i in np.linspace(0, len(steps) - 1, SAMPLED_STEPS).astype(int)})
    area = slice(*record.y), slice(*record.x)
    (parts,) = dask.compute([piece(z, slice(t, t + 1), *area) for t in chosen])
    parts = np.concatenate([np.asarray(part, float) for part in parts])
    parts = np.nan_to_num(parts - np.nanmean(parts, axis=0))
    power = (np.abs(np.fft.fft2(parts * spatial_window(*record.shape))) ** 2).sum(axis=0)
    ky, kx = (rings.wavenumbers(n, step) for n, step in zip(record.shape, (record.dy, record.dx)))
    return power_gain_of_slopes(power, ky, kx, record.dy, record.dx)


def relative_std(power: Array, dof: Array, overlap: Array) -> float:
    """Relative standard uncertainty of the sum of a spectrum (n,) with correlated lines or rings."""
    if not (np.isfinite(power).all() and np.isfinite(dof).all() and power.sum() > 0):
        return np.nan
    return float(np.sqrt(2 / sum_freedom(power[:, None], np.maximum(dof, 1)[:, None], overlap)[0]))


def moment_stds(energy: xr.DataArray, dof: Array, welch: Welch) -> dict[str, float]:
    """Relative standard uncertainties of the variance and of the mean square slope of all nodes.
    From E(omega, k) and the degrees of freedom of E(omega); in moments all steps count alike.
    """
    energy = energy.fillna(0.0)
    # waves of a line lie along an arc of the k plane, on which Hann windows make `CORRELATED_CELLS` cells
    # one; moments are of all nodes alike, without a window: on a long arc that many more are independent
    arc = np.maximum(dof / welch.dof, 1.0)
    longer = welch.record.steps_in_runs() * welch.record.dt / welch.duration
    dof = dof * longer * (1 + (arc - 1) * CORRELATED_CELLS) / arc
    overlap = hann_correlation(energy.sizes["omega"])
    sums = {"variance": energy.sum("k"), "slope": (energy * energy["k"] ** 2).sum("k")}
    return {name: relative_std(power.values, dof, overlap) for name, power in sums.items()}


def of_elevation(z: xr.DataArray, record: Record) -> dict[str, float]:
    """The uncertainties of `moment_stds` for a field (time, y, x); NaN where the record is too short."""
    try:
        both = komega(z, record=record).compute()
    except CubeError:
        return {"variance": np.nan, "slope": np.nan}
    return moment_stds(both["E"], E_omega(both)["dof"].values, Welch.of(z, record=record))


def peak_and_std(energy: Array, valid: NDArray[np.bool_], dof: Array, omega: Array) -> tuple[float, float]:
    """Frequency of the largest energy, of the parabola through its line and the next ones, rad/s; its std.
    The std is that of draws about the spectrum, with each line's degrees of freedom and a Hann window's
    correlation.
    """
    measured = np.log(np.maximum(np.nan_to_num(energy), 1e-9 * np.nanmax(energy[valid])))
    white = np.random.default_rng(0).standard_normal((PEAK_DRAWS, energy.size + 2))
    # squared, (1/2, 1, 1/2) over its norm has the correlation of a Hann window's powers: 4/9, 1/36
    noise = ndimage.convolve1d(white, np.array([0.26, 1.0, 0.26]) / np.sqrt(1 + 2 * 0.26**2), axis=1)[:, 1:-1]
    drawn = measured + np.sqrt(2 / np.maximum(np.nan_to_num(dof, nan=1.0), 1)) * noise
    levels = np.vstack([measured, drawn])
    line = np.argmax(np.where(valid, levels, -np.inf), axis=1).clip(1, omega.size - 2)
    near = (levels[np.arange(len(line)), line + side] for side in (-1, 0, 1))
    found = omega[line] + parabola_vertex(*near).clip(-0.5, 0.5) * (omega[1] - omega[0])
    std = np.sqrt(((found[1:] - found[0]) ** 2).mean()) if np.isfinite(dof).any() else np.nan
    return float(found[0]), float(std)


def with_stds(out: xr.Dataset, stds: dict[str, float]) -> xr.Dataset:
    """Add the standard uncertainties of the significant height and of the slopes."""
    parts = {}
    for name, kind, power in (
        ("significant_height", "variance", 0.5),
        ("mean_square_slope", "slope", 1.0),
        ("slope_rms", "slope", 0.5),
    ):
        if name in out:
            parts[f"{name}_std"] = ((), power * stds[kind] * float(out[name]))
    return out.assign(parts)


def steepness_std(out: xr.Dataset, peak: float, depth: float, gamma: float) -> xr.Dataset:
    """Add the standard uncertainties of peak and steepness, from that of the peak's omega, rad/s."""
    k = float(out["peak_k"])
    k_std = peak / float(group_velocity(k, depth, gamma))
    relative = np.hypot(k_std / k, float(out["significant_height_std"] / out["significant_height"]))
    return out.assign(
        peak_frequency_std=((), peak / (2 * np.pi)),
        peak_k_std=((), k_std),
        steepness_std=((), float(out["steepness"]) * relative),
    )
