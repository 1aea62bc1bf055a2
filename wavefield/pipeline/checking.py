"""`check`: find missing files and faults of an experiment, and estimate time, memory and disk of a run."""

import shutil
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numcodecs
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.errors import ExperimentError, RigError
from wavefield.execution.cluster import count_workers
from wavefield.execution.process import one_opencv_thread, peak_memory
from wavefield.execution.workflow import Workflow
from wavefield.grid import Grid
from wavefield.pipeline import assess
from wavefield.pipeline.chunk import make_chunk, measure_chunk
from wavefield.pipeline.learning import learn_from, samples
from wavefield.pipeline.prepare import (
    SAMPLE_STEPS,
    PreparedRun,
    expected_coverage,
    load_files,
    prepare,
    refuse_small_fields,
)
from wavefield.quality import camera_motion, record, remarks
from wavefield.rig import Rig
from wavefield.series import Experiment, FrameSeries
from wavefield.store.layout import COMPRESSION
from wavefield.store.ledger import BadFrames
from wavefield.store.verdict import Remark, Verdict
from wavefield.text import short_path, spell_time
from wavefield.variables import AROUND, CUBE_DIMS, FrameFault, FrameStatus


@dataclass(frozen=True)
class Cost:
    """Time, memory and disk space that a run will need, estimated from a few measured steps."""

    step_seconds: float  # Time per step on one worker, s
    workers: int  # Number of workers
    seconds: float  # Time of the whole run, s
    memory: int  # Memory per worker, bytes
    disk: int  # Size of the store, bytes
    free: int  # Free space on the disk of the experiment, bytes

    def __str__(self) -> str:
        workers = "1 worker" if self.workers == 1 else f"{self.workers} workers"
        return (
            f"{spell_time(self.seconds)} on {workers} ({self.step_seconds:.2f} s per step), "
            f"{self.memory / 1e9:.2f} GB of memory per worker, {spell_size(self.disk)} of disk"
        )


@dataclass(frozen=True)
class Trial:
    """Results of `check` at n steps in the middle of a record, and the estimated cost of the whole run."""

    prepared: PreparedRun  # The run, with spectra and noise learned from the first of these steps
    start: int  # Index of the first of these steps in the record
    fields: Mapping[str, NDArray[Any]]  # (n, ny, nx): Measured variables, by name
    cost: Cost  # Estimate for the whole run


