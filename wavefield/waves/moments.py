"""Distributions and moments of the elevation and the displacements, spectral peak and steepness."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from wavefield.errors import CubeError
from wavefield.parabola import parabola_vertex
from wavefield.variables import annotate, validate
from wavefield.water import group_velocity, wavenumber
from wavefield.waves import kernels, motion
from wavefield.waves.crests import BOOTSTRAP_DRAWS, PERIODS_IN_BLOCK
from wavefield.waves.dof import dof_of_all_nodes, hann_correlation, sum_freedom
from wavefield.waves.inputs import a_cube, takes
from wavefield.waves.products import Noted, WaveProduct, register
from wavefield.waves.record import Record, find_record
from wavefield.waves.spectra import E_omega, ring_spectrum
from wavefield.waves.welch import Reader, Welch, add_sums, inner

Array = NDArray[Any]


MIN_PERIODS = PERIODS_IN_BLOCK  # of the shortest record that separates the peak from other waves
# quantities with a standard uncertainty: power of k in the integral of E(omega, k), power of this integral
_INTEGRALS = {"significant_height": (0, 0.5), "mean_square_slope": (2, 1.0), "slope_rms": (2, 0.5)}


def with_stds(out: xr.Dataset, energy: xr.DataArray, dof: Array, welch: Welch) -> xr.Dataset:
    """Return `out` with standard uncertainties ``_std`` of significant height and slopes; NaN if unknown.
    `energy` is E(omega, k) of z; `dof` (omega,) are the degrees of freedom of E(omega) over all nodes."""
    energy = energy.fillna(0.0)
    dof = np.maximum(dof * (welch.record.steps_in_runs() * welch.record.dt / welch.duration), 1)[:, None]
    overlap = hann_correlation(len(dof))
    stds = {}
    for name, (of_k, exponent) in _INTEGRALS.items():
        if name not in out:
            continue
        power = (energy * energy["k"] ** of_k).sum("k").values
        known = np.isfinite(power).all() and np.isfinite(dof).all() and power.sum() > 0
        relative = np.sqrt(2 / sum_freedom(power[:, None], dof, overlap)[0]) if known else np.nan
        stds[f"{name}_std"] = ((), exponent * float(relative) * float(out[name]))
    return out.assign(stds)


def peak_and_std(energy: Array, valid: NDArray[np.bool_], dof: Array, omega: Array) -> tuple[float, float]:
    """Return the frequency of the spectral peak, from a parabola, and its standard uncertainty, rad/s. The
    uncertainty is the scatter in random spectra with `dof` degrees of freedom. All arrays are (omega,)."""
    measured = np.log(np.maximum(np.nan_to_num(energy), 1e-9 * np.nanmax(energy[valid])))
    white = np.random.default_rng(0).standard_normal((BOOTSTRAP_DRAWS, energy.size + 2))
    # filtered noise with the correlations of the powers of a Hann window's lines, 4/9 and 1/36
    noise = ndimage.convolve1d(white, np.array([0.26, 1.0, 0.26]) / np.sqrt(1 + 2 * 0.26**2), axis=1)[:, 1:-1]
    drawn = measured + np.sqrt(2 / np.maximum(np.nan_to_num(dof, nan=1.0), 1)) * noise
    levels = np.vstack([measured, drawn])
    line = np.argmax(np.where(valid, levels, -np.inf), axis=1).clip(1, omega.size - 2)
    near = (levels[np.arange(len(line)), line + side] for side in (-1, 0, 1))
    found = omega[line] + parabola_vertex(*near).clip(-0.5, 0.5) * (omega[1] - omega[0])
    std = np.sqrt(((found[1:] - found[0]) ** 2).mean()) if np.isfinite(dof).any() else np.nan
    return float(found[0]), float(std)


QUANTITIES = {"z": "z", "dx": "u", "dy": "v", "dz": "w"}  # displacements are velocities times dt
REACH, BINS = 6.0, 120  # chosen: half width of the histograms in standard deviations, and number of bins
SAMPLED_STEPS = 8  # steps for the rough bins, which are later interpolated; a scale wrong by a tenth suffices
Scales = Mapping[str, tuple[float, float]]  # rough mean and standard deviation of each field


def rough_scales(cube: xr.Dataset, record: Record, names: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Return (mean, standard deviation) of each field by name, from a few steps, for histograms."""
    part = (
        cube[list(names)]
        .isel(time=record.some_steps(SAMPLED_STEPS), y=slice(*record.y), x=slice(*record.x))
        .compute()
    )
    out = {}
    for name in names:
        values = part[name].values.astype(float)
        values = values[np.isfinite(values)]
        std = float(values.std()) if values.size else 0.0
        out[name] = (float(values.mean()) if values.size else 0.0, std if std > 0 else 1.0)
    return out


