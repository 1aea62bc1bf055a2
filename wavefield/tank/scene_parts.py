"""The parts of a scene: every setting of a simulated experiment, with its unit and its limits."""

from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, ConfigDict, Field, model_validator

from wavefield.config_files import ConfigSection
from wavefield.rig import Rig
from wavefield.tank import rigs
from wavefield.tank.sea import Sea
from wavefield.water import GAMMA, dispersion

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Limits = tuple[float, float]


def _rising(limits: Limits) -> Limits:
    if limits[1] < limits[0]:
        raise ValueError("the smaller value comes first")
    return limits


class Part(ConfigSection):
    """Base class of the parts of a scene; its settings are validated and cannot be changed afterwards."""

    model_config = ConfigDict(allow_inf_nan=True)  # deep water has depth .inf


class PaperRig(Part):
    """The cameras of Aubourg et al. (2019): all three, only the two oblique ones, or all and a fourth."""

    cameras: Literal[2, 3, 4] = 3
    scale: Annotated[float, Field(gt=0, le=2)] = Field(default=1.0, description="image size over full size")
    crop: Annotated[float, Field(gt=0, le=1)] = Field(default=1.0, description="share of the sensor read out")

    def build(self) -> Rig:
        """Return the exact cameras of Aubourg et al. (2019) with these settings."""
        return rigs.paper_rig(self.scale, self.crop, self.cameras)


class SheetRig(Part):
    """Cameras around a light sheet: one on each side and, with three cameras, a vertical one between."""

    cameras: Literal[2, 3] = 2
    angle: Annotated[float, Field(ge=5, le=70)] = Field(
        default=35.0, description="angle of the outer cameras from the vertical, degrees"
    )
    distance: Positive = Field(default=1.0, description="distance from the middle of the sheet, m")
    pixel: Positive = Field(default=2e-4, description="size of a pixel on the sheet, m")
    size: tuple[int, int] = Field(default=(800, 600), description="width and height of the images, px")

    def build(self) -> Rig:
        """Return the exact cameras around the light sheet."""
        return rigs.sheet_rig(self.cameras, self.angle, self.distance, self.pixel, self.size)


class PlatformRig(Part):
    """Two cameras side by side on a platform at sea; they look towards +y, the horizon in view."""

    height: Positive = Field(description="height of the cameras above the sea, m")
    baseline: Positive = Field(default=2.5, description="distance between the cameras, m")
    pitch: Annotated[float, Field(gt=0, lt=90)] = Field(
        default=20.0, description="angle of the optical axes below the horizontal, degrees"
    )
    focal: Positive = Field(default=750.0, description="focal length, px")
    size: tuple[int, int] = Field(default=(800, 600), description="width and height of the images, px")

    def build(self) -> Rig:
        """Return the two exact cameras on the platform."""
        return rigs.platform_rig(self.height, self.baseline, self.pitch, self.focal, self.size)


class RigFile(Part):
    """Cameras read from a rig file."""

    file: str = Field(description="a rig as YAML; relative to the scene file")

    def build(self) -> Rig:
        """Return the cameras that the rig file describes."""
        return Rig.load(self.file)


