"""Elevation and rise of the surface half-way between two frames, from the six frames around."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.measurement.elevation import Surface
from wavefield.measurement.paths import EVEN_TIMES, FRAMES_OF_Z, frame_weights
from wavefield.measurement.velocity import Motion
from wavefield.variables import AROUND

Float = NDArray[Any]
Mask = NDArray[np.bool_]
Surfaces = Sequence[Surface | None]


@dataclass(frozen=True)
class MidTime:
    """The surface at mid-time of a step."""

    z: Float  # (ny, nx): elevation, metres
    rise: Float  # (ny, nx): rise per step of the surface at the water that is at the node at mid-time, metres
    frames: NDArray[np.uint8]  # (ny, nx): number of frames that z comes from
    measured: Mask  # (ny, nx): whether the nearest two measured the water that is at the node
    # Mean square of z by six frames less that by four, by its median over the nodes, m^2; 0 without six
    departure: float = 0.0


@dataclass(frozen=True)
class StepEstimate:
    """Elevation and motion of one step, from the cameras that are consistent."""

    surfaces: Surfaces  # of six frames
    motion: Motion
    mid_time: MidTime
    left_out: frozenset[str] = frozenset()  # cameras that contradict the others

    @property
    def nearest(self) -> tuple[Surface, Surface]:
        """Surfaces of the step's own two frames."""
        first, second = self.surfaces[AROUND : AROUND + 2]
        assert first is not None
        assert second is not None
        return first, second


def z_by_orders(
    surfaces: Surfaces,
    flow: tuple[float, float],
    x: Float,
    y: Float,
    times: Float = EVEN_TIMES,
    late: Float | None = None,
) -> tuple[Float, ...]:
    """Elevation at mid-time at nodes x, y (ny, nx), metres, from all frames, from fewer, and from two.
    Times of frames, and the delay of each node in them (late, ny, nx), are in frame intervals.
    """
    # a current carries short waves past a node faster than frames follow: in water that moves with it (U, the
    # median displacement) their phase turns no faster than on still water; with z_n = z(x + t_n U), t_n =
    # -5/2 ... 5/2, z = (150 (z_0 + z_1) - 25 (z_-1 + z_2) + 3 (z_-2 + z_3)) / 256, and lower degrees where
    # frames are missing; beads repeat their errors in all frames, so these do not average out
    used = [FRAMES_OF_Z[n] for n in _numbers_of_frames(surfaces)]
    if surfaces[4] is None:
        used = [reversed_in_time(one) for one in used]
    return _interpolated(used, surfaces, flow, x, y, times, late)


def reversed_in_time(frames: Sequence[int]) -> tuple[int, ...]:
    """The frames mirrored in time about mid-time."""
    return tuple(5 - n for n in reversed(frames))


def _interpolated(
    used: Sequence[Sequence[int]],
    surfaces: Surfaces,
    flow: tuple[float, float],
    x: Float,
    y: Float,
    times: Float,
    late: Float | None,
) -> tuple[Float, ...]:
    """Polynomial interpolation to mid-time of surfaces, in a frame that moves with the mean flow."""
    dx, dy = _per_interval(flow, times)
    at: Float | float = 0.0 if late is None else -late
    weights = [frame_weights(times, some, at=at)[0].astype(np.float32) for some in used]
    out: list[Float] = [np.zeros(x.shape, np.float32) for _ in used]
    for n, (t, surface) in enumerate(zip(times.tolist(), surfaces, strict=True)):
        if surface is not None and any(n in some for some in used):
            z = surface.read(x + (t - at) * dx, y + (t - at) * dy)
            for total, one, some in zip(out, weights, used, strict=True):
                if n in some:
                    total += one[n] * z
    return tuple(out)


def _per_interval(flow: tuple[float, float], times: Float) -> tuple[float, float]:
    """Displacement of the water per frame interval, metres, from that over the step."""
    interval = float(times[AROUND + 1] - times[AROUND])
    return flow[0] / interval, flow[1] / interval


