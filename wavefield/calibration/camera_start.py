"""Start values of the joint fit: calibrate each camera alone, compare the results, use one common frame.

`R` and `T` transform from the world to a camera, Xc = R x + T. A pose (R, t) transforms from the target to a
camera's frame, or from the frame of one camera to that of another. A node is a marked point of the target.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import cv2
import numpy as np

from wavefield.calibration.bundle import fit
from wavefield.calibration.observations import LIMITS, Findings, Geometry, Observations
from wavefield.errors import CalibrationError
from wavefield.rig.lens import LENS, Array

Pose = tuple[Array, Array]  # rotation (3, 3), translation (3,), metres


def camera_to_camera(a: Pose, b: Pose) -> Pose:
    """Return the transformation (R, t), t in metres, from the frame of camera a to the frame of camera b.
    `a` and `b` are the poses of one target in the frames of the two cameras."""
    (Ra, ta), (Rb, tb) = a, b
    R = Rb @ Ra.T
    return R, tb - R @ ta


def mean_pose(poses: Iterable[Pose]) -> Pose:
    """Return the average of similar poses: the orthogonalised mean rotation and the median translation."""
    rotations, translations = zip(*poses, strict=True)
    U, _, V = np.linalg.svd(np.mean(np.stack(rotations), axis=0))
    return U @ np.diag([1.0, 1.0, np.linalg.det(U @ V)]) @ V, np.median(translations, axis=0)


def angle_between(A: Array, B: Array) -> float:
    """Return the angle, degrees, of the rotation that takes the orientation A (3, 3) to B (3, 3)."""
    chord = np.linalg.norm(A - B) / np.sqrt(8.0)
    return float(np.degrees(2.0 * np.arcsin(min(chord, 1.0))))


MAX_HOMOGRAPHY_MISFIT = 8.0  # px: residual of an inlier, which still contains the lens distortion
MAX_MEDIAN_MISFIT = 0.02  # image widths: median reprojection error of points with known z
START_TERMS = ("f", "c", "k1")  # lens terms of a camera calibrated alone


@dataclass(frozen=True)
class SingleCamera:
    """Result of `calibrate_single`: the lens of a camera, and target poses in the frame of this camera."""

    lens: Array  # (12,): Lens in the order of `LENS`
    poses: dict[str, Pose]  # Target to camera, for each pose observed
    spread: float  # Largest angle between two views of the target, degrees
    known_heights: bool = False  # Whether nodes of known z determine the focal length, so no tilt is needed


def homography(plan: Array, pixel: Array) -> Array | None:
    """Fit a homography (3, 3) from points `plan` (n, 2), m, on a plane to pixels (n, 2); ignore outliers.
    Returns None for fewer than six points, for points on a line, or if fewer than half of the points fit."""
    if len(plan) < 6 or np.linalg.matrix_rank(plan - plan.mean(0), tol=1e-9) < 2:
        return None
    cv2.setRNGSeed(1)
    H, inliers = cv2.findHomography(plan, pixel, cv2.RANSAC, MAX_HOMOGRAPHY_MISFIT, maxIters=500)
    if H is None or inliers.sum() < 0.5 * len(plan):
        return None
    return np.asarray(H, float)


def focal_length(homographies: list[Array], centre: Array) -> float | None:
    """Return the focal length, px, from homographies of a plane in several poses (Zhang 2000).
    `centre` (2,) is the principal point, px. Returns None if the poses do not determine the focal length."""
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
    """Return the lens terms (12,), in the order of `LENS`, and the camera matrix (3, 3) of an ideal lens.
    The focal length is f, px; the principal point is the centre of an image of `size` (width, height), px."""
    cx, cy = (size[0] - 1) / 2, (size[1] - 1) / 2
    lens = np.zeros(len(LENS))
    lens[:4] = f, f, cx, cy
    return lens, np.array([[f, 0.0, cx], [0.0, f, cy], [0.0, 0.0, 1.0]])


def plane_pose(H: Array, K: Array) -> Pose:
    """Return the pose (R, t), t in metres, of a plane in the frame of a camera.
    H (3, 3) is the homography from metres on the plane to pixels, K (3, 3) the camera matrix."""
    h = np.linalg.solve(K, H)
    h /= 0.5 * (np.linalg.norm(h[:, 0]) + np.linalg.norm(h[:, 1]))
    if h[2, 2] < 0.0:  # the plane must be in front of the camera
        h = -h
    U, _, V = np.linalg.svd(np.column_stack([h[:, :2], np.cross(h[:, 0], h[:, 1])]))
    rotation: Array = U @ V
    return rotation, np.asarray(h[:, 2], float)


def calibrate_single(observations: Observations) -> SingleCamera:
    """Calibrate one camera alone. Start values come from known node positions, else from Zhang's method.
    Raises a CalibrationError if the views do not determine the focal length."""
    o = observations
    start, poses = _from_known_heights(o) if o.placed else _from_planes(o)
    terms = ("f", "k1") if len(poses) < 3 else START_TERMS
    g = fit(o.only(np.isin(o.pose, poses)), start, [terms], poses[0], placed=o.placed).geometry
    fitted = {o.poses[p]: (g.R[0] @ g.pose_R[p], g.R[0] @ g.pose_t[p] + g.T[0]) for p in poses}
    normals = np.stack([R[:, 2] for R, _ in fitted.values()])
    spread = float(np.degrees(np.arccos(np.clip(normals @ normals.T, -1.0, 1.0)).max()))
    return SingleCamera(g.lens[0], fitted, spread, known_heights=bool(o.placed))


def _of_poses(o: Observations, lens: Array, poses: dict[int, Pose]) -> Geometry:
    """Return the geometry of one camera with lens terms (12,), and of target poses in the camera's frame.
    The keys of `poses` are pose indices. The pose with the smallest index becomes the world frame."""
    pose_R, pose_t = np.tile(np.eye(3), (len(o.poses), 1, 1)), np.zeros((len(o.poses), 3))
    world, origin = poses[min(poses)]
    for p, (R, t) in poses.items():
        pose_R[p], pose_t[p] = world.T @ R, world.T @ (t - origin)
    return Geometry(lens[None], world[None], origin[None], pose_R, pose_t, np.zeros((len(o.nodes), 3)))


def _from_planes(o: Observations) -> tuple[Geometry, list[int]]:
    """Return start values of one camera by Zhang's method, and the indices of the poses found."""
    (name,), (size,) = o.cameras, o.sizes
    maps: dict[int, Array] = {}
    depth: dict[int, float] = {}
    for p in range(len(o.poses)):
        rows = o.pose == p
        plan = o.nominal[o.node[rows]]
        # of a target with two levels, use the one with more nodes
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
    if f is None:
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
    """Return start values of one camera from nodes of known position, and indices of the poses found."""
    (name,), (size,) = o.cameras, o.sizes
    rows = np.isin(o.pose, o.placed)
    points, pixel = o.nominal[o.node[rows]], o.pixel[rows]
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
    for p in range(count):  # the remaining views, with unknown poses
        own = o.pose == p
        if p in o.placed or own.sum() < LIMITS.min_nodes:
            continue
        ok, rvec, tvec = cv2.solvePnP(o.nominal[o.node[own]], o.pixel[own], K, np.zeros(4))
        if ok:
            view = np.asarray(cv2.Rodrigues(rvec)[0], float)
            pose_R[p], pose_t[p] = R.T @ view, R.T @ (tvec.ravel() - T)
            poses.append(p)
    return Geometry(lens[None], R[None], T[None], pose_R, pose_t, np.zeros((len(o.nodes), 3))), poses