class Spots(Part):
    """Settings: how bright beads or particles are in the simulated images."""

    brightness: Positive = Field(default=110.0, description="mean height of a spot, grey levels of 255")
    spread: NotNegative = Field(default=0.35, description="relative spread of brightness over beads")
    spread_between: NotNegative = Field(default=0.15, description="relative spread of a bead between cameras")

    def draw_brightness(self, cameras: int, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """Draw random values of the relative brightness of `count` beads in each camera, (cameras, count)."""
        # gamma distribution: most beads are similar, a few bright, none negative
        own = rng.gamma(self.spread**-2, self.spread**2, count) if self.spread else np.ones(count)
        return own * np.exp(rng.normal(0.0, self.spread_between, (cameras, count)))


class Beads(Spots):
    """Floating beads: their number, size, brightness, and irregularities such as groups and holes."""

    kind: Literal["beads"] = "beads"
    density: Positive = Field(default=1.1e4, description="beads per m2; 1.1e4 is 17.6 per 4 x 4 cm")
    diameter: NotNegative = Field(default=0.7e-3, description="m")
    one_camera: Share = Field(default=0.0, description="share of beads that only one camera sees")
    clustered: Share = Field(default=0.0, description="share of beads in groups of six within 8 mm")
    holes: Annotated[int, Field(ge=0)] = Field(default=0, description="number of round places without beads")
    hole_diameter: Positive | Annotated[tuple[Positive, Positive], AfterValidator(_rising)] = Field(
        default=0.10, description="m; two values: drawn evenly between them"
    )
    renewal: Share = Field(default=0.005, description="share of beads laid anew per second")
    submerged: Share = Field(default=0.0, description="share of beads that float below the surface")
    submerged_depth: Annotated[tuple[Positive, Positive], AfterValidator(_rising)] = Field(
        default=(2e-3, 1e-2), description="depth of these beads, drawn evenly, m (no refraction)"
    )


class Texture(Part):
    """White noise painted on the water surface, as in a test by Aubourg et al. (2019)."""

    kind: Literal["texture"] = "texture"
    mesh: Positive | None = Field(default=None, description="size of the grains, m; by default 1.5 pixels")
    contrast: Positive = Field(default=40.0, description="standard deviation, grey levels of 255")
    mean: NotNegative = Field(default=120.0, description="grey levels of 255")
    carried: bool = Field(default=False, description="moves with the water, or only up and down with it")


class SeaSurface(Part):
    """The open sea by daylight: water that reflects the sky according to its slope, ripples, and foam."""

    kind: Literal["sea"] = "sea"
    mesh: Positive = Field(default=0.08, description="size of the finest grains of ripples and foam, m")
    ripple_slope: NotNegative = Field(default=0.12, description="rms slope of ripples, by which they shade")
    water: NotNegative = Field(default=20.0, description="light from below the surface, grey levels of 255")
    sky: NotNegative = Field(default=200.0, description="the sky at the horizon, grey levels of 255")
    foam: NotNegative = Field(default=190.0, description="brightness of foam, grey levels of 255")
    foam_threshold: float = Field(default=2.0, description="foam is where its texture exceeds this (in std)")


class Sheet(Spots):
    """Particles in a light sheet and their flow, in place of a water surface; the sea must be still."""

    kind: Literal["sheet"] = "sheet"
    thickness: Positive = Field(default=1e-3, description="where light is above 1/e2 of its peak, m")
    height: float = Field(default=0.0, description="height of its middle above the target's plane, m")
    tilt: tuple[float, float] = Field(
        default=(0.0, 0.0), description="tilt against the target's plane along x and y, degrees"
    )
    density: Positive = Field(default=6e5, description="particles in the sheet per m2")
    diameter: NotNegative = Field(default=1e-4, description="m")
    speed: NotNegative = Field(default=0.015, description="rms of u and of v, m/s")
    speed_across: NotNegative = Field(default=0.003, description="rms of w, m/s")
    shortest: Positive = Field(default=0.03, description="shortest wavelength of the flow, m")


class Light(Part):
    """Settings of light and sensors: blur, illumination, gain, noise and bits of the images."""

    blur: Positive = Field(default=0.62, description="standard deviation of a point's image, px")
    background: NotNegative = Field(default=12.0, description="grey levels of 255")
    unevenness: NotNegative = Field(default=0.3, description="relative difference of light across an image")
    flicker: NotNegative = Field(default=0.0, description="relative rms change of light from frame to frame")
    gain: dict[str, Positive] = Field(default_factory=dict, description="camera: factor on its grey levels")
    read_noise: NotNegative = Field(default=1.2, description="grey levels of 255")
    shot_noise: NotNegative = Field(default=0.04, description="variance per grey level, grey levels of 255")
    bits: Literal[8, 16] = 8


class Timing(Part):
    """Errors of the times at which the cameras take their frames."""

    jitter: NotNegative = Field(
        default=0.0, description="rms error of a frame's time, common to all cameras, s (beads only)"
    )


class Fault(Part):
    """Faults of one camera while it records: its images are shifted, late or blurred, for example.
    Its target images are correct."""

    mirrored: bool = Field(default=False, description="columns in reverse order")
    shows: str | None = Field(default=None, description="the camera whose images come under its name")
    late: Annotated[int, Field(ge=0)] = Field(
        default=0, description="frames behind the others; at the start it repeats its first image"
    )
    shift: tuple[float, float] = Field(
        default=(0.0, 0.0), description="columns and rows by which its picture has moved, px"
    )
    defocus: NotNegative = Field(default=0.0, description="standard deviation added to the blur, px")
    delay: float = Field(default=0.0, description="s by which its frames are taken later (beads only)")
    row_time: NotNegative = Field(
        default=0.0,
        description="s from row to row of a rolling shutter; the middle row is on time (beads only)",
    )
    turned: tuple[float, float, float] = Field(
        default=(0.0, 0.0, 0.0), description="rotation vector in its own axes, degrees (beads only)"
    )
    since: Annotated[int, Field(ge=0)] = Field(default=0, description="frame from which it is turned")


class Strings(Part):
    """A target that is a grid of white strings, as in Aubourg et al. (2019)."""

    kind: Literal["strings"] = "strings"
    mesh: Positive = Field(default=0.10, description="distance between strings, m")
    width: Positive = Field(default=3e-3, description="width of a string, m")
    half: Annotated[int, Field(ge=2)] = Field(
        default=10, description="strings beside the middle one, each side"
    )
    origin_disc: Positive = Field(default=0.036, description="diameter of the disc at the origin, m")
    x_disc: Positive = Field(default=0.022, description="diameter of the disc at the next crossing, m")
    brightness: Positive = Field(default=150.0, description="grey levels of 255")


class Chessboard(Part):
    """A target that is a chessboard centred on the origin."""

    kind: Literal["chessboard"]
    mesh: Positive = Field(default=0.08, description="side of a square, m")
    shape: tuple[int, int] = Field(default=(11, 8), description="inner corners along x and y")
    brightness: Positive = 150.0


class Dots(Part):
    """A target that is a regular grid of white dots on a dark plate, centred on the origin."""

    kind: Literal["dots"]
    mesh: Positive = Field(default=0.08, description="distance between dots, m")
    shape: tuple[int, int] = Field(default=(11, 8), description="dots along x and y")
    diameter: Positive = Field(default=0.02, description="m")
    brightness: Positive = 150.0


class CalibrationScene(Part):
    """The calibration target and the poses (positions of it) in which the cameras photograph it."""

    target: Annotated[Strings | Chessboard | Dots, Field(discriminator="kind")] = Strings()
    tilted: Annotated[int, Field(ge=0)] = Field(default=6, description="number of tilted poses")
    tilt: Positive = Field(default=20.0, description="largest tilt, degrees")
    level: float = Field(default=0.0, description="height of the flat target above still water, m")


class Probes(Part):
    """Wave probes, which measure the elevation at fixed positions."""

    rate: Positive = Field(default=100.0, description="Hz")
    positions: dict[str, tuple[float, float]] = Field(
        default_factory=lambda: {"probe1": (-0.25, 0.1), "probe2": (0.2, -0.15)}, description="x, y, m"
    )
    noise: NotNegative = Field(default=1e-4, description="rms, m")


Array = NDArray[np.float64]

MIN_RELATIVE_AMPLITUDE = 1e-6  # waves below this fraction of the rms elevation are left out, to save time


class PlaneWave(Part):
    """A plane wave of given amplitude, wavelength, direction and phase.
    The setting ``added`` of a sea adds such waves to it."""

    amplitude: NotNegative = Field(description="m")
    wavelength: Positive = Field(description="m")
    direction: float = Field(default=0.0, description="direction of travel, degrees anticlockwise from +x")
    phase: float = Field(default=0.0, description="phase of the wave, degrees")

    def components(self) -> tuple[float, float, complex]:
        """Return kx and ky, rad/m, and the complex amplitude of the elevation, m, of the wave."""
        k, angle = 2 * np.pi / self.wavelength, np.radians(self.direction)
        amplitude = self.amplitude * np.exp(1j * np.radians(self.phase))
        return float(k * np.cos(angle)), float(k * np.sin(angle)), complex(amplitude)


class _SeaSettings(Part):
    """Settings that all kinds of sea have: depth, surface tension, current and added plane waves."""

    depth: Positive = Field(default=0.7, description="depth of the water, m; .inf for deep water")
    surface_tension: NotNegative = Field(default=GAMMA, description="surface tension over density, m3 s-2")
    current: tuple[float, float] = Field(default=(0.0, 0.0), description="uniform velocity of the water, m/s")
    added: tuple[PlaneWave, ...] = Field(default=(), description="further free waves on top")

    def _sea(self, kx: ArrayLike, ky: ArrayLike, amplitude: ArrayLike, bound: int) -> Sea:
        for wave in self.added:
            added_kx, added_ky, added_amplitude = wave.components()
            kx, ky = np.append(kx, added_kx), np.append(ky, added_ky)
            amplitude = np.append(amplitude, added_amplitude)
        waves = np.asarray(kx, float), np.asarray(ky, float), np.asarray(amplitude, complex)
        return Sea(*waves, self.depth, self.surface_tension, self.current, bound)


class StillSea(_SeaSettings):
    """Water without waves other than those in ``added``; it may have a current."""

    kind: Literal["still"]

    def build(self, seed: int) -> Sea:
        """Return a sea that contains only the added waves; `seed` has no effect."""
        return self._sea([1.0], [0.0], [0.0], bound=0)


class SingleWave(PlaneWave, _SeaSettings):
    """A sea with one plane wave and, optionally, its second harmonic."""

    kind: Literal["single"]
    order: Literal[1, 2] = Field(default=1, description="2 adds the second harmonic bound to the wave")

    def build(self, seed: int) -> Sea:
        """Return a sea with this wave and the added ones; `seed` has no effect."""
        kx, ky, amplitude = self.components()
        return self._sea([kx], [ky], [amplitude], bound=int(self.order == 2))


class Jonswap(Part):
    """JONSWAP spectrum of the elevation (Hasselmann et al. 1973)."""

    kind: Literal["jonswap"]
    peak: Positive = Field(description="frequency of the peak, Hz")
    enhancement: Positive = 3.3

    def __call__(self, f: Array) -> Array:
        """Return the spectrum, in arbitrary units, at frequencies f, Hz, of any shape."""
        width = np.where(f <= self.peak, 0.07, 0.09)
        bump = self.enhancement ** np.exp(-((f / self.peak - 1) ** 2) / (2 * width**2))
        density: Array = f**-5.0 * np.exp(-1.25 * (self.peak / f) ** 4) * bump
        return density


class PowerLaw(Part):
    """Spectrum that decays as a power of the frequency above its peak, as in wave turbulence."""

    kind: Literal["power"]
    peak: Positive = Field(description="frequency of the peak, Hz")
    exponent: Positive = 6.0

    def __call__(self, f: Array) -> Array:
        """Return the spectrum, in arbitrary units, at frequencies f, Hz, of any shape."""
        return f**-self.exponent * np.exp(-self.exponent / 4 * (self.peak / f) ** 4)


class RandomSea(_SeaSettings):
    """A random sea with a given spectrum, directional spread and standard deviation of the elevation."""

    kind: Literal["random"]
    rms: NotNegative = Field(description="standard deviation of the elevation, m")
    spectrum: Annotated[Jonswap | PowerLaw, Field(discriminator="kind")]
    direction: float = Field(default=0.0, description="main direction, degrees anticlockwise from +x")
    spread: NotNegative = Field(default=0.0, description="exponent s of cos^2s(angle / 2); 0: isotropic")
    shortest: Positive = Field(default=0.05, description="shortest free wave, m")
    longest: Positive = Field(default=np.inf, description="longest free wave, m")
    period: Positive = Field(default=6.0, description="the sea repeats itself after this distance, m")
    order: Literal[1, 2] = Field(default=1, description="2 adds the waves bound to the steepest free ones")
    interacting: Annotated[int, Field(ge=2, le=2000)] = Field(
        default=300, description="number of free waves (the steepest) that get bound waves, with order 2"
    )

    @model_validator(mode="after")
    def _check(self) -> "RandomSea":
        if self.shortest * 4 > self.period:
            raise ValueError("period must be at least four times the shortest wave")
        if self.longest <= self.shortest:
            raise ValueError("longest must be larger than shortest")
        return self

    def build(self, seed: int) -> Sea:
        """Return a Gaussian sea of waves on a square lattice of wave vectors; `seed` draws random amplitudes.
        Mean squared amplitudes are proportional to S(f) (df/dk) D / k and scaled to the standard deviation
        `rms`; S is the spectrum, D the directional distribution, f the frequency and k the wavenumber."""
        dk = 2 * np.pi / self.period
        n = int(self.period / self.shortest)
        lattice = np.arange(-n, n + 1) * dk
        kx, ky = (a.ravel() for a in np.meshgrid(lattice, lattice))
        k = np.hypot(kx, ky)
        highest, lowest = 2 * np.pi / self.shortest, 2 * np.pi / self.longest
        in_band = (k > 0) & (k <= highest * (1 + 1e-9)) & (k >= lowest * (1 - 1e-9))
        kx, ky, k = kx[in_band], ky[in_band], k[in_band]
        frequency = dispersion(k, self.depth, self.surface_tension) / (2 * np.pi)
        nudge = 1e-6 * k
        slope = dispersion(k + nudge, self.depth, self.surface_tension) / (2 * np.pi) - frequency
        angle = np.arctan2(ky, kx) - np.radians(self.direction)
        directional = np.cos(angle / 2) ** (2 * self.spread)
        density = self.spectrum(frequency) * (slope / nudge) / k * directional
        # complex Gaussian amplitudes make the elevation Gaussian, with spectra that fluctuate as in nature
        real, imaginary = np.random.default_rng([seed, 4]).standard_normal((2, k.size))
        amplitude = np.sqrt(density) * (real + 1j * imaginary)
        amplitude *= self.rms / np.sqrt(0.5 * np.sum(np.abs(amplitude) ** 2))
        strong = np.abs(amplitude) > MIN_RELATIVE_AMPLITUDE * self.rms
        return self._sea(
            kx[strong], ky[strong], amplitude[strong], bound=self.interacting if self.order == 2 else 0
        )