def measure_some(prepared: PreparedRun) -> Trial:
    """Measure a few steps in the middle of the record, and estimate the cost of the whole run.
    ExperimentError if no step has the images of all cameras, or if nothing can be measured."""
    complete = record.complete_steps(prepared.series)
    steps = np.flatnonzero(complete)
    if steps.size == 0:
        raise ExperimentError(
            "no two consecutive frames exist in all cameras: nothing can be measured; check `images`, "
            "`frames` and `offset`"
        )
    start = int(steps[np.argmin(np.abs(steps - len(complete) // 2))])  # in the middle of the record
    stop = min(start + SAMPLE_STEPS, prepared.steps)
    learned = learn_from(samples(prepared.series, [start]), prepared.geometry, prepared.frame_rate)
    prepared = prepared.with_prior(learned)  # this also compiles, which is not part of the time per step
    chunk = make_chunk(prepared.series, start, stop, prepared.departures)
    since = time.perf_counter()
    found = measure_chunk(chunk, prepared.geometry, prepared.frame_rate, prepared.model)
    seconds = (time.perf_counter() - since) / (chunk.steps + 2 * AROUND + 1)  # per frame, all cameras
    if (found.frame_status == FrameStatus.FAILED).all() and not found.fields["quality"].any():
        raise ExperimentError(
            f"the step that begins at frame {prepared.first_frame + start} could not be measured; check its "
            "images, the rig and the grid"
        )
    workers = count_workers(prepared.workflow)
    frames_measured = prepared.steps * (1 + (2 * AROUND + 1) / prepared.chunk_steps)
    cost = Cost(
        step_seconds=seconds,
        workers=workers,
        seconds=seconds * frames_measured / workers,
        memory=peak_memory() + 3 * prepared.chunk_steps * prepared.step_bytes,
        disk=int(_stored_bytes(found.fields) * prepared.steps / (stop - start)),
        free=shutil.disk_usage(prepared.experiment.path.parent).free,
    )
    return Trial(prepared, start, found.fields, cost)


def _stored_bytes(fields: Mapping[str, np.ndarray]) -> int:
    """Return the size of measured fields in bytes, when compressed as in the store."""
    codec = numcodecs.Blosc(**COMPRESSION, shuffle=numcodecs.Blosc.SHUFFLE)
    return sum(len(codec.encode(np.ascontiguousarray(values))) for values in fields.values())


def spell_size(count: float) -> str:
    """Return a number of bytes as text, in MB or GB."""
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.0f} MB"


@dataclass(frozen=True)
class CameraCheck:
    """What `check` found in the frames of one camera; of more than 24 frames, only a sample is read."""

    name: str  # Name of the camera
    frames: int  # Number of frames that exist
    size: tuple[int, int]  # (width, height), px
    dtype: str  # Data type of the images
    bad: tuple[BadFrames, ...]  # Missing or bad frames; a frame's number is that of its file plus `offset`
    beyond: tuple[int, int] = (0, 0)  # How many frames before and after the record are not used
    first: int = 0  # Number of the first frame of the record, also plus `offset`

    def __str__(self) -> str:
        text = f"{self.name}: {self.frames} frames of {self.size[0]} x {self.size[1]} px, {self.dtype}"
        ends = [f"{n} {where}" for n, where in zip(self.beyond, ("before", "after")) if n]
        if ends:
            text += f"; not used: {' and '.join(ends)} the record"
        return "\n    ".join([text, *map(str, self.bad)])


@dataclass(frozen=True)
class Check:
    """What `check` found, and the estimated cost of the run.
    Fields that are unknown, because the rig is not usable or a run cannot start, are None or empty."""

    experiment: str  # Name of the experiment
    path: Path  # Experiment file
    steps: int  # Steps of the whole run; a step is the interval between two frames
    frame_rate: float  # Hz
    cameras: tuple[CameraCheck, ...]  # Frames of every camera
    rig: tuple[str, ...]  # Names of the rig's cameras
    grid: Grid | None  # Nodes of the cube
    coverage: float | None  # Fraction of the nodes that all measuring cameras see if the water is at rest
    measured: float | None  # Fraction of the nodes in view that were measured in the trial steps
    cost: Cost | None  # Estimate for the run
    problems: tuple[str, ...]  # Reasons why a run cannot start
    verdict: Verdict | None  # Remarks on frames, cameras, rig, grid and probes
    motion: str = ""  # A sentence on the displacement of the water between frames
    heights: str = ""  # A sentence on the range of elevations
    clocks: str = ""  # A sentence on the delays between cameras

    @property
    def exit_status(self) -> int:
        """Exit status of `wavefield check`.
        It is 1 if a run cannot start, 3 if a remark is more than a note, and 0 otherwise."""
        return 1 if self.problems else self.verdict.exit_status if self.verdict else 0

    def to_dict(self) -> dict[str, object]:
        """Return the result as a dict of plain data, which `wavefield check --json` prints."""
        return asdict(self) | {
            "path": str(self.path),
            "first_frame": self.cameras[0].first,
            "exit_status": self.exit_status,
            "verdict": self.verdict.to_dict() if self.verdict else None,
        }

    @property
    def line(self) -> str:
        """Verdict, such as "not ready", "sound" or "sound with remarks: cam1 focus"; empty if unknown."""
        return "not ready" if self.problems else self.verdict.line if self.verdict else ""

    def __str__(self) -> str:
        lines = [f"verdict: {self.line}"] if self.line else []
        lines += [
            f"{self.experiment} ({short_path(self.path)}): {self.steps} steps at {self.frame_rate:g} Hz "
            f"({spell_time(self.steps / self.frame_rate)})"
        ]
        lines += [f"  {camera}" for camera in self.cameras]
        if self.rig:
            lines.append(f"  rig: {', '.join(self.rig)}")
        if self.grid:
            (x0, x1), (y0, y1), (ny, nx) = self.grid.x, self.grid.y, self.grid.shape
            lines.append(
                f"  grid: x {x0:g} to {x1:g} m, y {y0:g} to {y1:g} m, every {self.grid.step:g} m: "
                f"{nx} x {ny} nodes"
            )
        if self.coverage is not None:
            text = f"  coverage: all cameras see {100 * self.coverage:.0f} % of the nodes"
            if self.measured is not None:
                text += f"; a trial measured {100 * self.measured:.0f} % of the nodes in view"
            lines.append(text)
        if self.cost:
            lines.append(f"  a run will take {self.cost}")
        lines += [f"  {words}" for words in (self.motion, self.heights) if words]
        if self.verdict and self.verdict.pairs:
            pairs = [
                f"{pair} {100 * float(np.median(one['agreement'])):.0f} %, "
                f"epipolar error {np.median(one['eps_y']):.2f} px"
                for pair, one in self.verdict.pairs.items()
            ]
            lines.append(f"  patches matched: {'; '.join(pairs)}")
        elif self.verdict and len(self.rig) > 1 and self.coverage is not None:
            lines.append("  patches matched: none, because the cameras share too small a part of the water")
        lines += [f"  clocks: {self.clocks}"] if self.clocks else []
        lines += [f"  not ready: {problem}" for problem in self.problems]
        lines += [f"  {remark}" for remark in (self.verdict.remarks if self.verdict else ())]
        return "\n".join(lines)


def check(
    experiment: str | Path | Experiment,
    rig: str | Path | Rig | None = None,
    workflow: str | Path | Workflow | None = None,
) -> Check:
    """Check an experiment before its run: read some of its images, and measure a few steps.

    No file is written.

    Parameters
    ----------
    experiment : path or Experiment
        Experiment file, or the experiment.
    rig : path or Rig, optional
        Used instead of the rig that the experiment names.
    workflow : path or Workflow, optional
        Cluster and settings of the planned run; by default the processes of this machine.

    Returns
    -------
    Check
        Frames, grid, cost and faults; printing it gives a summary. ``problems`` lists the reasons why a run
        cannot start, such as an error in the rig or the workflow.

    Raises
    ------
    ExperimentError
        If the experiment file is wrong, or if a camera has no images.

    Examples
    --------
    Three images of one camera, without a rig: a run cannot start.

    >>> import tempfile
    >>> from wavefield.images import write_image
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "experiment.yaml"
    ...     _ = file.write_text("{name: basin, frame_rate: 20, cameras: {left: 'left/{frame}.tif'}}")
    ...     for number in range(3):
    ...         write_image(Path(folder) / f"left/{number}.tif", np.eye(64, k=number, dtype=np.uint8))
    ...     found = check(file)
    >>> found.steps, len(found.problems)
    (2, 1)
    """
    experiment, _ = load_files(experiment, None)  # errors of the workflow are reported as a problem below
    series = experiment.open_frames()
    measuring = {name: series[name] for name in experiment.measuring_cameras}
    sample = record.sample_frames(measuring)
    inspections = {name: record.inspect_frames(one, sample) for name, one in series.items()}
    cameras = tuple(_summary(one, inspections[name]) for name, one in series.items())
    prepared, trial, faults, problem = None, None, None, ""
    try:
        prepared = prepare(experiment, rig, workflow)
        refuse_small_fields(prepared.geometry, prepared.experiment.path)
        if experiment.rest:
            experiment.at_rest().open_frames()  # raises if images of the still-water record are missing
        with one_opencv_thread():
            trial = measure_some(prepared)
        faults = assess.compare_cameras(prepared, trial.fields["quality"])
    except (RigError, ExperimentError) as error:
        problem = str(error)
    every = [
        *record.remark_on_frames(measuring, {name: inspections[name] for name in measuring}),
        *record.remark_on_recordings(experiment, series),
        *remarks.remark_on_probe_file(experiment, assess.record_span(experiment, series)),
    ]
    if trial and (cost := trial.cost).free < cost.disk:
        sentence = f"the run will write {spell_size(cost.disk)}, but only {spell_size(cost.free)} are free"
        means, remedy = "The run may stop before its end", "Free some space or write elsewhere with -o"
        values = {"bytes": cost.disk, "free": cost.free}
        every.append(Remark("disk", "disk space", "remark", sentence, means, remedy, values))
    coverage = None
    if prepared:
        coverage = expected_coverage(prepared.rig, prepared.grid)
        every.append(remarks.remark_on_rest(prepared.experiment, prepared.rig))
        every += remarks.remark_on_coverage(coverage)
    delays = ""
    if trial and faults:
        every += faults.remarks
        if faults.weight != "grave":
            fields = {name: (CUBE_DIMS, trial.fields[name]) for name in ("u", "v", "w", "quality")}
            frames = range(trial.start + 1, trial.start + len(trial.fields["u"]))
            found = assess.measure_synchrony(trial.prepared, xr.Dataset(fields), frames, trial.start)
            delays = camera_motion.spell_delays(found.delays)
            every += [*camera_motion.remarks_on_clocks(found), *assess.remarks_on_fields(trial.fields)]
    verdict = Verdict(every, *(faults.pairs, faults.frames) if faults else ())
    return Check(
        experiment=experiment.name,
        path=experiment.path,
        steps=len(next(iter(series.values()))) - 1,
        frame_rate=experiment.frame_rate,
        cameras=cameras,
        rig=tuple(prepared.rig) if prepared else (),
        grid=prepared.grid if prepared else None,
        coverage=coverage,
        measured=assess.fraction_measured(trial.fields["quality"]) if trial else None,
        cost=trial.cost if trial else None,
        problems=(problem,) if problem else (),
        verdict=verdict if every or faults else None,
        motion=prepared.motion.sentence if prepared and prepared.motion else "",
        heights=prepared.heights.sentence if prepared and prepared.heights else "",
        clocks=delays,
    )


def _summary(series: FrameSeries, found: record.FrameInspection) -> CameraCheck:
    """Return the number, size, type and faults of a camera's frames; ``found`` has the faults in a sample."""
    rows, columns = series.shape
    faults = {FrameFault.MISSING: tuple(int(n) for n in series.missing)}
    for fault in record.FAULTS:
        faults[fault] = tuple(series.first + k for k, (kind, _) in found.faults.items() if kind == fault)
    return CameraCheck(
        series.camera,
        len(series) - len(series.missing),
        (columns, rows),
        series.dtype,
        tuple(BadFrames(series.camera, fault, numbers) for fault, numbers in faults.items() if numbers),
        beyond=series.beyond,
        first=series.first,
    )
