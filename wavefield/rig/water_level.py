"""The reference plane: bring z = 0 to the water at rest."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wavefield.errors import RigError
from wavefield.rig.rig import Rig
from wavefield.robust import robust_std

_NEARLY = 10.0  # degrees: a frame tilted by more is not the water's


@dataclass(frozen=True)
class WaterPlane:
    """A plane fitted to surface points."""

    height: float  # Of the plane at x = y = 0, metres
    slope: tuple[float, float]  # Along x and y
    rms: float  # Of the points kept, across the plane, metres
    kept: NDArray[np.bool_]  # (n,): Points that belong to the plane

    @property
    def axes(self) -> NDArray[np.float64]:
        """Axes of a frame on the plane as columns, (3, 3): z across it, x in the old x-z plane."""
        bx, by = self.slope
        z = np.array([-bx, -by, 1.0]) / np.sqrt(1.0 + bx * bx + by * by)
        x = np.array([1.0, 0.0, bx]) / np.sqrt(1.0 + bx * bx)
        return np.stack([x, np.cross(z, x), z], axis=1)


def fit_plane(x: ArrayLike, y: ArrayLike, z: ArrayLike) -> WaterPlane:
    """Plane through surface points, blunders left out.

    With x, y, z, metres.
    """
    points = np.stack([np.ravel(v) for v in np.broadcast_arrays(x, y, z)], axis=-1).astype(float)
    kept = np.isfinite(points).all(axis=1)
    if kept.sum() < 10:
        raise RigError(f"{kept.sum()} points of the surface at rest: ten at least are needed for its plane")
    finite = kept.copy()
    design = np.column_stack([np.ones(len(points)), points[:, :2]])
    weight = kept.astype(float)
    for _ in range(20):
        # first the median-like fit, which blunders do not move, then least squares on what agrees with it
        A, b = design[kept] * weight[kept, None], points[kept, 2] * weight[kept]
        solution, _, rank, _ = np.linalg.lstsq(A, b, rcond=1e-9)
        if rank < 3:
            raise RigError("the points of the surface at rest lie on a line: a plane needs a field")
        miss = np.where(finite, points[:, 2] - design @ solution, np.inf)
        spread = robust_std(miss[finite])
        weight = np.where(finite, 1.0 / np.sqrt(np.maximum(np.abs(miss), 0.1 * spread + 1e-12)), 0.0)
    kept = np.abs(miss) <= 4.0 * spread + 1e-12
    for _ in range(10):
        solution = np.linalg.lstsq(design[kept], points[kept, 2], rcond=None)[0]
        miss = np.where(finite, points[:, 2] - design @ solution, np.inf)
        new = np.abs(miss) <= 4.0 * robust_std(miss[kept]) + 1e-12
        if (new == kept).all():
            break
        kept = new
    height, bx, by = (float(v) for v in solution)
    rms = float(np.sqrt(np.mean(miss[kept] ** 2) / (1.0 + bx * bx + by * by)))
    return WaterPlane(height, (bx, by), rms, kept)


def level(rig: Rig, x: ArrayLike, y: ArrayLike, z: ArrayLike) -> tuple[Rig, WaterPlane]:
    """Re-express a rig so that the plane of surface points at rest is z = 0.

    With x, y, z, metres.
    """
    turned = rig
    points = np.stack([np.ravel(v) for v in np.broadcast_arrays(x, y, z)], axis=-1).astype(float)
    axes, origin = _across(rig, points)
    steep = float(np.degrees(np.arccos(np.clip(axes[2, 2], -1.0, 1.0))))
    if steep > _NEARLY:  # the frame is a camera's, not the water's: turn it first, then level as any other
        turned = rig.moved(axes, origin)
        points = (points - origin) @ axes
    plane = fit_plane(*points.T)
    note = {
        "height_m": plane.height,
        "tilt_deg": steep if steep > _NEARLY else float(np.degrees(np.arctan(np.hypot(*plane.slope)))),
        "rms_m": plane.rms,
        "points": int(plane.kept.sum()),
    }
    return turned.moved(plane.axes, (0.0, 0.0, plane.height), levelled=note), plane


def _across(rig: Rig, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Axes (as columns) and origin of a frame on the plane of points, however it lies: z to the cameras."""
    finite = points[np.isfinite(points).all(axis=1)]
    if len(finite) < 10:
        raise RigError(f"{len(finite)} points of the surface at rest: ten at least are needed for its plane")
    middle, weight = np.median(finite, axis=0), np.ones(len(finite))
    for _ in range(20):  # the plane that blunders do not move
        middle = weight @ finite / weight.sum()
        normal = np.linalg.svd((finite - middle) * np.sqrt(weight)[:, None], full_matrices=False)[2][2]
        miss = np.abs((finite - middle) @ normal)
        weight = 1.0 / np.maximum(miss, 0.1 * robust_std(miss) + 1e-12)
    above = np.mean([camera.centre for camera in rig.cameras.values()], axis=0) - middle
    z = normal * (1.0 if above @ normal > 0 else -1.0)
    along = np.eye(3)[0] if abs(z[0]) < 0.9 else np.eye(3)[1]
    x = along - (along @ z) * z
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1), middle


def with_water_level(rig: Rig, height: float) -> Rig:
    """Re-express a rig when the water stands above or below the flat target by a known height.

    With height, metres.
    """
    return rig.moved(np.eye(3), (0.0, 0.0, height), water_above_target_m=float(height))
