"""Poses as rotations and translations: x' = R x + t."""

from collections.abc import Iterable

import numpy as np

from wavefield.rig.lens import Array

Pose = tuple[Array, Array]  # rotation (3, 3), translation (3,), metres


def passage(a: Pose, b: Pose) -> Pose:
    """From one camera's frame to another's, by the pose of the target in each of them."""
    (Ra, ta), (Rb, tb) = a, b
    R = Rb @ Ra.T
    return R, tb - R @ ta


def mean_pose(poses: Iterable[Pose]) -> Pose:
    """Rotation nearest to the mean of rotations that are similar, and the median translation."""
    rotations, translations = zip(*poses, strict=True)
    U, _, V = np.linalg.svd(np.mean(np.stack(rotations), axis=0))
    return U @ np.diag([1.0, 1.0, np.linalg.det(U @ V)]) @ V, np.median(translations, axis=0)


def angle_between(A: Array, B: Array) -> float:
    """Angle of the rotation from one orientation (3, 3) to another, degrees."""
    chord = np.linalg.norm(A - B) / np.sqrt(8.0)
    return float(np.degrees(2.0 * np.arcsin(min(chord, 1.0))))
