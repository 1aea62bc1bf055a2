"""Everything that a run needs, read and checked before it starts."""

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wavefield.errors import ExperimentError
from wavefield.execution.cluster import count_workers
from wavefield.execution.workflow import Workflow
from wavefield.grid import Grid
from wavefield.measurement.algorithm import ALGORITHM
from wavefield.measurement.search_range import (
    FirstGuess,
    FirstHeights,
    first_guess,
    first_heights,
    high_enough,
    wide_enough,
)
from wavefield.pipeline.experiment_of_cube import image_names
from wavefield.pipeline.magnitudes import (
    name_of_rig,
    refuse_fine_grids,
    refuse_high_water,
    refuse_implausible_rigs,
    refuse_unseen_grids,
)
from wavefield.quality.stabilized import refuse_unless_in_a_row
from wavefield.rig import Rig
from wavefield.sampling import evenly_spaced
from wavefield.series import Experiment, FrameSeries, masks, mean_images
from wavefield.series.clocks import frame_departures
from wavefield.store.recipe import Recipe
from wavefield.variables import CUBE_FIELDS, TABLE

if TYPE_CHECKING:
    from wavefield.measurement import GridGeometry, LearnedRecord, Model, Settings

SAMPLE_STEPS = 4  # steps over the record by which the range of displacements is found
MAX_CHUNK_STEPS = 100  # steps; a chunk costs one to two steps more for its five extra frames


@dataclass(frozen=True)
class PreparedRun:
    """Everything that a run needs before it starts."""

    experiment: Experiment  # The experiment
    series: Mapping[str, FrameSeries]  # Frames of the cameras that measure
    rig: Rig  # Those cameras
    grid: Grid  # The nodes
    geometry: "GridGeometry"  # What follows from them
    recipe: Recipe  # All of it as plain data
    workflow: Workflow  # How to process
    model: "Model | None" = None  # What was learned of the record
    # How far the water moves from frame to frame; None where the settings state the range to search
    motion: FirstGuess | None = None
    # Range of elevations and of the rise; None where the settings state ``z_range``
    heights: FirstHeights | None = None
    # (n,): of the frames from even times, intervals, by the cameras' clocks; None where these are even
    departures: np.ndarray | None = None

    def with_prior(self, record: Mapping[str, object]) -> "PreparedRun":
        """The same run with the record that was learned from sample frames."""
        from wavefield.measurement import LearnedRecord, Model

        model = Model(self.geometry, LearnedRecord.from_dict(record)) if record else self.model
        return replace(self, model=model, recipe=replace(self.recipe, record=record))

    @property
    def record(self) -> "LearnedRecord | None":
        """The record that was learned from sample frames; None before."""
        return None if self.model is None else self.model.record

    @property
    def steps(self) -> int:
        """Number of steps of the whole run."""
        return len(next(iter(self.series.values()))) - 1

    @property
    def first_frame(self) -> int:
        """Number of the first frame."""
        return next(iter(self.series.values())).first

    @property
    def step_bytes(self) -> int:
        """Bytes of the results of one step."""
        return int(self.geometry.x.size) * sum(np.dtype(TABLE[name].dtype).itemsize for name in CUBE_FIELDS)

    @property
    def chunk_steps(self) -> int:
        """Steps per chunk of a new store."""
        workflow = self.workflow
        chunk = workflow.steps_per_block or choose_chunk_steps(
            self.steps, count_workers(workflow), self.step_bytes, workflow.memory_bytes
        )
        return min(chunk, self.steps)


def prepare(
    experiment: str | Path | Experiment,
    rig: str | Path | Rig | None = None,
    workflow: str | Path | Workflow | None = None,
) -> PreparedRun:
    """Read and check everything that a run needs."""
    from wavefield.measurement import GridGeometry

    experiment, workflow = load_files(experiment, workflow)
    series = experiment.open_frames()
    rig_file = name_of_rig(experiment, rig)
    if not isinstance(rig, Rig):
        rig = experiment.load_rig(rig, series)
    used = {name: rig[name] for name in experiment.measuring_cameras}
    rig = replace(rig, cameras=used)
    refuse_implausible_rigs(experiment, rig, rig_file)
    settings = make_settings(experiment, workflow)
    try:
        grid = experiment.choose_grid(rig, {**experiment.settings, **workflow.settings})
    except ValueError as error:  # a step that does not fit what the cameras see
        raise ExperimentError(f"{experiment.path}: {error}") from None
    refuse_fine_grids(experiment, rig, grid, rig_file)
    refuse_unseen_grids(experiment, rig, grid)
    refuse_high_water(
        settings, rig, str(workflow.path if "z_range" in workflow.settings else experiment.path)
    )
    series = {name: series[name] for name in used}
    covered = masks.footprints(experiment.mask)
    geometry = GridGeometry(rig, grid, settings, covered)
    if settings.vibration == "correct":
        refuse_unless_in_a_row(geometry)
    bare, folder = series, experiment.path.parent
    series = masks.covered_series(experiment.mask, bare, rig, folder, -geometry.z_range[0])
    look = _SampleImages(series, geometry)
    motion, heights = None, None
    if not _states_search(experiment, workflow):
        motion = first_guess(look.read, geometry.velocity_cameras, look.steps)
        settings = wide_enough(settings, motion)
    if settings.z_range is None:
        settings, heights = high_enough(settings, first_heights(look.read, geometry, look.steps))
    if settings != geometry.settings:
        geometry = GridGeometry(rig, grid, settings, covered)
        series = masks.covered_series(experiment.mask, bare, rig, folder, -geometry.z_range[0])
    departures = frame_departures(series, experiment.frame_rate)
    recipe = make_recipe(experiment, series, geometry, workflow.packing)
    if departures is not None:
        digest = hashlib.sha256(departures.astype("<f8").tobytes()).hexdigest()[:16]
        recipe = replace(recipe, departures={"sha256": digest})
    return PreparedRun(
        experiment, series, rig, grid, geometry, recipe, workflow, None, motion, heights, departures
    )


