"""Bring the plane z = 0 of a rig to the still water."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wavefield.errors import RigError
from wavefield.rig.lens import Array
from wavefield.rig.rig import Rig
from wavefield.robust import reweighted_lstsq, robust_std

MAX_TILT = 10.0  # degrees; a frame that is tilted more than this is not that of a target, but of a camera
MIN_POINTS = 10  # on the water: about three times the number of parameters of a plane
MAX_DEVIATIONS = 4.0  # robust standard deviations from the plane


@dataclass(frozen=True)
class WaterPlane:
    """A plane fitted to points of the water surface: z = height + slope[0] x + slope[1] y."""

    height: float  # Of the plane at x = y = 0, metres
    slope: tuple[float, float]  # Along x and y
    rms: float  # Rms distance of the points from the plane, without outliers, metres
    kept: NDArray[np.bool_]  # (n,): whether a point is finite and not an outlier

    @property
    def axes(self) -> Array:
        """Axes, as the columns of a matrix (3, 3), of a frame whose plane z = 0 is parallel to this plane.
        The x axis is in the x-z plane of the present frame."""
        bx, by = self.slope
        z = np.array([-bx, -by, 1.0]) / np.sqrt(1.0 + bx * bx + by * by)
        x = np.array([1.0, 0.0, bx]) / np.sqrt(1.0 + bx * bx)
        return np.stack([x, np.cross(z, x), z], axis=1)


def _points(x: ArrayLike, y: ArrayLike, z: ArrayLike) -> tuple[Array, NDArray[np.bool_]]:
    """Return x, y, z as points (n, 3), and a mask (n,) of the finite ones; RigError if fewer than ten are."""
    points = np.stack([np.ravel(v) for v in np.broadcast_arrays(x, y, z)], axis=-1).astype(float)
    finite = np.isfinite(points).all(axis=1)
    if finite.sum() < MIN_POINTS:
        raise RigError(f"{finite.sum()} points of the still water: ten at least are needed for its plane")
    return points, finite


def fit_plane(x: ArrayLike, y: ArrayLike, z: ArrayLike) -> WaterPlane:
    """Fit a plane to points x, y, z of the water surface, metres, leaving out outliers.
    RigError if fewer than ten points are finite, or if all are on a line."""
    points, finite = _points(x, y, z)
    height = points[finite, 2]
    design = np.column_stack([np.ones(len(height)), points[finite, :2]])
    if np.linalg.matrix_rank(design, rtol=1e-9) < 3:
        raise RigError("the points of the still water are on a line: a plane needs a field")

    def least_absolute(residual: Array) -> Array:
        weight: Array = 1.0 / np.sqrt(np.maximum(np.abs(residual), 0.1 * robust_std(residual) + 1e-12))
        return weight

    # a fit of least absolute residuals finds the outliers; least squares fits the other points
    _, residual = reweighted_lstsq(design, height, np.ones(len(height)), least_absolute, 20)
    inlier = np.abs(residual) <= MAX_DEVIATIONS * robust_std(residual) + 1e-12
    for _ in range(10):
        solution = np.linalg.lstsq(design[inlier], height[inlier], rcond=None)[0]
        residual = height - design @ solution
        new = np.abs(residual) <= MAX_DEVIATIONS * robust_std(residual[inlier]) + 1e-12
        if (new == inlier).all():
            break
        inlier = new
    at_origin, bx, by = (float(v) for v in solution)
    rms = float(np.sqrt(np.mean(residual[inlier] ** 2) / (1.0 + bx * bx + by * by)))
    kept = finite.copy()
    kept[finite] = inlier
    return WaterPlane(at_origin, (bx, by), rms, kept)


def level(rig: Rig, x: ArrayLike, y: ArrayLike, z: ArrayLike) -> tuple[Rig, WaterPlane]:
    """Return a rig in a frame whose plane z = 0 is fitted to points of still water, and the fitted plane.
    x, y, z are the points in the present frame of the rig, metres. The fitted plane is given in the present
    frame or, if this is tilted by over 10 degrees, in a frame that is first turned roughly onto the water."""
    points, finite = _points(x, y, z)
    axes, origin = _frame_on_plane(rig, points[finite])
    tilt = float(np.degrees(np.arccos(np.clip(axes[2, 2], -1.0, 1.0))))
    coarse = tilt > MAX_TILT  # turn the frame of a camera first, then level it as any other
    if coarse:
        rig, points = rig.moved(axes, origin), (points - origin) @ axes
    plane = fit_plane(*points.T)
    note = {
        "height_m": plane.height,
        "tilt_deg": tilt if coarse else float(np.degrees(np.arctan(np.hypot(*plane.slope)))),
        "rms_m": plane.rms,
        "points": int(plane.kept.sum()),
    }
    return rig.moved(plane.axes, (0.0, 0.0, plane.height), levelled=note), plane


def _frame_on_plane(rig: Rig, points: Array) -> tuple[Array, Array]:
    """Return the axes (3, 3), as columns, and the origin (3,) of a frame on the plane of points (n, 3).
    Its z axis points towards the cameras of the rig."""
    middle, weight = np.median(points, axis=0), np.ones(len(points))
    for _ in range(20):  # robust fit: weights fall with the distance from the plane
        middle = weight @ points / weight.sum()
        normal = np.linalg.svd((points - middle) * np.sqrt(weight)[:, None], full_matrices=False)[2][2]
        distance = np.abs((points - middle) @ normal)
        weight = 1.0 / np.maximum(distance, 0.1 * robust_std(distance) + 1e-12)
    above = np.mean([camera.centre for camera in rig.cameras.values()], axis=0) - middle
    z = normal * (1.0 if above @ normal > 0 else -1.0)
    along = np.eye(3)[0] if abs(z[0]) < 0.9 else np.eye(3)[1]
    x = along - (along @ z) * z
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1), middle


def with_water_level(rig: Rig, height: float) -> Rig:
    """Return a rig whose plane z = 0 is `height` metres above the present z = 0; negative is below."""
    return rig.moved(np.eye(3), (0.0, 0.0, height), water_above_target_m=float(height))
