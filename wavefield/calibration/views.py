"""Views of the target before any joint fit: which of them can be used."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from wavefield.calibration.findings import Findings
from wavefield.calibration.limits import LIMITS
from wavefield.calibration.observations import collect
from wavefield.calibration.points import TargetPoints
from wavefield.calibration.pose_consistency import PoseConsistency, compare_poses, mirrored
from wavefield.calibration.start import SingleCamera, calibrate_single
from wavefield.errors import CalibrationError

Views = Mapping[str, Mapping[str, TargetPoints]]
UsableViews = dict[str, dict[str, TargetPoints]]

MIN_STD = 1e-4  # px: no image gives a smaller uncertainty


def usable_views(views: Views, findings: Findings) -> UsableViews:
    """Views with enough points, of one size per camera."""
    usable: UsableViews = {}
    for name, by_pose in views.items():
        size = _common_size(name, by_pose, findings)
        usable[name] = {}
        for pose, given in by_pose.items():
            points = _finite(given)
            if tuple(points.size) != size:
                findings.leave_out(name, pose, len(points))
            elif len(points) < LIMITS.min_nodes:
                content = f"only {len(points)} nodes of the target" if len(points) else "no target"
                findings.leave_out(name, pose, len(points), f"{content} found")
            else:
                usable[name][pose] = points
        if not usable[name]:
            findings.problems.append(f"no target was found in any view of {name}: photograph it again")
    if not views:
        findings.problems.append("there are no views of the target")
    return usable


def _common_size(
    name: str, by_pose: Mapping[str, TargetPoints], findings: Findings
) -> tuple[int, int] | None:
    """Size of most of a camera's images; other sizes are a problem."""
    sizes: dict[tuple[int, int], list[str]] = {}
    for pose, points in by_pose.items():
        sizes.setdefault((int(points.size[0]), int(points.size[1])), []).append(pose)
    if not sizes:
        return None
    common = max(sizes, key=lambda s: len(sizes[s]))
    if len(sizes) > 1:
        odd = [f"{pose} ({s[0]} x {s[1]})" for s in sizes if s != common for pose in sizes[s]]
        findings.problems.append(
            f"the images of {name} have different sizes, most {common[0]} x {common[1]}, but "
            f"{', '.join(odd)}: take all views with the same settings of the camera"
        )
    return common


def _finite(points: TargetPoints) -> TargetPoints:
    """Points that are numbers, with uncertainties that an image can give."""
    finite = np.isfinite(points.pixel).all(axis=-1) & np.isfinite(points.std)
    return replace(
        points,
        node=points.node[finite],
        pixel=points.pixel[finite],
        std=np.maximum(points.std[finite], MIN_STD),
        z=None if points.z is None else points.z[finite],
    )


def calibrate_each(
    usable: UsableViews,
    mesh: float,
    origin: tuple[float, float],
    flats: Sequence[str],
    lens: str,
    findings: Findings,
) -> dict[str, SingleCamera]:
    """Each camera calibrated on its own; views that are no plane grid are removed from `usable`."""
    single: dict[str, SingleCamera] = {}
    for name, views in usable.items():
        if not views:
            continue
        try:
            single[name] = calibrate_single(collect({name: views}, mesh, origin), lens)
        except CalibrationError as error:
            findings.problems.append(str(error))
    for name, camera in single.items():
        for pose in [p for p in usable[name] if p not in camera.poses]:
            findings.leave_out(name, pose, len(usable[name].pop(pose)), "its points are no plane grid")
        if camera.deep:
            continue
        tilted = [p for p in camera.poses if p not in flats]
        if len(camera.poses) < 3:
            findings.problems.append(
                f"{name} has {len(camera.poses)} usable view{'s' * (len(camera.poses) != 1)} of the target; "
                "photograph at least five tilted ones and a flat one"
            )
        elif len(tilted) < 2 or camera.spread < LIMITS.min_tilt_range:
            findings.problems.append(
                f"the views of {name} are parallel (at most {camera.spread:.1f} degrees apart): its "
                "focal length is unknown; photograph the target tilted by 20 to 40 degrees, to several "
                "sides, or state the heights of a target that was moved along z"
            )
    return single


def consistent_cameras(
    single: dict[str, SingleCamera], usable: UsableViews, mesh: float, findings: Findings
) -> dict[str, SingleCamera]:
    """Cameras with consistent poses of the target; views that differ are removed from both arguments."""
    consistency = compare_poses(single, mesh)
    _report_inconsistency(consistency, single, mesh, findings)
    for name, pose in consistency.wrong_views:
        findings.leave_out(
            name,
            pose,
            len(usable[name].pop(pose)),
            "the target's pose is not the one that the other cameras found "
            "(its nodes are counted from another origin or turned, or it was moved between shots)",
        )
        del single[name].poses[pose]
    excluded = consistency.wrong_cameras + consistency.alone
    consistent = {name: camera for name, camera in single.items() if name not in excluded}
    if consistent:
        return consistent
    # cameras that have nothing in common: the first with the most views
    name = max(single, key=lambda n: len(single[n].poses))
    return {name: single[name]}


def _report_inconsistency(
    consistency: PoseConsistency, single: Mapping[str, SingleCamera], mesh: float, findings: Findings
) -> None:
    right = [name for name in single if name not in consistency.wrong_cameras]
    for name in consistency.wrong_cameras:
        flipped = compare_poses({**{n: single[n] for n in right}, name: mirrored(single[name])}, mesh)
        if name not in flipped.wrong_cameras:
            candidates = name if len(single) > 2 else f"{name} or {right[0]}"
            findings.problems.append(
                f"the images of {candidates} are mirrored: flip them left to right, or take the mirror away"
            )
        else:
            findings.problems.append(
                f"the target moved differently in the views of {name} and of {' and '.join(right)}: are its "
                "views in the same order, and was the target still while all cameras took their image?"
            )
    for name in consistency.alone:
        findings.problems.append(
            f"{name} shares no view of the target with another camera: "
            "photograph the target where all cameras see it at once"
        )
