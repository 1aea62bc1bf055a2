"""Beads: their positions, their motion with the surface water, and their brightness."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from wavefield.tank.scene import Scene
from wavefield.tank.scene_parts import Beads
from wavefield.tank.sea import REMEMBERED_FRAMES, Basin

T = TypeVar("T")


class FrameHistory(Generic[T]):
    """The states of a simulation by frame number; `advance(state, frame)` computes the next state from one.
    Only the first state and the latest few are kept; older ones are computed again from frame 0."""

    def __init__(self, first: T, advance: Callable[[T, int], T]) -> None:
        self._states, self._advance = {0: first}, advance

    def __getitem__(self, frame: int) -> T:
        if frame not in self._states:
            last = max(number for number in self._states if number <= frame)
            for number in range(last, frame):
                self._states[number + 1] = self._advance(self._states[number], number)
                kept = {0, *range(number + 1 - REMEMBERED_FRAMES, number + 2)}
                self._states = {n: state for n, state in self._states.items() if n in kept}
        return self._states[frame]


Array = NDArray[np.float64]
Velocity = Callable[[Array, Array], Array]  # x, y to u, v (and w), (2 or 3, ...), m/s

# Longest time step for beads, s. Over 50 ms of a random sea with waves down to 5 cm it misplaces a bead by
# less than 0.1 um, in a steep sea by 0.4 um.
MAX_SUBSTEP_S = 0.025
GROUP_SIZE = 6  # beads in a cluster
GROUP_SPREAD = 0.002  # standard deviation of their positions in the cluster, m


def runge_kutta(position: Array, h: float, start: Velocity, middle: Velocity, end: Velocity) -> Array:
    """Return positions (2 or 3, ...), m, after one fourth-order Runge-Kutta step of duration h, s.
    `start`, `middle` and `end` are functions of x and y, m, that return the velocity, m/s, at the
    beginning, the middle and the end of the step."""
    k1 = start(position[0], position[1])
    p2 = position + h / 2 * k1
    k2 = middle(p2[0], p2[1])
    p3 = position + h / 2 * k2
    k3 = middle(p3[0], p3[1])
    p4 = position + h * k3
    k4 = end(p4[0], p4[1])
    return position + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def carry(basin: Basin, x: Array, y: Array, start: float, end: float) -> tuple[Array, Array]:
    """Return positions x, y, m, at time `end`, s, of points that drift with the surface water from `start`.
    `end` may be before `start`. Points that leave the basin become NaN."""
    steps = max(1, int(np.ceil(abs(end - start) / MAX_SUBSTEP_S - 1e-9)))
    h = (end - start) / steps
    names = ("u", "v")
    position = np.stack([x, y])
    after = basin.snapshot(start, names)
    for step in range(steps):
        t = start + step * h
        before, middle, after = after, basin.snapshot(t + h / 2, names), basin.snapshot(t + h, names)
        position = runge_kutta(position, h, before, middle, after)
    return position[0], position[1]


def centred_path(carried: Callable[[Array, Array, float], Array], x: Array, y: Array, half: float) -> Array:
    """Return the start and end points, (2, 2 or 3, ...), m, of paths from time -half to half, s.
    The mean of start and end is at x, y, m. `carried(px, py, t)` returns the position at time t of water
    that is at (px, py) at time 0."""
    px, py = x, y
    # correct the position at mid-time until the mean of both ends is the given point
    for _ in range(3):
        start, end = carried(px, py, -half), carried(px, py, half)
        px, py = px + x - (start[0] + end[0]) / 2, py + y - (start[1] + end[1]) / 2
    return np.stack([start, end])


@dataclass(frozen=True)
class BeadField:
    """Positions and brightness of all beads, or of the particles in a light sheet, in one frame."""

    x: Array  # (n,): Positions, metres
    y: Array
    z: Array
    brightness: Array  # (cameras, n): Relative brightness in each camera; 0 where a bead is not visible


class Population:
    """Beads on a rectangle of water with limits x and y, m; a bead that leaves returns on the opposite side.
    A small fraction moves to random places each second, so that the density stays even in long records.
    `cameras` is the number of cameras."""

    def __init__(
        self, scene: Scene, basin: Basin, x: tuple[float, float], y: tuple[float, float], cameras: int
    ) -> None:
        if not isinstance(scene.surface, Beads):
            raise ValueError("this scene has a painted surface, no beads")
        settings = scene.surface
        self._scene, self._basin, self._x, self._y = scene, basin, x, y
        self._renewal = settings.renewal / scene.frame_rate  # fraction per frame
        rng = np.random.default_rng([scene.seed, 1])
        number = round(settings.density * (x[1] - x[0]) * (y[1] - y[0]))
        grouped = int(settings.clustered * number) // GROUP_SIZE * GROUP_SIZE
        px, py = rng.uniform(*x, number), rng.uniform(*y, number)
        centre = np.repeat(np.arange(0, grouped, GROUP_SIZE), GROUP_SIZE)
        px[:grouped] = px[centre] + rng.normal(0.0, GROUP_SPREAD, grouped)
        py[:grouped] = py[centre] + rng.normal(0.0, GROUP_SPREAD, grouped)
        empty = np.zeros(number, bool)
        for hole_x, hole_y, diameter in _holes(scene, settings):
            empty |= (px - hole_x) ** 2 + (py - hole_y) ** 2 < (diameter / 2) ** 2
        count = int(np.sum(~empty))
        brightness = settings.draw_brightness(cameras, count, rng)
        only = rng.integers(0, cameras, count)
        hidden = (rng.uniform(size=count) < settings.one_camera) & (np.arange(cameras)[:, None] != only)
        self._brightness = np.where(hidden, 0.0, brightness)
        self._below = np.zeros(count)  # depth below the surface, m
        if settings.submerged:
            rng = np.random.default_rng([scene.seed, 12])
            below = rng.random(count) < settings.submerged
            self._below = np.where(below, rng.uniform(*settings.submerged_depth, count), 0.0)
        self._frames = FrameHistory(self._field(px[~empty], py[~empty], 0), self._advance)

    def __len__(self) -> int:
        return len(self._frames[0].x)

    def frame(self, frame: int) -> BeadField:
        """Return the beads in a frame, counted from 0. Requests in rising order of frames are fast."""
        return self._frames[frame]

    def _field(self, x: Array, y: Array, frame: int) -> BeadField:
        (z,) = self._basin.snapshot(self._scene.frame_time(frame), ("z",))(x, y)
        return BeadField(x, y, z - self._below, self._brightness)

    def _advance(self, beads: BeadField, frame: int) -> BeadField:
        """Return the beads at frame number `frame` + 1; `beads` are the beads at frame number `frame`."""
        time = self._scene.frame_time
        x, y = carry(self._basin, beads.x, beads.y, time(frame), time(frame + 1))
        for p, (low, high) in ((x, self._x), (y, self._y)):
            p[:] = low + np.mod(p - low, high - low)
        if self._renewal:
            rng = np.random.default_rng([self._scene.seed, 2, frame])
            anew = rng.integers(0, x.size, rng.poisson(self._renewal * x.size))
            x[anew], y[anew] = rng.uniform(*self._x, anew.size), rng.uniform(*self._y, anew.size)
        return self._field(x, y, frame + 1)


def _holes(scene: Scene, settings: Beads) -> Array:
    """Draw random round patches without beads; return their centres x, y and diameters, (n, 3), m."""
    rng = np.random.default_rng([scene.seed, 6])
    places = [
        rng.uniform(0.9 * low + 0.1 * high, 0.1 * low + 0.9 * high, settings.holes)
        for low, high in (scene.grid.x, scene.grid.y)
    ]
    smallest, largest = np.broadcast_to(np.array(settings.hole_diameter), 2)
    return np.stack([*places, rng.uniform(smallest, largest, settings.holes)], axis=1)
