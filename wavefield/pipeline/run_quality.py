"""The verdict on an experiment before its run, and on a cube after it."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wavefield.execution.cluster import threads_here
from wavefield.execution.worker_settings import one_thread
from wavefield.measurement.unresolved_waves import unresolved_std
from wavefield.pipeline.cost import fraction_measured
from wavefield.pipeline.magnitudes import expected_coverage
from wavefield.pipeline.prepare import PreparedRun
from wavefield.pipeline.still_water import remark_on_rest
from wavefield.quality import camera_delay, camera_motion
from wavefield.quality.camera_delay import Synchrony
from wavefield.quality.camera_faults import CameraFaults, find_camera_faults
from wavefield.quality.field_remarks import (
    remark_on_coverage,
    remark_on_eps_piv,
    remark_on_holes,
    remark_on_unresolved_waves,
)
from wavefield.quality.patch_matching import PatchMatcher
from wavefield.quality.probe_remarks import remark_on_probes
from wavefield.quality.recording_remarks import remark_on_recordings
from wavefield.quality.stored_values import remark_on_stored_values
from wavefield.sampling import evenly_spaced
from wavefield.series import Experiment, FrameSeries
from wavefield.store.cube_group import CubeGroup
from wavefield.store.ledger import Status
from wavefield.store.read import open_group, open_without_jitter
from wavefield.store.verdict import Remark, Verdict
from wavefield.text import spell_ranges
from wavefield.variables import Quality


@dataclass(frozen=True)
class RunLimits:
    """What the verdict on a run samples, and from which values on it remarks."""

    instants: int = 4  # of a record, compared before a run and after it
    instants_for_delays: int = 24  # of a record, by which delays of cameras are measured after its run
    instants_for_first_delays: int = 4  # the same before it
    steps: int = 12  # of a cube whose stored values are read
    steps_compared: int = 5  # of a record: shorter ones have no neighbours to compare with
    without_camera: tuple[float, float] = (0.01, 0.1)  # fraction of the nodes: more is noted, remarked upon
    faulty: float = 0.01  # of the steps with bad frames: fewer are only noted


LIMITS = RunLimits()


def compare_cameras(prepared: PreparedRun) -> CameraFaults:
    """Compare the cameras' images at some instants of the record."""
    count = prepared.steps + 1
    frames = evenly_spaced(count, LIMITS.instants)
    with one_thread():  # each of them
        return find_camera_faults(_patch_matcher(prepared), count, frames, threads_here(prepared.workflow))


def synchrony_of(prepared: PreparedRun, instants: int = LIMITS.instants_for_delays) -> Synchrony:
    """Whether the cameras take their frames at the same moment."""
    count = prepared.steps + 1
    frames = sorted({min(max(k, 2), count - 3) for k in evenly_spaced(count, instants)}) if count >= 5 else []
    rate = prepared.experiment.frame_rate
    with one_thread():  # each of them
        return camera_delay.delays(
            prepared.geometry,
            prepared.record,
            _patch_matcher(prepared),
            frames,
            rate,
            threads_here(prepared.workflow),
        )


def clocks(prepared: PreparedRun) -> tuple[str, list[Remark]]:
    """First estimate of the delays between cameras, at a few instants."""
    found = synchrony_of(prepared, LIMITS.instants_for_first_delays)
    words = camera_delay.sentence(found.delays, 1 / prepared.experiment.frame_rate)
    return words, list(camera_delay.remarks(found))


def _patch_matcher(prepared: PreparedRun) -> PatchMatcher:
    return PatchMatcher(lambda name, k: prepared.series[name].read_uncovered(k), prepared.rig, prepared.grid)


def assess_run(prepared: PreparedRun, status: Status) -> Verdict:
    """The verdict on a cube whose run has ended."""
    faults = compare_cameras(prepared)
    remarks = [
        *faults.remarks,
        *(
            []
            if any(one.weight == "grave" for one in faults.remarks)
            else _clocks_and_mounts(prepared, status)
        ),
        remark_on_rest(prepared.experiment, prepared.rig, _level_std(status.store)),
        *remark_on_recordings(prepared.experiment, prepared.series),
        *remark_on_probes(
            prepared.experiment, status.store, record_span(prepared.experiment, prepared.series)
        ),
        *_steps(status),
        *_fields(status.store, expected_coverage(prepared.rig, prepared.grid)),
        *_stored_values(prepared, status),
        *_short_waves(prepared, status),
    ]
    return Verdict.of(remarks, faults.cameras, faults.pairs, faults.frames)


def record_span(experiment: Experiment, series: Mapping[str, FrameSeries]) -> tuple[float, float]:
    """Times of the first and the last frame, s."""
    times = experiment.frame_times(next(iter(series.values())))
    return float(times[0]), float(times[-1])


def _level_std(store: Path) -> float:
    """Standard uncertainty of z = 0 of a cube, metres; NaN in cubes of earlier versions."""
    group = open_group(store)
    return float(group["z_level_std"][()]) if "z_level_std" in group else float("nan")


