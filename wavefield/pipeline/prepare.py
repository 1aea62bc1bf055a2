"""Read and check frames, rig, grid and settings before a run, and estimate search ranges.

Rigs, grids and elevations whose values cannot be metres raise errors.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wavefield.errors import ExperimentError, RigError
from wavefield.execution.cluster import count_workers
from wavefield.execution.workflow import Workflow
from wavefield.grid import Grid
from wavefield.measurement.search_range import (
    FirstGuess,
    FirstHeights,
    first_guess,
    first_heights,
    high_enough,
    wide_enough,
)
from wavefield.measurement.step import ALGORITHM
from wavefield.pipeline.opened_run import image_names
from wavefield.rig import Rig
from wavefield.rig.field import common_field
from wavefield.sampling import evenly_spaced
from wavefield.series import Experiment, FrameSeries, backgrounds, masks
from wavefield.series.clocks import frame_departures
from wavefield.store.recipe import Recipe
from wavefield.variables import CUBE_FIELDS, TABLE

if TYPE_CHECKING:
    from wavefield.measurement import GridGeometry, Model, Settings
    from wavefield.measurement.model import LearnedRecord

_CAMERA_DISTANCES = (0.02, 200.0)  # m from the water: from a macro lens to a platform at sea
_MIN_BLOCKS = 21  # interrogation blocks along the longer side of the field, for a spectrum
_MIN_COVERAGE = 0.05  # fraction of the grid in common view; with less, its unit is wrong
_MAX_ELEVATION_FRACTION = 0.5  # elevations, as a fraction of the distance of the nearest camera
_MAX_THICKNESS_FRACTION = 0.05  # beads and light sheets, as a fraction of that distance


def refuse_implausible_rigs(experiment: Experiment, rig: Rig, rig_file: str) -> None:
    """Raise an error if the lengths in a rig are not in metres, or if `water.level` is above a camera.
    Lengths count as metres if the median distance between cameras and water is 0.02 to 200. ``rig_file``
    is the name of the rig in messages. Also raises the errors of `refuse_own_frame`."""
    refuse_own_frame(rig, rig_file)
    distance = float(np.median(_distances(rig)))
    if not _CAMERA_DISTANCES[0] <= distance <= _CAMERA_DISTANCES[1]:
        raise RigError(
            f"{rig_file}: its cameras are {distance:.3g} m away from the water; lengths must be in metres "
            "(`wavefield rig convert FILE --unit UNIT` converts the rig file of another program)"
        )
    level = experiment.water.level
    under = [name for name, camera in rig.cameras.items() if camera.centre[2] <= 0 < camera.centre[2] + level]
    if under:
        raise ExperimentError(
            f"{experiment.path}: water.level of {level:g} m is above {', '.join(under)}; it is in metres"
        )


def refuse_own_frame(rig: Rig, rig_file: str) -> None:
    """Raise RigError if a rig has no camera positions, or if a camera is at the origin of the coordinates.
    In such coordinates z = 0 is not the water. ``rig_file`` is the name of the rig in messages."""
    if rig.lenses_alone:
        raise RigError(
            f"{rig_file} contains lenses but no camera positions; for two cameras at sea, "
            "`wavefield rig level EXPERIMENT --distance METRES -o rig.yaml` finds them from the distance "
            "between the cameras"
        )
    for name, camera in rig.cameras.items():
        if np.allclose(camera.centre, 0.0, atol=1e-9):
            raise RigError(
                f"{rig_file} is in the coordinate system of {name}, in which z = 0 is not the water; level "
                "it with `wavefield rig level EXPERIMENT --rig RIG -o rig.yaml`, or with a still-water "
                "record and `wavefield refine`"
            )


def expected_coverage(rig: Rig, grid: Grid) -> float:
    """Return the fraction of the grid that all cameras see when the water is at rest."""
    x, y = np.linspace(*grid.x), np.linspace(*grid.y)[:, None]  # 50 x 50 points are enough
    visible = np.ones((y.size, x.size), bool)
    with np.errstate(all="ignore"):  # a grid in another unit may reach behind the cameras
        for name in rig:
            visible &= rig[name].sees(x, y, 0.0)
    return float(visible.mean())


def refuse_unseen_grids(experiment: Experiment, rig: Rig, grid: Grid) -> None:
    """Raise ExperimentError if the area that all cameras see is less than 5 % of the grid."""
    fraction = expected_coverage(rig, grid)
    if fraction >= _MIN_COVERAGE:
        return
    field = common_field(rig.cameras.values())
    (x0, x1), (y0, y1) = field.x, field.y
    raise ExperimentError(
        f"{experiment.path}: the cameras have {100 * fraction:.2g} % of the grid in common view "
        f"(x {grid.x[0]:g} to {grid.x[1]:g} m, y {grid.y[0]:g} to {grid.y[1]:g} m); `grid` is in metres: "
        f"the cameras see {{x: [{x0:g}, {x1:g}], y: [{y0:g}, {y1:g}]}}; or leave it out"
    )


def refuse_high_water(settings: "Settings", rig: Rig, source: Path | None) -> None:
    """Raise ExperimentError if a length in the settings is too large for cameras so near to the water.
    The lengths are z_range, bead_height and sheet_thickness. ``source`` is the file of the settings."""
    distance = min(_distances(rig))
    for name, value, fraction in (
        ("z_range", settings.z_range, _MAX_ELEVATION_FRACTION),
        ("bead_height", settings.bead_height, _MAX_THICKNESS_FRACTION),
        ("sheet_thickness", settings.sheet_thickness, _MAX_THICKNESS_FRACTION),
    ):
        largest = float(np.abs(value or 0.0).max())
        if largest > fraction * distance:
            raise ExperimentError(
                f"{source}: settings.{name} of {largest:g} m does not fit below cameras that are "
                f"{distance:.2g} m away from the water; it is in metres"
            )


def refuse_small_fields(geometry: "GridGeometry", source: Path) -> None:
    """Raise ExperimentError if the grid, or the part that a camera sees, is too small for a wave spectrum.
    ``source`` is the experiment file."""
    shapes = {"the grid": geometry.lattice.shape}
    shapes |= {f"the part that {name} sees": s.lattice.shape for name, s in geometry.sights.items()}
    for name, (rows, columns) in shapes.items():
        if max(rows, columns) < _MIN_BLOCKS:
            raise ExperimentError(
                f"{source}: {name} is too small: it has {columns} x {rows} interrogation blocks, but "
                f"{_MIN_BLOCKS} along the longer side are needed; enlarge `grid`, or leave it out"
            )


def _distances(rig: Rig) -> list[float]:
    """Return the distance between each camera and the water, m, along the sight line of the image centre.
    For a line that does not meet the water, it is the height of the camera."""
    distances = []
    for camera in rig.cameras.values():
        x, y = (float(v) for v in camera.unproject(*(0.5 * (n - 1) for n in camera.size)))
        if not np.isfinite(x + y):  # the image centre is above the horizon
            x, y = camera.centre[:2]
        distances.append(float(np.linalg.norm(np.subtract(camera.centre, (x, y, 0.0)))))
    return distances


# -- the run

SAMPLE_STEPS = 4  # steps of the record from which search ranges are found and cameras are compared
MAX_CHUNK_STEPS = 100  # the five extra frames of a chunk cost as much as one or two steps, so 1 to 2 %


@dataclass(frozen=True)
class PreparedRun:
    """All inputs of a run, read and checked: the result of `prepare`."""

    experiment: Experiment  # The experiment
    series: Mapping[str, FrameSeries]  # Frames of the measuring cameras
    rig: Rig  # The measuring cameras
    grid: Grid  # Nodes of the cube
    geometry: "GridGeometry"  # Blocks, sight lines and search ranges, computed from rig, grid and settings
    recipe: Recipe  # Record of all inputs that determine the values of the cube, as plain data
    workflow: Workflow  # Cluster, chunks and settings of the run
    model: "Model | None" = None  # Estimator with bead widths, spectra and noise; None before learning
    motion: FirstGuess | None = None  # Displacement between frames; None if its search range is given
    heights: FirstHeights | None = None  # Range of elevations; None if `z_range` is given
    # (frames,): delay of each frame relative to even times, in frame intervals; None if times are even
    departures: np.ndarray | None = None

    def with_prior(self, record: Mapping[str, object]) -> "PreparedRun":
        """Return the same run with an estimator (model) that uses ``record``, the result of `learn_record`.
        If the record is empty, the estimator is not changed."""
        from wavefield.measurement import Model
        from wavefield.measurement.model import LearnedRecord

        model = Model(self.geometry, LearnedRecord.from_dict(record)) if record else self.model
        return replace(self, model=model, recipe=replace(self.recipe, record=record))

    @property
    def record(self) -> "LearnedRecord | None":
        """What was learned from sample frames: bead widths, wave spectra, noise; None before learning."""
        return None if self.model is None else self.model.record

    def read_uncovered(self, name: str, frame: int) -> Any:
        """Return the image of the camera ``name`` at an index in the record, with masked pixels filled.
        None if the image is missing or bad."""
        return self.series[name].read_uncovered(frame)

    @property
    def frame_rate(self) -> float:
        """Frames per second, Hz."""
        return self.experiment.frame_rate

    @property
    def in_light_sheet(self) -> bool:
        """True if particles in a light sheet are measured, False for beads on the water surface."""
        return self.geometry.z_is_known

    @property
    def steps(self) -> int:
        """Number of steps of the record: one less than its frames."""
        return len(next(iter(self.series.values()))) - 1

    @property
    def first_frame(self) -> int:
        """Number of the first frame of the record: number of its file plus `offset` of the camera."""
        return next(iter(self.series.values())).first

    @property
    def step_bytes(self) -> int:
        """Size of the results of one step in memory, in bytes."""
        return int(self.geometry.x.size) * sum(np.dtype(TABLE[name].dtype).itemsize for name in CUBE_FIELDS)

    @property
    def chunk_steps(self) -> int:
        """Number of steps per chunk of a new store: that of the workflow, if given.
        Otherwise a chunk fits into the memory of a worker, and all workers have about equal work."""
        workers, memory = count_workers(self.workflow), self.workflow.memory_bytes
        # half of the memory is for the results: as measured, stacked and compressed, with some reserve
        fitting = int((memory or 1_500_000_000) // 2 // (4 * self.step_bytes))
        longest = max(1, min(MAX_CHUNK_STEPS, fitting))
        rounds = -(-self.steps // (workers * longest))
        chosen = self.workflow.steps_per_block or min(longest, -(-self.steps // (workers * rounds)))
        return max(1, min(chosen, self.steps))


def prepare(
    experiment: str | Path | Experiment,
    rig: str | Path | Rig | None = None,
    workflow: str | Path | Workflow | None = None,
) -> PreparedRun:
    """Read and check the inputs of a run, and estimate search ranges that the settings do not give.
    ``rig`` replaces the rig that the experiment names. ExperimentError or RigError if an input is wrong."""
    from wavefield.measurement import GridGeometry

    experiment, workflow = load_files(experiment, workflow)
    series = experiment.open_frames()
    rig_file = "the rig" if isinstance(rig, Rig) else str(rig or experiment.rig or "rig.yaml")
    if not isinstance(rig, Rig):
        rig = experiment.load_rig(rig, series)
    rig = replace(rig, cameras={name: rig[name] for name in experiment.measuring_cameras})
    refuse_implausible_rigs(experiment, rig, rig_file)
    settings = make_settings(experiment, workflow)
    try:
        grid = experiment.choose_grid(rig, {**experiment.settings, **workflow.settings})
    except ValueError as error:  # the node spacing is too large for the field of the cameras
        raise ExperimentError(f"{experiment.path}: {error}") from None
    refuse_unseen_grids(experiment, rig, grid)
    refuse_high_water(settings, rig, workflow.path if "z_range" in workflow.settings else experiment.path)
    covered = masks.footprints(experiment.mask)
    geometry = GridGeometry(rig, grid, settings, covered)
    series = {name: series[name] for name in rig}
    series = masks.covered_series(experiment.mask, series, rig, experiment.path.parent)
    steps = evenly_spaced(len(next(iter(series.values()))) - 1, SAMPLE_STEPS)
    read = _sample_reader(series, geometry, steps)
    motion, heights = None, None
    given = (source.settings.get("piv") for source in (experiment, workflow))
    if not any(isinstance(piv, Mapping) and {"search_x", "search_y"} & set(piv) for piv in given):
        motion = first_guess(read, geometry.velocity_cameras, steps)
        settings = wide_enough(settings, motion)
    if settings.z_range is None:
        settings, heights = high_enough(settings, first_heights(read, geometry, steps))
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


def _sample_reader(
    series: Mapping[str, FrameSeries], geometry: "GridGeometry", steps: Sequence[int]
) -> Callable[[str, int], np.ndarray | None]:
    """Return a function that reads the image of a camera at an index, filtered as for the measurement.
    It returns None if the image is missing or bad. Images at ``steps`` are kept in memory, because the
    estimates of motion and elevation share them."""
    from wavefield.measurement.images import bead_width, ready, usable

    widths: dict[str, float] = {}  # width of beads, px, measured in each camera's first image
    kept: dict[tuple[str, int], np.ndarray | None] = {}

    def read(name: str, frame: int) -> np.ndarray | None:
        if (name, frame) in kept:
            return kept[name, frame]
        image, flat = series[name].read_uncovered(frame), None
        if usable(image, geometry.rig[name].size):
            if name not in widths:
                widths[name] = bead_width(np.asarray(image))
            flat = ready(np.asarray(image), geometry.sights[name].binning, widths[name])
        if frame in steps:
            kept[name, frame] = flat
        return flat

    return read


def level_at_rest(
    experiment: Experiment,
    rig: str | Path | Rig | None = None,
    frames: int = 10,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Rig, str]:
    """Correct a rig with images of still, seeded water, and level it so that z = 0 is the water.
    ``rig`` replaces the rig of the experiment, and ``frames`` is the number of frames that are matched.
    ``progress`` is called with the numbers of frames done and of all frames. Returns the corrected rig, and
    a text on the errors of the given rig and on the plane of the water in that rig's coordinates."""
    from wavefield.calibration.still_water import refine_and_level
    from wavefield.measurement.elevation import matched_pixels

    prepared = prepare(experiment, rig)
    sample = evenly_spaced(prepared.steps + 1, frames)
    matches = matched_pixels(
        lambda camera, frame: prepared.series[camera].read(frame).image, sample, prepared.geometry, progress
    )
    levelled, found, plane = refine_and_level(prepared.rig, matches)
    return levelled, (
        f"{found.sentence}\n"
        f"The water's plane: {1e3 * plane.height:+.3f} mm at the origin, slope {1e3 * plane.slope[0]:+.3f}, "
        f"{1e3 * plane.slope[1]:+.3f} mrad along x, y; rms about it {1e3 * plane.rms:.3f} mm."
    )


def load_files(
    experiment: str | Path | Experiment, workflow: str | Path | Workflow | None
) -> tuple[Experiment, Workflow]:
    """Return the experiment and the workflow, which are read if they are given as files.
    The default workflow uses the processes of this machine."""
    if not isinstance(experiment, Experiment):
        experiment = Experiment.load(experiment)
    if not isinstance(workflow, Workflow):
        workflow = Workflow() if workflow is None else Workflow.load(workflow)
    return experiment, workflow


def make_recipe(
    experiment: Experiment, series: Mapping[str, FrameSeries], geometry: "GridGeometry", packing: str
) -> Recipe:
    """Return the recipe of a run, the record of all inputs that determine the values of the cube.
    ``packing`` is the type of stored values, such as "float32"."""
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
        background=backgrounds.checksums(series),
        algorithm=ALGORITHM,
    )


def make_settings(experiment: Experiment, workflow: Workflow) -> "Settings":
    """Return the settings of the measurement: each from the workflow, else the experiment, else its default.
    Camera pairs, cameras that measure velocity, and delays of image rows have their own keys in the file of
    the experiment."""
    from wavefield.measurement.settings import Settings

    for source in (experiment, workflow):  # checked one by one, so that errors name the right file
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
