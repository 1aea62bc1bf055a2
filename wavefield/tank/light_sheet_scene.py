"""Particles in a light sheet, carried by a flow with three components: where they are in every frame."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wavefield.compiled import compiled
from wavefield.tank import scene_parts
from wavefield.tank.beads import BeadField
from wavefield.tank.truth import Truth

Array = NDArray[np.float64]

_WAVES = 48  # of the flow
_SAMPLES = 128  # along each side of a period: where its strength is looked at
_SLAB = 2.0  # thicknesses: height of the layer that holds the particles; light is 3e-4 at its faces
_LONGEST_TURN = 0.2  # rad: that a wave of the flow may turn in a sub-step


@dataclass(frozen=True)
class SheetFlow:
    """A steady flow that repeats itself in x and y and is alike across the sheet; free of divergence."""

    k: Array  # (n, 2): Wave vectors, rad/m
    # (n,): Amplitudes of the velocity in the sheet, at right angles to k, and across it, m/s
    along: NDArray[np.complex128]
    across: NDArray[np.complex128]

    @classmethod
    def random(cls, settings: scene_parts.Sheet, period: tuple[float, float], seed: int) -> "SheetFlow":
        """Draw a flow: as much of it at every wavelength from half the period down to the shortest."""
        rng = np.random.default_rng([seed, 11])
        longest = 0.5 * min(period)
        k = 2 * np.pi / longest * (longest / settings.shortest) ** rng.uniform(0.0, 1.0, _WAVES)
        angle = rng.uniform(0.0, 2 * np.pi, _WAVES)
        unit = 2 * np.pi / np.array(period)
        vector = unit * np.round(np.stack([k * np.cos(angle), k * np.sin(angle)], axis=1) / unit)
        vector[np.all(vector == 0, axis=1)] = unit
        along, across = np.exp(1j * rng.uniform(0.0, 2 * np.pi, (2, _WAVES)))
        # as strong as wanted in every flow, however waves of one place meet
        x, y = np.meshgrid(*(np.linspace(0.0, side, _SAMPLES, endpoint=False) for side in period))
        u, v, w = cls(vector, along, across)(x, y)
        along *= settings.speed / np.sqrt(0.5 * np.mean(u**2 + v**2))
        return cls(vector, along, across * (settings.speed_across / np.sqrt(np.mean(w**2))))

    def __call__(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """Velocity at points of any shape, m/s."""
        out = np.empty((3, np.size(x)))
        unit = self.k / np.hypot(*self.k.T)[:, None]
        _velocity(np.ravel(x), np.ravel(y), self.k, unit, self.along, self.across, out)
        u, v, w = out.reshape(3, *np.shape(x))
        return u, v, w

    def carry(self, x: Array, y: Array, time: float) -> tuple[Array, Array, Array]:
        """Where the fluid at (x, y) is after a time, and by how much it has risen: x, y, dz, metres."""
        fastest = np.hypot(*self.k.T).max() * 2.0 * np.sqrt(np.sum(np.abs(self.along) ** 2))
        steps = max(1, int(np.ceil(abs(time) * fastest / _LONGEST_TURN)))
        h, rise = time / steps, np.zeros(np.shape(x))
        for _ in range(steps):
            u1, v1, w1 = self(x, y)
            u2, v2, w2 = self(x + h / 2 * u1, y + h / 2 * v1)
            u3, v3, w3 = self(x + h / 2 * u2, y + h / 2 * v2)
            u4, v4, w4 = self(x + h * u3, y + h * v3)
            x = x + h / 6 * (u1 + 2 * u2 + 2 * u3 + u4)
            y = y + h / 6 * (v1 + 2 * v2 + 2 * v3 + v4)
            rise = rise + h / 6 * (w1 + 2 * w2 + 2 * w3 + w4)
        return x, y, rise


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
    """Particles in and beside a light sheet, frame after frame.

    They fill a layer twice as thick as the sheet evenly; what leaves it comes back on the other side, dark
    there, so that particles enter the light and leave it as they do in a flow.

    With x, y, metres.
    """

    def __init__(
        self,
        settings: scene_parts.Sheet,
        x: tuple[float, float],
        y: tuple[float, float],
        cameras: int,
        frame_rate: float,
        seed: int,
    ) -> None:
        self.settings, self._x, self._y, self._step = settings, x, y, 1.0 / frame_rate
        self.flow = SheetFlow.random(settings, (x[1] - x[0], y[1] - y[0]), seed)
        self._axes, self._origin = plane(settings)
        rng = np.random.default_rng([seed, 12])
        # density counts those whose light is above 1/e^2: in the middle half of the layer
        count = round(_SLAB * settings.density * (x[1] - x[0]) * (y[1] - y[0]))
        self._own = rng.gamma(settings.spread**-2, settings.spread**2, count)
        self._own = self._own * np.exp(rng.normal(0.0, settings.spread_between, (cameras, count)))
        self._places = {0: np.stack([rng.uniform(*x, count), rng.uniform(*y, count), rng.random(count)])}

    def frame(self, frame: int) -> BeadField:
        """Particles in one frame, from 0; ask in rising order: the last places are kept."""
        if frame not in self._places:
            last = max(number for number in self._places if number <= frame)
            for number in range(last, frame):
                self._places[number + 1] = self._advance(self._places[number])
            kept = {0, *range(frame - 8, frame + 1)}
            self._places = {number: p for number, p in self._places.items() if number in kept}
        x, y, height = self._places[frame]
        n = (height - 0.5) * _SLAB * self.settings.thickness
        light = np.exp(-8.0 * (n / self.settings.thickness) ** 2)
        px, py, pz = self._axes @ np.stack([x, y, n]) + self._origin[:, None]
        return BeadField(px, py, pz, self._own * light)

    def _advance(self, places: Array) -> Array:
        x, y, rise = self.flow.carry(places[0], places[1], self._step)
        (x0, x1), (y0, y1) = self._x, self._y
        height = places[2] + rise / (_SLAB * self.settings.thickness)
        return np.stack([x0 + np.mod(x - x0, x1 - x0), y0 + np.mod(y - y0, y1 - y0), np.mod(height, 1.0)])

    def truth(self, x: Array, y: Array, time: float) -> Truth:
        """Exact fields of one step at nodes in the sheet, in its own frame.

        With x, y (ny, nx), metres.
        """
        u, v, w = self.flow(x, y)
        zero = np.zeros(np.shape(x))
        px, py = x, y
        for _ in range(3):
            ax, ay, below = self.flow.carry(px, py, -self._step / 2)
            bx, by, above = self.flow.carry(px, py, self._step / 2)
            px, py = px + x - (ax + bx) / 2, py + y - (ay + by) / 2
        moved = bx - ax, by - ay, above - below
        return Truth(time, zero, zero, zero, u, v, w, zero, zero, *moved)


def plane(settings: scene_parts.Sheet) -> tuple[Array, Array]:
    """Where the sheet lies: its axes as columns, x above the rig's own x, and its origin, metres."""
    bx, by = np.tan(np.radians(settings.tilt))
    normal = np.array([-bx, -by, 1.0]) / np.sqrt(1.0 + bx * bx + by * by)
    x = np.array([1.0, 0.0, bx]) / np.sqrt(1.0 + bx * bx)
    return np.stack([x, np.cross(normal, x), normal], axis=1), np.array([0.0, 0.0, settings.height])
