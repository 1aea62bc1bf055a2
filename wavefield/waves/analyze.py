"""Everything the waves of one cube have to say, in one store.

The store that :func:`analyze` writes is a Zarr hierarchy; ``xarray.open_datatree(path, engine="zarr")`` reads
it without this package. Its groups and variables are those of `wavefield.variables`, listed in the
documentation's page on formats.

Conventions. k points where the wave goes: f = Re sum F exp(i (k . x - omega t)), omega > 0. Spectra are
densities in rad/m and rad/s, one-sided in omega, so that the sum of E over its axes times the cell is the
variance. Coordinates: ``omega`` (rad s-1) with ``frequency`` (Hz) beside it, ``k`` (rad m-1, centres of
rings) with ``cycles`` (m-1) beside it, ``kx`` and ``ky`` (rad m-1). Intervals are factors: the truth lies
in [low E, high E] with 95 % confidence. ``valid`` masks say where a spectrum can be trusted.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import dask
import numpy as np
import xarray as xr

import wavefield
from wavefield.atomic_write import check_writable, refuse_input
from wavefield.errors import CubeError, StoreError
from wavefield.store.wave_store import WAVES, write_waves
from wavefield.variables import FIELD_TEXTS, FIELD_UNITS, TABLE, annotate, density_units, validate
from wavefield.water import water_of
from wavefield.waves.dispersion_relation.current_by_depth import current_by_depth
from wavefield.waves.dispersion_relation.current_used import (
    FITTED,
    GIVEN,
    NO_CURRENT,
    CurrentUsed,
    current_used,
)
from wavefield.waves.dispersion_relation.direction import direction_group
from wavefield.waves.dispersion_relation.directional_spectrum import from_density
from wavefield.waves.dispersion_relation.dispersion_fit import dispersion_group
from wavefield.waves.dispersion_relation.doppler_correction import SpectraOnCurrent
from wavefield.waves.dispersion_relation.fit_settings import FitSettings, fit_settings
from wavefield.waves.estimation import segment_variance, segments, transfer_functions
from wavefield.waves.estimation.mean_current import delayed_current
from wavefield.waves.estimation.record_limits import leave_out_unknown
from wavefield.waves.estimation.wave_record import Each, Record, find_record
from wavefield.waves.estimation.welch import Welch, frames_of, frames_of_z, moves_with_flow, omega_coords
from wavefield.waves.estimation.window_gain import gain_of
from wavefield.waves.fused import fused_spectra
from wavefield.waves.nonlinear import coherence, kinematics, nonlinear_ratio
from wavefield.waves.nonlinear.bound_waves import free_and_bound
from wavefield.waves.nonlinear.higher_order import higher_order
from wavefield.waves.nonlinear.resonances import resonances
from wavefield.waves.onepass import FIELDS, MAPS, NAMES, PAIRS, Progress, Sums, one_pass
from wavefield.waves.probes.probe_files import probe_spectra, read_probes
from wavefield.waves.spectra import cross_spectra, field_spectra
from wavefield.waves.surface import statistics

MAP_FREQUENCIES = (1.5, 2.0, 2.8, 4.0)  # Hz; 2.8 is the paper's
_FEW = 7  # segments: with fewer, single cells say little


@dataclass(frozen=True)
class _Job:
    """What is asked of an analysis, and what is known of the water."""

    cube: xr.Dataset  # its fields as `validate` gives them
    whole: xr.Dataset  # as given
    segment: int | None
    depth: float
    gamma: float
    pixel_size: float | None
    gain: xr.Dataset | None
    probes: xr.Dataset | None
    fit: FitSettings
    current: tuple[float, float] | None  # where the fit is refused
    maps: Sequence[float]
    progress: Progress | None
    each: Each | None


def _open(cube: Any) -> xr.Dataset:
    if isinstance(cube, xr.Dataset):
        return cube
    if (Path(cube) / "checksum").is_dir():  # written by a run
        from wavefield.store.read import open_stored

        return open_stored(cube, chunks=None)
    try:
        out: xr.Dataset = xr.open_zarr(cube, chunks=None, consolidated=False)
        return out
    except Exception as error:  # whatever a library makes of damaged or foreign files
        raise StoreError(f"{cube} cannot be read as a cube: {error}") from None


def analyze(
    cube: Any,
    out: str | Path | None = None,
    *,
    probes: Any = None,
    segment: int | None = None,
    depth: float | None = None,
    pixel_size: float | None = None,
    gain: Any = None,
    fit: FitSettings | Mapping[str, Any] | None = None,
    maps: Sequence[float] = MAP_FREQUENCIES,
    progress: Progress | None = None,
    each: Each | None = None,
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
    gain : path, Dataset or False, optional
        What the measurement keeps of waves, to be undone in the spectra where it is half or more; shorter
        waves are not valid. That stored with the cube if not given; one measured on a simulated experiment
        (`window_gain`); False leaves the spectra as they were measured.
    fit : FitSettings or mapping, optional
        How the current is fitted, such as ``{"lowest": 1.5, "highest": 4.0}``, Hz; by default the band
        follows from the spectrum. ``current_x`` and ``current_y``, m/s, are used where the fit is refused.
    maps : sequence of float
        Frequencies of the maps E(ky, kx), Hz.
    progress : callable, optional
        Called with the parts done and all parts.
    each : callable, optional
        ``each(work, items)`` does work for every item elsewhere and gives the results in the order of the
        items; for a cube in a store (`wavefield.analyze_on_workers` gives one).

    Returns
    -------
    DataTree
        One group for each subject; its variables are listed in the documentation's page on formats.

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

    Examples
    --------
    >>> import xarray as xr
    >>> t, y, x = np.arange(64) * 0.05, np.arange(16) * 0.05, np.arange(20) * 0.05
    >>> noise = np.random.default_rng(0).standard_normal((5, 64, 16, 20))
    >>> wave = 0.01 * np.cos(12.3 * x - 10.98 * t[:, None, None] + 0 * y[:, None])
    >>> names, axes = ("z", "z_t", "u", "v", "w"), {"time": t, "y": y, "x": x}
    >>> fields = {
    ...     name: (tuple(axes), wave + 1e-3 * n, {"units": "m" if name == "z" else "m s-1"})
    ...     for name, n in zip(names, noise)
    ... }
    >>> waves = analyze(xr.Dataset(fields, axes), segment=16)
    >>> sorted({"coherence", "spectra", "statistics"} & set(waves))
    ['coherence', 'spectra', 'statistics']
    >>> waves["spectra"].E_komega_w.dims
    ('omega', 'k')
    """
    if out is not None:
        refuse_input(Path(out), cube, gain)
        check_writable(out, WAVES)
    whole = _open(cube)
    for name in FIELDS:
        if name not in whole:
            raise CubeError(
                f"the cube has no {name!r}: the analysis needs {', '.join(FIELDS)} over time, y and x"
            )
    fields = validate(whole, *FIELDS)
    # what can be wrong is found before the long pass
    with np.errstate(all="ignore"):
        job = _Job(
            fields,
            whole,
            segment,
            *water_of(whole.attrs, depth),
            pixel_size or whole.attrs.get("pixel_size"),
            gain_of(whole, gain),
            probes if probes is None or isinstance(probes, xr.Dataset) else read_probes(probes),
            *fit_settings(fit),
            maps,
            progress,
            each,
        )
        status = {name: whole[name] for name in ("frame_status", "quality") if name in whole}
        # a cube has all fields where it has z: the pass sees to it, so the others need not be read twice
        try:
            tree = _analyze(job, find_record(fields[["z"]].assign(status), each=each), True)
        except segments.UnlikeFirst:
            tree = _analyze(job, find_record(fields.assign(status), each=each), False)
    if out is not None:
        write_waves(tree, Path(out))
    return tree


