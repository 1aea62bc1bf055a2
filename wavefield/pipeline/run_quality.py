"""The verdict on an experiment before its run, and on a cube after it."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from wavefield.execution.cluster import threads_here
from wavefield.execution.worker_settings import one_thread
from wavefield.pipeline.cost import fraction_measured
from wavefield.pipeline.prepare import PreparedRun, expected_coverage
from wavefield.pipeline.still_water import remark_on_rest
from wavefield.quality import camera_delay, camera_motion
from wavefield.quality.camera_delay import Delay
from wavefield.quality.camera_faults import CameraFaults, find_camera_faults
from wavefield.quality.patch_matching import PatchMatcher
from wavefield.quality.probe_remarks import remark_on_probes
from wavefield.quality.recording_remarks import remark_on_recordings
from wavefield.quality.stored_values import remark_on_stored_values
from wavefield.store.ledger import Status
from wavefield.store.read import open_group
from wavefield.store.verdict import Remark, Verdict
from wavefield.text import spell_ranges
from wavefield.variables import Quality

_INSTANTS = 4  # of a record, compared before a run and after it
_SYNCHRONY = 24  # of a record, by which delays of cameras are measured after its run
_FIRST_CHECK = 4  # the same before it
_STEPS = 12  # of a cube, checked after its run
_EPS = (0.15, 0.5)  # px: median eps' that is remarked upon, that makes values useless
_ALONE = (0.01, 0.1)  # of the nodes measured without one camera: that is noted, that is remarked upon
MIN_STEPS_COMPARED = 5  # of a record: shorter ones have no neighbours to compare with
_LEAST_IN_VIEW = (0.5, 0.05)  # of the grid in common view: less is remarked upon, is worth nothing
_LEAST_MEASURED = (0.7, 0.2)  # of what all cameras see: less is remarked upon, is worth nothing
_MANY = 0.01  # of the steps with bad frames: fewer are only noted


def compare_cameras(prepared: PreparedRun) -> CameraFaults:
    """Compare the cameras' images at some instants of the record."""
    count = prepared.steps + 1
    frames = sorted({int((k + 0.5) * count / _INSTANTS) for k in range(_INSTANTS)})
    with one_thread():  # each of them
        return find_camera_faults(_patch_matcher(prepared), count, frames, threads_here(prepared.workflow))


def synchrony_of(prepared: PreparedRun, instants: int = _SYNCHRONY) -> tuple[dict[str, Delay], float]:
    """Whether the cameras take their frames at the same moment."""
    count = prepared.steps + 1
    even = ((k + 0.5) * count / instants for k in range(instants))
    frames = sorted({min(max(int(k), 2), count - 3) for k in even}) if count >= 5 else []
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
    found, speed = synchrony_of(prepared, _FIRST_CHECK)
    return camera_delay.sentence(found), list(camera_delay.remarks(found, speed))


def _patch_matcher(prepared: PreparedRun) -> PatchMatcher:
    return PatchMatcher(lambda name, k: prepared.series[name].read_uncovered(k), prepared.rig, prepared.grid)


def assess_run(prepared: PreparedRun, status: Status, seen: CameraFaults | None = None) -> Verdict:
    """The verdict on a cube whose run has ended."""
    seen = compare_cameras(prepared) if seen is None else seen
    remarks = [
        *seen.remarks,
        *([] if any(one.weight == "grave" for one in seen.remarks) else _clocks_and_mounts(prepared, status)),
        remark_on_rest(prepared.experiment, prepared.rig, _level_std(status.store)),
        *remark_on_recordings(prepared.experiment, prepared.series),
        *remark_on_probes(prepared.experiment, status.store),
        *_steps(status),
        *_fields(status.store, expected_coverage(prepared.rig, prepared.grid)),
        *_stored_values(prepared, status),
    ]
    return Verdict.of(remarks, seen.cameras, seen.pairs, seen.frames)


def _level_std(store: Path) -> float:
    """Standard uncertainty of z = 0 of a cube, metres; NaN in cubes of earlier versions."""
    group = open_group(store)
    return float(group["z_level_std"][()]) if "z_level_std" in group else float("nan")


