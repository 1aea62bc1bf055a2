"""The description of a simulated experiment: everything that is set, and how it is read from YAML."""

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, ValidationError, model_validator

from wavefield.errors import ExperimentError
from wavefield.grid import Grid
from wavefield.rig import Rig
from wavefield.tank import rigs, spectrum
from wavefield.tank.sea import SURFACE_TENSION, Sea

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Limits = tuple[float, float]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=True)


class _Water(_Part):
    depth: Positive = Field(default=0.7, description="depth of the water, m; .inf for deep water")
    surface_tension: NotNegative = Field(
        default=SURFACE_TENSION, description="surface tension over density, m3 s-2"
    )
    current: tuple[float, float] = Field(
        default=(0.0, 0.0), description="velocity of the water as a whole, m/s"
    )

    def _sea(self, kx: Any, ky: Any, amplitude: Any, bound: int) -> Sea:
        return Sea(kx, ky, amplitude, self.depth, self.surface_tension, self.current, bound)


class StillSea(_Water):
    """Water at rest (but for its current)."""

    kind: Literal["still"]

    def build(self, seed: int) -> Sea:
        """Make the sea."""
        return self._sea([1.0], [0.0], [0.0], 0)


class SingleWave(_Water):
    """One wave."""

    kind: Literal["single"]
    amplitude: NotNegative = Field(description="m")
    wavelength: Positive = Field(description="m")
    direction: float = Field(default=0.0, description="where it goes, degrees anticlockwise from +x")
    phase: float = Field(default=0.0, description="degrees")
    order: Literal[1, 2] = Field(default=1, description="2 adds the bound second harmonic")

    def build(self, seed: int) -> Sea:
        """Make the sea."""
        k, angle = 2 * np.pi / self.wavelength, np.radians(self.direction)
        amplitude = self.amplitude * np.exp(1j * np.radians(self.phase))
        return self._sea([k * np.cos(angle)], [k * np.sin(angle)], [amplitude], int(self.order == 2))


class Jonswap(_Part):
    """JONSWAP spectrum."""

    kind: Literal["jonswap"]
    peak: Positive = Field(description="frequency of the peak, Hz")
    enhancement: Positive = 3.3

    def __call__(self, frequency: np.ndarray) -> np.ndarray:
        """Spectrum at frequencies in Hz, to within a factor."""
        return spectrum.jonswap(frequency, self.peak, self.enhancement)


class PowerLaw(_Part):
    """Spectrum that falls as a power of the frequency."""

    kind: Literal["power"]
    peak: Positive = Field(description="frequency of the peak, Hz")
    exponent: Positive = 6.0

    def __call__(self, frequency: np.ndarray) -> np.ndarray:
        """Spectrum at frequencies in Hz, to within a factor."""
        return spectrum.power_law(frequency, self.peak, self.exponent)


class RandomSea(_Water):
    """A random sea with a given spectrum."""

    kind: Literal["random"]
    rms: NotNegative = Field(description="standard deviation of the elevation, m")
    spectrum: Annotated[Jonswap | PowerLaw, Field(discriminator="kind")]
    direction: float = Field(default=0.0, description="main direction, degrees anticlockwise from +x")
    spread: NotNegative = Field(
        default=0.0, description="exponent s of cos^2s of half the angle; 0 is isotropic"
    )
    shortest: Positive = Field(default=0.05, description="shortest free wave, m")
    period: Positive = Field(
        default=6.0, description="the sea repeats itself in x and y after this distance, m"
    )
    order: Literal[1, 2] = Field(default=1, description="2 adds the waves bound to the steepest free ones")
    interacting: Annotated[int, Field(ge=2, le=2000)] = Field(
        default=300, description="free waves with bound ones"
    )

    @model_validator(mode="after")
    def _check(self) -> "RandomSea":
        if self.shortest * 4 > self.period:
            raise ValueError("period must be at least four times the shortest wave")
        return self

    def build(self, seed: int) -> Sea:
        """Make the sea."""
        kx, ky, amplitude = spectrum.random_waves(
            self.spectrum,
            rms=self.rms,
            direction=np.radians(self.direction),
            spread=self.spread,
            shortest=self.shortest,
            period=self.period,
            depth=self.depth,
            surface_tension=self.surface_tension,
            seed=seed,
        )
        return self._sea(kx, ky, amplitude, self.interacting if self.order == 2 else 0)


class PaperRig(_Part):
    """The paper's three cameras."""

    scale: Annotated[float, Field(gt=0, le=2)] = Field(default=1.0, description="image size over full size")
    crop: Annotated[float, Field(gt=0, le=1)] = Field(default=1.0, description="share of the sensor read out")

    def build(self) -> Rig:
        """Make the rig."""
        return rigs.paper_rig(self.scale, self.crop)


class RigFile(_Part):
    """Any cameras, from a rig file."""

    file: str = Field(description="a rig as YAML; relative to the scene file")

    def build(self) -> Rig:
        """Read the rig."""
        return Rig.load(self.file)