MAX_ANGLE = 1.5  # degrees between a pose found by two cameras: hundredths if consistent, 3 or more if not
MAX_SHIFT = 0.4  # meshes between the same; counting from a wrong node shifts the pose by one mesh


@dataclass(frozen=True)
class PoseConsistency:
    """Result of `compare_poses`: views and cameras with target poses that contradict the other cameras."""

    wrong_views: list[tuple[str, str]]  # (camera, pose) of single views that differ from all others
    wrong_cameras: list[str]  # Cameras outside the largest group of consistent ones
    unlinked: list[str]  # Cameras that share no pose of the target with another


def transforms_by_pose(a: SingleCamera, b: SingleCamera) -> dict[str, Pose]:
    """Return the transformation (R, t) from camera a's frame to camera b's, computed from each common pose.
    The keys are names of poses. If the two cameras agree, all transformations are about equal."""
    return {pose: camera_to_camera(a.poses[pose], b.poses[pose]) for pose in a.poses if pose in b.poses}


def compare_poses(cameras: Mapping[str, SingleCamera], mesh: float) -> PoseConsistency:
    """Find views and cameras with target poses that contradict the other cameras.
    `mesh` is the distance between neighbouring target nodes, metres."""
    names = list(cameras)
    pairs = [(a, b) for a, b in combinations(names, 2) if set(cameras[a].poses) & set(cameras[b].poses)]
    unlinked = [name for name in names if not any(name in pair for pair in pairs)] if len(names) > 1 else []
    compared = {(a, b): _compare_pair(cameras[a], cameras[b], mesh) for a, b in pairs}
    agreeing = {pair: good for pair, good in compared.items() if good is not None}
    # assume that the largest group of consistent cameras is right
    group = max((_linked(name, list(agreeing)) for name in names), key=len, default=[])
    return PoseConsistency(
        _wrong_views(names, agreeing),
        [name for name in names if name not in group and name not in unlinked],
        unlinked,
    )


