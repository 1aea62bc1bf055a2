"""Start values: each camera from its own views of the target, then all in one frame if these agree."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import cv2
import numpy as np

from wavefield.calibration.bundle import Fit, fit
from wavefield.calibration.observations import LIMITS, Findings, Geometry, Observations
from wavefield.errors import CalibrationError
from wavefield.rig.lens import LENS, Array

Pose = tuple[Array, Array]  # rotation (3, 3), translation (3,), metres


def passage(a: Pose, b: Pose) -> Pose:
    """Transformation from one camera's frame to another's, from the target's pose in each."""
    (Ra, ta), (Rb, tb) = a, b
    R = Rb @ Ra.T
    return R, tb - R @ ta


def mean_pose(poses: Iterable[Pose]) -> Pose:
    """Mean of similar rotations, and median of translations."""
    rotations, translations = zip(*poses, strict=True)
    U, _, V = np.linalg.svd(np.mean(np.stack(rotations), axis=0))
    return U @ np.diag([1.0, 1.0, np.linalg.det(U @ V)]) @ V, np.median(translations, axis=0)


def angle_between(A: Array, B: Array) -> float:
    """Angle of the rotation from one orientation (3, 3) to another, degrees."""
    chord = np.linalg.norm(A - B) / np.sqrt(8.0)
    return float(np.degrees(2.0 * np.arcsin(min(chord, 1.0))))


MAX_HOMOGRAPHY_MISFIT = 8.0  # px: of an inlier, before the lens distortion is fitted
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
    """Homography (3, 3) from the target's plane (n, 2), metres, to the image (n, 2), px, without outliers.
    None if the nodes are on a line, or fewer than half of them fit one homography.
    """
    if len(plan) < 6 or np.linalg.matrix_rank(plan - plan.mean(0), tol=1e-9) < 2:
        return None
    cv2.setRNGSeed(1)
    H, inliers = cv2.findHomography(plan, pixel, cv2.RANSAC, MAX_HOMOGRAPHY_MISFIT, maxIters=500)
    if H is None or inliers.sum() < 0.5 * len(plan):
        return None
    return np.asarray(H, float)


def focal_length(homographies: list[Array], centre: Array) -> float | None:
    """Focal length, px, from views of a plane, for square pixels and a known principal point.
    None if the views do not determine it.
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
    """Geometry of one camera whose frame is the first pose that it found."""
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


MAX_ANGLE = (
    1.5  # degrees, between two cameras' poses of a view: good ones differ by hundredths, wrong ones by 3
)
MAX_SHIFT = 0.4  # of a mesh, between the same: a view counted from another node is off by one mesh


@dataclass(frozen=True)
class PoseConsistency:
    """Cameras and views whose poses of the target differ from the others'."""

    wrong_views: list[tuple[str, str]]  # (camera, pose) of single views that differ from all others
    wrong_cameras: list[str]  # Cameras that are consistent with no other
    alone: list[str]  # Cameras that share no view with another


@dataclass(frozen=True)
class _Pair:
    """Consistency of two cameras, in total and by view."""

    consistent: bool
    good: Mapping[str, bool] = field(default_factory=dict)  # by pose, where they are consistent


def passages(a: SingleCamera, b: SingleCamera) -> dict[str, Pose]:
    """Transformations from camera a's frame to camera b's, one from each pose that both observed."""
    return {pose: passage(a.poses[pose], b.poses[pose]) for pose in a.poses if pose in b.poses}


def compare_poses(cameras: Mapping[str, SingleCamera], mesh: float) -> PoseConsistency:
    """Compare the poses of the target that the cameras found each on its own; mesh in metres."""
    names = list(cameras)
    compared = {(a, b): _compare_pair(cameras[a], cameras[b], mesh) for a, b in combinations(names, 2)}
    pairs = {names: pair for names, pair in compared.items() if pair is not None}
    alone = [name for name in names if not any(name in pair for pair in pairs)] if len(names) > 1 else []
    # the largest group of consistent cameras is right; the others are wrong
    links = [names for names, pair in pairs.items() if pair.consistent]
    group = max((_linked(name, links) for name in names), key=len, default=[])
    return PoseConsistency(
        _wrong_views(names, pairs),
        [name for name in names if name not in group and name not in alone],
        alone,
    )


def _compare_pair(a: SingleCamera, b: SingleCamera, mesh: float) -> _Pair | None:
    """Consistency of two cameras; None where they share no view."""
    common = passages(a, b)
    if len(common) < 2:
        return _Pair(True) if common else None
    angles = np.array([[angle_between(A, B) for B, _ in common.values()] for A, _ in common.values()])
    medoid = list(common.values())[int(np.argmin(np.median(angles, axis=1)))][0]
    shift = np.median([t for _, t in common.values()], axis=0)
    angle = {pose: angle_between(R, medoid) for pose, (R, _) in common.items()}
    # translations of oblique views scatter along the sight line: compare them where the target is
    offset = {pose: float(np.linalg.norm(_at_target(a, b, pose, medoid, shift))) / mesh for pose in common}
    good = {pose: angle[pose] <= MAX_ANGLE and offset[pose] <= MAX_SHIFT for pose in common}
    count = sum(good.values())
    if count > len(good) / 2 or (count >= 2 and len(good) <= 4):
        return _Pair(True, good)
    return _Pair(False)


