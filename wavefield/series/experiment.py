"""The experiment file: one YAML file that describes an experiment as a lab note would."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PrivateAttr, field_validator, model_validator

from wavefield.config_files import ConfigSection, load, read_yaml
from wavefield.errors import ExperimentError, RigError
from wavefield.grid import Grid
from wavefield.rig import Rig
from wavefield.rig.field import common_field
from wavefield.rig.formats import load_rig
from wavefield.rig.water_level import with_water_level
from wavefield.series import masks
from wavefield.series.clocks import (
    RECORDED,
    own_times,
    place_by_intervals,
    place_by_time,
    read_time_stamps,
    recorded_times,
)
from wavefield.series.experiment_parts import (
    CalibrationSection,
    CameraSection,
    FramesSection,
    GridSection,
    ProbesSection,
    SurfaceSection,
    VelocitySection,
    WaterSection,
)
from wavefield.series.frames import FrameSeries
from wavefield.series.listing import Numbered, make_series, number_frames
from wavefield.series.rates import one_rate, recorded_rates

_MAX_FRAMES = 5_000_000  # of a record
_MAX_LEAP = 1000  # times as many numbers as there are frames


class Experiment(ConfigSection):
    """An experiment: cameras, rig, grid, and what is known of the water.

    Read one with `Experiment.load`; relative paths in it are relative to the file (images: to ``folder``,
    if it is given).

    Examples
    --------
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "experiment.yaml"
    >>> _ = path.write_text('''
    ... name: basin
    ... frame_rate: 20.0
    ... cameras: {cam1: "cam1/*.tif", cam2: "cam2/*.tif"}
    ... velocity: {cameras: [cam1, cam2]}
    ... ''')
    >>> Experiment.load(path).frame_rate
    20.0
    """

    name: str = Field(examples=["coriolis-07"], pattern=r"^[^/\\]+$")
    description: str = ""
    frame_rate: float = Field(
        gt=0, le=1e7, examples=["20.0"], description="Hz; by default what recordings state"
    )
    folder: str | None = Field(default=None, description="folder of the images, if not that of this file")
    cameras: dict[str, CameraSection] = Field(min_length=1, examples=['{cam1: {images: "cam1/*.tif"}}'])
    frames: FramesSection = FramesSection()
    calibration: CalibrationSection | None = None
    rest: str | dict[str, str] | None = Field(
        default=None,
        examples=['"rest/{camera}/img_{frame:05d}.tif"'],
        description="images of the water at rest, one pattern or one per camera: they mend and level the rig",
    )
    rig: str | dict[str, str] | None = Field(
        default=None, examples=["rig.yaml"], description="this program's or another's; or one file per camera"
    )
    surface: SurfaceSection | None = None
    velocity: VelocitySection | None = None
    grid: GridSection | Literal["auto"] = Field(
        default="auto", examples=["{x: [-1.0, 1.0], y: [-0.75, 0.75], step: 0.01}"]
    )
    water: WaterSection = WaterSection()
    mask: dict[str, list[masks.MaskSection]] = Field(
        default_factory=dict,
        examples=["{cam1: masks/cam1.png, water: {cylinder: {x: 0.2, y: -0.1, radius: 0.1}}}"],
        description="what is no water, by camera (px) or on the `water` (m)",
    )
    probes: ProbesSection | None = Field(default=None, examples=["probes.csv"])
    settings: dict[str, Any] = Field(default_factory=dict, description="measurement settings that differ")

    _path: Path = PrivateAttr(default=Path("experiment.yaml"))

    @field_validator("name", mode="before")
    @classmethod
    def _name_is_text(cls, value: Any) -> Any:
        return str(value) if isinstance(value, int | float) else value  # `name: 7` is a fine name

    @model_validator(mode="before")
    @classmethod
    def _masks_written_out(cls, data: Any) -> Any:
        if isinstance(data, Mapping) and isinstance(data.get("cameras"), Mapping) and "mask" in data:
            return {**data, "mask": masks.normalized(data["mask"], data["cameras"])}
        return data

    @model_validator(mode="after")
    def _cameras_exist(self) -> "Experiment":
        known = ", ".join(self.cameras)
        for a, b in self.surface.pairs if self.surface else ():
            for name in (a, b):
                if name not in self.cameras:
                    raise ValueError(f"surface.pairs names {name!r}, but the cameras are {known}")
            if a == b:
                raise ValueError(f"surface.pairs pairs {a!r} with itself")
        for name in self.velocity.cameras if self.velocity else ():
            if name not in self.cameras:
                raise ValueError(f"velocity.cameras names {name!r}, but the cameras are {known}")
        masks.check(self.mask)
        first, last = self.frames.first, self.frames.last
        if first is not None and last is not None and last <= first:
            raise ValueError(f"frames runs from {first} to {last}; a step needs two frames")
        return self

    # -- reading -------------------------------------------------------------------------------------

    @classmethod
    def load(cls, path: str | Path, folder: str | Path | None = None) -> "Experiment":
        """Read and check an experiment file.

        Parameters
        ----------
        path : path
            The file; one that holds only ``experiment: other.yaml`` (and perhaps ``folder``) stands for
            the other.
        folder : path, optional
            Folder of the images, in place of the one the file names.

        Returns
        -------
        Experiment

        Raises
        ------
        ExperimentError
            If the file is missing or wrong; the message names the line and the remedy.
        """
        path = Path(str(path).removeprefix("file://")).absolute()
        data = read_yaml(path)
        if set(data) in ({"experiment"}, {"experiment", "folder"}):
            if folder is None and data.get("folder"):
                folder = path.parent / data["folder"]
            target = path.parent / str(data["experiment"])
            if not target.is_file():
                raise ExperimentError(f"{path} points to {target}, which is not there")
            return cls.load(target, folder)
        if folder:
            data["folder"] = str(Path(str(folder).removeprefix("file://")).absolute())
        if "frame_rate" not in data and isinstance(data.get("cameras"), Mapping):
            rate = one_rate(recorded_rates(data["cameras"], path.parent / (data.get("folder") or "")), path)
            data |= {} if rate is None else {"frame_rate": rate}
        out = load(cls, path, data)
        out._path = path
        return out

    @property
    def path(self) -> Path:
        """The file this experiment was read from."""
        return self._path

    @property
    def image_folder(self) -> Path:
        """Folder that the images' names start from."""
        return self._path.parent / (self.folder or "")

    def resolve(self, name: str | Path) -> Path:
        """Absolute path of a file that the experiment names (other than an image).

        Parameters
        ----------
        name : path
            As in the file; ``{folder}`` stands for the folder of the images.

        Returns
        -------
        Path
        """
        return self._path.parent / str(name).replace("{folder}", str(self.image_folder))

    def at_rest(self) -> "Experiment":
        """The record of the water at rest, as an experiment of its own.

        Returns
        -------
        Experiment
            The same cameras, rig and grid with the images of ``rest``.

        Raises
        ------
        ExperimentError
            If none is named, or not for every camera.
        """
        if not self.rest:
            raise ExperimentError(f"{self.path} names no record at rest; add `rest:` with its images")
        patterns = self.rest if isinstance(self.rest, dict) else dict.fromkeys(self.cameras, self.rest)
        absent = [name for name in self.measuring_cameras if name not in patterns]
        if absent:
            raise ExperimentError(f"{self.path}: rest names no images of {', '.join(absent)}")
        if isinstance(self.rest, str) and len(self.cameras) > 1 and "{camera}" not in self.rest:
            raise ExperimentError(f"{self.path}: rest: {self.rest} does not say where {{camera}} is")
        strange = [name for name in patterns if name not in self.cameras]
        if strange:
            raise ExperimentError(f"{self.path}: rest names {strange[0]!r}, which is no camera of it")
        cameras = {name: CameraSection(images=pattern) for name, pattern in patterns.items()}
        more = {"cameras": cameras, "frames": FramesSection(), "rest": None, "probes": None}
        return self.model_copy(update={"name": f"{self.name}, at rest", **more})

    # -- what follows from it ------------------------------------------------------------------------

    def open_frames(self) -> dict[str, FrameSeries]:
        """Find the frames of every camera: one listing of each folder, one frame read per camera.

        Returns
        -------
        dict of str to FrameSeries
            All on the same range of frame numbers, gaps kept: of missing files, and of images that a camera
            dropped, by its `times` or by those in its recording.

        Raises
        ------
        ExperimentError
            If images are not there or cannot be numbered.
        """
        numbered = {
            name: number_frames(section.images, self.image_folder, name)
            for name, section in self.cameras.items()
        }
        numbered, clocks = self._by_clocks(numbered)
        for name, section in self.cameras.items():
            if section.offset:
                numbered[name] = {n + section.offset: entry for n, entry in numbered[name].items()}
        measuring = [numbered[name] for name in self.measuring_cameras]
        # a record is what all cameras saw: what one has before or after the others is no gap of theirs
        first = max(min(frames) for frames in measuring)
        last = min(max(frames) for frames in measuring)
        first = first if self.frames.first is None else self.frames.first
        last = last if self.frames.last is None else self.frames.last
        if last <= first:
            raise ExperimentError(self._no_step(numbered))
        self._refuse_leaps(measuring, first, last)
        return make_series(numbered, first, last, clocks)

    def _refuse_leaps(self, measuring: Sequence[Numbered], first: int, last: int) -> None:
        """Refuse a range of numbers that hardly has frames, before it takes any memory."""
        lowest = min(min(frames) for frames in measuring)
        if first < min(lowest, 0):
            raise ExperimentError(
                f"{self.path}: frames.first is {first}, but the first frame there is {lowest}"
            )
        there = max(sum(first <= number <= last for number in frames) for frames in measuring)
        count = last - first + 1
        if count > _MAX_FRAMES or count > _MAX_LEAP * max(there, 1):
            raise ExperimentError(
                f"{self.path}: the record runs from frame {first} to {last}, but only {there} of these "
                f"{count} numbers have a file; correct `frames`, or remove files whose number leaps"
            )

    def _by_clocks(
        self, numbered: Mapping[str, Numbered]
    ) -> tuple[dict[str, Numbered], dict[str, NDArray[np.float64]]]:
        """Frames at their places by the cameras' clocks, and what these say, of cameras that have one."""
        stamped = {
            name: self._stamps(name, section) for name, section in self.cameras.items() if section.times
        }
        if not stamped:
            own = {name: own_times(one.images, name, self.image_folder) for name, one in self.cameras.items()}
            clocks = {
                name: times
                for name, times in own.items()
                if times is not None and len(times) == len(numbered[name])
            }
            placed = {name: place_by_intervals(numbered[name], times) for name, times in clocks.items()}
            return {**numbered, **placed}, clocks
        if len(stamped) < len(numbered):
            without = next(name for name in numbered if name not in stamped)
            raise ExperimentError(
                f"{self.path}: {without} has no `times`, but other cameras have; give them all, or none"
            )
        start = min(times[0] for _, times in stamped.values())
        placed = {
            name: place_by_time(numbered[name], times, start, self.frame_rate, path, name)
            for name, (path, times) in stamped.items()
        }
        return placed, {name: times for name, (_, times) in stamped.items()}

    def _stamps(self, name: str, section: CameraSection) -> tuple[Path, NDArray[Any]]:
        """Where a camera's time stamps stand, and they."""
        assert section.times is not None
        if section.times == RECORDED:
            times = recorded_times(section.images, name, self.image_folder)
            return self.image_folder / str(section.images).replace("{camera}", name), times
        path = self.resolve(section.times)
        return path, read_time_stamps(path, name)

    def _no_step(self, numbered: Mapping[str, Mapping[int, Any]]) -> str:
        ranges = {name: (min(numbered[name]), max(numbered[name])) for name in self.measuring_cameras}
        if all(low == high for low, high in ranges.values()):
            return f"{self.path}: there is one frame only; a step needs two"
        words = ", ".join(f"{name} {low} to {high}" for name, (low, high) in ranges.items())
        return (
            f"{self.path}: the cameras share no two frames (frames of {words}); "
            "correct `offset`, or `frames` if it is given"
        )

    def read_probes(self) -> Any:
        """Read the wave probes.

        Returns
        -------
        Dataset or None
            As from `wavefield.waves.read_probes`; None if the file names none.

        Raises
        ------
        ExperimentError
            If their file is missing or wrong.
        """
        if self.probes is None:
            return None
        from wavefield.waves import read_probes
        from wavefield.waves.probes.probe_files import Columns

        section = self.probes
        columns = Columns(section.time, section.columns) if section.columns else None
        return read_probes(
            self.resolve(section.file),
            columns,
            unit=section.unit,
            factor=section.factor,
            clock=section.clock,
            places=section.places,
        )

    def frame_times(self, series: FrameSeries) -> np.ndarray:
        """Times of the frames, from their numbers and the frame rate.

        Parameters
        ----------
        series : FrameSeries
            Any camera.

        Returns
        -------
        ndarray, (n,)
            Seconds; frame number 0 is at 0.
        """
        return (series.first + np.arange(len(series))) / self.frame_rate

    @property
    def rig_paths(self) -> list[Path]:
        """Files that the rig is read from: ``rig.yaml`` beside the experiment file if it names none."""
        named = list(self.rig.values()) if isinstance(self.rig, dict) else [self.rig or "rig.yaml"]
        return [self.resolve(file) for file in named]

    def load_rig(
        self, path: str | Path | None = None, series: Mapping[str, FrameSeries] | None = None
    ) -> Rig:
        """Load the rig, in any format that `wavefield.rig.formats` knows.

        Parameters
        ----------
        path : path, optional
            In place of the one that the experiment names.
        series : mapping of str to FrameSeries, optional
            The frames: some programs do not store the size of their images.

        Returns
        -------
        Rig
            With z = 0 on the water at rest.

        Raises
        ------
        RigError
            If there is none, or cameras of the experiment are not in it, or its images have other sizes.
        """
        if path is None and self.rig is None:
            path = self.resolve("rig.yaml")  # where `wavefield calibrate` writes it
            if not path.exists():
                raise RigError(
                    f"{self.path} names no rig and there is no rig.yaml beside it; "
                    f"run `wavefield calibrate {self.path.name}`"
                )
        where: Path | dict[str, Path]
        if path is not None:
            where = Path(path)
        elif isinstance(self.rig, dict):
            where = {name: self.resolve(file) for name, file in self.rig.items()}
        else:
            where = self.resolve(str(self.rig))
        sizes = {name: (s.shape[1], s.shape[0]) for name, s in series.items()} if series else None
        own = isinstance(where, Path) and where.suffix in (".yaml", ".yml") and "%YAML" not in _start(where)
        rig = load_rig(where, sizes, None if own or isinstance(where, dict) else list(self.cameras))
        absent = [name for name in self.measuring_cameras if name not in rig.cameras]
        if absent:
            raise RigError(f"{where} has no camera {', '.join(absent)}; it has {', '.join(rig)}")
        for name, size in (sizes or {}).items():
            if name in rig.cameras and rig[name].size != size:
                w, h = rig[name].size
                raise RigError(
                    f"{where} was made for images of {name} of {w} x {h} px, but these have "
                    f"{size[0]} x {size[1]}; use the rig of these images"
                )
        return with_water_level(rig, self.water.level) if self.water.level else rig

    def choose_grid(self, rig: Rig) -> Grid:
        """The grid of the file, or the largest that all cameras see.

        Parameters
        ----------
        rig : Rig
            The cameras.

        Returns
        -------
        Grid

        Raises
        ------
        RigError
            If the grid is `auto` and the cameras have no common field.
        """
        section = self.grid
        if isinstance(section, GridSection) and section.x is not None and section.y is not None:
            return Grid(section.x, section.y, section.step)
        step = section.step if isinstance(section, GridSection) else None
        return common_field([rig[name] for name in self.measuring_cameras], step)

    @property
    def measuring_cameras(self) -> list[str]:
        """Cameras that the measurement uses, in the order of the file."""
        if self.surface is None and self.velocity is None:
            return list(self.cameras)
        used = {name for pair in (self.surface.pairs if self.surface else ()) for name in pair}
        used |= set(self.velocity.cameras if self.velocity else ())
        return [name for name in self.cameras if name in used]


def _start(path: Path) -> str:
    try:
        with path.open(errors="replace") as stream:
            return stream.read(200)
    except OSError:
        return ""  # `load_rig` says what is wrong