def sums_of(fields: Mapping[str, Array], scales: Scales, dy: float, dx: float) -> dict[str, Array]:
    """Return sums over fields (steps, ny, nx): "powers <field>" (4, nodes), sums over steps of (value -
    mean)^p for p = 1 to 4; "counts <field>", a histogram; "steps", the number of steps; "slopes" (2,), the
    sum of squared slopes and the number of values. `scales` are rough means and standard deviations."""
    out: dict[str, Array] = {}
    for name, values in fields.items():
        mean, std = scales[name]
        flat = values.reshape(len(values), -1)
        powers, counts = np.zeros((4, flat.shape[1])), np.zeros(BINS + 2, np.int64)
        kernels.node_powers(flat, mean, mean - REACH * std, BINS / (2 * REACH * std), powers, counts)
        out[f"powers {name}"], out[f"counts {name}"] = powers, counts[1:-1]
        out["steps"] = np.array([flat.shape[0]], float)
    if "z" in fields:
        slopes = motion.slopes(fields["z"], dy, dx)
        out["slopes"] = np.array([sum(np.square(part, dtype=float).sum() for part in slopes), slopes[0].size])
    return out


def _moments_of(powers: Array, guess: float, steps: float) -> dict[str, float]:
    """Return moments of a field from `powers` (4, nodes), sums over steps of (value - `guess`)^p, p = 1 to 4.
    Moments are about the mean of each node, since differences between nodes are mostly calibration errors."""
    a1, a2, a3, a4 = powers / steps
    m2 = (a2 - a1**2).mean()
    m3 = (a3 - 3 * a1 * a2 + 2 * a1**3).mean()
    m4 = (a4 - 4 * a1 * a3 + 6 * a1**2 * a2 - 3 * a1**4).mean()
    with np.errstate(invalid="ignore", divide="ignore"):
        return {
            "mean": guess + a1.mean(),
            "std": np.sqrt(m2),
            "skewness": m3 / m2**1.5,
            "kurtosis": m4 / m2**2 - 3,
            "count": steps * a1.size,
            "pdf_std": np.sqrt(a2.mean() - a1.mean() ** 2),
        }


def _rebin(counts: Array, scale: tuple[float, float], moments: Mapping[str, float]) -> Array:
    """Return the density (bins,) of (value - mean) / pdf_std, with mean and pdf_std from `moments`.
    `counts` (bins,) is a histogram of (value - m) / s, with `scale` = (m, s)."""
    edges = np.linspace(-REACH, REACH, BINS + 1)
    if not moments["pdf_std"] > 0:
        return np.full(BINS, np.nan)
    rough = (edges * scale[1] + scale[0] - moments["mean"]) / moments["pdf_std"]
    cumulative = np.r_[0, np.cumsum(counts)]
    return np.diff(np.interp(edges, rough, cumulative)) / (np.diff(edges) * moments["count"])


