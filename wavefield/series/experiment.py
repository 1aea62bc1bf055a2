"""The experiment file: one YAML file with cameras, images, rig, grid, water and settings."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PrivateAttr, model_validator

from wavefield.config_files import PathText, load, read_yaml
from wavefield.errors import ExperimentError, RigError
from wavefield.grid import Grid
from wavefield.rig import Rig
from wavefield.rig.field import common_field
from wavefield.rig.formats import load_rig
from wavefield.rig.water_level import with_water_level
from wavefield.series import masks
from wavefield.series.backgrounds import with_backgrounds
from wavefield.series.clocks import one_rate, stated_by_recordings
from wavefield.series.experiment_parts import (
    CalibrationSection,
    CameraSection,
    FramesSection,
    GridSection,
    ProbesSection,
    RecordSection,
    SurfaceSection,
    VelocitySection,
    WaterSection,
)
from wavefield.series.frames import FrameSeries
from wavefield.series.probes import read_probes
from wavefield.series.record import open_record
from wavefield.text import html_table

SAME_PLACE = 1e-4  # distance between two cameras over one's distance from the origin; below, no parallax


class Experiment(RecordSection):
    """An experiment: cameras, rig, grid, and the properties of the water; read one with `Experiment.load`.

    Relative paths in an experiment file start from the folder of the file. Relative paths of images start
    from ``folder`` if the file gives it.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "experiment.yaml"
    >>> _ = path.write_text('''
    ... name: basin
    ... frame_rate: 20.0
    ... cameras: {cam1: "cam1/{frame:05d}.tif", cam2: "cam2/{frame:05d}.tif"}
    ... velocity: {cameras: [cam1, cam2]}
    ... ''')
    >>> Experiment.load(path).frame_rate
    20.0
    """

    calibration: CalibrationSection | None = None
    rest: PathText | dict[str, PathText] | None = Field(
        default=None,
        examples=['"rest/{camera}/img_{frame:05d}.tif"'],
        description="images of still water, to correct and level the rig",
    )
    rig: PathText | dict[str, PathText] | None = Field(
        default=None,
        examples=["rig.yaml"],
        description="rig file, of wavefield or another program",
    )
    surface: SurfaceSection | None = None
    velocity: VelocitySection | None = None
    grid: GridSection | Literal["auto"] = Field(
        default="auto", examples=["{x: [-1.0, 1.0], y: [-0.75, 0.75], step: 0.01}"]
    )
    water: WaterSection = WaterSection()
    background: PathText | dict[str, PathText] | None = Field(
        default=None,
        examples=['"background/{camera}.tif"'],
        description="images to subtract from the frames (`wavefield background`)",
    )
    mask: dict[str, list[masks.MaskSection]] = Field(
        default_factory=dict,
        examples=["{cam1: masks/cam1.png, water: {polygon: [[-0.1, 0], [0.1, 0], [0, 0.1]]}}"],
        description="areas that are not water; see Masks",
    )
    probes: ProbesSection | None = Field(default=None, examples=["probes.csv"])
    smooth: bool = Field(default=False, description="write `smooth.zarr` after each run")
    settings: dict[str, Any] = Field(
        default_factory=dict, description="measurement settings that differ from the defaults; see below"
    )

    _path: Path = PrivateAttr(default=Path("experiment.yaml"))

    def __repr__(self) -> str:
        return f"Experiment({self.name!r}, {', '.join(self.cameras)}, {self.frame_rate:g} Hz)"

    def _repr_html_(self) -> str:
        grid = "auto"
        if isinstance(self.grid, GridSection) and self.grid.x is not None:
            grid = f"x {self.grid.x} m, y {self.grid.y} m, step {self.grid.step:g} m"
        depth = self.water.depth
        rows: list[tuple[str, object]] = [
            ("file", self._path),
            ("frame rate", f"{self.frame_rate:g} Hz"),
            *((name, str(one.images)) for name, one in self.cameras.items()),
            ("rig", ", ".join(path.name for path in self.rig_paths)),
            ("grid", grid),
            ("water depth", "not given: deep water" if depth is None else f"{depth:g} m"),
        ]
        if self.probes:
            rows.append(("probes", self.probes.file))
        return html_table(f"Experiment {self.name}", [], rows)

    @model_validator(mode="before")
    @classmethod
    def _masks_written_out(cls, data: object) -> object:
        if isinstance(data, Mapping) and isinstance(data.get("cameras"), Mapping) and "mask" in data:
            return {**data, "mask": masks.normalized(data["mask"], data["cameras"])}
        return data

    @model_validator(mode="after")
    def _cameras_exist(self) -> "Experiment":
        cameras = ", ".join(self.cameras)
        for a, b in self.surface.pairs if self.surface else ():
            for name in (a, b):
                if name not in self.cameras:
                    raise ValueError(f"surface.pairs names {name!r}, but the cameras are {cameras}")
            if a == b:
                raise ValueError(f"surface.pairs pairs {a!r} with itself")
        unknown = set(self.velocity.cameras if self.velocity else ()) - set(self.cameras)
        if unknown:
            raise ValueError(f"velocity.cameras names {min(unknown)!r}, but the cameras are {cameras}")
        if any(shape.image for shape in self.mask.get(masks.WATER, ())):
            raise ValueError("mask: an image belongs to a camera; on the water give a polygon")
        first, last = self.frames.first, self.frames.last
        if first is not None and last is not None and last <= first:
            raise ValueError(f"frames runs from {first} to {last}; a step needs two frames")
        return self

    @classmethod
    def load(cls, path: str | Path, folder: str | Path | None = None) -> "Experiment":
        """Read and check an experiment file; `folder` replaces the image folder that the file names.
        ExperimentError if the file is missing or wrong, or if recordings have different frame rates; the
        message names the line and the remedy."""
        path = Path(str(path).removeprefix("file://")).absolute()
        path = path.resolve() if path.is_symlink() else path  # files are named relative to the file itself
        data = read_yaml(path)
        if folder:
            data["folder"] = str(Path(str(folder).removeprefix("file://")).absolute())
        if data.get("frame_rate") is None and isinstance(data.get("cameras"), Mapping):
            images = path.parent / (data.get("folder") or "")
            stated = stated_by_recordings(data["cameras"], images)
            rates = {name: one.rate for name, one in stated.items() if one.rate}
            recorded = {name: rate for name, rate in rates.items() if not stated[name].is_video}
            rate = one_rate(recorded or rates, path)
            data |= {} if rate is None else {"frame_rate": rate}
        out = load(cls, path, data)
        out._path = path
        return out

    @property
    def path(self) -> Path:
        """The file that this experiment was read from."""
        return self._path

    @property
    def image_folder(self) -> Path:
        """Folder from which relative paths of images start."""
        return self._path.parent / (self.folder or "")

    def resolve(self, name: str | Path) -> Path:
        """Return the path of a file named in the experiment file; ``{folder}`` in it is the image folder."""
        return self._path.parent / str(name).replace("{folder}", str(self.image_folder))

    def at_rest(self) -> "Experiment":
        """Return an experiment with the same cameras, but with the images of still water (key ``rest``).
        ExperimentError if the file names no such images, or none for one of the measuring cameras."""
        if not self.rest:
            raise ExperimentError(f"{self.path} names no record at rest; add `rest:` with its images")
        patterns = self.rest if isinstance(self.rest, dict) else dict.fromkeys(self.cameras, self.rest)
        absent = [name for name in self.measuring_cameras if name not in patterns]
        if absent:
            raise ExperimentError(f"{self.path}: rest names no images of {', '.join(absent)}")
        if isinstance(self.rest, str) and len(self.cameras) > 1 and "{camera}" not in self.rest:
            raise ExperimentError(f"{self.path}: rest: {self.rest} does not contain {{camera}}")
        cameras = {name: CameraSection(images=patterns[name]) for name in self.cameras if name in patterns}
        changed = {"cameras": cameras, "frames": FramesSection(), "rest": None, "probes": None}
        return self.model_copy(update={"name": f"{self.name}, at rest", **changed})

    def open_frames(self) -> dict[str, FrameSeries]:
        """Find the frames of every camera, over the range of frame numbers that the measuring cameras share.
        One frame of each camera is read. Missing files leave gaps; so do dropped images, which are recognized
        by time stamps (in the key ``times`` or in the recording). ExperimentError if images are missing or
        cannot be numbered, or if the cameras share fewer than two frame numbers."""
        series = open_record(self, self._path, self.image_folder, self.measuring_cameras)
        return with_backgrounds(series, self.background, self.resolve, self._path)

    def read_probes(self) -> Any:
        """Read the wave probes, as `wavefield.read_probes`; None if the experiment file names none."""
        if self.probes is None:
            return None
        options = self.probes.model_dump(include={"unit", "factor", "clock", "places"})
        return read_probes(self.resolve(self.probes.file), **options)

    def frame_times(self, series: FrameSeries) -> NDArray[np.float64]:
        """Return the times of a camera's frames, (n,), s: frame number divided by frame rate."""
        return (series.first + np.arange(len(series))) / self.frame_rate

    @property
    def rig_paths(self) -> list[Path]:
        """Absolute paths of the rig files; by default only ``rig.yaml`` next to the experiment file."""
        named = list(self.rig.values()) if isinstance(self.rig, dict) else [self.rig or "rig.yaml"]
        return [self.resolve(file) for file in named]

    def load_rig(
        self, path: str | Path | None = None, series: Mapping[str, FrameSeries] | None = None
    ) -> Rig:
        """Load the rig (the calibrated cameras), with z = 0 on the still water.
        All formats of `wavefield.rig.formats` are read. `path` replaces the rig file that the experiment
        names. If `series` is given, its frames must have the image size in a rig file of wavefield; for a rig
        file of another program, their size is used instead. RigError if there is no rig, or the rig lacks a
        measuring camera, was made for images of another size, or has two cameras at the same position."""
        source: Path | dict[str, Path] = self.rig_paths[0] if path is None else Path(path)
        if path is None and isinstance(self.rig, dict):
            source = {name: self.resolve(file) for name, file in self.rig.items()}
        elif path is None and self.rig is None and not self.rig_paths[0].exists():
            raise RigError(
                f"{self.path} names no rig and there is no rig.yaml beside it; "
                f"run `wavefield calibrate {self.path.name}`"
            )
        sizes = {name: (s.shape[1], s.shape[0]) for name, s in series.items()} if series else None
        rig = load_rig(source, sizes, list(self.cameras))
        absent = [name for name in self.measuring_cameras if name not in rig.cameras]
        if absent:
            raise RigError(f"{source} has no camera {', '.join(absent)}; it has {', '.join(rig)}")
        for name, one in (series or {}).items():
            if name in rig.cameras:
                _check_image_size(source, rig[name].size, one)
        _refuse_same_place(source, rig, self.measuring_cameras)
        return with_water_level(rig, self.water.level) if self.water.level else rig

    def choose_grid(self, rig: Rig, settings: Mapping[str, object] | None = None) -> Grid:
        """Return the grid of the experiment file, or else the largest grid that all measuring cameras see.
        They must see an automatic grid at all elevations in ``z_range`` of `settings` (by default those of
        the experiment file), or else within half of ``sheet_thickness`` up and down, or else within 1 % of
        the distance of the nearest camera. RigError if the cameras share no view."""
        section = self.grid
        if isinstance(section, GridSection) and section.x is not None and section.y is not None:
            return Grid(section.x, section.y, section.step)
        step = section.step if isinstance(section, GridSection) else None
        height = _elevations_in_view(self.settings if settings is None else settings)
        return common_field([rig[name] for name in self.measuring_cameras], step, height)

    @property
    def measuring_cameras(self) -> list[str]:
        """Names of the cameras used to measure: those in ``surface`` and ``velocity``, by default all."""
        if self.surface is None and self.velocity is None:
            return list(self.cameras)
        used = {name for pair in (self.surface.pairs if self.surface else ()) for name in pair}
        used |= set(self.velocity.cameras if self.velocity else ())
        return [name for name in self.cameras if name in used]


