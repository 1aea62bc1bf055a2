"""What is there, what is missing, and what a run will cost: before a night is spent on it."""

import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wavefield.errors import ExperimentError, RigError
from wavefield.execution.worker_settings import one_thread
from wavefield.execution.workflow import Workflow
from wavefield.grid import Grid
from wavefield.pipeline.advice import advise
from wavefield.pipeline.cost import MIN_FREE_SHARE, Cost, measure_cost, spell_size
from wavefield.pipeline.magnitudes import refuse_small_fields
from wavefield.pipeline.prepare import expected_coverage, load_files, prepare
from wavefield.pipeline.run_quality import clocks, compare_cameras
from wavefield.pipeline.still_water import remark_on_rest
from wavefield.quality.camera_faults import CameraFaults
from wavefield.quality.frame_remarks import FrameInspection, inspect_frames, remark_on_frames, sample_frames
from wavefield.quality.recording_remarks import remark_on_recordings
from wavefield.rig import Rig
from wavefield.series import Experiment, FrameSeries
from wavefield.store.verdict import Remark, Verdict
from wavefield.text import spell_ranges, spell_time
from wavefield.variables import FrameFault

_UNUSUAL_SIZE = 0.005  # of the usual size of a camera's files
_UNUSUAL_SPREADS = 8.0  # times the median deviation from it
_MAX_UNUSUAL_READ = 24  # files of a camera


@dataclass(frozen=True)
class CameraCheck:
    """Frames of one camera.

    Of a record of more than 40 frames only a sample is read, and files of unusual sizes.
    """

    name: str  # The camera
    frames: int  # Frames that have a file
    size: tuple[int, int]  # (width, height), px
    dtype: str  # Type of the images
    # Numbers of the frames that have none: those of the run, file numbers plus the camera's `offset`
    missing: tuple[int, ...]
    small: tuple[int, ...]  # Numbers of the frames whose file is empty or truncated
    blank: tuple[int, ...] = ()  # Numbers of those without any contrast
    other: tuple[int, ...] = ()  # Numbers of those of another size or type than the first
    beyond: tuple[int, int] = (0, 0)  # Frames before and after the record, which are not used
    offset: int = 0  # Of the camera: number of a frame less that of its file

    def __str__(self) -> str:
        text = f"{self.name}: {self.frames} frames of {self.size[0]} x {self.size[1]} px, {self.dtype}"
        if self.missing:
            text += f"; {len(self.missing)} missing: {_frames(self.missing)}"
        for numbers, state in (
            (self.small, "empty or truncated"),
            (self.blank, "blank (all pixels equal)"),
            (self.other, "of another size or type"),
        ):
            if numbers:
                files = "1 file is" if len(numbers) == 1 else f"{len(numbers)} files are"
                text += f"; {files} {state}: {_frames(numbers)}"
        if self.offset and (self.missing or self.small or self.blank or self.other):
            text += f" (frame n is file n {-self.offset:+d})"
        ends = [f"{n} {where}" for n, where in zip(self.beyond, ("before", "after")) if n]
        if ends:
            text += f"; not used: {' and '.join(ends)} the record"
        return text


def _frames(numbers: tuple[int, ...]) -> str:
    return f"frame{'s' if len(numbers) > 1 else ''} {spell_ranges(numbers)}"