def _analyze(job: _Job, record: Record, alike: bool) -> xr.DataTree:
    segment = segments.segment_length(record, job.segment)
    frames = frames_of(job.cube), frames_of_z(job.cube), moves_with_flow(job.cube)
    welch = Welch(record, segment, None, *frames)
    mean, mean_std = dask.compute(delayed_current(job.cube, record))[0]
    welch = replace(welch, current=(float(mean[0]), float(mean[1])))
    time = job.cube["time"].values.astype(float)
    probes = _probes(job, welch, time)
    scale = statistics.pilot(job.cube, record, list(statistics.QUANTITIES.values()))
    sums = one_pass(job.cube, welch, alike, scale, job.progress, job.each)
    notes = _notes(welch, job)
    groups, subjects = _groups(job, welch, sums, scale, notes)
    if probes is not None:
        groups["spectra"] = groups["spectra"].assign(probes.data_vars)
    groups["kinematics"] = kinematics.balance_group(sums.balance, time).assign(
        nonlinear_ratio.mean_current(mean, mean_std).data_vars
    )
    groups["kinematics"] = groups["kinematics"].merge(
        nonlinear_ratio.from_spectra(groups["spectra"]), combine_attrs="override"
    )
    if welch.count < 4:
        notes.append("Bicoherence and tricoherence were left out: they need four segments at least.")
    for subject, found in zip(subjects, _side_by_side(job, subjects)):
        if isinstance(found, CubeError):
            notes.append(f"{subject.without}: {found}.")
        else:
            groups[subject.name] = found
    attrs = _attributes(job, welch) | {"notes": "\n".join(notes)}
    return xr.DataTree.from_dict({"/": xr.Dataset(attrs=attrs)} | {f"/{n}": g for n, g in groups.items()})