def label(sums: Mapping[str, Array], scales: Scales, dt: float) -> xr.Dataset:
    """Return the Dataset of `statistics` from `sums` (see `sums_of`), without peak and uncertainties."""
    fields = {name: field for name, field in QUANTITIES.items() if f"powers {field}" in sums}
    rows: dict[str, list[Any]] = defaultdict(list)
    for name, field in fields.items():
        moments = _moments_of(sums[f"powers {field}"], scales[field][0], float(sums["steps"][0]))
        counts = sums[f"counts {field}"]
        rows["pdf"].append(_rebin(counts, scales[field], moments))
        rows["n_outliers"].append(moments["count"] - counts.sum())
        for key, value in moments.items():
            of_length = key in ("mean", "std", "pdf_std")
            rows[key].append(value * dt if of_length and name != "z" else value)
    edges = np.linspace(-REACH, REACH, BINS + 1)
    bins = (edges[1:] + edges[:-1]) / 2
    out: dict[str, Any] = {key: ("quantity", np.array(row)) for key, row in rows.items() if key != "pdf"}
    out["pdf"] = (("quantity", "bin"), np.array(rows["pdf"]))
    out["gaussian"] = ("bin", np.exp(-(bins**2) / 2) / np.sqrt(2 * np.pi))
    if "z" in fields:
        out["significant_height"] = ((), 4 * rows["std"][list(fields).index("z")])
    if "slopes" in sums:
        square = float(sums["slopes"][0] / sums["slopes"][1])
        out["mean_square_slope"] = ((), square)
        out["slope_rms"] = ((), float(np.sqrt(square)))
    coords = {"quantity": ("quantity", list(fields)), "bin": ("bin", bins)}
    return annotate(xr.Dataset(out, coords), "statistics")


@takes(a_cube)
def statistics(cube: xr.Dataset) -> xr.Dataset:
    """Distributions and moments of the elevation and of the displacements over one time step.

    Parameters
    ----------
    cube : Dataset
        z (m) and, where present, u, v, w (m/s) over (time, y, x).

    Returns
    -------
    Dataset
        The coordinate ``quantity`` is z, or dx, dy, dz: the displacements over one step, m. ``pdf``
        (quantity, bin) is the density of (value - ``mean``) / ``pdf_std``, and ``gaussian`` (bin) the
        standard normal density. Over ``quantity``: ``mean``, ``std`` (m), ``skewness``, ``kurtosis``
        (excess), ``count`` and ``n_outliers``, the number of values beyond six standard deviations.
        ``std`` is about the mean of each node, ``pdf_std`` about the mean of all values. Single numbers:
        ``significant_height`` (m), four standard deviations of z; ``mean_square_slope``; ``slope_rms``;
        ``peak_frequency`` (Hz), NaN in a record shorter than ten peak periods; and for these four, standard
        uncertainties ``_std``, NaN for runs of fewer than 8 steps.

    Raises
    ------
    CubeError
        If the cube has no z, or fewer than 8 x 8 nodes are measured.

    Notes
    -----
    Slopes are central differences of sixth order, whose gain is 0.99 for wavelengths of six node spacings
    and 0.74 for three.

    Examples
    --------
    >>> import wavefield as wf
    >>> cube = wf.open_cube("sea.zarr")
    >>> round(float(wf.statistics(cube).significant_height / cube.z.std()), 1)
    4.0
    """
    if "z" not in cube:
        raise CubeError("the cube has no 'z': statistics of the surface need it")
    names = [field for field in QUANTITIES.values() if field in cube]
    cube = validate(cube, *names)
    record = find_record(cube)
    scales = rough_scales(cube, record, names)

    sums: dict[str, Array] = {}
    read = Reader([cube[name] for name in names], record)
    for run in record.runs:
        for blocks in read.blocks(run):
            sums = add_sums(sums, sums_of(dict(zip(names, blocks)), scales, record.dy, record.dx))
    out = label(sums, scales, record.dt)
    peak = np.nan, np.nan
    try:
        both = ring_spectrum(cube["z"], record=record, nodes=True)
    except CubeError:  # shorter than a segment
        out = out.assign({f"{name}_std": ((), np.nan) for name in _INTEGRALS})
    else:
        found = E_omega(both)
        energy, valid, dof, omega = (found[name].values for name in ("E", "valid", "dof", "omega"))
        out = with_stds(out, both["E"], dof, Welch.of(cube["z"], record=record))
        if energy[valid].max(initial=0.0) > 0:
            peak = peak_and_std(energy, valid, dof, omega)
    if not record.steps_in_runs() * record.dt * peak[0] / (2 * np.pi) >= MIN_PERIODS:
        peak = np.nan, np.nan
    out["peak_frequency"], out["peak_frequency_std"] = (((), value / (2 * np.pi)) for value in peak)
    return annotate(out, "statistics")


