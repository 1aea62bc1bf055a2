"""The parts of an experiment file: record, calibration, surface, velocity, grid, water, probes."""

from typing import Any, Literal

from pydantic import Field, field_validator, model_validator

from wavefield.config_files import ConfigSection, Name, PathText, safe_name
from wavefield.grid import Grid
from wavefield.series.formats.arrays import refuse_password
from wavefield.water import tension_over_density

_RANGE = "first and last frame number to use, both included, as in `--frames FIRST:LAST`"
_NODES = "first and last node, m; left out: the common view of the cameras"


class CameraSection(ConfigSection):
    """Names of the images of one camera, and how their frames are numbered and timed."""

    images: PathText | list[PathText | None] = Field(
        examples=['"cam1/img_{frame:05d}.tif"'],
        description="pattern with the frame number, list, multi-page TIFF, recording, video, Zarr array",
    )
    offset: int = Field(default=0, description="added to this camera's frame numbers")
    times: PathText | None = Field(
        default=None,
        description="file of time stamps, s, one per image (one per line, or a CSV with a column `time`)",
    )
    row_time: float = Field(
        default=0.0,
        ge=-1e-2,
        le=1e-2,
        examples=["8e-6"],
        description="rolling shutter: delay from one row to the next, s",
    )

    @model_validator(mode="before")
    @classmethod
    def _shorthand(cls, data: object) -> object:
        return {"images": data} if isinstance(data, str | list) else data

    @field_validator("images")
    @classmethod
    def _without_password(cls, value: str | list[str | None]) -> str | list[str | None]:
        for name in [value] if isinstance(value, str) else value:
            refuse_password(name or "")
        return value


class FramesSection(ConfigSection):
    """Range of frame numbers to use; the first and the last are included."""

    first: int | None = Field(default=None, examples=["0"], description=_RANGE)
    last: int | None = Field(default=None, examples=["11999"], description=_RANGE)


class RecordSection(ConfigSection):
    """The images of an experiment: name, frame rate, cameras, and the range of frame numbers to use."""

    name: Name = Field(examples=["coriolis-07"])
    description: str = ""
    frame_rate: float = Field(
        ge=1e-4, le=1e7, examples=["20.0"], description="Hz; by default what recordings state"
    )
    folder: PathText | None = Field(
        default=None, description="folder of the images, if not that of this file"
    )
    cameras: dict[str, CameraSection] = Field(min_length=1, examples=['{cam1: {images: "cam1/{frame}.tif"}}'])
    frames: FramesSection = FramesSection()

    @field_validator("name", mode="before")
    @classmethod
    def _name_is_text(cls, value: object) -> object:
        number = isinstance(value, int | float) and not isinstance(value, bool)
        return str(value) if number else value  # YAML reads `name: 7` as a number

    @field_validator("cameras")
    @classmethod
    def _cameras_in_paths(cls, value: dict[str, CameraSection]) -> dict[str, CameraSection]:
        for name in value:
            safe_name(name)
        return value


class CalibrationSection(ConfigSection):
    """Images of the calibration target, its kind and size, and the lens terms to fit."""

    target: dict[str, Any] = Field(examples=["{kind: strings, mesh: 0.10}"], description="see below")
    tilted: PathText | list[PathText] = Field(
        examples=['"calib/{camera}/tilt_*.tif"'], description="images of the tilted target"
    )
    flat: PathText | None = Field(
        default=None,
        examples=['"calib/{camera}/flat.tif"'],
        description="image of the target on the still water",
    )
    model: str = Field(
        default="auto",
        examples=["f tilt k1"],
        description="lens terms to fit; auto: those that predict left-out views best",
    )
    target_std: float = Field(
        default=0.0,
        ge=0,
        examples=["0.001"],
        description="standard uncertainty of the target's nodes, m",
    )
    heights: dict[str, float] = Field(
        default_factory=dict,
        examples=["{z_1: -0.003, z_2: 0.0, z_3: 0.003}"],
        description="z of each pose, m, if the target moves along z",
    )
    camera_distance: dict[str, float] = Field(
        default_factory=dict,
        examples=["{cam1: 4.5}"],
        description="distance of a camera from the origin, m, to check the mesh",
    )


class SurfaceSection(ConfigSection):
    """Pairs of cameras that give z.
    The surface elevation z follows from the parallax between the two images of each pair."""

    pairs: list[tuple[str, str]] = Field(examples=["[[cam3, cam1], [cam3, cam2]]"], min_length=1)


class VelocitySection(ConfigSection):
    """Cameras that give u, v, w.
    The velocity of the water follows from displacements in their images between frames."""

    cameras: list[str] = Field(examples=["[cam1, cam2]"], min_length=2)


class GridSection(ConfigSection):
    """Nodes of the grid.
    The nodes are the positions at which the water is measured, between limits along x and y."""

    x: tuple[float, float] | None = Field(default=None, examples=["[-1.0, 1.0]"], description=_NODES)
    y: tuple[float, float] | None = Field(default=None, examples=["[-0.75, 0.75]"], description=_NODES)
    step: float = Field(gt=0, examples=["0.01"], description="distance between nodes, m")

    @model_validator(mode="after")
    def _complete(self) -> "GridSection":
        if (self.x is None) != (self.y is None):
            raise ValueError("give both x and y, or neither for the extent that the cameras see")
        if self.x is not None and self.y is not None:
            Grid(self.x, self.y, self.step)
        return self


class WaterSection(ConfigSection):
    """Depth, still level, density and surface tension of the water."""

    depth: float | None = Field(default=None, gt=0, le=12_000, examples=["0.70"], description="depth, m")
    level: float = Field(default=0.0, description="height of the still water above z = 0 of the rig file, m")
    density: float | None = Field(
        default=None, ge=400, le=30_000, examples=["1000"], description="kg m-3; default 1000"
    )
    surface_tension: float | None = Field(
        default=None, ge=0, le=5, examples=["0.073"], description="N m-1; default 0.0728"
    )

    def attributes(self) -> dict[str, float]:
        """Return the water's properties as attributes of a dataset; those not in the file are left out.
        They are ``water_depth``, m, and ``surface_tension_over_density``, m3 s-2."""
        out = {} if self.depth is None else {"water_depth": self.depth}
        if self.surface_tension is not None or self.density is not None:
            out["surface_tension_over_density"] = tension_over_density(self.surface_tension, self.density)
        return out


class ProbesSection(ConfigSection):
    """A CSV file of wave probes: ``time`` (s) and a column per probe."""

    file: PathText = Field(examples=["probes.csv"], description="CSV file; see Wave probes")
    unit: Literal["m", "cm", "mm", "um"] = Field(default="m", description="unit of the elevations")
    factor: float = Field(
        default=1.0, description="multiplies the elevations; -1 for gauges that count downwards"
    )
    clock: float = Field(default=0.0, description="added to the times, s")
    places: dict[str, tuple[float, float]] = Field(
        default_factory=dict, examples=["{p1: [0.2, -0.1]}"], description="x, y of each probe, m"
    )

    @model_validator(mode="before")
    @classmethod
    def _shorthand(cls, data: object) -> object:
        return {"file": data} if isinstance(data, str) else data