class Beads(_Part):
    """Floating beads."""

    kind: Literal["beads"] = "beads"
    density: Positive = Field(default=1.1e4, description="beads per m2; 1.1e4 is 17.6 per 4 x 4 cm")
    diameter: NotNegative = Field(default=0.7e-3, description="m")
    brightness: Positive = Field(default=110.0, description="mean height of a spot, grey levels of 255")
    spread: NotNegative = Field(default=0.35, description="relative spread of brightness over beads")
    spread_between: NotNegative = Field(
        default=0.15, description="relative spread between cameras for one bead"
    )
    one_camera: Share = Field(default=0.0, description="share of beads that only one camera sees")
    clustered: Share = Field(default=0.0, description="share of beads in groups of six within 8 mm")
    holes: Annotated[int, Field(ge=0)] = Field(default=0, description="number of round places without beads")
    hole_diameter: Positive = Field(default=0.10, description="m")
    renewal: Share = Field(default=0.005, description="share of beads laid anew per second")


class Texture(_Part):
    """White noise painted on the surface, as in the paper's test."""

    kind: Literal["texture"] = "texture"
    mesh: Positive | None = Field(default=None, description="size of the grains, m; by default 1.5 pixels")
    contrast: Positive = Field(default=40.0, description="standard deviation, grey levels of 255")
    mean: NotNegative = Field(default=120.0, description="grey levels of 255")
    carried: bool = Field(
        default=False, description="moves with the water; else it stays and only its height changes"
    )


class Light(_Part):
    """How the cameras see."""

    blur: Positive = Field(default=0.62, description="standard deviation of a point's image, px")
    background: NotNegative = Field(default=12.0, description="grey levels of 255")
    unevenness: NotNegative = Field(default=0.3, description="relative difference of light across an image")
    flicker: NotNegative = Field(default=0.0, description="relative rms change of light from frame to frame")
    gain: dict[str, Positive] = Field(default_factory=dict, description="camera: factor on its grey levels")
    read_noise: NotNegative = Field(default=1.2, description="grey levels of 255")
    shot_noise: NotNegative = Field(default=0.04, description="variance per grey level, grey levels of 255")
    bits: Literal[8, 16] = 8


class Strings(_Part):
    """The paper's grid of white strings."""

    kind: Literal["strings"] = "strings"
    mesh: Positive = Field(default=0.10, description="m")
    width: Positive = Field(default=3e-3, description="width of a string, m")
    half: Annotated[int, Field(ge=2)] = Field(
        default=10, description="strings on each side of the middle one"
    )
    origin_disc: Positive = Field(default=0.036, description="diameter of the disc at the origin, m")
    x_disc: Positive = Field(
        default=0.022, description="diameter of the disc at the next crossing along +x, m"
    )
    brightness: Positive = Field(default=150.0, description="grey levels of 255")
    node_offset: NotNegative = Field(default=0.0, description="rms error of the crossings in x, y, z, m")


class Chessboard(_Part):
    """A chessboard, its middle at the origin."""

    kind: Literal["chessboard"]
    mesh: Positive = Field(default=0.08, description="side of a square, m")
    shape: tuple[int, int] = Field(default=(11, 8), description="inner corners along x and y")
    brightness: Positive = 150.0


class Dots(_Part):
    """White dots on a dark plate, their middle at the origin."""

    kind: Literal["dots"]
    mesh: Positive = Field(default=0.08, description="distance between dots, m")
    shape: tuple[int, int] = Field(default=(11, 8), description="dots along x and y")
    diameter: Positive = Field(default=0.02, description="m")
    brightness: Positive = 150.0


class Calibration(_Part):
    """Target images."""

    target: Annotated[Strings | Chessboard | Dots, Field(discriminator="kind")] = Strings()
    tilted: Annotated[int, Field(ge=0)] = Field(default=6, description="number of tilted poses")
    tilt: Positive = Field(default=20.0, description="largest tilt, degrees")
    level: float = Field(default=0.0, description="height of the flat target above the water at rest, m")


class Probes(_Part):
    """Wave probes."""

    rate: Positive = Field(default=100.0, description="Hz")
    positions: dict[str, tuple[float, float]] = Field(
        default_factory=lambda: {"probe1": (-0.25, 0.1), "probe2": (0.2, -0.15)}, description="x, y, m"
    )
    noise: NotNegative = Field(default=1e-4, description="rms, m")


def _kind_of_surface(value: Any) -> str:
    return value.get("kind", "beads") if isinstance(value, Mapping) else getattr(value, "kind", "")