@dataclass(frozen=True)
class Check:
    """What `check` found of an experiment.

    Parameters
    ----------
    experiment : str
        Its name.
    path : path
        Its file.
    steps : int
        Steps of the whole run.
    frame_rate : float
        Hz.
    cameras : tuple of CameraCheck
        Frames of every camera.
    rig : tuple of str
        Cameras of the rig; empty if there is none.
    grid : Grid or None
        The nodes.
    coverage : float or None
        Share of the nodes that every measuring camera sees at rest.
    measured : float or None
        Fraction of the nodes in view that the step tried measured; filled ones do not count.
    cost : Cost or None
        What a run will take; None if it cannot run yet.
    problems : tuple of str
        What prevents a run.
    verdict : Verdict or None
        On the cameras' images; None if they could not be compared.
    motion, heights, clocks : str
        How far the water moves from frame to frame, how high it rises, and whether the cameras take their
        frames at the same moment, in words.
    advice : str
        What would help where little is measured.
    """

    experiment: str
    path: Path
    steps: int
    frame_rate: float
    cameras: tuple[CameraCheck, ...]
    rig: tuple[str, ...]
    grid: Grid | None
    coverage: float | None
    measured: float | None
    cost: Cost | None
    problems: tuple[str, ...]
    verdict: Verdict | None = None
    motion: str = ""
    heights: str = ""
    clocks: str = ""
    advice: str = ""

    @property
    def exit_status(self) -> int:
        """Of a command: 1 where something prevents a run, 3 where a remark matters, else 0."""
        if self.problems:
            return 1
        return self.verdict.exit_status if self.verdict else 0

    def to_dict(self) -> dict[str, Any]:
        """Plain data, as for ``--json``.

        Returns
        -------
        dict
        """
        out = asdict(self) | {"path": str(self.path), "exit_status": self.exit_status}
        return out | {"verdict": self.verdict.to_dict() if self.verdict else None}

    @property
    def ready(self) -> bool:
        """Whether a run can start."""
        return not self.problems

    @property
    def line(self) -> str:
        """The verdict in one line."""
        return "not ready" if self.problems else self.verdict.line if self.verdict else ""

    def __str__(self) -> str:
        lines = [f"verdict: {self.line}"] if self.line else []
        lines += [
            f"{self.experiment} ({self.path}): {self.steps} steps at {self.frame_rate:g} Hz "
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
                text += f"; the step tried measured {100 * self.measured:.0f} %"
            lines.append(text)
        if self.cost:
            lines.append(f"  a run will take {self.cost}")
            lines += [f"  {self.cost.reading}"] if self.cost.reading else []
        lines += [f"  {words}" for words in (self.motion, self.heights, self.advice) if words]
        lines += self._pair_consistencies()
        lines += [f"  clocks: {self.clocks}"] if self.clocks else []
        lines += [f"  not ready: {problem}" for problem in self.problems]
        lines += [f"  {remark}" for remark in (self.verdict.remarks if self.verdict else ())]
        return "\n".join(lines)

    def _pair_consistencies(self) -> list[str]:
        """How well the cameras agree, in a line."""
        pairs = self.verdict.pairs if self.verdict else {}
        words = [
            f"{pair} {100 * float(np.median(of['agreement'])):.0f} %, miss {np.median(of['eps_y']):.2f} px"
            for pair, of in pairs.items()
        ]
        return [f"  cameras agree: {'; '.join(words)}"] if words else []


def check(
    experiment: str | Path | Experiment,
    rig: str | Path | Rig | None = None,
    workflow: str | Path | Workflow | None = None,
) -> Check:
    """Look at an experiment and measure a few of its steps; changes nothing.

    Parameters
    ----------
    experiment : path or Experiment
        The experiment.
    rig : path or Rig, optional
        In place of the one that the experiment names.
    workflow : path or Workflow, optional
        How it would be processed.

    Returns
    -------
    Check
        To be printed; ``problems`` lists what prevents a run.

    Raises
    ------
    ExperimentError
        If the experiment file is wrong or images are not there.

    Examples
    --------
    >>> import wavefield as wf
    >>> found = wf.check("experiment.yaml")  # doctest: +SKIP
    >>> found.ready, found.problems  # doctest: +SKIP
    (True, ())
    """
    experiment, _ = load_files(experiment, None)  # a wrong workflow is one of the problems
    series = experiment.open_frames()
    measuring = {name: series[name] for name in experiment.measuring_cameras}
    sample = sample_frames(measuring)
    inspections = {
        name: inspect_frames(one, tuple(sorted({*sample, *_unusual_files(one)})))
        for name, one in series.items()
    }
    cameras = tuple(
        _summary(one, inspections[name], experiment.cameras[name].offset) for name, one in series.items()
    )
    steps = len(next(iter(series.values()))) - 1
    problems: list[str] = []
    prepared, cost, coverage, measured, advice = None, None, None, None, ""
    try:
        prepared = prepare(experiment, rig, workflow)
        refuse_small_fields(prepared.geometry, str(prepared.experiment.path))
        if experiment.rest:
            experiment.at_rest().open_frames()  # are they there?
    except (RigError, ExperimentError) as error:
        problems.append(str(error))
    if prepared:
        coverage = expected_coverage(prepared.rig, prepared.grid)
        with one_thread():
            try:
                cost, measured = measure_cost(prepared)
            except ExperimentError as error:
                problems.append(str(error))
            advice = advise(prepared, measured or 0.0)
    seen = compare_cameras(prepared) if prepared and not problems else None
    clock_text, late = "", list[Remark]()
    if prepared and seen and not any(one.weight == "grave" for one in seen.remarks):
        clock_text, late = clocks(prepared)
    remarks = [
        *remark_on_frames(measuring, {name: inspections[name] for name in measuring}, sample),
        *_disk(cost),
        *(seen.remarks if seen else ()),
        *late,
        *remark_on_recordings(experiment, series),
    ]
    if prepared:
        remarks.append(remark_on_rest(prepared.experiment, prepared.rig))
    return Check(
        experiment=experiment.name,
        path=experiment.path,
        steps=steps,
        frame_rate=experiment.frame_rate,
        cameras=cameras,
        rig=tuple(prepared.rig) if prepared else (),
        grid=prepared.grid if prepared else None,
        coverage=coverage,
        measured=measured,
        cost=cost,
        problems=tuple(problems),
        verdict=_verdict(remarks, seen),
        motion=prepared.motion.sentence if prepared and prepared.motion else "",
        heights=prepared.heights.sentence if prepared and prepared.heights else "",
        clocks=clock_text,
        advice=advice,
    )


def _verdict(remarks: list[Remark], seen: CameraFaults | None) -> Verdict | None:
    if seen:
        return Verdict.of(remarks, seen.cameras, seen.pairs, seen.frames)
    return Verdict.of(remarks) if remarks else None


def _disk(cost: Cost | None) -> Iterator[Remark]:
    if cost and cost.free < MIN_FREE_SHARE * cost.disk:
        yield Remark(
            "disk",
            "room",
            "remark",
            f"a run writes {spell_size(cost.disk)}, but only {spell_size(cost.free)} are free",
            f"{MIN_FREE_SHARE} times as much",
            "free some room or write elsewhere with -o",
            {"bytes": cost.disk, "free": cost.free},
        )


def _unusual_files(series: FrameSeries) -> list[int]:
    """Frames whose files are less than half as large as most, and some of other sizes than most."""
    sizes = {}
    for index, entry in enumerate(series.entries):
        if entry is not None and entry.kind == "file":
            try:
                sizes[index] = os.stat(entry.path).st_size
            except OSError:
                sizes[index] = 0
    if not sizes:
        return []
    size = np.array(list(sizes.values()))
    usual = float(np.median(size))
    apart = np.abs(size - usual)
    unusual = apart > max(_UNUSUAL_SIZE * usual, _UNUSUAL_SPREADS * float(np.median(apart)))
    largest_first = sorted(np.flatnonzero(unusual), key=lambda k: -apart[k])[:_MAX_UNUSUAL_READ]
    chosen = {*largest_first, *np.flatnonzero(size < usual / 2)}
    return [index for k, index in enumerate(sizes) if k in chosen]


def _summary(series: FrameSeries, found: FrameInspection, offset: int) -> CameraCheck:
    """What there is of one camera; frames are numbered as the run counts them."""
    missing = tuple(int(n) for n in series.missing)
    rows, columns = series.shape
    return CameraCheck(
        series.camera,
        len(series) - len(missing),
        (columns, rows),
        series.dtype,
        missing,
        small=found.numbers(series.first, FrameFault.UNREADABLE),
        blank=found.numbers(series.first, FrameFault.BLANK),
        other=found.numbers(series.first, FrameFault.WRONG_SIZE),
        beyond=series.beyond,
        offset=offset,
    )
