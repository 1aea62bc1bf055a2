"""Before the joint fit: do the cameras agree on how the target moved?

The target has one pose per view, whoever looks. So the passage from one camera's frame to another's, taken
from any view that both saw, must be the same. A view indexed wrongly, or a mirrored image, is not.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from wavefield.calibration.start import Alone, angle_between, mean_rotation
from wavefield.rig.lens import Array

# what a view may differ by: five times the median of all views, within these limits
ANGLE = 0.3, 1.5  # degrees; sound views differ by hundredths, wrong ones by 3 and more
SHIFT = 0.1, 0.4  # of a mesh; a view counted from another node is off by a whole one


@dataclass
class Agreement:
    """What the comparison found.

    Parameters
    ----------
    wrong_views : list of (str, str)
        (camera, pose) of single views that disagree with all others.
    wrong_cameras : list of str
        Cameras that agree with no other.
    alone : list of str
        Cameras that share no view with another.
    angle : dict of (str, str) to float
        Largest disagreement of each pair of cameras over the views kept, degrees.
    """

    wrong_views: list[tuple[str, str]] = field(default_factory=list)
    wrong_cameras: list[str] = field(default_factory=list)
    alone: list[str] = field(default_factory=list)
    angle: dict[tuple[str, str], float] = field(default_factory=dict)


def passages(a: Alone, b: Alone) -> dict[str, tuple[Array, Array]]:
    """From camera a's frame to camera b's, by each view that both saw.

    Parameters
    ----------
    a, b : Alone
        Two cameras, each calibrated on its own.

    Returns
    -------
    dict of str to (ndarray (3, 3), ndarray (3,))
        Rotation and translation per pose, metres.
    """
    out = {}
    for pose in a.poses:
        if pose in b.poses:
            (Ra, ta), (Rb, tb) = a.poses[pose], b.poses[pose]
            R = Rb @ Ra.T
            out[pose] = R, tb - R @ ta
    return out


def _medoid(rotations: list[Array]) -> int:
    angles = np.array([[angle_between(A, B) for B in rotations] for A in rotations])
    return int(np.argmin(np.median(angles, axis=1)))


def compare(cameras: Mapping[str, Alone], mesh: float) -> Agreement:
    """Compare the poses of the target that the cameras found each on its own.

    Parameters
    ----------
    cameras : mapping of str to Alone
        The cameras.
    mesh : float
        Of the target, metres.

    Returns
    -------
    Agreement
    """
    found = Agreement()
    names = list(cameras)
    bad: dict[tuple[str, str], int] = {}  # (camera, pose) -> pairs in which it disagrees
    asked: dict[tuple[str, str], int] = {}
    partners: dict[str, list[str]] = {name: [] for name in names}
    agrees: dict[str, list[str]] = {name: [] for name in names}
    for i, a in enumerate(names):
        for b in names[i + 1 :]:
            common = passages(cameras[a], cameras[b])
            if not common:
                continue
            partners[a].append(b)
            partners[b].append(a)
            if len(common) == 1:
                agrees[a].append(b)
                agrees[b].append(a)
                continue
            poses = list(common)
            middle = common[poses[_medoid([common[p][0] for p in poses])]]
            shift = np.median([t for _, t in common.values()], axis=0)
            # translations of oblique views scatter along the sight line: judge them where the target is
            angle = {p: angle_between(common[p][0], middle[0]) for p in poses}
            away = {
                p: float(np.linalg.norm(_at_target(cameras[a], cameras[b], p, middle[0], shift))) / mesh
                for p in poses
            }
            off = {p: max(angle[p] / _limit(angle, ANGLE), away[p] / _limit(away, SHIFT)) for p in poses}
            good = [p for p in poses if off[p] <= 1.0]
            if len(good) > len(poses) / 2 or (len(good) >= 2 and len(poses) <= 4):
                agrees[a].append(b)
                agrees[b].append(a)
                found.angle[a, b] = max(angle[p] for p in good)
                for p in poses:
                    for name in (a, b):
                        asked[name, p] = asked.get((name, p), 0) + 1
                        bad[name, p] = bad.get((name, p), 0) + (p not in good)
            else:
                found.angle[a, b] = float(np.median(list(angle.values())))
    found.alone = [name for name in names if not partners[name]] if len(names) > 1 else []
    # the largest company is right; who agrees with none of it is wrong
    company = max((_company(name, agrees) for name in names), key=len, default=[])
    found.wrong_cameras = [name for name in names if name not in company and name not in found.alone]
    for (name, pose), count in bad.items():
        # with three cameras the one at fault disagrees with both others; with two there is no telling which
        if count and count == asked[name, pose]:
            others = [n for n in names if n != name and (n, pose) in bad]
            if all(bad[n, pose] < asked[n, pose] for n in others) or all(
                bad[n, pose] == asked[n, pose] for n in others
            ):
                found.wrong_views.append((name, pose))
    return found


def _limit(differences: Mapping[str, float], bounds: tuple[float, float]) -> float:
    return float(np.clip(5.0 * np.median(list(differences.values())), *bounds))


def _company(name: str, agrees: Mapping[str, list[str]]) -> list[str]:
    company, queue = [name], [name]
    while queue:
        for other in agrees[queue.pop()]:
            if other not in company:
                company.append(other)
                queue.append(other)
    return company


def _at_target(a: Alone, b: Alone, pose: str, R: Array, t: Array) -> Array:
    """How far apart the two cameras put the target's origin, across b's line of sight, metres."""
    expected = R @ a.poses[pose][1] + t
    seen = b.poses[pose][1]
    along = seen / np.linalg.norm(seen)
    miss = expected - seen
    return miss - along * (along @ miss)


def mirrored(alone: Alone) -> Alone:
    """The camera as it would have been found from images flipped left to right.

    Parameters
    ----------
    alone : Alone
        As found.

    Returns
    -------
    Alone
        In a mirror the target's y axis runs the other way, and so does the camera's x axis.
    """
    F, G = np.diag([-1.0, 1.0, 1.0]), np.diag([1.0, -1.0, 1.0])
    poses = {}
    for pose, (R, t) in alone.poses.items():
        turned = F @ R @ G
        poses[pose] = turned, F @ t
    return Alone(alone.lens, poses, alone.rms, alone.spread, alone.deep)


def chained(cameras: Mapping[str, Alone], first: str) -> dict[str, tuple[Array, Array]]:
    """Pose of each camera from the frame of the first, by the views they share.

    Parameters
    ----------
    cameras : mapping of str to Alone
        Cameras that agree with each other.
    first : str
        Whose frame.

    Returns
    -------
    dict of str to (ndarray (3, 3), ndarray (3,))
        Passage from the first camera's frame, metres.
    """
    out = {first: (np.eye(3), np.zeros(3))}
    while True:
        links = [(len(passages(cameras[a], cameras[b])), a, b) for a in out for b in cameras if b not in out]
        count, a, b = max(links, default=(0, "", ""))
        if not count:
            return out
        common = list(passages(cameras[a], cameras[b]).values())
        R = mean_rotation(np.stack([R for R, _ in common]))
        t = np.median([tb for _, tb in common], axis=0)
        Ra, ta = out[a]
        out[b] = R @ Ra, R @ ta + t
