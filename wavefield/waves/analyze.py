"""Everything the waves of one cube have to say, in one store.

The store that :func:`analyze` writes is a Zarr hierarchy; ``xarray.open_datatree(path, engine="zarr")`` reads
it without this package. Every variable carries ``units``, ``long_name`` and, where needed, ``comment``.

Conventions. k points where the wave goes: f = Re sum F exp(i (k . x - omega t)), omega > 0. Spectra are
densities in rad/m and rad/s, one-sided in omega, so that the sum of E over its axes times the cell is the
variance. Coordinates: ``omega`` (rad s-1) with ``frequency`` (Hz) beside it, ``k`` (rad m-1, centres of
rings) with ``cycles`` (m-1) beside it, ``kx`` and ``ky`` (rad m-1). Intervals are factors: the truth lies
in [low E, high E] with 95 % confidence. ``valid`` masks say where a spectrum can be trusted.

``/``
    attributes only: ``source``, ``frame_rate`` (Hz), ``water_depth`` (m; "deep" if unknown), ``segment``
    (steps), ``segments``, ``steps``, ``steps_used``, ``steps_bridged``, ``nodes_filled``, ``x`` and ``y``
    (two numbers each: the rectangle, m), ``runs`` (number of pieces between long gaps),
    ``degrees_of_freedom`` (of a single cell), ``windows_undone`` (no, or
    where the gain is from), ``notes`` (sentences for the reader, one per line),
    ``wavefield_version``.

``/spectra``
    dims omega, k; ky, kx; omega_map; probe.

    - ``E_komega_z``, ``E_komega_z_t``, ``E_komega_u``, ``E_komega_v``, ``E_komega_w``, ``E_komega_nl``
      (omega, k): E(k, omega), integral over angle. z is at frame times; nl is u . grad z.
    - ``coverage`` (k): share of the ring inside the sampled plane; ``cells`` (k): its independent cells for
      energy spread evenly over it. The azimuthal mean is E / (2 pi k coverage).
    - ``dof_komega_z`` ... ``dof_komega_nl``, ``low_komega_z`` ..., ``high_komega_z`` ... (omega, k), from the
      spread of the energy over the cells of the ring; ``valid_komega`` (omega, k).
    - ``E_k_z`` ... ``E_k_nl`` (k): E(k) = integral over omega; with ``dof_E_k_z`` ..., ``low_E_k_z`` ...,
      ``high_E_k_z`` ... (k).
    - ``E_z``, ``E_z_t``, ``E_u``, ``E_v``, ``E_w``, ``E_nl`` (omega): integral over k, as measured; with
      ``dof_E_z`` ..., ``low_E_z`` ..., ``high_E_z`` ... (omega).
    - ``Ez_stereo``, ``Ez_w``, ``Ez_cross``, ``Ez_fusion`` and, with probes, ``Ez_probes`` (omega): the
      spectrum of the elevation, m2 s rad-1, by five roads (transfer functions in time undone; fusion has its
      noise taken off; with a gain all four have, and the matching windows are
      undone), each with ``valid_stereo`` ..., ``dof_stereo`` ..., ``low_stereo`` ..., ``high_stereo`` ...
      (omega).
    - ``Ez_probe`` (probe, omega): each probe by itself; coordinates probe (name), probe_x, probe_y.
    - ``gain_two_frames``, ``gain_four_frames``, ``gain_displacement`` (omega): the power transfer functions.
    - ``E_kxky_z``, ``E_kxky_w`` (omega_map, ky, kx): maps at chosen frequencies, the paper's 2.8 Hz among
      them.

``/coherence``
    dims k; omega, k.

    - ``C_w``, ``C_nl``, ``C_tot`` (k), complex: of z_t with w, -u . grad z, and their sum; one normalisation,
      so that C_w + C_nl = C_tot; |C_w| may exceed 1. Plot the modulus for the paper's curves.
    - ``gamma2_w``, ``gamma2_nl``, ``gamma2_tot`` (k): standard magnitude-squared coherence, 0 to 1.
    - ``samples`` (k): effective number of independent samples; ``bias`` = 1 / samples; ``level`` (k): what
      unrelated signals exceed in 5 % of cases (compare with gamma2).
    - the same with ``_komega`` at the end: (omega, k); ``samples_komega``, ``level_komega`` (k).

``/kinematics``
    dims step; scalars.

    - ``w_rms``, ``z_t_rms``, ``nonlinear_rms``, ``residual_rms``, ``finite_residual_rms`` (step), m s-1:
      over the rectangle, at the sampled steps (coordinate ``time``, s); the residual is z_t - w + u . grad z,
      ``finite`` its exact form for finite displacements.
    - ``nonlinear_share`` = rms(nl) / rms(w), ``residual_share`` = rms(residual) / rms(nl),
      ``finite_residual_share`` (scalars).
    - ``vorticity_rms``, ``divergence_rms`` (step), s-1.

``/statistics``
    dims bin; quantity.

    - ``pdf`` (quantity, bin), ``gaussian`` (bin), in standard deviations: coordinate ``bin`` = (value - mean)
      / std, quantity = z, dx, dy, dz (the displacements over one time step).
    - ``mean``, ``std``, ``skewness``, ``kurtosis`` (excess), ``count`` (quantity); mean and std in metres.
    - ``std_px`` (quantity): in pixels, where the cube says how large a pixel is (``pixel_size``, m).
    - scalars: ``significant_height`` (Hs = 4 sigma, m), ``steepness`` (k_p sigma), ``mean_square_slope``,
      ``slope_rms``, ``peak_frequency`` (Hz), ``peak_k`` (rad m-1).
    - errors, where the cube has them: ``eps_y_mean``, ``eps_y_std``, ``eps_y_rms`` (m), ``eps_piv_mean``,
      ``eps_piv_std``, ``eps_piv_rms`` (px), ``eps_pdf`` (error, eps_bin) over ``eps_bin`` in standard
      deviations.

``/dispersion``
    dims k; point; band. The group holds the theory alone where no ridge could be followed.

    - ``omega_theory`` (k) without current; ``omega_fit`` (k) with the fitted gamma, no current.
    - ``ridge_k``, ``ridge_omega``, ``ridge_angle``, ``ridge_weight`` (point): the measured ridge.
    - ``ridge_error`` (band; coordinate ``band_frequency``, Hz): the ridge's k against the theory's, relative.
    - scalars: ``current_x``, ``current_y`` (m s-1), ``gamma`` (m3 s-2), each with ``..._std``;
      ``ridge_share``: share of the variance of w within the ridge; ``depth`` (m).

``/fusion``
    dims omega.

    - ``noise_z``, ``noise_w`` (omega): noise of the stereo elevation and of the integrated w, m2 s rad-1;
      ``noise_z_fit``, ``noise_w_fit``: their white fits.
    - ``weight_z`` (omega): weight of the stereo elevation in the best combination; ``wiener`` (omega).
    - scalars: ``sigma_z`` (m), ``sigma_dz`` (m): noise of z and of the displacement, without a rest record;
      ``noise_coherence``: correlation of the two off the ridge, on which the gain depends.
    - with a gain, ``Ez_komega`` (omega, k): the elevation by the best combination, windows undone; NaN where
      that cannot be trusted.
    - ``range_frequency``, ``range_decades`` (road): how far each road reaches above its own noise; coordinate
      road = stereo, w, cross, fusion.

``/direction``
    dims omega_map, theta.

    - ``D`` (omega_map, theta): directional density of the waves on the ridge, rad-1, its integral is 1; with
      ``dof_D``, ``low_D``, ``high_D``.
    - ``direction``, ``spread`` (omega_map): mean direction and directional spread, rad; the resolution is
      taken off the spread.
    - ``isotropy`` (omega): 1 - the larger of the first two harmonics, 1 for an isotropic sea. This group has
      its own omega.

``/higher_order``
    dims omega1, omega2. Missing where the record holds fewer than four segments.

    - ``bicoherence`` (omega1, omega2) in [0, 1], ``bicoherence_level`` what phase-randomised surrogates
      exceed in 5 % of cases; ``bicoherence_samples``.
    - ``tricoherence`` (omega1, omega2): at the best omega3, trivial pairings left out;
      ``tricoherence_omega3``; ``tricoherence_level``.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import dask
import numpy as np
import xarray as xr
from dask.callbacks import Callback

import wavefield
from wavefield.errors import CubeError, StoreError
from wavefield.store.waves import write_waves
from wavefield.water import GAMMA, dispersion, wavenumber
from wavefield.waves import (
    coherence,
    crosses,
    fusion,
    kinematics,
    rings,
    segments,
    spectra,
    statistics,
    transfer,
)
from wavefield.waves.direction import directions
from wavefield.waves.higher_order import higher_order
from wavefield.waves.predicted_gain import predicted_gain
from wavefield.waves.probes import probe_spectra, read_probes
from wavefield.waves.record import Record, find_record
from wavefield.waves.ridge import fit_dispersion
from wavefield.waves.units import product
from wavefield.waves.window_gain import read_gain
from wavefield.waves.windows import effective_duration

FIELDS = ("z", "z_t", "u", "v", "w")
NAMES = ("z", "z_t", "u", "v", "w", "nl")
PAIRS = (*coherence.PAIRS, *fusion.PAIRS)
MAPS = ("z", "w")
MAP_FREQUENCIES = (1.5, 2.0, 2.8, 4.0)  # Hz; 2.8 is the paper's
_KINEMATIC_STEPS = 200  # steps at which the kinematic balance is drawn up
_POINT_DISTANCE = 0.08  # m between the points of the higher-order spectra
_FEW = 7  # segments: with fewer, single cells say little

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class _Step:
    """Takes in half a segment: sums of transforms, counts, the balance at some steps, time series."""

    read: segments.Reader
    scale: dict[str, tuple[float, float]]
    record: Record
    table: rings.Rings
    every: int
    apart: tuple[int, int]

    def __call__(
        self, state: dict[str, Any] | None, a: int, b: int, run: tuple[int, int], new: bool
    ) -> dict[str, Any]:
        state = {"survey": None, "sums": None, "balance": [], "points": []} if state is None else {**state}
        dt, dy, dx = self.record.dt, self.record.dy, self.record.dx
        fields = dict(zip(FIELDS, self.read(a, b, run)))
        if new:
            survey = self._survey(fields)
            state["survey"] = survey if state["survey"] is None else segments.add(state["survey"], survey)
            state["balance"] = state["balance"] + self._balance(fields, a)
            points = fields["w"][:, :: self.apart[0], :: self.apart[1]]
            state["points"] = [*state["points"], points.reshape(points.shape[0], -1).copy()]
        # transforms come last: the rest needs room too
        half = crosses.transforms(fields, NAMES, dt, dy, dx, state.get("old"))
        if "half" in state:
            if state["sums"] is None:
                state["sums"] = crosses.empty_sums(half["z"], NAMES, PAIRS, MAPS, self.table)
            crosses.add_segment(state["sums"], state["half"], half, NAMES, PAIRS, MAPS, self.table, dt)
        return state | {"half": half, "old": state.get("half")}

    def _survey(self, fields: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        sums = statistics.survey({name: fields[name] for name in self.scale}, self.scale)
        return sums | {"slopes": statistics.slope_square(fields["z"], self.record.dy, self.record.dx)}

    def _balance(self, fields: dict[str, np.ndarray], first: int) -> list[dict[str, float]]:
        dt, dy, dx = self.record.dt, self.record.dy, self.record.dx
        count = fields["z"].shape[0]
        rows = []
        for i in range(1, count - 1):
            if (first + i) % self.every:
                continue
            now = {name: fields[name][i].astype(float) for name in FIELDS}
            before, after = fields["z_t"][i - 1].astype(float), fields["z_t"][i + 1].astype(float)
            ends = kinematics.frame_elevations(now["z"], before, after, now["z_t"], dt)
            finite = kinematics.finite_residual_on_grid(*ends, now["u"], now["v"], now["w"], dt, dy, dx)
            terms = kinematics.terms(now | {"mean": (ends[0] + ends[1]) / 2}, dy, dx)
            values = {
                "w_rms": now["w"],
                "z_t_rms": now["z_t"],
                "nonlinear_rms": terms["nonlinear"],
                "residual_rms": terms["residual"],
                "finite_residual_rms": finite[np.isfinite(finite)],
                "vorticity_rms": terms["vorticity"],
                "divergence_rms": terms["divergence"],
            }
            row = {
                name: float(np.sqrt(np.mean(np.square(v)))) if v.size else np.nan
                for name, v in values.items()
            }
            rows.append({"step": float(first + i)} | row)
        return rows


class _Count(Callback):
    """Tells how many tasks are done."""

    def __init__(self, tell: Progress, total: int) -> None:
        self.tell, self.total, self.done = tell, total, 0
        super().__init__(posttask=self._finished)

    def _finished(self, key: Any, result: Any, dsk: Any, state: Any, worker_id: Any) -> None:
        if str(key).startswith("_Step"):
            self.done = min(self.done + 1, self.total)
            self.tell(self.done, self.total)


def _close(state: dict[str, Any]) -> dict[str, Any]:
    return {name: part for name, part in state.items() if name not in ("half", "old")}


def _look(read: segments.Reader, a: int, b: int, run: tuple[int, int]) -> None:
    read(a, b, run)  # complains


def _pass(
    cube: xr.Dataset,
    record: Record,
    alike: bool,
    scale: dict[str, tuple[float, float]],
    segment: int,
    table: rings.Rings,
    progress: Progress | None,
) -> Any:
    """One pass over the cube: ring sums, surveys, kinematic balance, time series at points (by chains)."""
    used = sum(b - a for a, b in record.runs)
    apart = tuple(max(1, round(_POINT_DISTANCE / step)) for step in (record.dy, record.dx))
    step = _Step(
        segments.Reader([cube[name] for name in FIELDS], record, alike),
        scale,
        record,
        table,
        max(1, used // _KINEMATIC_STEPS),
        (apart[0], apart[1]),
    )
    chains = segments.chains(record, segment, step)
    states = [dask.delayed(_close, pure=False)(state) for state in chains]
    wanted = (
        segments.in_order([state["sums"] for state in states]),
        segments.in_order([state["survey"] for state in states]),
        [state["balance"] for state in states],
        [state["points"] for state in states],
        # what lies in no segment has a say in where the runs end
        [dask.delayed(_look)(step.read, *rest) for rest in segments.remainders(record, segment) if alike],
    )
    if progress is None:
        return dask.compute(*wanted)
    with _Count(progress, segments.count_segments(record, segment) + len(chains)):
        return dask.compute(*wanted)


def _open(cube: Any) -> xr.Dataset:
    if isinstance(cube, xr.Dataset):
        return cube
    try:
        return xr.open_zarr(cube, chunks=None, consolidated=False)
    except (OSError, ValueError, KeyError) as error:
        raise StoreError(f"{cube} cannot be read as a cube: {error}") from None


def _rename(dataset: xr.Dataset, name: str) -> xr.Dataset:
    of = name if name.startswith("komega") else f"E_{name}"
    return dataset.rename({"E": f"E_{name}"} | {n: f"{n}_{of}" for n in ("dof", "low", "high")})


def _spectra_group(
    ring: xr.Dataset, fused: xr.Dataset, maps: dict[str, xr.DataArray], probes: xr.Dataset | None
) -> xr.Dataset:
    step_omega = float(ring["omega"][1] - ring["omega"][0])
    out = xr.Dataset(attrs=ring.attrs)
    for name in NAMES:
        whole = spectra.with_interval(ring[f"E_{name}"], ring[f"dof_{name}"])
        out = out.assign(_rename(whole, f"komega_{name}").data_vars)
    out["valid_komega"] = ring["valid"]
    out["coverage"], out["cells"] = ring["coverage"], ring["cells"]
    duration = effective_duration(ring.attrs["segments"], ring.attrs["segment"] * ring.attrs["dt"])
    for name in NAMES:
        energy = ring[f"E_{name}"]
        over_k = energy.sum("omega") * step_omega
        over_k.attrs = {
            "long_name": energy.attrs["long_name"].replace("E(k, omega)", "E(k)"),
            "units": product((energy.attrs["units"], 1), (spectra.OMEGA_UNITS, 1)),
        }
        cells = ring[f"dof_{name}"] / ring.attrs["degrees_of_freedom"]
        dof = 2 * (coherence.samples_in_time(energy, duration, cells)).clip(min=1)
        out = out.assign(_rename(spectra.with_interval(over_k, dof), f"k_{name}").data_vars)
        single = ring.rename({f"E_{name}": "E", f"dof_{name}": "dof"})
        out = out.assign(_rename(spectra.frequency_spectrum(single).drop_vars("valid"), name).data_vars)
    out = out.assign(fused[_of_roads()].data_vars)
    for name, gain in (
        ("two_frames", transfer.gain_two_frames),
        ("four_frames", transfer.gain_four_frames),
        ("displacement", transfer.gain_displacement),
    ):
        attrs = {"long_name": f"power gain: {name.replace('_', ' ')}", "units": "1"}
        out[f"gain_{name}"] = ("omega", gain(ring["omega"].values, ring.attrs["dt"]), attrs)
    for name, energy in maps.items():
        out[f"E_kxky_{name}"] = energy
    if probes is not None:
        out = out.assign(probes.data_vars)
    return out


def _of_roads() -> list[str]:
    return [f"{name}_{road}" for road in fusion.ROADS for name in ("Ez", "dof", "low", "high", "valid")]


def _map_lines(omega: np.ndarray, wanted: Sequence[float]) -> list[int]:
    lines = omega / (2 * np.pi)
    return sorted({int(np.abs(lines - f).argmin()) for f in wanted if f < lines[-2]} - {0})


def _maps(density: xr.DataArray, chosen: list[int], name: str) -> xr.DataArray:
    out = density.isel(omega=chosen).drop_vars("frequency").rename(omega="omega_map")
    out["omega_map"].attrs = {"long_name": "angular frequency of the map", "units": spectra.OMEGA_UNITS}
    out.attrs = density.attrs | {"long_name": f"E(ky, kx) of {crosses.LONG_NAMES[name]}"}
    return out


def _density(power: np.ndarray, name: str, record: Record, segment: int, count: int) -> xr.DataArray:
    values = spectra.unfold(power, *record.shape)
    values *= power.dtype.type(spectra.density(record, segment, count))
    omega = spectra.omega_axis(segment, record.dt)
    units = product((crosses.UNITS[name], 2), (spectra.K_UNITS, -2), (spectra.OMEGA_UNITS, -1))
    coords = spectra.omega_coords(omega) | spectra.plane_coords(record)
    return xr.DataArray(values, coords, ("omega", "ky", "kx"), attrs={"units": units})


def _kinematics_group(rows: list[dict[str, float]], cube: xr.Dataset) -> xr.Dataset:
    texts = {
        "w_rms": ("vertical velocity, rms", "m s-1"),
        "z_t_rms": ("rate of rise, rms", "m s-1"),
        "nonlinear_rms": ("nonlinear term u . grad z, rms", "m s-1"),
        "residual_rms": ("residual z_t - w + u . grad z, rms", "m s-1"),
        "finite_residual_rms": ("residual for finite displacements, rms", "m s-1"),
        "vorticity_rms": ("vorticity, rms", "s-1"),
        "divergence_rms": ("divergence, rms", "s-1"),
    }
    steps = np.array([row["step"] for row in rows], int)
    out = xr.Dataset(
        {
            name: ("step", np.array([row[name] for row in rows]), {"long_name": text, "units": unit})
            for name, (text, unit) in texts.items()
        },
        {
            "step": ("step", steps, {"long_name": "step of the cube"}),
            "time": ("step", cube["time"].values[steps].astype(float), {"long_name": "time", "units": "s"}),
        },
    )
    mean = {name: float(np.sqrt((out[name] ** 2).mean())) for name in texts}
    for name, part, whole, text in (
        ("nonlinear_share", "nonlinear_rms", "w_rms", "nonlinear term over w, rms"),
        ("residual_share", "residual_rms", "nonlinear_rms", "residual over nonlinear term, rms"),
        (
            "finite_residual_share",
            "finite_residual_rms",
            "nonlinear_rms",
            "residual for finite displacements over nonlinear term, rms",
        ),
    ):
        share = mean[part] / mean[whole] if mean[whole] > 0 else np.nan
        out[name] = ((), share, {"long_name": text, "units": "1"})
    return out


def _dispersion_group(
    density: xr.DataArray, table: rings.Rings, depth: float, dof: float, notes: list[str]
) -> xr.Dataset:
    theory = xr.DataArray(
        dispersion(table.k, depth), spectra.k_coords(table.k), ("k",), attrs={"units": spectra.OMEGA_UNITS}
    )
    theory.attrs["long_name"] = "dispersion relation, clean water, no current"
    try:
        out = fit_dispersion(density, depth, dof=dof)
    except CubeError as error:
        notes.append(f"No ridge was fitted: {error}.")
        return xr.Dataset({"omega_theory": theory})
    fitted = theory.copy(data=dispersion(table.k, depth, float(out["gamma"])))
    fitted.attrs["long_name"] = "dispersion relation with the fitted surface tension, no current"
    return out.assign(omega_theory=theory, omega_fit=fitted)


def _direction_group(density: xr.DataArray, chosen: list[int], depth: float, dof: float) -> xr.Dataset:
    lines = density["omega"].values / (2 * np.pi)
    at_maps = directions(density, lines[chosen], depth, dof=dof).drop_vars("isotropy")
    at_maps = at_maps.rename({name: f"{name}_D" for name in ("dof", "low", "high")})
    at_maps = at_maps.assign_coords(frequency=2 * np.pi * at_maps["frequency"]).rename(frequency="omega_map")
    at_maps["omega_map"].attrs = {"long_name": "angular frequency", "units": spectra.OMEGA_UNITS}
    highest = min(0.9 * lines[-1], dispersion(0.7 * float(density["kx"].max()), depth) / (2 * np.pi))
    frequencies = np.arange(max(0.5, 2 * lines[1]), highest, 0.25)
    if not frequencies.size:
        return at_maps
    isotropy = directions(density, frequencies, depth)["isotropy"].assign_coords(
        frequency=2 * np.pi * frequencies
    )
    isotropy = isotropy.rename(frequency="omega")
    isotropy["omega"].attrs = {"long_name": "angular frequency", "units": spectra.OMEGA_UNITS}
    return at_maps.assign(isotropy=isotropy)


def _statistics_group(
    moments: xr.Dataset, fused: xr.Dataset, record: Record, cube: xr.Dataset, depth: float
) -> xr.Dataset:
    out = moments.assign(statistics.error_statistics(cube, record).data_vars)
    best = fused["Ez_cross"].where(fused["valid_cross"], 0.0)
    if not float(best.max()) > 0:
        best = fused["Ez_stereo"].where(np.arange(fused.sizes["omega"]) > 0, 0.0)
    peak = float(best["omega"][int(np.argmax(best.values))])
    k_peak = float(wavenumber(peak, depth))
    for name, value, text, unit in (
        ("peak_frequency", peak / (2 * np.pi), "frequency of the spectral peak", "Hz"),
        ("peak_k", k_peak, "wavenumber of the spectral peak", spectra.K_UNITS),
        ("steepness", k_peak * float(out["std"].sel(quantity="z")), "steepness k_p sigma", "1"),
    ):
        out[name] = ((), value, {"long_name": text, "units": unit})
    return out


def _notes(record: Record, cube: xr.Dataset, segment: int, count: int, dof: float, depth: float) -> list[str]:
    used = sum(b - a for a, b in record.runs if b - a >= segment)
    out = []
    if count < _FEW:
        seconds = segment * record.dt
        out.append(
            f"The record holds {count} segment{'s' if count > 1 else ''} of {seconds:.3g} s: a single cell"
            f" has {dof:.1f} degrees of freedom, so trust averages over rings and bands, not single values."
        )
    if used < record.steps:
        out.append(
            f"{record.steps - used} of {record.steps} steps are missing or lie in pieces too short for a"
            " segment."
        )
    if record.bridged:
        out.append(
            f"{len(record.bridged)} missing steps in short gaps were bridged by interpolation in time."
        )
    if record.holes:
        out.append(f"{record.holes} missing nodes were filled from their neighbours.")
    if record.shape != (cube.sizes["y"], cube.sizes["x"]):
        out.append(
            f"Of {cube.sizes['y']} x {cube.sizes['x']} nodes (y, x) the largest full rectangle was used,"
            f" {record.shape[0]} x {record.shape[1]}."
        )
    if not np.isfinite(depth):
        out.append("The depth of the water is not known to the cube: deep water was assumed.")
    return out


def analyze(
    cube: Any,
    out: str | Path | None = None,
    *,
    probes: Any = None,
    segment: int | None = None,
    depth: float | None = None,
    pixel_size: float | None = None,
    gain: Any = None,
    maps: Sequence[float] = MAP_FREQUENCIES,
    progress: Progress | None = None,
) -> xr.DataTree:
    """Compute the waves of a cube: spectra, coherence, kinematics, statistics, dispersion, fusion and more.

    Parameters
    ----------
    cube : path or Dataset
        A cube's store, or z, z_t, u, v, w over (time, y, x), m and m/s.
    out : path, optional
        Zarr store to write; one that is there is replaced once the new one is whole.
    probes : path or Dataset, optional
        Wave probes (`read_probes`).
    segment : int, optional
        Steps of a Welch segment; chosen from the record if not given.
    depth : float, optional
        Depth of the water, m; the attribute ``water_depth`` of the cube, or deep, if not given.
    pixel_size : float, optional
        Size of a pixel on the water, m; the attribute ``pixel_size`` of the cube if not given.
    gain : path or Dataset or "theory", optional
        What the matching windows leave of waves, to be undone in the spectra of the elevation: measured on a
        simulated experiment (`window_gain`), or predicted from the cube's recipe (`predicted_gain`).
    maps : sequence of float
        Frequencies of the maps E(ky, kx), Hz.
    progress : callable, optional
        Called with the parts done and all parts.

    Returns
    -------
    DataTree
        As described at the top of `wavefield.waves.analyze`.

    Raises
    ------
    CubeError
        If the cube lacks a variable, is shorter than a segment, has uneven steps or no full rectangle, or if
        the probes were not recording while the cameras were.
    StoreError
        If the cube or the gain cannot be read or the store cannot be written.

    Notes
    -----
    One pass over the cube in bounded memory; the result does not depend on how the cube is chunked.
    """
    cube = _open(cube)
    for name in FIELDS:
        if name not in cube:
            raise CubeError(
                f"the cube has no {name!r}: the analysis needs {', '.join(FIELDS)} over time, y and x"
            )
    with np.errstate(all="ignore"):
        # what can be wrong is found before the long pass
        if gain is not None:
            gain = predicted_gain(cube) if isinstance(gain, str) and gain == "theory" else read_gain(gain)
        status = ["frame_status"] if "frame_status" in cube else []
        rest = out, probes, segment, depth, pixel_size, gain, maps, progress
        # a cube has all fields where it has z: the pass sees to it, so the others need not be read twice
        try:
            return _analyze(cube, find_record(cube[["z", *status]]), True, *rest)
        except segments.UnlikeFirst:
            return _analyze(cube, find_record(cube[[*FIELDS, *status]]), False, *rest)


def _analyze(
    cube: xr.Dataset,
    record: Record,
    alike: bool,
    out: str | Path | None,
    probes: Any,
    segment: int | None,
    depth: float | None,
    pixel_size: float | None,
    gain: Any,
    maps: Sequence[float],
    progress: Progress | None,
) -> xr.DataTree:
    segment = segments.segment_length(record, segment)
    count = segments.count_segments(record, segment)
    depth = float(cube.attrs.get("water_depth") or np.inf) if depth is None else float(depth)
    table = spectra.ring_table(record)
    omega = spectra.omega_axis(segment, record.dt)
    time = cube["time"].values.astype(float)
    probe_part = None
    if probes is not None:
        probes = probes if isinstance(probes, xr.Dataset) else read_probes(probes)
        axis = xr.DataArray(omega, dims="omega", coords={"omega": spectra.omega_coords(omega)["omega"]})
        span = time[record.runs[0][0]], time[record.runs[-1][1] - 1]
        probe_part = probe_spectra(probes, axis, (float(span[0]), float(span[1])))

    scale = statistics.pilot(cube, record, list(statistics.QUANTITIES.values()))
    sums, survey, balance, series, _ = _pass(cube, record, alike, scale, segment, table, progress)
    ring = crosses.label(sums, NAMES, PAIRS, record, segment, table)
    dof = ring.attrs["degrees_of_freedom"]
    notes = _notes(record, cube, segment, count, dof, depth)
    fused = fusion.from_spectra(ring, depth, gain)
    density = {name: _density(sums.pop(f"map {name}"), name, record, segment, count) for name in MAPS}
    chosen = _map_lines(omega, maps)
    statistic = statistics.label(survey, scale, record.dt, pixel_size or cube.attrs.get("pixel_size"))
    groups = {
        "spectra": _spectra_group(
            ring, fused, {name: _maps(density[name], chosen, name) for name in MAPS}, probe_part
        ),
        "coherence": coherence.from_spectra(ring),
        "kinematics": _kinematics_group([row for rows in balance for row in rows], cube),
        "statistics": _statistics_group(statistic, fused, record, cube, depth),
        "dispersion": _dispersion_group(density["w"], table, depth, dof, notes),
        "fusion": fused.drop_vars(_of_roads()),
        "direction": _direction_group(density["w"], chosen, depth, dof),
    }
    points = np.concatenate([np.concatenate(run) for run in series])
    if count >= 4:
        groups["higher_order"] = higher_order(points, record.dt, segment)
    else:
        notes.append("Bicoherence and tricoherence were left out: they need four segments at least.")
    attrs = {
        "title": "waves of a cube",
        "source": str(cube.attrs.get("experiment", cube.encoding.get("source", ""))),
        "frame_rate": 1 / record.dt,
        "water_depth": depth if np.isfinite(depth) else "deep",
        "surface_tension": GAMMA,
        "windows_undone": "no" if gain is None else str(gain.attrs.get("origin", "yes")),
        "segment": segment,
        "segments": count,
        "degrees_of_freedom": dof,
        "steps": record.steps,
        "steps_used": sum(b - a for a, b in record.runs if b - a >= segment),
        "steps_bridged": len(record.bridged),
        "nodes_filled": record.holes,
        "runs": len(record.runs),
        "x": [float(cube["x"][record.x[0]]), float(cube["x"][record.x[1] - 1])],
        "y": [float(cube["y"][record.y[0]]), float(cube["y"][record.y[1] - 1])],
        "notes": "\n".join(notes),
        "wavefield_version": wavefield.__version__,
    }
    tree = xr.DataTree.from_dict({"/": xr.Dataset(attrs=attrs)} | {f"/{n}": g for n, g in groups.items()})
    if out is not None:
        write_waves(tree, out)
    return tree
