"""Starting values: each camera on its own, by Zhang's method."""

from dataclasses import dataclass

import cv2
import numpy as np

from wavefield.calibration.bundle import Fit, fit
from wavefield.calibration.observations import Geometry, Observations
from wavefield.errors import CalibrationError
from wavefield.rig.lens import LENS, Array
from wavefield.robust import robust_std

FEWEST_NODES = 12  # of the target in a view


@dataclass(frozen=True)
class Alone:
    """One camera calibrated on its own."""

    lens: Array  # (12,): `LENS`
    poses: dict[str, tuple[Array, Array]]  # (3, 3): Target to camera for each pose seen, metres
    rms: dict[str, float]  # Robust scatter of each view, px
    spread: float  # Largest angle between two views of the target, degrees
    deep: bool = False  # Whether nodes in known places tell the focal length, however parallel the views


def homography(plan: Array, pixel: Array) -> Array | None:
    """Homography from the target's plane to the image, blunders and lens notwithstanding.

    With plan (n, 2), metres; pixel (n, 2), px; returns (3, 3): None if the nodes lie on a line or agree with
    no homography.
    """
    if len(plan) < 6 or np.linalg.matrix_rank(plan - plan.mean(0), tol=1e-9) < 2:
        return None
    cv2.setRNGSeed(1)
    H, kept = cv2.findHomography(plan, pixel, cv2.RANSAC, 8.0, maxIters=500)
    if H is None or kept.sum() < 0.5 * len(plan):
        return None
    return np.asarray(H, float)


def focal_length(homographies: list[Array], centre: Array) -> float | None:
    """Focal length from plane views, square pixels and a known principal point assumed.

    Zhang (2000): with w = diag(u, u, 1), u = 1/f^2, h1^T w h2 = 0 and h1^T w h1 = h2^T w h2.

    With homographies (3, 3); centre (2,), px.
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


def plane_pose(H: Array, lens: Array) -> tuple[Array, Array]:
    """Pose of a plane from its homography.

    With H (3, 3); lens (12,); returns R, t (3, 3): Plane to camera, metres.
    """
    K = np.array([[lens[0], 0.0, lens[2]], [0.0, lens[1], lens[3]], [0.0, 0.0, 1.0]])
    h = np.linalg.solve(K, H)
    h /= 0.5 * (np.linalg.norm(h[:, 0]) + np.linalg.norm(h[:, 1]))
    if h[2, 2] < 0.0:  # in front of the camera
        h = -h
    U, _, V = np.linalg.svd(np.column_stack([h[:, :2], np.cross(h[:, 0], h[:, 1])]))
    return U @ V, h[:, 2]


def calibrate_alone(observations: Observations) -> Alone:
    """Calibrate one camera by Zhang's method, then by a fit of its own."""
    o = observations
    start, seen, deep = _from_places(o) if o.placed else _from_planes(o)
    used = o.only(np.isin(o.pose, seen))
    terms = ("f", "k1") if len(seen) < 3 else ("f", "c", "k1")
    result: Fit = fit(used, start, [terms], seen[0], placed=o.placed)
    g = result.geometry
    found = {o.poses[p]: (g.R[0] @ g.pose_R[p], g.R[0] @ g.pose_t[p] + g.T[0]) for p in seen}
    rms = {o.poses[p]: robust_std(result.residual[used.pose == p]) for p in seen}
    normals = np.stack([R[:, 2] for R, _ in found.values()])
    spread = float(np.degrees(np.arccos(np.clip(normals @ normals.T, -1.0, 1.0)).max()))
    return Alone(g.lens[0], found, rms, spread, deep)


