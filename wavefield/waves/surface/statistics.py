"""Distributions and moments of the surface, and the internal errors of the measurement."""

import functools
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import dask
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.errors import CubeError
from wavefield.variables import annotate, validate
from wavefield.water import wavenumber
from wavefield.waves.estimation import segments, wave_kernels
from wavefield.waves.estimation.record_limits import without_short_peak
from wavefield.waves.estimation.wave_record import Each, Record, find_record, piece
from wavefield.waves.estimation.welch import Welch
from wavefield.waves.products import Noted, Product, register

Array = NDArray[Any]

QUANTITIES = {
    "z": "z",
    "dx": "u",
    "dy": "v",
    "dz": "w",
}  # quantity -> field; displacements are velocity times dt
REACH, BINS = 6.0, 120  # of the distributions, in standard deviations
_PILOT = 8  # steps that fix the bins
_PIECE = 256  # steps of the error fields read at once
ERRORS = ("eps_y", "eps_piv")


def pilot(cube: xr.Dataset, record: Record, names: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Rough mean and standard deviation from a few steps: they fix the bins of the distributions.

    Returns (float, float): Mean and standard deviation.
    """
    missing = set(record.bridged)
    steps = [t for a, b in record.runs for t in range(a, b) if t not in missing]
    chosen = sorted({steps[i] for i in np.linspace(0, len(steps) - 1, _PILOT).astype(int)})
    part = cube[list(names)].isel(time=chosen, y=slice(*record.y), x=slice(*record.x)).compute()
    out = {}
    for name in names:
        values = part[name].values.astype(float)
        values = values[np.isfinite(values)]
        std = float(values.std()) if values.size else 0.0
        out[name] = (float(values.mean()) if values.size else 0.0, std if std > 0 else 1.0)
    return out


def survey(fields: Mapping[str, Array], scale: Mapping[str, tuple[float, float]]) -> dict[str, Array]:
    """Count and sum what the statistics need of a piece of a record.

    With fields (steps, ny, nx); scale (float, float).
    """
    out = {}
    for name, values in fields.items():
        mean, std = scale[name]
        flat = values.reshape(values.shape[0], -1)
        out[f"sums {name}"] = np.zeros(5)
        wave_kernels.moments(flat, mean, out[f"sums {name}"])
        out[f"counts {name}"] = np.zeros(BINS, np.int64)
        wave_kernels.histogram(flat.ravel(), mean, std, REACH, out[f"counts {name}"])
    return out


def time_sums(fields: Mapping[str, Array], scale: Mapping[str, tuple[float, float]]) -> dict[str, Array]:
    """Sums over the steps at every node, "map name" (3, nodes), of the first powers about the rough mean.

    With fields (steps, ny, nx); scale (float, float).
    """
    out: dict[str, Array] = {}
    for name, values in fields.items():
        flat = values.reshape(values.shape[0], -1)
        out[f"map {name}"] = np.zeros((3, flat.shape[1]))
        wave_kernels.node_powers(flat, scale[name][0], out[f"map {name}"])
        out["steps"] = np.array([flat.shape[0]], float)
    return out


def _in_time(sums: Array, maps: Array, steps: float) -> tuple[Array, float]:
    # sums of the powers about each node's own mean, and the standard deviation of these means: what stands
    # still (an error of the calibration, mostly) is no wave
    m = maps[0] / steps
    n, _, s2, s3, s4 = sums
    moved = [
        n,
        0.0,
        s2 - steps * (m**2).sum(),
        s3 - (3 * m * maps[1]).sum() + 2 * steps * (m**3).sum(),
        s4 - (4 * m * maps[2]).sum() + (6 * m**2 * maps[1]).sum() - 3 * steps * (m**4).sum(),
    ]
    return np.array(moved), float(m.std())


def slope_square(z: Array, dy: float, dx: float) -> Array:
    """Sum of |grad z|^2 over the nodes of some steps, and their number, (2,)."""
    return np.array([wave_kernels.slope_square(z, dy, dx), z.size], float)


def central_moments(sums: Array, guess: float) -> dict[str, float]:
    """Mean, standard deviation, skewness and excess kurtosis.

    With sums (5,).
    """
    n = sums[0]
    if n == 0:
        return dict.fromkeys(("mean", "std", "skewness", "kurtosis"), np.nan) | {"count": 0.0}
    a1, a2, a3, a4 = sums[1:] / n
    m2 = a2 - a1**2
    m3 = a3 - 3 * a1 * a2 + 2 * a1**3
    m4 = a4 - 4 * a1 * a3 + 6 * a1**2 * a2 - 3 * a1**4
    with np.errstate(invalid="ignore", divide="ignore"):
        return {
            "mean": guess + a1,
            "std": float(np.sqrt(m2)),
            "skewness": float(m3 / m2**1.5),
            "kurtosis": float(m4 / m2**2 - 3),
            "count": float(n),
        }


def rebin(counts: Array, scale: tuple[float, float], moments: Mapping[str, float]) -> Array:
    """Probability density over (value - mean) / std from counts in rough bins, (bins,).

    The cumulative count is interpolated, so that no value is lost but beyond the last bin.
    """
    edges = np.linspace(-REACH, REACH, BINS + 1)
    if not moments["count"] or not moments["std"] > 0:
        return np.full(BINS, np.nan)
    rough = (edges * scale[1] + scale[0] - moments["mean"]) / moments["std"]
    total = np.r_[0, np.cumsum(counts)]
    return np.diff(np.interp(edges, rough, total)) / (np.diff(edges) * moments["count"])


def bin_centres() -> Array:
    """Centres of the bins, (bins,), in standard deviations."""
    edges = np.linspace(-REACH, REACH, BINS + 1)
    return (edges[1:] + edges[:-1]) / 2


def label(
    sums: Mapping[str, Array],
    scale: Mapping[str, tuple[float, float]],
    dt: float,
    pixel_size: float | None,
) -> xr.Dataset:
    """Turn sums over a record into labelled statistics.

    With scale (float, float).
    """
    names = [name for name, field in QUANTITIES.items() if f"sums {field}" in sums]
    raw, rows = {}, {}
    for name in names:
        field = QUANTITIES[name]
        raw[name] = central_moments(sums[f"sums {field}"], scale[field][0])
        moved, still = _in_time(sums[f"sums {field}"], sums[f"map {field}"], sums["steps"][0])
        rows[name] = central_moments(moved, 0.0) | {"mean": raw[name]["mean"], "static_std": still}
    pdf = [rebin(sums[f"counts {QUANTITIES[name]}"], scale[QUANTITIES[name]], raw[name]) for name in names]
    bins = bin_centres()
    to_length = np.array([1.0 if name == "z" else dt for name in names])

    def column(key: str) -> Array:
        return np.array([rows[name][key] for name in names])

    std = column("std") * to_length
    out: dict[str, Any] = {
        "pdf": (("quantity", "bin"), np.array(pdf)),
        "gaussian": ("bin", np.exp(-(bins**2) / 2) / np.sqrt(2 * np.pi)),
        "mean": ("quantity", column("mean") * to_length),
        "std": ("quantity", std),
        "skewness": ("quantity", column("skewness")),
        "kurtosis": ("quantity", column("kurtosis")),
        "count": ("quantity", column("count")),
        "pdf_std": ("quantity", np.array([raw[name]["std"] for name in names]) * to_length),
        "static_std": ("quantity", column("static_std") * to_length),
        "wild": ("quantity", [rows[n]["count"] - sums[f"counts {QUANTITIES[n]}"].sum() for n in names]),
    }
    if pixel_size:
        out["std_px"] = ("quantity", std / pixel_size)
    if "z" in names:
        out["significant_height"] = ((), 4 * rows["z"]["std"])
    if "slopes" in sums:
        square = float(sums["slopes"][0] / max(sums["slopes"][1], 1))
        out["mean_square_slope"] = ((), square)
        out["slope_rms"] = ((), float(np.sqrt(square)))
    coords = {"quantity": ("quantity", names), "bin": ("bin", bins)}
    return annotate(xr.Dataset(out, coords), "statistics")


def sums_of(
    fields: Mapping[str, Array], scale: Mapping[str, tuple[float, float]], dy: float, dx: float
) -> dict[str, Array]:
    """All sums over a piece of a record (steps, ny, nx): `survey`, `time_sums` and, of z, `slope_square`."""
    out = survey(fields, scale) | time_sums(fields, scale)
    if "z" in fields:
        out["slopes"] = slope_square(fields["z"], dy, dx)
    return out


def statistics(
    cube: xr.Dataset, *, record: Record | None = None, pixel_size: float | None = None
) -> xr.Dataset:
    """Distributions and moments of the elevation and of the displacements over one time step.

    Parameters
    ----------
    cube : Dataset
        z and, where present, u, v, w over (time, y, x), m and m/s.
    record : Record, optional
        Rectangle and runs; found from the cube if not given.
    pixel_size : float, optional
        Size of a pixel on the water, m; the attribute ``pixel_size`` of the cube if not given.

    Returns
    -------
    Dataset
        ``pdf`` (quantity, bin) beside ``gaussian`` (bin); ``mean``, ``std``, ``skewness``, ``kurtosis``
        (excess), ``count`` (quantity); ``std_px`` where the pixel size is known; ``significant_height``,
        ``mean_square_slope``, ``slope_rms``. Computed at once.

    Raises
    ------
    CubeError
        If the cube has no z, or no full rectangle is left.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> axes = {"time": np.arange(64) * 0.05, "y": np.arange(30) * 0.01, "x": np.arange(40) * 0.01}
    >>> cube = xr.Dataset({"z": (("time", "y", "x"), 0.01 * rng.standard_normal((64, 30, 40)))}, axes)
    >>> round(float(statistics(cube).significant_height), 2)
    0.04
    """
    if "z" not in cube:
        raise CubeError("the cube has no 'z': statistics of the surface need it")
    names = [field for field in QUANTITIES.values() if field in cube]
    cube = validate(cube, *names)
    record = find_record(cube) if record is None else record
    scale = pilot(cube, record, names)

    def make(blocks: list[Array], first: int) -> dict[str, Array]:
        return sums_of(dict(zip(names, blocks)), scale, record.dy, record.dx)

    parts = segments.pieces([cube[name] for name in names], record, _PIECE, make)
    (sums,) = dask.compute(segments.in_order(parts))
    return label(sums, scale, record.dt, pixel_size or cube.attrs.get("pixel_size"))


@dataclass(frozen=True)
class _Errors:
    """Counts and sums what the statistics need of some steps of the fields of error."""

    fields: Mapping[str, xr.DataArray]
    scales: Mapping[str, tuple[float, float]]
    record: Record

    def lay(self, name: str, steps: tuple[int, int]) -> Any:
        return piece(self.fields[name], slice(*steps), slice(*self.record.y), slice(*self.record.x))

    def __call__(self, item: tuple[str, tuple[int, int]]) -> dict[str, Array]:
        return _errors(self.lay(*item), self.scales[item[0]])


def _errors(block: Any, scale: tuple[float, float]) -> dict[str, Array]:
    values = np.asarray(block).ravel()
    return survey({"e": values[np.isfinite(values)][None, None]}, {"e": scale})


def error_statistics(cube: xr.Dataset, record: Record, each: Each | None = None) -> xr.Dataset:
    """Distributions and moments of the internal errors ``eps_y`` and ``eps_piv``, where the cube has them."""
    names = [name for name in ERRORS if name in cube]
    cube = validate(cube, *names)
    out: dict[str, Any] = {}
    densities = []
    if not names:
        return xr.Dataset()
    scales = pilot(cube, record, names)
    work = _Errors({name: cube[name] for name in names}, scales, record)
    pieces = [(i, min(i + _PIECE, b)) for a, b in record.runs for i in range(a, b, _PIECE)]
    for name, sums in zip(names, _error_sums(work, names, pieces, each)):
        moments = central_moments(sums["sums e"], scales[name][0])
        rms = float(np.hypot(moments["mean"], moments["std"]))
        for key, value in (("mean", moments["mean"]), ("std", moments["std"]), ("rms", rms)):
            out[f"{name}_{key}"] = ((), value)
        densities.append(rebin(sums["counts e"], scales[name], moments))
    out["eps_pdf"] = (("error", "eps_bin"), np.array(densities))
    coords = {"error": ("error", names), "eps_bin": ("eps_bin", bin_centres())}
    return annotate(xr.Dataset(out, coords), "statistics")


def _error_sums(
    work: _Errors, names: Sequence[str], pieces: Sequence[tuple[int, int]], each: Each | None
) -> Iterator[dict[str, Array]]:
    if each is not None:
        parts = each(work, [(name, steps) for name in names for steps in pieces])
        for _ in names:
            yield functools.reduce(segments.add, itertools.islice(parts, len(pieces)))
        return
    task = dask.delayed(_errors, pure=False)
    for name in names:
        laid = [task(work.lay(name, steps), work.scales[name]) for steps in pieces]
        yield from dask.compute(segments.in_order(laid))


def spectral_peak(statistics: xr.Dataset, fused: xr.Dataset, depth: float, gamma: float) -> xr.Dataset:
    """Add the spectral peak and the steepness."""
    best = fused["Ez_cross"].where(fused["valid_cross"], 0.0)
    if not float(best.max()) > 0:
        best = fused["Ez_stereo"].where(np.arange(fused.sizes["omega"]) > 0, 0.0)
    peak = float(best["omega"][int(np.argmax(best.values))])
    k_peak = float(wavenumber(peak, depth, gamma))
    steepness = k_peak * float(statistics["std"].sel(quantity="z"))
    peaks = {"peak_frequency": peak / (2 * np.pi), "peak_k": k_peak, "steepness": steepness}
    return annotate(statistics.assign(peaks), "statistics")


def _moments(
    sums: Mapping[str, Array],
    scale: Mapping[str, tuple[float, float]],
    welch: Welch,
    pixel_size: float | None,
) -> xr.Dataset:
    return label(sums, scale, welch.record.dt, pixel_size)


def _error_group(cube: xr.Dataset, welch: Welch, each: Each | None) -> xr.Dataset:
    return error_statistics(cube, welch.record, each)


def _statistics_group(
    moments: xr.Dataset, errors: xr.Dataset, fused: xr.Dataset, welch: Welch, depth: float, gamma: float
) -> Noted:
    notes = []
    wild = {str(q): int(n) for q, n in zip(moments["quantity"].values, moments["wild"].values) if n}
    if wild:
        counts = ", ".join(f"{n} of {q}" for q, n in wild.items())
        notes.append(
            f"Values beyond six standard deviations: {counts}. A single wild value lifts the floor of its"
            " spectra: look at them before you trust what lies decades below the peak."
        )
    out = spectral_peak(moments.assign(errors.data_vars), fused, depth, gamma)
    limited = without_short_peak(out, welch.record.steps_in_runs() * welch.record.dt)
    return Noted(limited.value, [*notes, *limited.notes])


register(
    Product("moments", ("survey_sums", "scale", "welch", "pixel_size"), _moments),
    Product("error_statistics", ("complete_cube", "welch", "each"), _error_group),
    Product(
        "statistics",
        ("moments", "error_statistics", "fused", "welch", "depth", "gamma"),
        _statistics_group,
        group="statistics",
    ),
)
