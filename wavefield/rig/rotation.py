"""Rotations as vectors and as matrices."""

import numpy as np
from numpy.typing import ArrayLike

from wavefield.rig.lens import Array


def rotation_about(vector: ArrayLike) -> Array:
    """Rotation matrix (3, 3) of a rotation vector (3,), rad (Rodrigues)."""
    x, y, z = np.asarray(vector, float)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = float(np.sqrt(x * x + y * y + z * z))
    half = 0.5 * angle
    # sinc keeps both quotients exact at zero
    turn: Array = np.eye(3) + np.sinc(angle / np.pi) * cross
    turn += 0.5 * np.sinc(half / np.pi) ** 2 * cross @ cross
    return turn