def _wrong_views(names: Sequence[str], pairs: Mapping[tuple[str, str], _Pair]) -> list[tuple[str, str]]:
    """Views (camera, pose) that disagree with every other camera; of two cameras, both views."""
    comparisons: dict[tuple[str, str], list[bool]] = {}  # (camera, pose): is it good, once per partner
    for cameras, pair in pairs.items():
        for pose, good in pair.good.items():
            for name in cameras:
                comparisons.setdefault((name, pose), []).append(good)
    wrong = {view for view, good in comparisons.items() if not any(good)}
    out = []
    for name, pose in comparisons:
        others = {(n, pose) in wrong for n in names if n != name and (n, pose) in comparisons}
        if (name, pose) in wrong and len(others) < 2:  # none of the others is, or all of them are
            out.append((name, pose))
    return out


def _linked(name: str, links: Sequence[tuple[str, str]]) -> list[str]:
    """All cameras that are linked with a camera, directly or through others."""
    group = [name]
    for member in group:
        partners = [b if a == member else a for a, b in links if member in (a, b)]
        group += [partner for partner in partners if partner not in group]
    return group


def _at_target(a: SingleCamera, b: SingleCamera, pose: str, R: Array, t: Array) -> Array:
    """Distance between the target's origins of the two cameras, across b's sight line, metres."""
    expected = R @ a.poses[pose][1] + t
    observed = b.poses[pose][1]
    along = observed / np.linalg.norm(observed)
    difference = expected - observed
    return difference - along * (along @ difference)


def mirrored(camera: SingleCamera) -> SingleCamera:
    """The camera as it would have been found from images flipped left to right."""
    F, G = np.diag([-1.0, 1.0, 1.0]), np.diag([1.0, -1.0, 1.0])
    return replace(camera, poses={pose: (F @ R @ G, F @ t) for pose, (R, t) in camera.poses.items()})


def chained(cameras: Mapping[str, SingleCamera], first: str) -> dict[str, Pose]:
    """Transformation from the first camera's frame to each camera's, through shared views."""
    out: dict[str, Pose] = {first: (np.eye(3), np.zeros(3))}
    while True:
        links = [(len(passages(cameras[a], cameras[b])), a, b) for a in out for b in cameras if b not in out]
        count, a, b = max(links, default=(0, "", ""))
        if not count:
            return out
        R, t = mean_pose(passages(cameras[a], cameras[b]).values())
        Ra, ta = out[a]
        out[b] = R @ Ra, R @ ta + t


@dataclass(frozen=True)
class PhysicalFrame:
    """The poses that define the physical frame: one fixed pose and others in its plane, or all given."""

    reference: int
    flat: tuple[int, ...] = ()
    placed: tuple[int, ...] = ()
    level: bool = True  # whether z = 0 is given


def physical_frame(observations: Observations, flats: Sequence[str], findings: Findings) -> PhysicalFrame:
    """The frame of placed or flat views if there are any, else of the view of most cameras."""
    o = observations
    if o.placed:  # the frame is that of the stated positions
        return PhysicalFrame(o.placed[0], placed=o.placed)
    flat = tuple(o.poses.index(name) for name in flats if name in o.poses)
    if flat:
        return PhysicalFrame(flat[0], flat)
    if flats:
        findings.problems.append(
            f"no camera has a usable flat view ({', '.join(flats)}): photograph the target on the plane z = 0"
        )
    else:
        findings.notes.append(
            f"no flat view: z = 0 is the target's plane in view {o.poses[0]}; "
            "level the rig on the water at rest before measuring"
        )
    n_cameras = [len(np.unique(o.camera[o.pose == p])) for p in range(len(o.poses))]
    return PhysicalFrame(int(np.argmax(n_cameras)), level=False)


def start_geometry(
    observations: Observations, single: Mapping[str, SingleCamera], frame: PhysicalFrame
) -> Geometry:
    """All cameras and poses in the frame of the reference pose, from each camera's own calibration."""
    o = observations
    reference = o.poses[frame.reference]
    first = max(single, key=lambda n: (reference in single[n].poses, len(single[n].poses)))
    links = chained(single, first)
    in_first: dict[str, Pose] = {}  # poses of the target in the first camera's frame
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
    for q in frame.flat:  # on the plane exactly: the fit turns them about z only
        c, d = pose_R[q][0, 0], pose_R[q][1, 0]
        c, d = c / np.hypot(c, d), d / np.hypot(c, d)
        pose_R[q] = np.array([[c, -d, 0.0], [d, c, 0.0], [0.0, 0.0, 1.0]])
        pose_t[q, 2] = 0.0
    for q in frame.placed:  # their nodes are in the physical frame already
        pose_R[q], pose_t[q] = np.eye(3), 0.0
    return Geometry(lens, R, T, pose_R, pose_t, np.zeros((len(o.nodes), 3)))
