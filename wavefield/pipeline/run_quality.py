"""The verdict on an experiment before its run, and on a cube after it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from wavefield.execution.cluster import threads_here
from wavefield.execution.process import one_thread
from wavefield.measurement.error_budget import fast_waves, level_std, ripples
from wavefield.pipeline.magnitudes import expected_coverage
from wavefield.pipeline.prepare import PreparedRun
from wavefield.quality.camera_motion import (
    Synchrony,
    delays,
    level_motion,
    remark_on_level,
    remarks_on_clocks,
    remarks_on_mounts,
    spell_delays,
)
from wavefield.quality.cameras import CameraFaults, PatchMatcher, find_camera_faults
from wavefield.quality.record import (
    COMPARED,
    RiseRatios,
    remark_on_cleared_steps,
    remark_on_jitter,
    remark_on_kinematics,
    remark_on_recordings,
    rise_ratios,
    steps_to_leave_out,
)
from wavefield.quality.remarks import (
    remark_on_cameras_left_out,
    remark_on_coverage,
    remark_on_eps_piv,
    remark_on_fast_waves,
    remark_on_holes,
    remark_on_mean_plane,
    remark_on_probes,
    remark_on_rest,
    remark_on_steps,
    remark_on_unresolved_waves,
)
from wavefield.sampling import evenly_spaced
from wavefield.series import Experiment, FrameSeries
from wavefield.store.ledger import Status
from wavefield.store.read import open_cube
from wavefield.store.verdict import Remark, Verdict
from wavefield.store.write_cube import clear_steps, write_level_std
from wavefield.variables import FrameStatus, Quality


@dataclass(frozen=True)
class RunLimits:
    """What the verdict on a run samples, and from which values on it remarks."""

    instants: int = 4  # of a record, compared before a run and after it
    instants_for_delays: int = 24  # of a record, by which delays of cameras are measured after its run
    instants_for_first_delays: int = 4  # the same before it
    steps: int = 12  # of a cube whose stored values are read
    steps_compared: int = 5  # of a record: shorter ones have no neighbours to compare with
    deep_sheet: float = 4.0  # px between sight lines: particles of thinner ones make one picture


LIMITS = RunLimits()


def compare_cameras(prepared: PreparedRun) -> CameraFaults:
    """Compare the cameras' images at some instants of the record.
    Patches of deep light sheets overlap differently in each camera, and disagree whatever the rig.
    """
    count, matcher = prepared.steps + 1, _patch_matcher(prepared)
    frames = evenly_spaced(count, LIMITS.instants)
    with one_thread():  # each of them
        found = find_camera_faults(matcher, count, frames, threads_here(prepared.workflow))
    thickness = prepared.geometry.settings.sheet_thickness
    if thickness is None:
        return found
    depth = thickness * max(float(np.median(matcher.parallax(pair))) for pair in prepared.geometry.pairs)
    if depth < LIMITS.deep_sheet * matcher.pixel:
        return found
    remarks = [
        _not_compared(depth / matcher.pixel) if one.kind == "disagree" else one for one in found.remarks
    ]
    return replace(found, remarks=tuple(remarks))


def _not_compared(depth: float) -> Remark:
    return Remark(
        "cameras",
        "light sheet",
        "remark",
        f"the light sheet is {depth:.0f} px deep between their sight lines (at most {LIMITS.deep_sheet:g} "
        "px to compare patches)",
        "A wrong rig or frames of other moments would not be found",
        "Run `wavefield rig sheet`, which correlates all frames together",
    )


def synchrony_of(prepared: PreparedRun, instants: int = LIMITS.instants_for_delays) -> Synchrony:
    """Whether the cameras take their frames at the same moment."""
    count = prepared.steps + 1
    frames = sorted({min(max(k, 2), count - 3) for k in evenly_spaced(count, instants)}) if count >= 5 else []
    matcher, rate = _patch_matcher(prepared), prepared.experiment.frame_rate
    threads = threads_here(prepared.workflow)
    with one_thread():  # each of them
        return delays(prepared.geometry, prepared.record, matcher, frames, rate, threads)


def clocks(prepared: PreparedRun) -> tuple[str, list[Remark]]:
    """First estimate of the delays between cameras, at a few instants."""
    found = synchrony_of(prepared, LIMITS.instants_for_first_delays)
    words = spell_delays(found.delays, 1 / prepared.experiment.frame_rate)
    return words, list(remarks_on_clocks(found))


def _patch_matcher(prepared: PreparedRun) -> PatchMatcher:
    return PatchMatcher(lambda name, k: prepared.series[name].read_uncovered(k), prepared.rig, prepared.grid)


@dataclass(frozen=True)
class RecordCheck:
    """What comparing all steps of a cube with their neighbours has shown."""

    ratios: RiseRatios  # NaN at steps that were cleared
    level_motion: float  # Rms of the mean level that no wave explains, m; 0 if it is not significant
    z_std: float  # Typical standard uncertainty of z, m


def check_record(prepared: PreparedRun, status: Status) -> RecordCheck | None:
    """Compare the steps of a cube with each other, and put into a complete one what that shows.

    Steps whose frames lie on both sides of a lost, doubled or late frame are cleared; the motion of the mean
    level that no wave explains enters `z_level_std`. Done again, it gives the same. None for light sheets and
    for records of few steps.
    """
    sheet = prepared.geometry.settings.sheet_thickness is not None
    if sheet or status.done + status.faulty < LIMITS.steps_compared:
        return None
    cube = open_cube(status.store)
    ratios, motion = rise_ratios(cube), level_motion(cube)
    z_std = float(cube.z_std.isel(time=evenly_spaced(status.steps, LIMITS.steps)).load().median())
    motion = motion if motion > z_std else 0.0
    found = steps_to_leave_out(ratios.discontinuous(), cube.sizes["time"])
    before = np.flatnonzero(cube.frame_status.values == FrameStatus.DISCONTINUOUS)
    cleared = np.union1d(found, before)
    if status.complete and cleared.size:
        clear_steps(status.store, cleared.tolist())
    if status.complete and prepared.record is not None:
        known = level_std(prepared.geometry, prepared.record)
        write_level_std(status.store, float(np.hypot(known, motion)))
    return RecordCheck(ratios.without(cleared), motion, z_std)


def assess_run(prepared: PreparedRun, status: Status, checked: RecordCheck | None) -> Verdict:
    """The verdict on a cube whose run has ended."""
    experiment, series = prepared.experiment, prepared.series
    faults, cube = compare_cameras(prepared), open_cube(status.store)
    sample = cube[[*COMPARED, "eps_piv", "quality"]]
    sample = sample.isel(time=evenly_spaced(status.steps, LIMITS.steps)).load()
    grave = any(one.weight == "grave" for one in faults.remarks)
    remarks = [
        *faults.remarks,
        *([] if grave else _clocks_and_mounts(prepared, cube)),
        remark_on_rest(experiment, prepared.rig, float(cube.get("z_level_std", np.nan))),
        *remark_on_recordings(experiment, series),
        *remark_on_probes(experiment, cube, record_span(experiment, series)),
        *remark_on_steps(status),
        *_fields(sample, expected_coverage(prepared.rig, prepared.grid)),
        *(_stored_values(cube, sample, checked) if checked else ()),
        *_short_waves(sample, prepared),
    ]
    return Verdict.of(remarks, faults.cameras, faults.pairs, faults.frames)


def record_span(experiment: Experiment, series: Mapping[str, FrameSeries]) -> tuple[float, float]:
    """Times of the first and the last frame, s."""
    times = experiment.frame_times(next(iter(series.values())))
    return float(times[0]), float(times[-1])


def _clocks_and_mounts(prepared: PreparedRun, cube: xr.Dataset) -> Iterator[Remark]:
    """Remarks on delays and motion of cameras, from the epipolar errors."""
    # of a short record, not most of its cost
    instants = min(LIMITS.instants_for_delays, max(LIMITS.instants, prepared.steps // 6))
    yield from remarks_on_clocks(synchrony_of(prepared, instants))
    yield from remarks_on_mounts(cube, prepared.geometry, prepared.record, _patch_matcher(prepared))


def _short_waves(sample: xr.Dataset, prepared: PreparedRun) -> Iterator[Remark]:
    """Waves that are faster than what frames follow, and shorter than what images resolve, beside the w that
    was measured at some steps.
    """
    record = prepared.record
    if record is None:
        return
    rate, (_, wavelength) = prepared.experiment.frame_rate, record.ripples
    yield from remark_on_fast_waves(*fast_waves(record.elevation, prepared.geometry.pixel, rate), rate)
    if not all(record.ripples):
        return
    rise = float(np.sqrt(ripples(record.ripples, rate)[3]))
    measured = sample.quality.values & int(Quality.MEASURED) != 0
    if measured.any():
        w, std = (sample[name].values[measured] for name in ("w", "w_std"))
        yield from remark_on_unresolved_waves(
            rise * rate, wavelength, float(np.sqrt(np.mean(np.square(w)))), float(np.median(std))
        )


def _fields(sample: xr.Dataset, in_view: float) -> Iterator[Remark]:
    """Remarks on the stored values of some steps."""
    if not np.isfinite(sample.z).any():
        return  # the ledger reports it
    yield from remark_on_eps_piv(sample.z.values, sample.eps_piv.values)
    yield from remark_on_cameras_left_out(sample.quality.values, sample.attrs["cameras"])
    yield from remark_on_coverage(in_view)
    yield from remark_on_holes(fraction_measured(sample.quality.values))


def _stored_values(cube: xr.Dataset, sample: xr.Dataset, checked: RecordCheck) -> Iterator[Remark]:
    yield from remark_on_kinematics(sample)
    yield from remark_on_cleared_steps(cube)
    yield from remark_on_jitter(checked.ratios, sample)
    pixel = float(cube.attrs["pixel_size"])
    yield from remark_on_level(checked.level_motion, checked.z_std, pixel)
    yield from remark_on_mean_plane(cube)


def fraction_measured(quality: np.ndarray) -> float:
    """Fraction of the nodes in view that were measured; filled nodes do not count."""
    visible = (quality & (Quality.OUTSIDE | Quality.MASKED)) == 0
    return float((quality[visible] & Quality.MEASURED != 0).mean()) if visible.any() else 0.0
