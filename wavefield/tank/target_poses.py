"""Where a calibration target is held."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wavefield.rig import Camera
from wavefield.tank.scene_parts import Chessboard, Dots

Array = NDArray[np.float64]

SHARES_OF_MOTION = (1.0, 0.8, 0.6, 0.4, 0.2, 0.0)  # tried in this order until a board is in view


@dataclass(frozen=True)
class Pose:
    """Position of a target: a point p of the target is at ``rotation @ p + origin``."""

    rotation: Array  # (3, 3): Target to physical frame
    origin: Array  # (3,): Position of the target's origin, metres


def poses(number: int, tilt: float, x: tuple[float, float], y: tuple[float, float], seed: int) -> list[Pose]:
    """Poses of a target held by hand in the field of view, tilted by degrees."""
    rng = np.random.default_rng([seed, 8])
    size = min(x[1] - x[0], y[1] - y[0])
    out = []
    for i in range(number):
        towards = 2 * np.pi * (i + rng.uniform(-0.2, 0.2)) / number + 0.4
        angle = np.radians(tilt) * rng.uniform(0.8, 1.0)
        about_x, about_y = angle * np.sin(towards), 0.75 * angle * np.cos(towards)
        turn = np.radians(rng.uniform(-8, 8))
        centre = np.array([rng.uniform(-0.08, 0.08) * size, rng.uniform(-0.08, 0.08) * size, 0.0])
        centre += [0.5 * (x[0] + x[1]), 0.5 * (y[0] + y[1]), (0.02 + 0.22 * i / max(number - 1, 1)) * size]
        out.append(Pose(_rotation(0, about_x) @ _rotation(1, about_y) @ _rotation(2, turn), centre))
    return out


def _rotation(axis: int, angle: float) -> Array:
    """Rotation about a coordinate axis."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    out = np.eye(3)
    out[i, i] = out[j, j] = c
    out[i, j], out[j, i] = -s, s
    return out


def brought_into_view(pose: Pose, board: Chessboard | Dots, middle: Array, cameras: Iterable[Camera]) -> Pose:
    """A pose moved towards the middle of the field, (3,), until every camera sees the whole board.
    A board too large for the field stays as it is.
    """
    # a chessboard of which a part is missing cannot be numbered
    around = 1.5 if isinstance(board, Chessboard) else 0.5  # the outer squares and half a white one
    half = ((np.array(board.shape) - 1) / 2 + around) * board.mesh
    corners = np.array([(sx, sy, 0.0) for sx in (-1, 1) for sy in (-1, 1)]) * (*half, 0.0)
    for share in SHARES_OF_MOTION:
        moved = replace(pose, origin=middle + share * (pose.origin - middle))
        x, y, z = (corners @ moved.rotation.T + moved.origin).T
        if all(camera.sees(x, y, z).all() for camera in cameras):
            return moved
    return pose