def _compare_pair(a: SingleCamera, b: SingleCamera, mesh: float) -> dict[str, bool] | None:
    """Return, for each pose of the target that two cameras saw, whether the cameras agree, by pose name.
    The result is empty for fewer than two common poses, which cannot be compared, and None if the cameras
    agree on too few poses. `mesh` is the distance between neighbouring target nodes, metres."""
    common = transforms_by_pose(a, b)
    if len(common) < 2:
        return {}
    angles = np.array([[angle_between(A, B) for B, _ in common.values()] for A, _ in common.values()])
    medoid = list(common.values())[int(np.argmin(np.median(angles, axis=1)))][0]
    shift = np.median([t for _, t in common.values()], axis=0)
    angle = {pose: angle_between(R, medoid) for pose, (R, _) in common.items()}
    # translations of oblique views scatter along the sight line: compare them across it, at the target
    offset = {pose: float(np.linalg.norm(_at_target(a, b, pose, medoid, shift))) / mesh for pose in common}
    good = {pose: angle[pose] <= MAX_ANGLE and offset[pose] <= MAX_SHIFT for pose in common}
    count = sum(good.values())
    return good if count > len(good) / 2 or (count >= 2 and len(good) <= 4) else None


def _wrong_views(
    names: Sequence[str], pairs: Mapping[tuple[str, str], Mapping[str, bool]]
) -> list[tuple[str, str]]:
    """Return the views (camera, pose) to leave out, because no other camera agrees on the pose of the target.
    For each pose this is the one camera that agrees with none, or every camera if no two agree; else no view
    is left out. `pairs` tells, by pair of cameras and by pose, whether the two agree."""
    comparisons: dict[tuple[str, str], list[bool]] = {}  # (camera, pose): agreement with each partner
    for cameras, agreement in pairs.items():
        for pose, good in agreement.items():
            for name in cameras:
                comparisons.setdefault((name, pose), []).append(good)
    wrong = {view for view, good in comparisons.items() if not any(good)}
    out = []
    for name, pose in comparisons:
        others = {(n, pose) in wrong for n in names if n != name and (n, pose) in comparisons}
        if (name, pose) in wrong and len(others) < 2:  # all other views are right, or all are wrong
            out.append((name, pose))
    return out


def _linked(name: str, links: Sequence[tuple[str, str]]) -> list[str]:
    """Return the camera `name` and all cameras linked to it, directly or through other cameras.
    `links` are the pairs of cameras that agree."""
    group = [name]
    for member in group:
        partners = [b if a == member else a for a, b in links if member in (a, b)]
        group += [partner for partner in partners if partner not in group]
    return group


def _at_target(a: SingleCamera, b: SingleCamera, pose: str, R: Array, t: Array) -> Array:
    """Return the vector (3,), m, from the target's origin as found by camera b to that found by camera a.
    It is in b's frame and perpendicular to b's sight line. R and t transform from a's frame to b's."""
    expected = R @ a.poses[pose][1] + t
    observed = b.poses[pose][1]
    along = observed / np.linalg.norm(observed)
    difference = expected - observed
    return difference - along * (along @ difference)