def spectral_peak(statistics: xr.Dataset, fused: xr.Dataset, depth: float, gamma: float) -> xr.Dataset:
    """Return `statistics` with peak frequency (Hz), peak wavenumber k (rad/m), steepness (k times the
    standard deviation of z) and their ``_std``. The peak is that of E(omega) of z, from `fused_group`."""
    stereo = fused.sel(source="stereo")  # integrated w has no lowest lines, in which the peak may be
    lines = inner(fused.sizes["omega"])
    peak, std = peak_and_std(stereo["Ez"].values, lines, stereo["dof_Ez"].values, fused["omega"].values)
    k = float(wavenumber(peak, depth, gamma))
    k_std = std / float(group_velocity(k, depth, gamma))
    steepness = k * float(statistics["std"].sel(quantity="z"))
    relative = np.hypot(
        k_std / k, float(statistics["significant_height_std"] / statistics["significant_height"])
    )
    out = {"peak_frequency": peak / (2 * np.pi), "peak_k": k, "steepness": steepness}
    stds = {
        "peak_frequency_std": std / (2 * np.pi),
        "peak_k_std": k_std,
        "steepness_std": steepness * relative,
    }
    return annotate(statistics.assign(out | stds), "statistics")


def _statistics_group(
    moments: xr.Dataset, fused: xr.Dataset, spectra: xr.Dataset, welch: Welch, depth: float, gamma: float
) -> Noted:
    """Return the statistics that `analyze` writes, with notes on outliers and on short records."""
    notes = []
    outliers = zip(moments["quantity"].values, moments["n_outliers"].values)
    found = {str(q): int(n) for q, n in outliers if n}
    if found:
        counts = ", ".join(f"{n} of {q}" for q, n in found.items())
        notes.append(
            f"Values beyond six standard deviations: {counts}. A single outlier raises the noise floor of"
            " its spectra: check them before you use spectra decades below the peak."
        )
    z = spectra.sel(quantity="z", drop=True)
    out = with_stds(moments, z["E"], dof_of_all_nodes(z["dof_omega"].values, welch), welch)
    out = spectral_peak(out, fused, depth, gamma)
    periods = welch.record.steps_in_runs() * welch.record.dt * float(out["peak_frequency"])
    if periods < MIN_PERIODS:
        notes.append(
            "No spectral peak, steepness or wave height: the record holds"
            f" {periods:.2g} peak periods; {MIN_PERIODS:.0f} are needed."
        )
        gone = ("peak_frequency", "peak_k", "steepness", "significant_height")
        out = out.drop_vars([f"{name}{end}" for name in gone for end in ("", "_std")])
    return Noted(out, notes)


register(
    WaveProduct(
        "moments",
        ("survey_sums", "scale", "welch"),
        lambda sums, scales, welch: label(sums, scales, welch.record.dt),
    ),
    WaveProduct(
        "statistics",
        ("moments", "fused", "spectra", "welch", "depth", "gamma"),
        _statistics_group,
        group="statistics",
    ),
)
