"""Whether cameras agree on how the target moved; start values of cameras that saw few poses."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from wavefield.calibration.camera_start import Pose, SingleCamera, angle_between, mean_pose, passage
from wavefield.calibration.observations import Findings, Geometry, Observations
from wavefield.rig.lens import Array

# what a view may differ by: five times the median of all views, within these limits
ANGLE_LIMITS = 0.3, 1.5  # degrees; good views differ by hundredths, wrong ones by 3 and more
SHIFT_LIMITS = 0.1, 0.4  # of a mesh; a view counted from another node is off by one mesh


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
    max_angle, max_offset = _limit(angle, ANGLE_LIMITS), _limit(offset, SHIFT_LIMITS)
    good = {pose: max(angle[pose] / max_angle, offset[pose] / max_offset) <= 1.0 for pose in common}
    count = sum(good.values())
    if count > len(good) / 2 or (count >= 2 and len(good) <= 4):
        return _Pair(True, good)
    return _Pair(False)


def _wrong_views(names: Sequence[str], pairs: Mapping[tuple[str, str], _Pair]) -> list[tuple[str, str]]:
    """Views that differ from all others; of two cameras it cannot be determined which one is wrong."""
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


def _limit(differences: Mapping[str, float], bounds: tuple[float, float]) -> float:
    return float(np.clip(5.0 * np.median(list(differences.values())), *bounds))


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
