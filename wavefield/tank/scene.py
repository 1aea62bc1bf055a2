"""The description of a simulated experiment: all settings, read from YAML and checked."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, cast

import numpy as np
import yaml
from pydantic import Discriminator, Field, Tag, model_validator

from wavefield.config_files import make, read_yaml
from wavefield.errors import ExperimentError
from wavefield.grid import Grid
from wavefield.rig import Rig
from wavefield.rig.field import common_field
from wavefield.tank.scene_parts import (
    Beads,
    CalibrationScene,
    Fault,
    Light,
    PaperRig,
    Part,
    PlatformRig,
    Positive,
    Probes,
    RandomSea,
    RigFile,
    SeaSurface,
    Sheet,
    SheetRig,
    SingleWave,
    StillSea,
    Texture,
    Timing,
)
from wavefield.tank.sea import Sea


def _kind_of_rig(value: object) -> str:
    """Return the type of a scene's rig, such as "sheet-rig"; `value` is an instance or a mapping."""
    if isinstance(value, RigFile) or (isinstance(value, Mapping) and "file" in value):
        return "rig-file"
    if isinstance(value, PlatformRig) or (isinstance(value, Mapping) and "height" in value):
        return "platform-rig"
    if isinstance(value, Mapping):
        only_of_sheets = set(SheetRig.model_fields) - set(PaperRig.model_fields)
        return "sheet-rig" if only_of_sheets & set(value) else "paper-rig"
    return "sheet-rig" if isinstance(value, SheetRig) else "paper-rig"


def _kind_of_surface(value: object) -> str:
    return value.get("kind", "beads") if isinstance(value, Mapping) else getattr(value, "kind", "")


