"""Starting values for a fisheye lens: no homography maps a target onto its images."""

import numpy as np

from wavefield.calibration.observations import Observations
from wavefield.calibration.poses import Pose
from wavefield.rig import fisheye
from wavefield.rig.lens import Array
from wavefield.robust import robust_std

FOCAL_LENGTHS = np.geomspace(0.15, 3.0, 60)  # image widths: 380 to 19 degrees along the image
MIN_POINTS = 8
INLIER_DEVIATIONS = 6.0


def equidistant_start(o: Observations, views: list[int]) -> tuple[float, dict[int, Pose]] | None:
    """Focal length, px, and poses of the views of one camera; None where no focal length fits any."""
    (size,) = o.sizes
    centre = (np.array(size) - 1) / 2
    best: tuple[float, float, dict[int, Pose]] | None = None
    for f in FOCAL_LENGTHS * max(size):
        x, y = ((o.pixel - centre) / f).T
        rays = np.stack(fisheye.directions(x, y, (0.0, 0.0, 0.0, 0.0)), -1)
        poses, errors = {}, []
        for p in views:
            rows = o.pose == p
            pose = pose_along_rays(o.plan[o.node[rows]], rays[rows])
            if pose is not None:
                poses[p] = pose
                errors.append(_angles(o.plan[o.node[rows]], rays[rows], pose))
        if not poses:
            continue
        # angles that a lens shows narrower are smaller: as pixels they compare
        misfit = f * float(np.median(np.concatenate(errors))) / len(poses)
        if best is None or misfit < best[0]:
            best = misfit, float(f), poses
    return None if best is None else best[1:]


def pose_along_rays(points: Array, rays: Array) -> Pose | None:
    """Pose of a plane target, points (n, 3), metres, along unit vectors (n, 3); None where there is none."""
    level = np.median(points[:, 2])
    used = np.isfinite(rays).all(1) & (np.abs(points[:, 2] - level) < 1e-8)
    plan = points[:, :2]
    if used.sum() < MIN_POINTS or not np.ptp(plan[used], axis=0).all():
        return None
    scale = float(np.ptp(plan[used], axis=0).max())
    plan = np.column_stack([plan / scale, np.ones(len(plan))])
    pose = None
    for _ in range(3):
        # ray x (H p) = 0
        p, r = plan[used], rays[used]
        zero = np.zeros_like(p)
        rows = np.concatenate([
            np.column_stack([zero, -r[:, 2:] * p, r[:, 1:2] * p]),
            np.column_stack([r[:, 2:] * p, zero, -r[:, :1] * p]),
            np.column_stack([-r[:, 1:2] * p, r[:, :1] * p, zero]),
        ])  # fmt: skip
        H = np.linalg.eigh(rows.T @ rows)[1][:, 0].reshape(3, 3)
        H = H / (0.5 * (np.linalg.norm(H[:, 0]) + np.linalg.norm(H[:, 1])))
        if np.median(np.sum((p @ H.T) * r, axis=1)) < 0.0:
            H = -H
        U, _, V = np.linalg.svd(np.column_stack([H[:, :2], np.cross(H[:, 0], H[:, 1])]))
        R: Array = U @ V
        pose = R, scale * H[:, 2] - level * R[:, 2]
        error = _angles(points, rays, pose)
        inlier = used & (error < INLIER_DEVIATIONS * robust_std(error[used]) + 1e-9)
        if inlier.sum() < MIN_POINTS or (inlier == used).all():
            break
        used = inlier
    return pose


def _angles(points: Array, rays: Array, pose: Pose) -> Array:
    """Angles between points and their rays, rad; pi where there is no ray."""
    R, t = pose
    there = points @ R.T + t
    there /= np.linalg.norm(there, axis=1, keepdims=True)
    sine = np.linalg.norm(np.cross(there, rays), axis=1)
    out: Array = np.nan_to_num(np.arctan2(sine, np.sum(there * rays, axis=1)), nan=np.pi)
    return out
