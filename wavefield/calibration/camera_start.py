"""Start values of a camera (focal length, pose) from its own views of the target."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from wavefield.calibration.bundle import Fit, fit
from wavefield.calibration.observations import LIMITS, Geometry, Observations
from wavefield.errors import CalibrationError
from wavefield.rig.lens import LENS, Array

Pose = tuple[Array, Array]  # rotation (3, 3), translation (3,), metres


def passage(a: Pose, b: Pose) -> Pose:
    """Transformation from one camera's frame to another's, from the target's pose in each."""
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


MAX_HOMOGRAPHY_MISFIT = 8.0  # px: of an inlier, before the lens distortion is fitted
PLAUSIBLE_FOCAL_LENGTHS = 0.2, 200.0  # image widths: outside of this range a focal length is not plausible
MAX_MEDIAN_MISFIT = 0.02  # image widths: of points with known z
START_TERMS = ("f", "c", "k1")


@dataclass(frozen=True)
class SingleCamera:
    """One camera calibrated on its own."""

    lens: Array  # (12,): `LENS`
    poses: dict[str, Pose]  # Target to camera for each pose observed
    spread: float  # Largest angle between two views of the target, degrees
    deep: bool = False  # Whether nodes of known height determine the focal length, however parallel the views


def homography(plan: Array, pixel: Array) -> Array | None:
    """Homography (3, 3) from the target's plane (n, 2), metres, to the image (n, 2), robust to outliers.
    None if the nodes are on a line or consistent with no homography.
    """
    if len(plan) < 6 or np.linalg.matrix_rank(plan - plan.mean(0), tol=1e-9) < 2:
        return None
    cv2.setRNGSeed(1)
    H, inliers = cv2.findHomography(plan, pixel, cv2.RANSAC, MAX_HOMOGRAPHY_MISFIT, maxIters=500)
    if H is None or inliers.sum() < 0.5 * len(plan):
        return None
    return np.asarray(H, float)


def focal_length(homographies: list[Array], centre: Array) -> float | None:
    """Focal length, px, from plane views, square pixels and a known principal point assumed.
    Zhang (2000): with w = diag(u, u, 1), u = 1/f^2, h1^T w h2 = 0 and h1^T w h1 = h2^T w h2.
    """
    shift = np.eye(3)
    shift[:2, 2] = -centre
    rows = []
    for H in homographies:
        h = shift @ H
        h = h / np.linalg.norm(h[:, :2])
        a, b = h[:, 0], h[:, 1]
        rows.append((a[0] * b[0] + a[1] * b[1], -a[2] * b[2]))
        rows.append((a[0] ** 2 + a[1] ** 2 - b[0] ** 2 - b[1] ** 2, b[2] ** 2 - a[2] ** 2))
    A, y = np.array(rows).T
    u = float(A @ y) / max(float(A @ A), 1e-300)
    return float(1.0 / np.sqrt(u)) if u > 0.0 else None


def _pinhole(f: float, size: tuple[int, int]) -> tuple[Array, Array]:
    """A lens without distortion as `LENS` (12,) and as a camera matrix (3, 3)."""
    cx, cy = (size[0] - 1) / 2, (size[1] - 1) / 2
    lens = np.zeros(len(LENS))
    lens[:4] = f, f, cx, cy
    return lens, np.array([[f, 0.0, cx], [0.0, f, cy], [0.0, 0.0, 1.0]])


def plane_pose(H: Array, K: Array) -> Pose:
    """Pose of a plane, to the camera of matrix K (3, 3), from its homography."""
    h = np.linalg.solve(K, H)
    h /= 0.5 * (np.linalg.norm(h[:, 0]) + np.linalg.norm(h[:, 1]))
    if h[2, 2] < 0.0:  # in front of the camera
        h = -h
    U, _, V = np.linalg.svd(np.column_stack([h[:, :2], np.cross(h[:, 0], h[:, 1])]))
    rotation: Array = U @ V
    return rotation, np.asarray(h[:, 2], float)


def calibrate_single(observations: Observations) -> SingleCamera:
    """Calibrate one camera on its own: Zhang's method, then a fit."""
    o = observations
    start, poses = _from_known_heights(o) if o.placed else _from_planes(o)
    g = _first_fit(o, start, poses).geometry
    fitted = {o.poses[p]: (g.R[0] @ g.pose_R[p], g.R[0] @ g.pose_t[p] + g.T[0]) for p in poses}
    normals = np.stack([R[:, 2] for R, _ in fitted.values()])
    spread = float(np.degrees(np.arccos(np.clip(normals @ normals.T, -1.0, 1.0)).max()))
    return SingleCamera(g.lens[0], fitted, spread, deep=bool(o.placed))


def _first_fit(o: Observations, start: Geometry, poses: list[int]) -> Fit:
    used = o.only(np.isin(o.pose, poses))
    terms = ("f", "k1") if len(poses) < 3 else START_TERMS
    return fit(used, start, [terms], poses[0], placed=o.placed)


