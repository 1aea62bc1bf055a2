"""Read and check what a run needs before it starts: frames, rig, grid, settings, search ranges.

Rigs, grids and search ranges that cannot be in metres are refused.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wavefield.errors import ExperimentError, RigError
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
from wavefield.pipeline.opened_run import image_names
from wavefield.quality.remarks import MIN_COVERAGE
from wavefield.rig import Rig
from wavefield.rig.field import common_field
from wavefield.sampling import evenly_spaced
from wavefield.series import Experiment, FrameSeries, masks, mean_images
from wavefield.series.clocks import frame_departures
from wavefield.store.recipe import Recipe
from wavefield.variables import CUBE_FIELDS, TABLE

if TYPE_CHECKING:
    from wavefield.measurement import GridGeometry, LearnedRecord, Model, Settings

_CAMERA_DISTANCES = (0.02, 200.0)  # m from the water: a macro lens, and a platform at sea
_MIN_BLOCKS = 21  # along the longer side of what is matched
_MAX_ELEVATION_SHARE = 0.5  # of the distance of the nearest camera
_MAX_THICKNESS_SHARE = 0.05  # of that distance, for beads and light sheets


def refuse_implausible_rigs(experiment: Experiment, rig: Rig, rig_file: str) -> None:
    """Refuse cameras at distances that cannot be metres, and cameras under water."""
    refuse_own_frame(rig, rig_file)
    distance = float(np.median(_distances(rig)))
    low, high = _CAMERA_DISTANCES
    if not low <= distance <= high:
        raise RigError(
            f"{rig_file}: its cameras are {distance:.3g} m away from the water; are its lengths in metres? "
            "`wavefield rig convert FILE --unit UNIT` converts another program's"
        )
    level = experiment.water.level
    under = [name for name, camera in rig.cameras.items() if camera.centre[2] <= 0 < camera.centre[2] + level]
    if under:
        raise ExperimentError(
            f"{experiment.path}: water.level of {level:g} m is above {', '.join(under)}; it is in metres"
        )


def refuse_own_frame(rig: Rig, rig_file: str) -> None:
    """Refuse a rig in the frame of one of its cameras, where z = 0 is not the water."""
    if rig.lenses_alone:
        raise RigError(
            f"{rig_file} contains lenses and no positions of the cameras; two at sea are placed by "
            "`wavefield rig level EXPERIMENT --distance METRES -o rig.yaml`, with the distance between them"
        )
    for name, camera in rig.cameras.items():
        if np.allclose(camera.centre, 0.0, atol=1e-9):
            raise RigError(
                f"{rig_file} is in the frame of {name} itself, in which z = 0 is not the water; level it "
                "with `wavefield rig level EXPERIMENT --rig RIG -o rig.yaml`, or by a seeded record at "
                "rest with `wavefield refine`"
            )


def expected_coverage(rig: Rig, grid: Grid) -> float:
    """Share of the grid that every camera sees at rest."""
    x, y = np.linspace(*grid.x), np.linspace(*grid.y)[:, None]  # enough of the nodes
    visible = np.ones((y.size, x.size), bool)
    with np.errstate(all="ignore"):  # a grid in another unit may be anywhere
        for name in rig:
            visible &= rig[name].sees(x, y, 0.0)
    return float(visible.mean())


def refuse_unseen_grids(experiment: Experiment, rig: Rig, grid: Grid) -> None:
    """Refuse a grid that the cameras hardly see."""
    share = expected_coverage(rig, grid)
    if share >= MIN_COVERAGE:
        return
    try:
        seen = common_field(rig.cameras.values())
        (x0, x1), (y0, y1) = seen.x, seen.y
        found = f"the cameras see {{x: [{x0:g}, {x1:g}], y: [{y0:g}, {y1:g}]}}; or leave it out"
    except RigError as error:
        found = f"correct it or the rig: {error}"
    raise ExperimentError(
        f"{experiment.path}: the cameras have {100 * share:.2g} % of the grid in common view "
        f"(x {grid.x[0]:g} to {grid.x[1]:g} m, y {grid.y[0]:g} to {grid.y[1]:g} m); `grid` is in metres: "
        f"{found}"
    )


def refuse_high_water(settings: "Settings", rig: Rig, source: str) -> None:
    """Refuse elevations that come near the cameras, and beads or sheets too thick to be in metres."""
    distance = min(_distances(rig))
    for name, value, share in (
        ("z_range", settings.z_range, _MAX_ELEVATION_SHARE),
        ("bead_height", settings.bead_height, _MAX_THICKNESS_SHARE),
        ("sheet_thickness", settings.sheet_thickness, _MAX_THICKNESS_SHARE),
    ):
        largest = float(np.abs(value or 0.0).max())
        if largest > share * distance:
            raise ExperimentError(
                f"{source}: settings.{name} of {largest:g} m does not fit below cameras that are "
                f"{distance:.2g} m away from the water; it is in metres"
            )


def refuse_small_fields(geometry: "GridGeometry", source: str) -> None:
    """Refuse a field with too few blocks of pixels for a spectrum."""
    shapes = {"the grid": geometry.lattice.shape}
    shapes |= {f"what {name} sees of the grid": s.lattice.shape for name, s in geometry.sights.items()}
    for name, (rows, columns) in shapes.items():
        if max(rows, columns) < _MIN_BLOCKS:
            raise ExperimentError(
                f"{source}: {name} is too small: {columns} x {rows} blocks of pixels are matched, but "
                f"{_MIN_BLOCKS} along the longer side are needed; enlarge `grid`, or leave it out"
            )


def name_of_rig(experiment: Experiment, rig: str | Path | Rig | None) -> str:
    """What to call a rig in a message."""
    if isinstance(rig, Rig):
        return "the rig"
    named = experiment.rig if rig is None else rig
    if isinstance(named, dict):
        return ", ".join(dict.fromkeys(named.values()))
    return str(rig) if rig is not None else str(experiment.resolve(named or "rig.yaml"))


def _distances(rig: Rig) -> list[float]:
    """Distance of each camera from the water in the middle of its image, metres."""
    distances = []
    for camera in rig.cameras.values():
        x, y = (float(v) for v in camera.unproject(*(0.5 * (n - 1) for n in camera.size)))
        level = np.isfinite(x + y)  # else the middle of the image is above the horizon
        below = (x, y, 0.0) if level else (*camera.centre[:2], 0.0)
        distances.append(float(np.linalg.norm(np.subtract(camera.centre, below))))
    return distances


# -- the run

SAMPLE_STEPS = 4  # over the record, in which search ranges are found and cameras are compared
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
    from wavefield.measurement.stabilize import refuse_unless_in_a_row

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
    refuse_unseen_grids(experiment, rig, grid)
    refuse_high_water(
        settings, rig, str(workflow.path if "z_range" in workflow.settings else experiment.path)
    )
    series = {name: series[name] for name in used}
    covered = masks.footprints(experiment.mask)
    geometry = GridGeometry(rig, grid, settings, covered)
    if settings.vibration == "correct":
        refuse_unless_in_a_row(geometry)
    series = masks.covered_series(experiment.mask, series, rig, experiment.path.parent)
    look = _SampleImages(series, geometry)
    motion, heights = None, None
    if not _states_search(experiment, workflow):
        motion = first_guess(look.read, geometry.velocity_cameras, look.steps)
        settings = wide_enough(settings, motion)
    if settings.z_range is None:
        settings, heights = high_enough(settings, first_heights(look.read, geometry, look.steps))
    if settings != geometry.settings:
        geometry = GridGeometry(rig, grid, settings, covered)
    departures = frame_departures(series)
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