def _check_image_size(source: object, size: tuple[int, int], series: FrameSeries) -> None:
    """Raise RigError if a camera's images do not have the `size`, (width, height) in px, of its calibration.
    The message tells if image axes seem to be exchanged; it names the rig file, `source`."""
    rows, columns = series.shape
    if size == (columns, rows):
        return
    count, name = len(series) + sum(series.beyond), series.camera
    if size == (rows, columns):
        remedy = "they are transposed: save them as (time, row, column); in MATLAB, permute(images, [2 1 3])"
    elif sorted(size) == sorted((count, rows)):
        remedy = "time is their last axis: save them as (time, row, column)"
    else:
        remedy = "use the rig of these images"
    raise RigError(
        f"{source} was made for images of {name} of {size[0]} x {size[1]} px, but these have "
        f"{columns} x {rows}; {remedy}"
    )


def _refuse_same_place(source: object, rig: Rig, names: Sequence[str]) -> None:
    """Raise RigError if two of the cameras `names` have the same position; `source` is the rig file."""
    if rig.lenses_alone:
        return
    for one, other in combinations(names, 2):
        apart = float(np.linalg.norm(rig[one].centre - rig[other].centre))
        if apart < SAME_PLACE * float(np.linalg.norm(rig[one].centre)):
            raise RigError(f"{source}: {one} and {other} are in one place; is one entry a copy?")


def _elevations_in_view(settings: Mapping[str, Any]) -> float | tuple[float, float] | None:
    """Return the elevations, m, at which all cameras must see an automatic grid.
    They are (low, high), from ``z_range``, or h, for -h to h, half of ``sheet_thickness``; None if not
    set."""
    try:
        if settings.get("z_range"):
            low, high = settings["z_range"]
            return float(low), float(high)
        return 0.5 * float(settings["sheet_thickness"])
    except (KeyError, TypeError, ValueError):  # wrong values are reported when the settings are checked
        return None
