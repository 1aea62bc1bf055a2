"""Particles in a light sheet, moved by a flow with three velocity components."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wavefield.compiled import compiled
from wavefield.tank.beads import BeadField, FrameHistory, centred_path, runge_kutta
from wavefield.tank.scene import Scene
from wavefield.tank.scene_parts import Sheet
from wavefield.tank.truth import Truth

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

WAVES_OF_FLOW = 48
STRENGTH_SAMPLES = 128  # points along each side of a period at which the rms velocity is computed
SLAB_THICKNESS = 2.0  # thickness of the layer of particles over that of the sheet: 3e-4 of the light is left
MAX_TURN = 0.2  # largest phase change that a particle sees in a sub-step, rad


@dataclass(frozen=True)
class SheetFlow:
    """A steady, random, divergence-free flow, periodic in x and y, that does not vary across the sheet."""

    k: Array  # (n, 2): Wave vectors, rad/m
    along: Complex  # (n,): Amplitudes of the velocity in the plane, perpendicular to k, m/s
    across: Complex  # (n,): Amplitudes of the velocity normal to the plane, m/s

    @classmethod
    def random(cls, settings: Sheet, period: tuple[float, float], seed: int) -> "SheetFlow":
        """Return a random flow with the rms velocities of `settings`.
        Wavelengths are uniform in the logarithm from `settings.shortest` to half the smaller `period`;
        `period` is along x and y, m."""
        rng = np.random.default_rng([seed, 11])
        longest = 0.5 * min(period)
        k = 2 * np.pi / longest * (longest / settings.shortest) ** rng.uniform(0.0, 1.0, WAVES_OF_FLOW)
        angle = rng.uniform(0.0, 2 * np.pi, WAVES_OF_FLOW)
        unit = 2 * np.pi / np.array(period)
        vector = unit * np.round(np.stack([k * np.cos(angle), k * np.sin(angle)], axis=1) / unit)
        vector[np.all(vector == 0, axis=1)] = unit
        along, across = np.exp(1j * rng.uniform(0.0, 2 * np.pi, (2, WAVES_OF_FLOW)))
        # scale to the rms velocity of the settings, which waves with equal vectors would change
        x, y = np.meshgrid(*(np.linspace(0.0, side, STRENGTH_SAMPLES, endpoint=False) for side in period))
        u, v, w = cls(vector, along, across)(x, y)
        along *= settings.speed / np.sqrt(0.5 * np.mean(u**2 + v**2))
        return cls(vector, along, across * (settings.speed_across / np.sqrt(np.mean(w**2))))

    def __call__(self, x: Array, y: Array) -> Array:
        """Return the velocity u, v, w, (3, ...), m/s, at points of any shape, metres."""
        out = np.empty((3, np.size(x)))
        unit = self.k / np.hypot(*self.k.T)[:, None]
        _velocity(np.ravel(x), np.ravel(y), self.k, unit, self.along, self.across, out)
        return out.reshape(3, *np.shape(x))

    def carry(self, x: Array, y: Array, time: float) -> Array:
        """Return the position after `time`, s, of fluid that is now at (x, y), m, in the middle of the sheet.
        The result is x, y and the displacement normal to the sheet, (3, ...), m."""
        fastest = np.hypot(*self.k.T).max() * 2.0 * np.sqrt(np.sum(np.abs(self.along) ** 2))
        steps = max(1, int(np.ceil(abs(time) * fastest / MAX_TURN)))
        position = np.stack([x, y, np.zeros(np.shape(x))])
        for _ in range(steps):
            position = runge_kutta(position, time / steps, self, self, self)
        return position


@compiled(fastmath=True)
def _velocity(
    x: Array,
    y: Array,
    k: Array,
    unit: Array,
    along: NDArray[np.complex128],
    across: NDArray[np.complex128],
    out: Array,
) -> None:
    for p in range(x.size):
        u = v = w = 0.0
        for n in range(along.size):
            phase = k[n, 0] * x[p] + k[n, 1] * y[p]
            c, s = math.cos(phase), math.sin(phase)
            speed = along[n].real * c - along[n].imag * s
            u -= unit[n, 1] * speed
            v += unit[n, 0] * speed
            w += across[n].real * c - across[n].imag * s
        out[0, p], out[1, p], out[2, p] = u, v, w


class Particles:
    """Particles that a flow moves, spread evenly over a layer twice as thick as the light sheet.
    x and y are the limits of the layer, m; particles that leave it return on the opposite side. `cameras`
    is the number of cameras."""

    def __init__(
        self, scene: Scene, settings: Sheet, x: tuple[float, float], y: tuple[float, float], cameras: int
    ) -> None:
        self._settings, self._x, self._y, self._step = settings, x, y, 1.0 / scene.frame_rate
        self.flow = SheetFlow.random(settings, (x[1] - x[0], y[1] - y[0]), scene.seed)
        self._axes, self._origin = plane(settings)
        rng = np.random.default_rng([scene.seed, 12])
        # the density counts particles in light above 1/e^2, the middle half of the layer
        count = round(SLAB_THICKNESS * settings.density * (x[1] - x[0]) * (y[1] - y[0]))
        self._brightness = settings.draw_brightness(cameras, count, rng)
        first = np.stack([rng.uniform(*x, count), rng.uniform(*y, count), rng.random(count)])
        self._places = FrameHistory(first, self._advance)

    def frame(self, frame: int) -> BeadField:
        """Return positions and brightness of the particles in a frame, counted from 0.
        The brightness falls with the distance from the middle of the sheet. Requests in rising order of
        frames are fast."""
        x, y, height = self._places[frame]
        n = (height - 0.5) * SLAB_THICKNESS * self._settings.thickness
        light = np.exp(-8.0 * (n / self._settings.thickness) ** 2)
        px, py, pz = self._axes @ np.stack([x, y, n]) + self._origin[:, None]
        return BeadField(px, py, pz, self._brightness * light)

    def _advance(self, places: Array, frame: int) -> Array:
        """Return the positions (3, n) at frame number `frame` + 1, from `places` at frame number `frame`.
        Positions are x and y, m, and the height in the layer as a fraction of the layer's thickness."""
        x, y, rise = self.flow.carry(places[0], places[1], self._step)
        (x0, x1), (y0, y1) = self._x, self._y
        height = places[2] + rise / (SLAB_THICKNESS * self._settings.thickness)
        return np.stack([x0 + np.mod(x - x0, x1 - x0), y0 + np.mod(y - y0, y1 - y0), np.mod(height, 1.0)])

    def truth(self, x: Array, y: Array, time: float) -> Truth:
        """Return the exact velocities and displacements at grid nodes x, y (ny, nx), m, for one frame step.
        Vectors are along the axes of the sheet and do not depend on `time`, as the flow is steady; z is 0."""
        start, end = centred_path(self.flow.carry, x, y, self._step / 2)
        zero = np.zeros(np.shape(x))
        u, v, w = self.flow(x, y)
        dx, dy, dz = end - start
        return Truth(time, zero, zero, zero, u, v, w, zero, zero, dx, dy, dz)


def plane(settings: Sheet) -> tuple[Array, Array]:
    """Return the axes (3, 3) of a light sheet and its origin (3,), m.
    The columns of the axes are unit vectors along x and y in the sheet and along its normal."""
    bx, by = np.tan(np.radians(settings.tilt))
    normal = np.array([-bx, -by, 1.0]) / np.sqrt(1.0 + bx * bx + by * by)
    x = np.array([1.0, 0.0, bx]) / np.sqrt(1.0 + bx * bx)
    return np.stack([x, np.cross(normal, x), normal], axis=1), np.array([0.0, 0.0, settings.height])