def _clocks_and_mounts(prepared: PreparedRun, status: Status) -> Iterator[Remark]:
    """Remarks on delays and motion of cameras, from the epipolar errors."""
    instants = min(
        LIMITS.instants_for_delays, max(LIMITS.instants, prepared.steps // 6)
    )  # of a short record, not most of its cost
    yield from camera_delay.remarks(synchrony_of(prepared, instants))
    first = next(iter(prepared.series.values())).first
    yield from camera_motion.remarks(
        status.store, prepared.geometry, prepared.record, _patch_matcher(prepared), first
    )


def _steps(status: Status) -> Iterator[Remark]:
    if status.failed:
        everything = status.failed == status.steps
        yield Remark(
            "record",
            "failed steps",
            "grave" if everything else "remark",
            f"{'all' if everything else status.failed} of {status.steps} steps could not be measured, "
            f"from frame {spell_ranges(status.failed_steps, 3)}",
            "none",
            "check these frames: are they present, bright and seeded in all cameras?",
            {"failed": status.failed, "steps": status.steps},
        )
    if status.faulty:
        yield Remark(
            "record",
            "bad frames",
            "remark" if status.faulty > LIMITS.faulty * status.steps else "note",
            f"{status.faulty} of {status.steps} steps have bad frames around them",
            f"less than {100 * LIMITS.faulty:.0f} %",
            "copy these frames again and run the same command",
            {"faulty": status.faulty, "steps": status.steps},
        )


def _stored_values(prepared: PreparedRun, status: Status) -> Iterator[Remark]:
    """What the stored fields show when they are compared with each other."""
    if status.done < LIMITS.steps_compared or prepared.geometry.settings.sheet_thickness is not None:
        return
    first = next(iter(prepared.series.values())).first
    yield from remark_on_stored_values(status.store, evenly_spaced(status.steps, LIMITS.steps), first)


def _short_waves(prepared: PreparedRun, status: Status) -> Iterator[Remark]:
    """Waves that are shorter than what images resolve, beside the w that was measured."""
    record = prepared.record
    if record is None or not record.unresolved[0]:
        return
    rate, (_, wavelength) = prepared.experiment.frame_rate, record.unresolved
    rise = unresolved_std(*record.unresolved, rate)[1]
    steps = evenly_spaced(status.steps, LIMITS.steps)
    cube = open_without_jitter(status.store)[["w", "w_std", "quality"]].isel(time=list(steps)).load()
    measured = cube.quality.values & int(Quality.MEASURED) != 0
    if measured.any():
        w, std = (cube[name].values[measured] for name in ("w", "w_std"))
        yield from remark_on_unresolved_waves(
            rise * rate, wavelength, float(np.sqrt(np.mean(np.square(w)))), float(np.median(std))
        )


def _fields(store: Path, in_view: float) -> Iterator[Remark]:
    """Remarks on the stored values, at some steps."""
    group = open_group(store)
    steps = evenly_spaced(group["z"].shape[0], LIMITS.steps)
    z = np.stack([np.asarray(group["z"][k]) for k in steps])
    if group["z"].dtype == np.int16:
        z = np.where(z == group["z"].attrs["_FillValue"], np.nan, z.astype(np.float32))
    if not np.isfinite(z).any():
        return  # the ledger reports it
    eps = np.stack([np.asarray(group["eps_piv"][k], np.float32) for k in steps])
    eps *= np.float32(group["eps_piv"].attrs.get("scale_factor", 1.0))
    yield from remark_on_eps_piv(z, eps)
    yield from _left_out(group, steps)
    quality = np.stack([np.asarray(group["quality"][k]) for k in steps])
    yield from remark_on_coverage(in_view)
    yield from remark_on_holes(fraction_measured(quality))


def _left_out(group: CubeGroup, steps: Sequence[int]) -> Iterator[Remark]:
    """Cameras without which much was measured."""
    quality = np.stack([np.asarray(group["quality"][k]) for k in steps])
    has_value = (quality & np.uint16(Quality.MEASURED | Quality.FILLED)) != 0
    for number, camera in enumerate(group.attrs["cameras"]):
        bit = np.uint16(Quality.without(number) & ~Quality.FEWER_CAMERAS)
        fraction = float(((quality & bit) != 0)[has_value].mean()) if has_value.any() else 0.0
        if fraction > LIMITS.without_camera[0]:
            yield Remark(
                camera,
                "left out",
                "remark" if fraction > LIMITS.without_camera[1] else "note",
                f"{100 * fraction:.1f} % of the nodes were measured without {camera}: its frame was missing,"
                " or it was inconsistent with the others there",
                f"less than {100 * LIMITS.without_camera[0]:.0f} %",
                f"check the images of {camera}: a drop on its window, a reflection, focus, a late frame?",
                {"fraction": fraction},
            )