def _states_search(experiment: Experiment, workflow: Workflow) -> bool:
    """Whether the settings give the range of displacements to search."""
    stated = (source.settings.get("piv") for source in (experiment, workflow))
    return any(isinstance(piv, Mapping) and {"search_x", "search_y"} & set(piv) for piv in stated)


class _SampleImages:
    """Images of sample steps, filtered as they are for matching."""

    def __init__(self, series: Mapping[str, FrameSeries], geometry: "GridGeometry") -> None:
        self.series, self.geometry = series, geometry
        count = min(len(series[name]) for name in geometry.cameras) - 1
        self.steps = evenly_spaced(count, SAMPLE_STEPS)
        self._widths: dict[str, float] = {}  # of the beads, measured in the first image of a camera
        # images of the sample steps: both motion and elevation are found in them
        self._shared: dict[tuple[str, int], np.ndarray | None] = {}

    def read(self, name: str, frame: int) -> np.ndarray | None:
        """Image of a camera; None where there is none that can be used."""
        if frame not in self.steps:
            return self._read(name, frame)
        if (name, frame) not in self._shared:
            self._shared[name, frame] = self._read(name, frame)
        return self._shared[name, frame]

    def _read(self, name: str, frame: int) -> np.ndarray | None:
        from wavefield.measurement.images import bead_width, ready, usable

        image = self.series[name].read_uncovered(frame)
        if not usable(image, self.geometry.rig[name].size):
            return None
        if name not in self._widths:
            self._widths[name] = bead_width(np.asarray(image))
        return ready(np.asarray(image), self.geometry.sights[name].binning, self._widths[name])


def load_files(
    experiment: str | Path | Experiment, workflow: str | Path | Workflow | None
) -> tuple[Experiment, Workflow]:
    """Read the experiment and workflow files, unless they are read already."""
    if not isinstance(experiment, Experiment):
        experiment = Experiment.load(experiment)
    if not isinstance(workflow, Workflow):
        workflow = Workflow() if workflow is None else Workflow.load(workflow)
    return experiment, workflow


def make_recipe(
    experiment: Experiment, series: Mapping[str, FrameSeries], geometry: "GridGeometry", packing: str
) -> Recipe:
    """Collect the recipe of a run."""
    one = next(iter(series.values()))
    return Recipe(
        experiment=experiment.name,
        images={name: image_names(experiment, name) for name in series},
        frames=(one.first, one.first + len(one) - 1),
        frame_rate=experiment.frame_rate,
        grid=asdict(geometry.grid),
        rig={name: geometry.rig[name].to_dict() for name in series},
        settings=geometry.settings.to_dict(),
        packing=packing,
        mask=masks.as_data(experiment.mask, experiment.path.parent),
        background=mean_images.checksums(series),
        algorithm=ALGORITHM,
    )


def make_settings(experiment: Experiment, workflow: Workflow) -> "Settings":
    """Measurement settings: defaults, then those of the experiment, then those of the workflow."""
    from wavefield.measurement.settings import Settings

    for source in (experiment, workflow):  # each by itself: only then is the place of an error known
        Settings.from_dict(source.settings, source.path)
    data: dict[str, Any] = {}
    if experiment.surface:
        data["pairs"] = experiment.surface.pairs
    if experiment.velocity:
        data["velocity_cameras"] = experiment.velocity.cameras
    row_times = {name: camera.row_time for name, camera in experiment.cameras.items() if camera.row_time}
    if row_times:
        data["row_delays"] = [(name, time * experiment.frame_rate) for name, time in row_times.items()]
    for name, value in (*experiment.settings.items(), *workflow.settings.items()):
        nested = isinstance(value, Mapping) and isinstance(data.get(name), Mapping)
        data[name] = {**data[name], **value} if nested else value
    return Settings.from_dict(data)


def choose_chunk_steps(steps: int, workers: int, step_bytes: int, memory: int | None) -> int:
    """Steps per chunk: long enough that its five extra frames do not matter, short enough for memory."""
    # results, their stack and their compressed copy are there at once; half the memory is for the measurement
    room = int((memory or 1_500_000_000) // 2 // (4 * step_bytes))
    longest = max(1, min(MAX_CHUNK_STEPS, room))
    rounds = -(-steps // (workers * longest))
    return max(1, min(longest, -(-steps // (workers * rounds))))