def _clocks_and_mounts(prepared: PreparedRun, status: Status) -> Iterator[Remark]:
    """Remarks on delays and motion of cameras, from the epipolar errors."""
    instants = min(_SYNCHRONY, max(_INSTANTS, prepared.steps // 6))  # of a short record, not most of its cost
    yield from camera_delay.remarks(*synchrony_of(prepared, instants))
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
            "remark" if status.faulty > _MANY * status.steps else "note",
            f"{status.faulty} of {status.steps} steps have bad frames around them",
            f"less than {100 * _MANY:.0f} %",
            "copy these frames again and run the same command",
            {"faulty": status.faulty, "steps": status.steps},
        )


def _stored_values(prepared: PreparedRun, status: Status) -> Iterator[Remark]:
    """What the stored fields show when they are compared with each other."""
    if status.done < MIN_STEPS_COMPARED or prepared.geometry.settings.sheet_thickness is not None:
        return
    first = next(iter(prepared.series.values())).first
    yield from remark_on_stored_values(status.store, _some(status.steps), first)


def _fields(store: Path, seen: float) -> Iterator[Remark]:
    """Remarks on the stored values, at some steps."""
    group = open_group(store)
    steps = _some(group["z"].shape[0])
    z = np.stack([np.asarray(group["z"][k]) for k in steps])
    if group["z"].dtype == np.int16:
        z = np.where(z == group["z"].attrs["_FillValue"], np.nan, z.astype(np.float32))
    found = np.isfinite(z)
    if not found.any():
        return  # the ledger reports it
    eps = np.stack([np.asarray(group["eps_piv"][k], np.float32) for k in steps])
    eps *= np.float32(group["eps_piv"].attrs.get("scale_factor", 1.0))
    misfit = (
        float(np.median(np.abs(eps[found & np.isfinite(eps)]))) if (found & np.isfinite(eps)).any() else 0.0
    )
    if misfit > _EPS[0]:
        yield Remark(
            "velocity",
            "eps'",
            "grave" if misfit > _EPS[1] else "remark",
            f"the cameras are inconsistent on the motion of the water: median eps' {misfit:.2f} px",
            f"less than {_EPS[0]} px",
            "are the frames of the same moments, and of the same order, for all cameras?",
            {"eps_piv": misfit},
        )
    yield from _left_out(group, steps)
    quality = np.stack([np.asarray(group["quality"][k]) for k in steps])
    measured = fraction_measured(quality)
    if seen < _LEAST_IN_VIEW[0]:
        yield Remark(
            "grid",
            "coverage",
            "grave" if seen < _LEAST_IN_VIEW[1] else "remark",
            f"the cameras have {100 * seen:.2g} % of the grid's nodes in common view",
            f"{100 * _LEAST_IN_VIEW[0]:.0f} % at least",
            "check the extent of the grid, which is in metres, or leave it out: `grid: auto`",
            {"fraction": seen},
        )
    if measured < _LEAST_MEASURED[0]:
        yield Remark(
            "surface",
            "holes",
            "grave" if measured < _LEAST_MEASURED[1] else "remark",
            f"{100 * measured:.0f} % of the nodes in view were measured; the others are filled or empty",
            f"{100 * _LEAST_MEASURED[0]:.0f} % at least",
            "check seeding and light; `quality` gives the reason why nodes were rejected",
            {"fraction": measured},
        )


def _left_out(group: Any, steps: Sequence[int]) -> Iterator[Remark]:
    """Cameras without which much was measured."""
    quality = np.stack([np.asarray(group["quality"][k]) for k in steps])
    seen = (quality & np.uint16(Quality.MEASURED | Quality.FILLED)) != 0
    for number, camera in enumerate(group.attrs["cameras"]):
        bit = np.uint16(Quality.without(number) & ~Quality.FEWER_CAMERAS)
        fraction = float(((quality & bit) != 0)[seen].mean()) if seen.any() else 0.0
        if fraction > _ALONE[0]:
            yield Remark(
                camera,
                "left out",
                "remark" if fraction > _ALONE[1] else "note",
                f"{100 * fraction:.1f} % of the nodes were measured without {camera}: its frame was missing,"
                " or it was inconsistent with the others there",
                f"less than {100 * _ALONE[0]:.0f} %",
                f"check the images of {camera}: a drop on its window, a reflection, focus, a late frame?",
                {"fraction": fraction},
            )


def _some(count: int) -> Sequence[int]:
    return sorted({int((k + 0.5) * count / _STEPS) for k in range(_STEPS)})