def _from_planes(o: Observations) -> tuple[Geometry, list[int], bool]:
    """Start from views of a plane target in unknown positions (Zhang's method)."""
    (name,) = o.cameras
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
    centre = np.array([(n - 1) / 2 for n in o.sizes[0]])
    f = focal_length(list(maps.values()), centre)
    if f is None or not 0.2 * max(o.sizes[0]) < f < 200 * max(o.sizes[0]):
        raise CalibrationError(
            f"the views of {name} do not tell its focal length (all are parallel to its sensor, or show no "
            "plane target): photograph the target tilted by 20 to 40 degrees, to several sides, or state the "
            "heights of a target that was moved along z"
        )
    lens = np.zeros(len(LENS))
    lens[:4] = f, f, *centre
    poses = {p: plane_pose(H, lens) for p, H in maps.items()}
    poses = {p: (R, t - depth[p] * R[:, 2]) for p, (R, t) in poses.items()}
    count = len(o.poses)
    start = Geometry(
        lens[None],
        np.eye(3)[None],
        np.zeros((1, 3)),
        np.stack([poses[p][0] if p in poses else np.eye(3) for p in range(count)]),
        np.stack([poses[p][1] if p in poses else np.zeros(3) for p in range(count)]),
        np.zeros((len(o.nodes), 3)),
    )
    # the frame is the camera's own: its pose stays, all target poses move
    return _seen_from(start, min(maps)), sorted(maps), False


def _from_places(o: Observations) -> tuple[Geometry, list[int], bool]:
    """Start from nodes in known places: the focal length by which they are seen best."""
    (name,) = o.cameras
    rows = np.isin(o.pose, o.placed)
    points, pixel = o.plan[o.node[rows]], o.pixel[rows]
    if np.ptp(points[:, 2]) <= 0.0:
        raise CalibrationError(
            f"all points of {name} with known z lie in one plane, which does not tell its focal length: "
            "move the target along z"
        )
    best: tuple[float, Array, Array, Array] | None = None
    for f in max(o.sizes[0]) * np.geomspace(0.3, 60.0, 28):
        K = np.array([[f, 0.0, (o.sizes[0][0] - 1) / 2], [0.0, f, (o.sizes[0][1] - 1) / 2], [0.0, 0.0, 1.0]])
        ok, rvec, tvec = cv2.solvePnP(points, pixel, K, np.zeros(4), flags=cv2.SOLVEPNP_SQPNP)
        if ok:
            miss = cv2.projectPoints(points, rvec, tvec, K, np.zeros(4))[0][:, 0] - pixel
            size = float(np.median(np.hypot(*miss.T)))
            if best is None or size < best[0]:
                turn: Array = np.asarray(cv2.Rodrigues(rvec)[0], float)
                best = size, K, turn, np.asarray(tvec, float).ravel()
    if best is None or best[0] > 0.02 * max(o.sizes[0]):
        raise CalibrationError(
            f"the points of {name} with known z do not fit a camera: are indices, mesh and heights (metres) "
            "right?"
        )
    _, K, R, T = best
    lens = np.zeros(len(LENS))
    lens[:4] = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    count = len(o.poses)
    pose_R, pose_t = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    seen = sorted(set(o.placed))
    for p in range(count):  # tilted views beside those in known places
        mine = o.pose == p
        if p in o.placed or mine.sum() < FEWEST_NODES:
            continue
        ok, rvec, tvec = cv2.solvePnP(o.plan[o.node[mine]], o.pixel[mine], K, np.zeros(4))
        if ok:
            view = np.asarray(cv2.Rodrigues(rvec)[0], float)
            pose_R[p], pose_t[p] = R.T @ view, R.T @ (tvec.ravel() - T)
            seen.append(p)
    geometry = Geometry(lens[None], R[None], T[None], pose_R, pose_t, np.zeros((len(o.nodes), 3)))
    return geometry, seen, True


def _seen_from(geometry: Geometry, pose: int) -> Geometry:
    """The geometry of one camera in the frame of one pose of the target."""
    Q, o = geometry.pose_R[pose], geometry.pose_t[pose]
    return Geometry(
        geometry.lens,
        geometry.R @ Q,
        geometry.R @ o + geometry.T,
        Q.T @ geometry.pose_R,
        (geometry.pose_t - o) @ Q,
        geometry.offset,
    )


def mean_rotation(rotations: Array) -> Array:
    """Mean of rotations that are near each other.

    With rotations (n, 3, 3); returns (3, 3): The rotation nearest to their mean.
    """
    U, _, V = np.linalg.svd(np.mean(rotations, axis=0))
    nearest: Array = U @ np.diag([1.0, 1.0, np.linalg.det(U @ V)]) @ V
    return nearest


def angle_between(A: Array, B: Array) -> float:
    """Angle of the rotation from one orientation to another.

    With A, B (3, 3).
    """
    chord = np.linalg.norm(A - B) / np.sqrt(8.0)
    return float(np.degrees(2.0 * np.arcsin(min(chord, 1.0))))