@dataclass(frozen=True)
class _Subject:
    """A group that rests on no other of its batch: computed in any process."""

    name: str
    compute: Callable[[], Any]
    without: str | None = None  # what is said where the record does not allow it; None if it always does
    recorded: Mapping[str, Any] = field(default_factory=dict)  # attributes added to the group


def _side_by_side(job: _Job, subjects: Sequence[_Subject]) -> Iterable[Any]:
    return (job.each or map)(_computed, subjects)


def _computed(subject: _Subject) -> Any:
    with np.errstate(all="ignore"):
        try:
            found = subject.compute()
            return found.assign_attrs(subject.recorded) if subject.recorded else found
        except CubeError as error:
            if subject.without is None:
                raise
            return error


def _probes(job: _Job, welch: Welch, time: np.ndarray) -> xr.Dataset | None:
    if job.probes is None:
        return None
    axis = annotate(xr.Dataset(coords=omega_coords(welch.omega)))["omega"].drop_vars("frequency")
    runs = welch.record.runs
    return probe_spectra(job.probes, axis, (float(time[runs[0][0]]), float(time[runs[-1][1] - 1])))


def _groups(
    job: _Job, welch: Welch, sums: Sums, scale: dict[str, tuple[float, float]], notes: list[str]
) -> tuple[dict[str, xr.Dataset], list[_Subject]]:
    ring = cross_spectra.label(sums.rings, NAMES, PAIRS, welch)
    density = {name: _density(sums.rings.pop(f"map {name}"), name, welch) for name in MAPS}
    # what rests on the sums alone; what takes longest comes first
    following = partial(dispersion_group, density["w"], welch.table.k, job.depth, job.gamma, job.fit)
    batch = [
        _Subject("dispersion", following),
        _Subject("spectra", partial(cross_spectra.by_field, ring, NAMES, job.gain)),
    ]
    if welch.count >= 4:
        alone = partial(higher_order, sums.points, welch.record.dt, welch.segment)
        batch.append(_Subject("higher_order", alone))
    early = {subject.name: found for subject, found in zip(batch, _side_by_side(job, batch))}
    dispersion, note = early.pop("dispersion")
    notes.extend([note] if note else [])
    used = current_used(dispersion, job.current)
    moving = _moving(used, density["w"], sums.rings.pop("map z*w"), welch)
    fused = fused_spectra.from_spectra(ring, (job.depth, job.gamma), job.gain, moving).assign_attrs(
        used.attrs
    )
    for method in fused_spectra.METHODS:
        fused[f"Ez_{method}"].attrs |= used.attrs
    chosen = _map_lines(welch.omega, job.maps)
    by_method = [
        f"{name}_{method}"
        for method in fused_spectra.METHODS
        for name in ("Ez", "dof", "low", "high", "valid")
    ]
    maps = {f"E_kxky_{name}": _map(density[name], chosen, name) for name in MAPS}
    spectra_group = early.pop("spectra").assign(fused[by_method].data_vars)
    spectra_group = spectra_group.assign(
        transfer_functions.gains(welch.omega, welch.record.dt, welch.frames)
    ).assign(maps)
    moments = statistics.label(sums.survey, scale, welch.record.dt, job.pixel_size)
    moments = moments.assign(statistics.error_statistics(job.whole, welch.record, job.each).data_vars)
    wild = {str(q): int(n) for q, n in zip(moments["quantity"].values, moments["wild"].values) if n}
    if wild:
        words = ", ".join(f"{n} of {q}" for q, n in wild.items())
        notes.append(
            f"Values beyond six standard deviations: {words}. A single wild value lifts the floor of its"
            " spectra: look at them before you trust what lies decades below the peak."
        )
    alone_dof = segment_variance.cell_freedom(sums.rings, "w", welch)
    water = job.depth, job.gamma, alone_dof
    subjects = _currents(job, density, dispersion, used, moments, welch, alone_dof)
    seconds = sum(b - a for a, b in welch.record.runs) * welch.record.dt
    peaks = statistics.spectral_peak(moments, fused, job.depth, job.gamma)
    peaks, dispersion, unknown = leave_out_unknown(peaks, dispersion, seconds, welch.count)
    notes.extend(unknown)
    by_direction = partial(direction_group, density["w"], chosen, used.velocity, *water)
    return {
        "spectra": annotate(spectra_group, "spectra"),
        "coherence": coherence.from_spectra(ring),
        "statistics": peaks,
        "dispersion": dispersion,
        "fusion": fused.drop_vars(by_method),
    } | early, [*subjects, _Subject("direction", by_direction, recorded=used.attrs)]