def mirrored(camera: SingleCamera) -> SingleCamera:
    """Return the camera with the poses that flipping the images from left to right would give."""
    F, G = np.diag([-1.0, 1.0, 1.0]), np.diag([1.0, -1.0, 1.0])
    return replace(camera, poses={pose: (F @ R @ G, F @ t) for pose, (R, t) in camera.poses.items()})


def linked_cameras(cameras: Mapping[str, SingleCamera], first: str) -> dict[str, Pose]:
    """Return the transformation from the frame of camera `first` to that of each linked camera, by name.
    Cameras are linked if they saw a common pose of the target, directly or through other cameras."""
    out: dict[str, Pose] = {first: (np.eye(3), np.zeros(3))}
    while True:
        rest = [b for b in cameras if b not in out]
        links = [(len(transforms_by_pose(cameras[a], cameras[b])), a, b) for a in out for b in rest]
        count, a, b = max(links, default=(0, "", ""))
        if not count:
            return out
        R, t = mean_pose(transforms_by_pose(cameras[a], cameras[b]).values())
        Ra, ta = out[a]
        out[b] = R @ Ra, R @ ta + t


@dataclass(frozen=True)
class PhysicalFrame:
    """Indices of the target poses that define z = 0 and the axes of the rig's frame."""

    reference: int  # The pose whose axes are those of the frame
    placed: tuple[int, ...] = ()  # Poses whose nodes have known positions in this frame
    level: bool = True  # Whether these poses define z = 0


def physical_frame(observations: Observations, flat: str, findings: Findings) -> PhysicalFrame:
    """Return the poses that define the rig's frame: those of known position, else the pose `flat`, else one.
    `flat` is the name of the pose on z = 0, or empty. The last choice is the pose that most cameras saw;
    `findings` then explains it."""
    o = observations
    if o.placed:
        return PhysicalFrame(o.placed[0], placed=o.placed)
    if flat in o.poses:
        return PhysicalFrame(o.poses.index(flat))
    n_cameras = [len(np.unique(o.camera[o.pose == p])) for p in range(len(o.poses))]
    reference = int(np.argmax(n_cameras))
    if flat:
        findings.problems.append(
            f"no camera has a usable flat view ({flat}): photograph the target on the plane z = 0"
        )
    else:
        findings.notes.append(
            f"no flat view: z = 0 is the target's plane in view {o.poses[reference]}; "
            "level the rig on the water at rest before measuring"
        )
    return PhysicalFrame(reference, level=False)


def start_geometry(
    observations: Observations, single: Mapping[str, SingleCamera], frame: PhysicalFrame
) -> Geometry:
    """Return all cameras and target poses in the rig's common frame, as start values of the joint fit.
    `single` holds the cameras calibrated alone, by name."""
    o = observations
    reference = o.poses[frame.reference]
    first = max(single, key=lambda n: (reference in single[n].poses, len(single[n].poses)))
    links = linked_cameras(single, first)
    in_first: dict[str, Pose] = {}  # the target's poses in the first camera's frame
    for p in o.poses:
        found = []
        for name, (R, t) in links.items():
            if p in single[name].poses:
                Rp, tp = single[name].poses[p]
                found.append((R.T @ Rp, R.T @ (tp - t)))
        in_first[p] = mean_pose(found)
    Q, origin = in_first[reference]
    lens = np.stack([single[name].lens for name in o.cameras])
    R = np.stack([links[name][0] @ Q for name in o.cameras])
    T = np.stack([links[name][0] @ origin + links[name][1] for name in o.cameras])
    pose_R = np.stack([Q.T @ in_first[p][0] for p in o.poses])
    pose_t = np.stack([Q.T @ (in_first[p][1] - origin) for p in o.poses])
    if frame.level and not frame.placed:  # put the flat target exactly on z = 0, without rounding errors
        q = frame.reference
        c, d = pose_R[q][:2, 0] / np.hypot(*pose_R[q][:2, 0])
        pose_R[q], pose_t[q, 2] = np.array([[c, -d, 0.0], [d, c, 0.0], [0.0, 0.0, 1.0]]), 0.0
    for q in frame.placed:  # the positions of their nodes are given in the rig's frame
        pose_R[q], pose_t[q] = np.eye(3), 0.0
    return Geometry(lens, R, T, pose_R, pose_t, np.zeros((len(o.nodes), 3)))