def _of_poses(o: Observations, lens: Array, poses: dict[int, Pose]) -> Geometry:
    """A camera in the frame of the first pose it found; that pose is fixed, the others are free."""
    pose_R, pose_t = np.tile(np.eye(3), (len(o.poses), 1, 1)), np.zeros((len(o.poses), 3))
    for p, (R, t) in poses.items():
        pose_R[p], pose_t[p] = R, t
    nowhere = np.zeros((len(o.nodes), 3))
    start = Geometry(lens[None], np.eye(3)[None], np.zeros((1, 3)), pose_R, pose_t, nowhere)
    return _in_frame_of_pose(start, min(poses))


def _from_planes(o: Observations) -> tuple[Geometry, list[int]]:
    """Start from views of a plane target in unknown poses (Zhang's method), and the poses found."""
    (name,), (size,) = o.cameras, o.sizes
    maps: dict[int, Array] = {}
    depth: dict[int, float] = {}
    for p in range(len(o.poses)):
        rows = o.pose == p
        plan = o.plan[o.node[rows]]
        # a target of several levels: the fullest of them
        levels, nodes = np.unique(plan[:, 2].round(9), return_counts=True)
        if not nodes.size:
            continue
        depth[p] = float(levels[np.argmax(nodes)])
        on = np.abs(plan[:, 2] - depth[p]) < 1e-8
        H = homography(plan[on, :2], o.pixel[rows][on])
        if H is not None:
            maps[p] = H
    if not maps:
        raise CalibrationError(f"no view of {name} shows a plane target: photograph it again")
    f = focal_length(list(maps.values()), np.array([(n - 1) / 2 for n in size]))
    shortest, longest = (width * max(size) for width in PLAUSIBLE_FOCAL_LENGTHS)
    if f is None or not shortest < f < longest:
        raise CalibrationError(
            f"the views of {name} do not determine its focal length (all are parallel to its sensor, or show "
            "no plane target): photograph the target tilted by 20 to 40 degrees, to several sides, or state "
            "the heights of a target that was moved along z"
        )
    lens, K = _pinhole(f, size)
    poses = {}
    for p, H in maps.items():
        R, t = plane_pose(H, K)
        poses[p] = R, t - depth[p] * R[:, 2]
    return _of_poses(o, lens, poses), sorted(maps)


def _from_known_heights(o: Observations) -> tuple[Geometry, list[int]]:
    """Start from nodes in known positions: the focal length with the smallest misfit, and the poses found."""
    (name,), (size,) = o.cameras, o.sizes
    rows = np.isin(o.pose, o.placed)
    points, pixel = o.plan[o.node[rows]], o.pixel[rows]
    if np.ptp(points[:, 2]) <= 0.0:
        raise CalibrationError(
            f"all points of {name} with known z are in one plane, which does not determine its focal length: "
            "move the target along z"
        )
    best: tuple[float, float, Array, Array] | None = None
    for f in max(size) * np.geomspace(0.3, 60.0, 28):
        K = _pinhole(f, size)[1]
        ok, rvec, tvec = cv2.solvePnP(points, pixel, K, np.zeros(4), flags=cv2.SOLVEPNP_SQPNP)
        if ok:
            residual = cv2.projectPoints(points, rvec, tvec, K, np.zeros(4))[0][:, 0] - pixel
            misfit = float(np.median(np.hypot(*residual.T)))
            if best is None or misfit < best[0]:
                turn: Array = np.asarray(cv2.Rodrigues(rvec)[0], float)
                best = misfit, f, turn, np.asarray(tvec, float).ravel()
    if best is None or best[0] > MAX_MEDIAN_MISFIT * max(size):
        raise CalibrationError(
            f"the points of {name} with known z do not fit a camera: are indices, mesh and heights (metres) "
            "right?"
        )
    _, f, R, T = best
    lens, K = _pinhole(f, size)
    count = len(o.poses)
    pose_R, pose_t = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    poses = sorted(set(o.placed))
    for p in range(count):  # tilted views in addition to those in known positions
        own = o.pose == p
        if p in o.placed or own.sum() < LIMITS.min_nodes:
            continue
        ok, rvec, tvec = cv2.solvePnP(o.plan[o.node[own]], o.pixel[own], K, np.zeros(4))
        if ok:
            view = np.asarray(cv2.Rodrigues(rvec)[0], float)
            pose_R[p], pose_t[p] = R.T @ view, R.T @ (tvec.ravel() - T)
            poses.append(p)
    return Geometry(lens[None], R[None], T[None], pose_R, pose_t, np.zeros((len(o.nodes), 3))), poses


def _in_frame_of_pose(geometry: Geometry, pose: int) -> Geometry:
    """The geometry of one camera in the frame of one pose of the target."""
    Q, o = geometry.pose_R[pose], geometry.pose_t[pose]
    return replace(
        geometry,
        R=geometry.R @ Q,
        T=geometry.R @ o + geometry.T,
        pose_R=Q.T @ geometry.pose_R,
        pose_t=(geometry.pose_t - o) @ Q,
    )