def _currents(
    job: _Job,
    densities: dict[str, xr.DataArray],
    dispersion: xr.Dataset,
    used: CurrentUsed,
    moments: xr.Dataset,
    welch: Welch,
    dof: float,
) -> list[_Subject]:
    # what rests on a fitted or a given current; what takes longest comes first
    if used.source == NO_CURRENT:
        return []
    drift = moments["mean"] / welch.record.dt
    surface = float(drift.sel(quantity="dx")), float(drift.sel(quantity="dy"))
    of_z, of_w = densities["z"], densities["w"]
    moving: dict[str, Any] = {"gamma": job.gamma, "current": used.velocity}
    vectors = moving | {"density": of_w, "record": welch.record}
    subjects = [
        _Subject(
            "resonances",
            partial(resonances, job.cube["w"], job.depth, **vectors),
            "No coherence of wave vectors",
            used.attrs,
        ),
        _Subject(
            "bound",
            partial(free_and_bound, of_z, job.depth, dof=dof, **moving),
            "No bound waves" if used.source == GIVEN else None,
            used.attrs,
        ),
        _Subject(
            "directional",
            partial(from_density, of_w, job.depth, job.gamma, used.velocity, dof, welch.frames),
            "No directional spectrum",
            used.attrs,
        ),
    ]
    by_depth = partial(current_by_depth, dispersion, surface=surface, gamma=job.gamma)
    if used.source == FITTED:
        subjects.append(_Subject("shear", by_depth, "No current by depth", used.attrs))
    return subjects


def _moving(used: CurrentUsed, w: xr.DataArray, power: np.ndarray, welch: Welch) -> SpectraOnCurrent | None:
    # what takes w to the elevation on the current; None on still water and where none is known
    if used.source == NO_CURRENT:
        return None
    zw = xr.DataArray(field_spectra.density(power, welch), w.coords, w.dims)
    return SpectraOnCurrent(used.velocity, w, zw)


def _map_lines(omega: np.ndarray, requested: Sequence[float]) -> list[int]:
    lines = omega / (2 * np.pi)
    return sorted({int(np.abs(lines - f).argmin()) for f in requested if f < lines[-2]} - {0})


def _map(density: xr.DataArray, chosen: list[int], name: str) -> xr.DataArray:
    out = density.isel(omega=chosen).drop_vars("frequency").rename(omega="omega_map")
    units = density_units(FIELD_UNITS[name], "k", "k", "omega")
    return out.assign_attrs(TABLE["maps/E"].of(FIELD_TEXTS[name], units))


def _density(power: np.ndarray, name: str, welch: Welch) -> xr.DataArray:
    values = xr.Variable(("omega", "ky", "kx"), field_spectra.density(power, welch))
    return field_spectra.plane_density(values, FIELD_TEXTS[name], FIELD_UNITS[name], welch)["E"]


def _notes(welch: Welch, job: _Job) -> list[str]:
    record, count, sizes = welch.record, welch.count, job.cube.sizes
    used = sum(b - a for a, b in record.runs if b - a >= welch.segment)
    out = []
    if count < _FEW:
        seconds = welch.segment * record.dt
        out.append(
            f"The record holds {count} segment{'s' if count > 1 else ''} of {seconds:.3g} s: a single cell"
            f" has {welch.dof:.1f} degrees of freedom, so trust averages over rings and bands, not single"
            " values."
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
    if record.shape != (sizes["y"], sizes["x"]):
        out.append(
            f"Of {sizes['y']} x {sizes['x']} nodes (y, x) the largest full rectangle was used,"
            f" {record.shape[0]} x {record.shape[1]}."
        )
    if not np.isfinite(job.depth):
        out.append("The depth of the water is not known to the cube: deep water was assumed.")
    return out


def _attributes(job: _Job, welch: Welch) -> dict[str, Any]:
    cube, record = job.cube, welch.record
    return {
        "title": "waves of a cube",
        "source": str(job.whole.attrs.get("experiment", job.whole.encoding.get("source", ""))),
        "frame_rate": 1 / record.dt,
        "water_depth": job.depth if np.isfinite(job.depth) else "deep",
        "surface_tension_over_density": job.gamma,
        "windows_undone": "no" if job.gain is None else str(job.gain.attrs.get("origin", "yes")),
        "segment": welch.segment,
        "segments": welch.count,
        "frames_of_velocities": welch.frames,
        "degrees_of_freedom": welch.dof,
        "steps": record.steps,
        "steps_used": sum(b - a for a, b in record.runs if b - a >= welch.segment),
        "steps_bridged": len(record.bridged),
        "nodes_filled": record.holes,
        "runs": len(record.runs),
        "x": [float(cube["x"][record.x[0]]), float(cube["x"][record.x[1] - 1])],
        "y": [float(cube["y"][record.y[0]]), float(cube["y"][record.y[1] - 1])],
        "wavefield_version": wavefield.__version__,
    }
