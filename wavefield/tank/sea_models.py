"""The seas that a scene can have: still water, one wave, random waves with a given spectrum."""

from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from wavefield.tank.scene_parts import NotNegative, Part, Positive
from wavefield.tank.sea import Sea
from wavefield.water import GAMMA, dispersion

Array = NDArray[np.float64]

MIN_RELATIVE_AMPLITUDE = 1e-6  # of the rms elevation: weaker waves cost as much as others and are not visible


class PlaneWave(Part):
    """A plane wave; in ``added``, one on top of the sea."""

    amplitude: NotNegative = Field(description="m")
    wavelength: Positive = Field(description="m")
    direction: float = Field(default=0.0, description="where it goes, degrees anticlockwise from +x")
    phase: float = Field(default=0.0, description="degrees")

    def components(self) -> tuple[float, float, complex]:
        """Wave vector, rad/m, and complex amplitude, m."""
        k, angle = 2 * np.pi / self.wavelength, np.radians(self.direction)
        amplitude = self.amplitude * np.exp(1j * np.radians(self.phase))
        return float(k * np.cos(angle)), float(k * np.sin(angle)), complex(amplitude)


class _SeaSettings(Part):
    depth: Positive = Field(default=0.7, description="depth of the water, m; .inf for deep water")
    surface_tension: NotNegative = Field(default=GAMMA, description="surface tension over density, m3 s-2")
    current: tuple[float, float] = Field(default=(0.0, 0.0), description="uniform velocity of the water, m/s")
    added: tuple[PlaneWave, ...] = Field(default=(), description="free waves besides")

    def _sea(self, kx: ArrayLike, ky: ArrayLike, amplitude: ArrayLike, bound: int) -> Sea:
        for wave in self.added:
            added_kx, added_ky, added_amplitude = wave.components()
            kx, ky = np.append(kx, added_kx), np.append(ky, added_ky)
            amplitude = np.append(amplitude, added_amplitude)
        waves = np.asarray(kx, float), np.asarray(ky, float), np.asarray(amplitude, complex)
        return Sea(*waves, self.depth, self.surface_tension, self.current, bound)


class StillSea(_SeaSettings):
    """Still water (but for its current)."""

    kind: Literal["still"]

    def build(self, seed: int) -> Sea:
        """Make the sea."""
        return self._sea([1.0], [0.0], [0.0], bound=0)


class SingleWave(PlaneWave, _SeaSettings):
    """One wave."""

    kind: Literal["single"]
    order: Literal[1, 2] = Field(default=1, description="2 adds the bound second harmonic")

    def build(self, seed: int) -> Sea:
        """Make the sea."""
        kx, ky, amplitude = self.components()
        return self._sea([kx], [ky], [amplitude], bound=int(self.order == 2))


class Jonswap(Part):
    """JONSWAP spectrum of the elevation."""

    kind: Literal["jonswap"]
    peak: Positive = Field(description="frequency of the peak, Hz")
    enhancement: Positive = 3.3

    def __call__(self, f: Array) -> Array:
        """Spectrum at frequencies in Hz, to within a factor."""
        width = np.where(f <= self.peak, 0.07, 0.09)
        bump = self.enhancement ** np.exp(-((f / self.peak - 1) ** 2) / (2 * width**2))
        density: Array = f**-5.0 * np.exp(-1.25 * (self.peak / f) ** 4) * bump
        return density


class PowerLaw(Part):
    """Spectrum that falls as a power of the frequency above its peak, as in wave turbulence."""

    kind: Literal["power"]
    peak: Positive = Field(description="frequency of the peak, Hz")
    exponent: Positive = 6.0

    def __call__(self, f: Array) -> Array:
        """Spectrum at frequencies in Hz, to within a factor."""
        return f**-self.exponent * np.exp(-self.exponent / 4 * (self.peak / f) ** 4)


class RandomSea(_SeaSettings):
    """A random sea with a given spectrum."""

    kind: Literal["random"]
    rms: NotNegative = Field(description="standard deviation of the elevation, m")
    spectrum: Annotated[Jonswap | PowerLaw, Field(discriminator="kind")]
    direction: float = Field(default=0.0, description="main direction, degrees anticlockwise from +x")
    spread: NotNegative = Field(
        default=0.0, description="exponent s of cos^2s of half the angle; 0 is isotropic"
    )
    shortest: Positive = Field(default=0.05, description="shortest free wave, m")
    longest: Positive = Field(default=np.inf, description="longest free wave, m")
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
        if self.longest <= self.shortest:
            raise ValueError("longest must be larger than shortest")
        return self

    def build(self, seed: int) -> Sea:
        """Draw a Gaussian sea on a square lattice of wave vectors.
        The density over wave vectors is S(f) (df/dk) D(theta) / k; amplitudes are complex Gaussian.
        """
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
        # so that the elevation is Gaussian and spectra fluctuate as in nature
        real, imaginary = np.random.default_rng([seed, 4]).standard_normal((2, k.size))
        amplitude = np.sqrt(density) * (real + 1j * imaginary)
        amplitude *= self.rms / np.sqrt(0.5 * np.sum(np.abs(amplitude) ** 2))
        strong = np.abs(amplitude) > MIN_RELATIVE_AMPLITUDE * self.rms
        return self._sea(
            kx[strong], ky[strong], amplitude[strong], bound=self.interacting if self.order == 2 else 0
        )
