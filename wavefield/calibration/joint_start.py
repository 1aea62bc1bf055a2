"""The start of the joint fit: the physical frame, and all cameras and poses in it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wavefield.calibration.findings import Findings
from wavefield.calibration.observations import Geometry, Observations
from wavefield.calibration.pose_consistency import chained
from wavefield.calibration.poses import Pose, mean_pose
from wavefield.calibration.start import SingleCamera


@dataclass(frozen=True)
class PhysicalFrame:
    """The poses that define the frame: one that is not moved, and others on its plane, or all placed."""

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