class Scene(Part):
    """The settings of a simulated experiment.

    `Scene.load` reads them from YAML. The class of each part describes its settings and their units;
    `Scene.presets` lists the scenes that come with the program.

    Examples
    --------
    >>> scene = Scene.load("demo")
    >>> sorted(scene.build_rig())
    ['cam1', 'cam2', 'cam3']
    """

    name: str = "tank"
    seed: Annotated[int, Field(ge=0)] = 1
    frames: Annotated[int, Field(ge=1)] = Field(default=42, description="number of frames")
    frame_rate: Positive = Field(default=20.0, description="Hz")
    start: float = Field(default=0.0, description="time of the sea at the first frame, s")
    rig: Annotated[
        Annotated[PaperRig, Tag("paper-rig")]
        | Annotated[SheetRig, Tag("sheet-rig")]
        | Annotated[PlatformRig, Tag("platform-rig")]
        | Annotated[RigFile, Tag("rig-file")],
        Discriminator(_kind_of_rig),
    ] = PaperRig()
    grid: Grid = Field(
        default=cast(Grid, None), description="nodes of the truth; by default what all cameras see"
    )
    sea: Annotated[StillSea | SingleWave | RandomSea, Field(discriminator="kind")]
    surface: Annotated[
        Annotated[Beads, Tag("beads")]
        | Annotated[Texture, Tag("texture")]
        | Annotated[SeaSurface, Tag("sea")]
        | Annotated[Sheet, Tag("sheet")],
        Discriminator(_kind_of_surface),
    ] = Beads()
    light: Light = Light()
    timing: Timing = Timing()
    faults: dict[str, Fault] = Field(default_factory=dict, description="camera: what goes wrong with it")
    calibration: CalibrationScene = CalibrationScene()
    probes: Probes = Probes()

    @model_validator(mode="after")
    def _fill_grid(self) -> "Scene":
        if self.grid is None:
            height = 0.0 if isinstance(self.surface, Sheet) else 0.05
            self.__dict__["grid"] = common_field(self.rig.build().cameras.values(), height=height)
        return self

    @model_validator(mode="after")
    def _sheet_in_still_water(self) -> "Scene":
        if isinstance(self.surface, Sheet):
            if not isinstance(self.sea, StillSea) or any(self.sea.current):
                raise ValueError("sea: a light sheet has a flow of its own: take `sea: {kind: still}`")
            if any(fault.delay or fault.row_time for fault in self.faults.values()):
                raise ValueError("faults: a delay is not simulated for a light sheet")
            if self.timing.jitter:
                raise ValueError("timing: jitter is not simulated for a light sheet")
        return self

    @model_validator(mode="after")
    def _cameras_exist(self) -> "Scene":
        if isinstance(self.rig, PaperRig):
            cameras = {f"cam{n + 1}" for n in range(self.rig.cameras)}
            shown = {fault.shows for fault in self.faults.values() if fault.shows is not None}
            for setting, named in (
                ("light.gain", self.light.gain),
                ("faults", self.faults),
                ("shows", shown),
            ):
                if unknown := set(named) - cameras:
                    raise ValueError(f"{setting} names {min(unknown)!r}, which is no camera of the rig")
        return self

    def time(self, frame: float) -> float:
        """Return the simulated time, s, of a frame counted from 0, without random errors of the clock."""
        return self.start + frame / self.frame_rate

    def frame_time(self, frame: float) -> float:
        """Return the simulated time, s, when cameras take a frame, with the random errors of the clock."""
        jitter = self.timing.jitter
        if not jitter:
            return self.time(frame)
        return self.time(frame) + jitter * float(np.random.default_rng([self.seed, 11, int(frame)]).normal())

    @classmethod
    def load(cls, source: str | Path) -> "Scene":
        """Return the scene of a YAML file or preset.

        Parameters
        ----------
        source : path or str
            A YAML file, or the name of a preset.

        Raises
        ------
        ExperimentError
            If there is no such file or preset, or a setting is wrong.
        """
        path = Path(source)
        presets = cls.presets()
        if not path.suffix and str(source) in presets:
            path = presets[str(source)]
        elif not path.exists():
            raise ExperimentError(f"{source}: no such scene; give a YAML file or one of {', '.join(presets)}")
        data = read_yaml(path)
        rig = data.get("rig")
        if isinstance(rig, dict) and isinstance(rig.get("file"), str):
            rig["file"] = str((path.parent / rig["file"]).resolve())
        return make(cls, data, path=path)

    @classmethod
    def from_dict(cls, data: Mapping[str, object]) -> "Scene":
        """Return the scene with the settings of a mapping.

        Parameters
        ----------
        data : mapping
            Settings as in the YAML file.

        Raises
        ------
        ExperimentError
            If a setting is wrong.
        """
        return make(cls, data, name="scene")

    @staticmethod
    def presets() -> dict[str, Path]:
        """Return the YAML files of the scenes that come with the program, by name."""
        folder = Path(__file__).parent / "scenes"
        return {path.stem: path for path in sorted(folder.glob("*.yaml"))}

    def to_yaml(self) -> str:
        """Return the scene as YAML with every setting written out."""
        data = self.model_dump(mode="json")
        return yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=110)

    def with_(self, **parts: object) -> "Scene":
        """Return a copy with some settings replaced.

        Parameters
        ----------
        **parts
            New values of top-level settings. A mapping changes only the settings that it names. A mapping
            with another `kind`, or with keys that the present part lacks, replaces the whole part.

        Examples
        --------
        >>> Scene.load("demo").with_(light={"bits": 16}).light.bits
        16
        """
        data = self.model_dump()
        for name, value in parts.items():
            old = data.get(name)
            if isinstance(value, Mapping) and isinstance(old, dict) and set(value) <= set(old):
                same_kind = value.get("kind", old.get("kind")) == old.get("kind")
                value = {**old, **value} if same_kind else value
            data[name] = value
        return type(self).from_dict(data)

    def build_rig(self) -> Rig:
        """Return the exact cameras of the scene."""
        return self.rig.build()

    def build_sea(self) -> Sea:
        """Return the sea of the scene; the seed of the scene draws its random waves."""
        return self.sea.build(self.seed)