class Scene(_Part):
    """A simulated experiment.

    Made from YAML with `Scene.load`; every setting and its unit is in the class of its part. Presets: see
    `Scene.presets`.

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
    rig: PaperRig | RigFile = PaperRig()
    grid: Grid = Grid(x=(-1.0, 1.0), y=(-0.75, 0.75), step=0.01)
    sea: Annotated[StillSea | SingleWave | RandomSea, Field(discriminator="kind")]
    surface: Annotated[
        Annotated[Beads, Tag("beads")] | Annotated[Texture, Tag("texture")], Discriminator(_kind_of_surface)
    ] = Beads()
    light: Light = Light()
    calibration: Calibration = Calibration()
    probes: Probes = Probes()

    @model_validator(mode="after")
    def _cameras_known(self) -> "Scene":
        if isinstance(self.rig, PaperRig):
            unknown = set(self.light.gain) - {"cam1", "cam2", "cam3"}
            if unknown:
                raise ValueError(f"light.gain names {sorted(unknown)[0]!r}, which is no camera of the rig")
        return self

    @classmethod
    def load(cls, source: str | Path) -> "Scene":
        """Read a scene.

        Parameters
        ----------
        source : path or str
            A YAML file, or the name of a preset.

        Returns
        -------
        Scene

        Raises
        ------
        ExperimentError
            If there is no such file or preset, or a setting is wrong.
        """
        path = Path(source)
        presets = cls.presets()
        if not path.suffix and str(source) in presets:
            text, where = presets[str(source)].read_text(), f"scene {source}"
        else:
            try:
                text, where = path.read_text(), str(path)
            except OSError:
                raise ExperimentError(
                    f"{source}: no such scene; give a YAML file or one of {', '.join(presets)}"
                ) from None
        try:
            data = yaml.safe_load(text)
        except yaml.YAMLError as error:
            raise ExperimentError(f"{where} is not YAML: {' '.join(str(error).split())}") from None
        if isinstance(data, dict) and isinstance(data.get("rig"), dict) and "file" in data["rig"]:
            data["rig"]["file"] = str((path.parent / str(data["rig"]["file"])).resolve())
        return cls.from_dict(data, where)

    @classmethod
    def from_dict(cls, data: Any, where: str = "scene") -> "Scene":
        """Make a scene from plain data.

        Parameters
        ----------
        data : mapping
            As in the YAML file.
        where : str
            What to name in error messages.

        Returns
        -------
        Scene

        Raises
        ------
        ExperimentError
            If a setting is wrong.
        """
        if not isinstance(data, Mapping):
            raise ExperimentError(f"{where} must be a mapping of settings, such as `sea: {{kind: still}}`")
        try:
            return cls.model_validate(dict(data))
        except ValidationError as error:
            raise ExperimentError(f"{where}: {_sentence(error)}") from None

    @staticmethod
    def presets() -> dict[str, Any]:
        """Scenes that come with the program.

        Returns
        -------
        dict of str to path
        """
        folder = files("wavefield.tank") / "scenes"
        found = {Path(f.name).stem: f for f in folder.iterdir() if f.name.endswith(".yaml")}
        return dict(sorted(found.items()))

    def to_yaml(self) -> str:
        """The scene as YAML, every setting written out.

        Returns
        -------
        str
        """
        data = self.model_dump(mode="json")
        return yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=110)

    def with_(self, **parts: Any) -> "Scene":
        """A copy with some settings replaced; parts are merged.

        Parameters
        ----------
        **parts
            Top-level settings; a mapping changes only the settings that it names (of another kind, it
            replaces the part).

        Returns
        -------
        Scene

        Examples
        --------
        >>> Scene.load("demo").with_(light={"bits": 16}).light.bits
        16
        """
        data = self.model_dump()
        for name, value in parts.items():
            old = data.get(name)
            merges = isinstance(value, Mapping) and isinstance(old, dict) and set(value) <= set(old)
            if merges and old is not None and value.get("kind", old.get("kind")) == old.get("kind"):
                value = {**old, **value}
            data[name] = value
        return type(self).from_dict(data)

    def summary(self) -> dict[str, Any]:
        """What to expect: resolution, seeding, coverage; see `wavefield.tank.plan.summary`.

        Returns
        -------
        dict

        Examples
        --------
        >>> Scene.load("demo").summary()["beads_per_block"]
        17.6
        """
        from wavefield.tank.plan import summary

        return summary(self)

    def build_rig(self) -> Rig:
        """Exact cameras.

        Returns
        -------
        Rig
        """
        return self.rig.build()

    def build_sea(self) -> Sea:
        """The sea.

        Returns
        -------
        Sea
        """
        return self.sea.build(self.seed)


def _sentence(error: ValidationError) -> str:
    first = error.errors()[0]
    kinds = {
        "still",
        "single",
        "random",
        "jonswap",
        "power",
        "strings",
        "chessboard",
        "dots",
        "beads",
        "texture",
    }
    place = ".".join(str(part) for part in first["loc"] if part not in kinds and not str(part)[:1].isupper())
    message = first["msg"].removeprefix("Value error, ")
    if first["type"] == "extra_forbidden":
        message = "there is no such setting; check its spelling"
    elif first["type"] == "missing":
        message = "this setting is needed"
    else:
        message = f"{message[0].lower()}{message[1:]} (got {first['input']!r})" if place else message
    return f"{place}: {message}" if place else message
