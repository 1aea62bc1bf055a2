"""Before the joint fit: do the cameras agree on how the target moved?

The target has one pose per view, whoever looks. So the passage from one camera's frame to another's, taken
from any view that both saw, must be the same. A view indexed wrongly, or a mirrored image, is not.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from wavefield.calibration.start import Alone, angle_between, mean_rotation
from wavefield.rig.lens import Array

# what a view may differ by: five times the median of all views, within these limits
ANGLE = 0.3, 1.5  # degrees; sound views differ by hundredths, wrong ones by 3 and more
SHIFT = 0.1, 0.4  # of a mesh; a view counted from another node is off by a whole one


@dataclass
class ViewAgreement:
    """What the comparison found."""

    # (str, str): (camera, pose) of single views that disagree with all others
    wrong_views: list[tuple[str, str]] = field(default_factory=list)
    wrong_cameras: list[str] = field(default_factory=list)  # Cameras that agree with no other
    alone: list[str] = field(default_factory=list)  # Cameras that share no view with another
    # (str, str): Largest disagreement of each pair of cameras over the views kept, degrees
    angle: dict[tuple[str, str], float] = field(default_factory=dict)


def passages(a: Alone, b: Alone) -> dict[str, tuple[Array, Array]]:
    """From camera a's frame to camera b's, by each view that both saw.

    Returns (3, 3): Rotation and translation per pose, metres.
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


@dataclass(frozen=True)
class _Pair:
    """What two cameras say of each other: whether they agree, how far apart they are, each view's verdict."""

    agrees: bool
    angle: float | None = None  # degrees; None where one view alone was seen by both
    good: Mapping[str, bool] = field(default_factory=dict)  # by pose, where they agree


def compare(cameras: Mapping[str, Alone], mesh: float) -> ViewAgreement:
    """Compare the poses of the target that the cameras found each on its own.

    With mesh, metres.
    """
    names = list(cameras)
    pairs = {(a, b): _pair(cameras[a], cameras[b], mesh) for a, b in combinations(names, 2)}
    met = {pair: verdict for pair, verdict in pairs.items() if verdict is not None}
    alone = [name for name in names if not any(name in pair for pair in met)] if len(names) > 1 else []
    # the largest company is right; who agrees with none of it is wrong
    agreed = [pair for pair, verdict in met.items() if verdict.agrees]
    company = max((_company(name, agreed) for name in names), key=len, default=[])
    return ViewAgreement(
        _wrong_views(names, met),
        [name for name in names if name not in company and name not in alone],
        alone,
        {pair: verdict.angle for pair, verdict in met.items() if verdict.angle is not None},
    )


def _pair(a: Alone, b: Alone, mesh: float) -> _Pair | None:
    """What two cameras say of each other; None where they share no view."""
    common = passages(a, b)
    if len(common) < 2:
        return _Pair(True) if common else None
    turns = [R for R, _ in common.values()]
    middle = turns[_medoid(turns)]
    shift = np.median([t for _, t in common.values()], axis=0)
    angle = {pose: angle_between(R, middle) for pose, (R, _) in common.items()}
    # translations of oblique views scatter along the sight line: judge them where the target is
    away = {pose: float(np.linalg.norm(_at_target(a, b, pose, middle, shift))) / mesh for pose in common}
    most_angle, most_away = _limit(angle, ANGLE), _limit(away, SHIFT)
    good = {pose: max(angle[pose] / most_angle, away[pose] / most_away) <= 1.0 for pose in common}
    count = sum(good.values())
    if count > len(good) / 2 or (count >= 2 and len(good) <= 4):
        return _Pair(True, max(angle[pose] for pose in common if good[pose]), good)
    return _Pair(False, float(np.median(list(angle.values()))))


def _wrong_views(names: Sequence[str], met: Mapping[tuple[str, str], _Pair]) -> list[tuple[str, str]]:
    """Views that disagree with all others; with two cameras there is no telling which of them it is."""
    verdicts: dict[tuple[str, str], list[bool]] = {}  # (camera, pose): is it good, once per partner
    for pair, verdict in met.items():
        for pose, good in verdict.good.items():
            for name in pair:
                verdicts.setdefault((name, pose), []).append(good)
    wrong = {view for view, good in verdicts.items() if not any(good)}
    out = []
    for name, pose in verdicts:
        others = {(n, pose) in wrong for n in names if n != name and (n, pose) in verdicts}
        if (name, pose) in wrong and len(others) < 2:  # none of the others is, or all of them are
            out.append((name, pose))
    return out


def _limit(differences: Mapping[str, float], bounds: tuple[float, float]) -> float:
    return float(np.clip(5.0 * np.median(list(differences.values())), *bounds))


def _company(name: str, agreed: Sequence[tuple[str, str]]) -> list[str]:
    """A camera, those it agrees with, those that they agree with, and so on."""
    company = [name]
    for member in company:
        partners = [b if a == member else a for a, b in agreed if member in (a, b)]
        company += [partner for partner in partners if partner not in company]
    return company


def _at_target(a: Alone, b: Alone, pose: str, R: Array, t: Array) -> Array:
    """How far apart the two cameras put the target's origin, across b's sight line, metres."""
    expected = R @ a.poses[pose][1] + t
    seen = b.poses[pose][1]
    along = seen / np.linalg.norm(seen)
    miss = expected - seen
    return miss - along * (along @ miss)


def mirrored(alone: Alone) -> Alone:
    """The camera as it would have been found from images flipped left to right."""
    F, G = np.diag([-1.0, 1.0, 1.0]), np.diag([1.0, -1.0, 1.0])
    poses = {}
    for pose, (R, t) in alone.poses.items():
        poses[pose] = F @ R @ G, F @ t
    return Alone(alone.lens, poses, alone.rms, alone.spread, alone.deep)


def chained(cameras: Mapping[str, Alone], first: str) -> dict[str, tuple[Array, Array]]:
    """Pose of each camera from the frame of the first, by the views they share.

    Returns (3, 3): Passage from the first camera's frame, metres.
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