def where_measured(
    orders: tuple[Float, ...],
    surfaces: Surfaces,
    flow: tuple[float, float],
    x: Float,
    y: Float,
    times: Float = EVEN_TIMES,
    late: Float | None = None,
) -> tuple[tuple[Float, ...], NDArray[np.uint8], Mask]:
    """Best elevation at each node, the number of frames used, and where the nearest two measured it.
    Fewer frames are used where others have not measured the node. Unmeasured nodes are filled, so z stays
    smooth.
    """
    dx, dy = _per_interval(flow, times)
    # z comes from the others where a frame is absent
    measured = [
        np.ones(x.shape, np.bool_) if surface is None else surface.is_measured(x + t * dx, y + t * dy)
        for t, surface in zip(times.tolist(), surfaces, strict=True)
    ]
    nearest = measured[AROUND] & measured[AROUND + 1]
    numbers = _numbers_of_frames(surfaces)
    out, frames = [orders[-1]], np.full(x.shape, numbers[-1], np.uint8)
    fewer = orders[-1]
    if numbers[0] >= 4:  # at the edge of the view a current leaves one of the neighbours
        before, after = (nearest & measured[n] & ~measured[5 - n] for n in (1, 4))
        if before.any() or after.any():
            one_sided = reversed_in_time(FRAMES_OF_Z[3]), FRAMES_OF_Z[3]
            by_sides = _interpolated(one_sided, surfaces, flow, x, y, times, late)
            fewer = np.where(before, by_sides[0], np.where(after, by_sides[1], fewer))
            frames = np.where(before | after, np.uint8(3), frames)
    for number, z in reversed(list(zip(numbers, orders))[:-1]):
        reach = (number + 1) // 2
        known = ~nearest | np.logical_and.reduce(measured[AROUND + 1 - reach : AROUND + 1 + reach])
        fewer = np.where(known, z, fewer)
        frames = np.where(known, np.uint8(number), frames)
        out.insert(0, fewer)
    return tuple(out), frames, nearest


def rise_of_water(
    first: Surface, second: Surface, motion: Motion, flow: tuple[float, float], x: Float, y: Float
) -> Float:
    """Rise per step, metres, of the surface that moves with the water at nodes x, y (ny, nx) at mid-time.
    z_1(x + c/2 + b) - z_0(x - c/2 + b) + d_z - c_z: c displacement over the step, b bend, d at mid-time.
    """
    measured = np.isfinite(motion.chord).all(axis=0)
    parts = *motion.chord[:2], *motion.bend[:2], motion.d[2] - motion.chord[2]
    # without a measured motion it is that of the mean flow
    elsewhere = *flow, 0.0, 0.0, 0.0
    cx, cy, bx, by, excess = (np.where(measured, part, mean) for part, mean in zip(parts, elsewhere))
    rise = second.read(x + 0.5 * cx + bx, y + 0.5 * cy + by)
    rise = rise - first.read(x - 0.5 * cx + bx, y - 0.5 * cy + by) + excess
    return rise.astype(np.float32)


def slope(z: Float, step: float, axis: int) -> Float:
    """Slope along an axis, by the differences of `wavefield.waves.motion.slopes`."""
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


def _numbers_of_frames(surfaces: Surfaces) -> list[int]:
    """Numbers of frames of the interpolations of z: all, fewer, two."""
    count = frames_used(surfaces)
    return [n for n in (6, 4, 3, 2) if n == count or (n < count and n != 3)]


def frames_used(surfaces: Surfaces) -> int:
    """Number of frames that z at mid-time comes from: 6, 4, 3 or 2."""
    present = [one is not None for one in surfaces]
    if present[1] and present[4]:
        return 6 if present[0] and present[5] else 4
    return 3 if present[1] or present[4] else 2
