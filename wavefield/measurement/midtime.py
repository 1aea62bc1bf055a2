"""Elevation and its change per step at mid-time, half-way between two frames, from the six nearest frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.measurement.elevation import Surface
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.paths import FRAMES_OF_Z, frame_weights, middle_row, row_delay
from wavefield.measurement.velocity import Motion
from wavefield.variables import AROUND

Float = NDArray[Any]
Mask = NDArray[np.bool_]
Surfaces = Sequence[Surface | None]


@dataclass(frozen=True)
class MidTime:
    """Elevation of the surface and its change per step, at mid-time, half-way between the two frames."""

    z: Float  # (ny, nx): elevation, metres
    rise: Float  # (ny, nx): rise per step of the particle that is at the node at mid-time, metres
    frames: NDArray[np.uint8]  # (ny, nx): number of frames that z comes from: 6, 4, 3 or 2
    measured: Mask  # (ny, nx): whether both frames of the step were measured there
    # variance over the nodes (robust) of z from six frames minus z from four, m^2; 0 without six frames
    departure: float = 0.0


@dataclass(frozen=True)
class StepEstimate:
    """Elevation and motion in one step, estimated from the cameras that agree with each other."""

    surfaces: Surfaces  # of the six frames around the step
    motion: Motion
    mid_time: MidTime
    left_out: frozenset[str] = frozenset()  # cameras that contradict the others

    @property
    def nearest(self) -> tuple[Surface, Surface]:
        """A tuple: the surfaces in the first and second frame of the step."""
        first, second = self.surfaces[AROUND : AROUND + 2]
        assert first is not None
        assert second is not None
        return first, second


def z_at_mid_time(
    surfaces: Surfaces,
    flow: tuple[float, float],
    x: Float,
    y: Float,
    times: Float,
    late: Float | None = None,
) -> tuple[tuple[Float, ...], NDArray[np.uint8], Mask]:
    """Interpolate z at mid-time, half-way between the frames of a step, at nodes x, y (ny, nx), metres.

    `surfaces` are those of six frames, None if missing; `flow` is the mean displacement (dx, dy) of the water
    per step, metres. `times` (6,) of the frames and `late` (ny, nx), the delay with which rolling shutters
    see a node, are in frame intervals. Returns three results: a tuple of one to three elevations (ny, nx),
    from as many frames as possible first, from two last; the number of frames used for the first of these
    (ny, nx); and a mask (ny, nx), True where both frames of the step were measured.
    """
    # Interpolate in a frame of reference that moves with the mean flow U: a current would carry short waves
    # past a node faster than the frames follow. With z_n = z(x + t_n U) at t_n = -5/2 ... 5/2,
    # z = (150 (z_0 + z_1) - 25 (z_-1 + z_2) + 3 (z_-2 + z_3)) / 256, or a polynomial of lower degree where
    # frames are missing.
    count = frames_used(surfaces)
    numbers = [n for n in (6, 4, 3, 2) if n == count or (n < count and n != 3)]
    used = [FRAMES_OF_Z[n] if surfaces[4] is not None else reversed_in_time(FRAMES_OF_Z[n]) for n in numbers]
    interval = float(times[AROUND + 1] - times[AROUND])
    at: Float | float = 0.0 if late is None else -late
    heights: list[Float | None] = [None] * 6
    measured = [np.ones(x.shape, np.bool_)] * 6
    for n in used[0]:
        surface, ahead = surfaces[n], float(times[n]) - at
        assert surface is not None
        place = x + ahead * (flow[0] / interval), y + ahead * (flow[1] / interval)
        heights[n] = z = surface.read(*place)
        measured[n] = surface.is_measured(*place, z)

    def by(some: Sequence[int]) -> Float:
        """Return z (ny, nx) at mid-time from the polynomial through the frames numbered `some`."""
        weights = frame_weights(times, some, at=at)[0].astype(np.float32)
        total = np.zeros(x.shape, np.float32)
        for n in some:
            total += weights[n] * heights[n]
        return total

    orders = [by(some) for some in used]
    nearest = measured[AROUND] & measured[AROUND + 1]
    fewer, frames = orders[-1], np.full(x.shape, numbers[-1], np.uint8)
    out = [fewer]
    if numbers[0] >= 4:  # at the edge of the view, a current carries the water out of one of the neighbours
        before, after = (nearest & measured[n] & ~measured[5 - n] for n in (1, 4))
        if before.any() or after.any():
            earlier, later = by(reversed_in_time(FRAMES_OF_Z[3])), by(FRAMES_OF_Z[3])
            fewer = np.where(before, earlier, np.where(after, later, fewer))
            frames = np.where(before | after, np.uint8(3), frames)
    for number, z in reversed(list(zip(numbers, orders))[:-1]):
        reach = (number + 1) // 2
        known = ~nearest | np.logical_and.reduce(measured[AROUND + 1 - reach : AROUND + 1 + reach])
        fewer = np.where(known, z, fewer)
        frames = np.where(known, np.uint8(number), frames)
        out.insert(0, fewer)
    return tuple(out), frames, nearest


def reversed_in_time(frames: Sequence[int]) -> tuple[int, ...]:
    """Mirror frame numbers (0 to 5) about mid-time: n becomes 5 - n; the result is in rising order."""
    return tuple(5 - n for n in reversed(frames))


def rise_of_water(
    first: Surface, second: Surface, motion: Motion, flow: tuple[float, float], x: Float, y: Float
) -> Float:
    """Return how much particles rise per step: z_1(x + c/2 + b) - z_0(x - c/2 + b) + d_z - c_z, (ny, nx), m.
    z_0 and z_1 are the `first` and `second` surface. From `motion` come c, the displacement from frame to
    frame; b, the mean position in both frames minus that at mid-time; and d, the velocity at mid-time per
    frame. Where the motion was not measured, c is the mean `flow` (dx, dy), and b and d_z - c_z are 0."""
    measured = np.isfinite(motion.chord).all(axis=0)
    parts = *motion.chord[:2], *motion.bend[:2], motion.d[2] - motion.chord[2]
    # where the motion was not measured, use the mean flow
    elsewhere = *flow, 0.0, 0.0, 0.0
    cx, cy, bx, by, excess = (np.where(measured, part, mean) for part, mean in zip(parts, elsewhere))
    rise = second.read(x + 0.5 * cx + bx, y + 0.5 * cy + by)
    rise = rise - first.read(x - 0.5 * cx + bx, y - 0.5 * cy + by) + excess
    return rise.astype(np.float32)


def slope(z: Float, step: float, axis: int) -> Float:
    """Return the slope of z (ny, nx) along an axis, by differences of sixth order, lower near the edges.
    `step` is the spacing of the nodes, metres."""
    out: Float = np.moveaxis(np.gradient(z, step, axis=axis, edge_order=2), axis, 0)
    rows = np.moveaxis(z, axis, 0)
    for reach, weights in ((2, (8, -1)), (3, (45, -9, 1))):
        count = len(rows) - 2 * reach
        if count > 0:
            total = sum(
                weight * (rows[reach + n : reach + n + count] - rows[reach - n : reach - n + count])
                for n, weight in enumerate(weights, 1)
            )
            scale = 2.0 * step * sum(n * weight for n, weight in enumerate(weights, 1))
            out[reach : reach + count] = total / scale
    return np.moveaxis(out, 0, axis)


def frames_used(surfaces: Surfaces) -> int:
    """Return the number of frames from which z at mid-time can be interpolated: 6, 4, 3 or 2.
    `surfaces` are those of the six frames, None if missing. The middle two, those of the step, must exist."""
    present = [one is not None for one in surfaces]
    if present[1] and present[4]:
        return 6 if present[0] and present[5] else 4
    return 3 if present[1] or present[4] else 2


def lateness(z: Float, geometry: GridGeometry) -> dict[str, Float]:
    """Return how late rolling shutters see the nodes at z (ny, nx), metres, by camera that measures z.
    Delays (ny, nx) are in frame intervals, relative to the middle row of the image."""
    out = {}
    for name in geometry.surface_cameras:
        sight = geometry.sights[name]
        out[name] = row_delay(name, geometry) * (sight.position(z)[1] - middle_row(sight))
    return out


def common_lateness(z: Float, geometry: GridGeometry) -> Float | None:
    """Return the delays from `lateness`, averaged over cameras, (ny, nx); None for global shutters."""
    if not geometry.settings.row_delays:
        return None
    return np.asarray(np.mean(list(lateness(z, geometry).values()), axis=0))


def elevation_errors(z: Float, d: Float, geometry: GridGeometry) -> tuple[Float, Float]:
    """Return a tuple of errors due to rolling shutters, metres: of z (ny, nx), of position x, y (2, ny, nx).
    d (3, ny, nx), metres, is the motion per step. Camera n, whose delay is tau_n, sees a point displaced by
    tau_n (d_xy - D_n d_z), with the slope D_n of its sight line."""
    late = lateness(z, geometry)
    mean = np.mean(list(late.values()), axis=0)
    shift, slope = {}, {}
    for name, tau in late.items():
        slope[name] = np.stack(geometry.rig[name].sight_line(geometry.x, geometry.y, z))
        shift[name] = (tau - mean) * (d[:2] - slope[name] * d[2])
    # a difference between the two cameras of a pair appears as an elevation
    along = square = np.float32(0.0)
    for a, b in geometry.pairs:
        parallax = slope[b] - slope[a]
        along = along - np.sum(parallax * (shift[b] - shift[a]), axis=0)
        square = square + np.sum(np.square(parallax), axis=0)
    error = along / square
    return np.asarray(error), np.asarray(shift[geometry.reference] + slope[geometry.reference] * error)


def without_shutters(z: Float, motion: Motion, geometry: GridGeometry) -> Float:
    """Return the elevation z (ny, nx), metres, corrected for the errors that rolling shutters cause."""
    measured = np.isfinite(motion.d).all(axis=0)
    error, (x, y) = elevation_errors(z, np.where(measured, motion.d, 0.0), geometry)
    z_y, z_x = (slope(z, geometry.grid.step, axis) for axis in (0, 1))
    return np.asarray((z + x * z_x + y * z_y - error).astype(np.float32))
