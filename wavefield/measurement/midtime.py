"""Elevation and rise of the surface half-way between two frames, from the six frames around."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.measurement.elevation import Surface
from wavefield.measurement.velocity import Motion

Float = NDArray[Any]
Surfaces = Sequence[Surface | None]

F = np.float32

# what each of the six frames weighs in z at mid-time, by the number of frames that are used
_WEIGHTS = {
    6: np.array([3, -25, 150, 150, -25, 3], F) / F(256),
    4: np.array([0, -1, 9, 9, -1, 0], F) / F(16),
    3: np.array([0, 0, 3, 6, -1, 0], F) / F(8),  # turned where the frame before is there
    2: np.array([0, 0, 1, 1, 0, 0], F) / F(2),
}


@dataclass(frozen=True)
class MidTime:
    """Surface at mid-time of a step."""

    z: Float  # (ny, nx): Elevation and its standard uncertainty, metres
    std: Float
    rise: Float  # (ny, nx): Rise per step of the surface at the water that is at the node at mid-time, metres


def at_mid_time(surfaces: Surfaces, moved: Motion, x: Float, y: Float) -> MidTime:
    """Surface at mid-time.

    A current sweeps short waves past a node faster than frames can follow; beside the water they turn no
    faster than on still water. So z is interpolated in time in a frame that moves with the mean flow U, the
    median of the displacements over the field, and coincides with the grid at mid-time: of z_n = z(x + t_n U)
    in frame n, t_n = -5/2 ... 5/2,

        z = (150 (z_0 + z_1) - 25 (z_-1 + z_2) + 3 (z_-2 + z_3)) / 256,

    a polynomial of fifth degree through six frames; without one of the outermost (9 (z_0 + z_1) - z_-1 -
    z_2) / 16, a cubic through four. Where a neighbour is missing a parabola serves, (3 z_0 + 6 z_1 - z_2) /
    8; where both are, the mean.

    The rise follows the water itself. With c its displacement over the step and b the bend of its path, it is
    at x_0 = x - c/2 + b in the first frame and at x_1 = x + c/2 + b in the second, and stays on the surface:
    z_1(x_1) - z_0(x_0) is c_z, to whatever size of displacements. What the displacement at mid-time rises
    more than c_z is added, so that the rise changes with w.

    The same beads in the same places err the same way in all frames, so their errors do not average out.

    With x, y (ny, nx), metres.
    """
    first, second = surfaces[2:4]
    assert first is not None
    assert second is not None
    weights = _WEIGHTS[frames_used(surfaces)]
    if surfaces[4] is None:
        weights = weights[::-1]
    seen = np.isfinite(moved.chord).all(axis=0)
    dx, dy = (float(np.median(part[seen])) if seen.any() else 0.0 for part in moved.chord[:2])
    z: Float = np.zeros(x.shape, F)
    for n, (surface, weight) in enumerate(zip(surfaces, weights, strict=True)):
        if surface is not None and weight:
            z += weight * surface.read(x + (n - 2.5) * dx, y + (n - 2.5) * dy)
    cx, cy, bx, by, faster = (
        np.where(seen, part, instead)
        for part, instead in zip(
            (*moved.chord[:2], *moved.bend[:2], moved.d[2] - moved.chord[2]), (dx, dy, 0.0, 0.0, 0.0)
        )
    )
    rise = second.read(x + 0.5 * cx + bx, y + 0.5 * cy + by) - first.read(
        x - 0.5 * cx + bx, y - 0.5 * cy + by
    )
    return MidTime(z, F(0.5) * (first.std + second.std), (rise + faster).astype(F))


def slope(z: Float, step: float, axis: int) -> Float:
    """Slope along an axis, by the differences of `wavefield.waves.nonlinear.kinematics.slopes`."""
    out: Float = np.gradient(z, step, axis=axis, edge_order=2)
    for reach, weights in ((2, (8, -1)), (3, (45, -9, 1))):
        rows = z.shape[axis] - 2 * reach
        if rows > 0:
            total = sum(
                weight * (_rows(z, reach + n, rows, axis) - _rows(z, reach - n, rows, axis))
                for n, weight in enumerate(weights, 1)
            )
            scale = 2.0 * step * sum(n * weight for n, weight in enumerate(weights, 1))
            _rows(out, reach, rows, axis)[:] = total / scale
    return out


def _rows(field: Float, first: int, count: int, axis: int) -> Float:
    """So many rows of a field along an axis, from a row on."""
    return field[(slice(None),) * axis + (slice(first, first + count),)]


def frames_used(surfaces: Surfaces) -> int:
    """Number of frames that z at mid-time comes from: 6, 4, 3 or 2."""
    there = [one is not None for one in surfaces]
    if there[1] and there[4]:
        return 6 if there[0] and there[5] else 4
    return 3 if there[1] or there[4] else 2
