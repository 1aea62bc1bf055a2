"""Views of the target before any fit: which of them can be used."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from wavefield.calibration.compare import ViewAgreement, compare, mirrored
from wavefield.calibration.findings import Findings
from wavefield.calibration.observations import collect
from wavefield.calibration.points import TargetPoints
from wavefield.calibration.start import FEWEST_NODES, Alone, calibrate_alone
from wavefield.errors import CalibrationError

Views = Mapping[str, Mapping[str, TargetPoints]]
Good = dict[str, dict[str, TargetPoints]]

SPREAD = 10.0  # degrees between views of the target, below which the focal length is a guess


def sound_views(views: Views, findings: Findings) -> Good:
    """Views with enough points, of one size per camera."""
    good: Good = {}
    for name, of_camera in views.items():
        common = _common_size(name, of_camera, findings)
        good[name] = {}
        for pose, given in of_camera.items():
            points = _finite(given)
            if tuple(points.size) != common:
                findings.leave_out(name, pose, len(points))
            elif len(points) < FEWEST_NODES:
                what = f"only {len(points)} nodes of the target" if len(points) else "no target"
                findings.leave_out(name, pose, len(points), f"{what} found")
            else:
                good[name][pose] = points
        if not good[name]:
            findings.problems.append(f"no target was found in any view of {name}: photograph it again")
    if not views:
        findings.problems.append("there are no views of the target")
    return good


def _common_size(
    name: str, of_camera: Mapping[str, TargetPoints], findings: Findings
) -> tuple[int, int] | None:
    sizes: dict[tuple[int, int], list[str]] = {}
    for pose, points in of_camera.items():
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
    """Points that are numbers; no uncertainty is below what an image can give."""
    sound = np.isfinite(points.pixel).all(axis=-1) & np.isfinite(points.std)
    return replace(
        points,
        node=points.node[sound],
        pixel=points.pixel[sound],
        std=np.maximum(points.std[sound], 1e-4),
        z=None if points.z is None else points.z[sound],
    )


def each_alone(
    good: Good, mesh: float, origin: tuple[float, float], flats: Sequence[str], findings: Findings
) -> dict[str, Alone]:
    """Each camera calibrated on its own; views that are no plane grid are taken out of `good`.

    With mesh, metres; origin (float, float), metres.
    """
    alone: dict[str, Alone] = {}
    for name in good:
        if not good[name]:
            continue
        try:
            alone[name] = calibrate_alone(collect({name: good[name]}, mesh, origin))
        except CalibrationError as error:
            findings.problems.append(str(error))
    for name, camera in alone.items():
        for pose in [p for p in good[name] if p not in camera.poses]:
            findings.leave_out(name, pose, len(good[name].pop(pose)), "its points are no plane grid")
        if camera.deep:  # positions of known height tell the focal length, however parallel
            continue
        tilted = [p for p in camera.poses if p not in flats]
        if len(camera.poses) < 3:
            findings.problems.append(
                f"{name} has {len(camera.poses)} usable view{'s' * (len(camera.poses) != 1)} of the target; "
                "photograph at least five tilted ones and a flat one"
            )
        elif len(tilted) < 2 or camera.spread < SPREAD:
            findings.problems.append(
                f"the views of {name} are parallel (at most {camera.spread:.1f} degrees apart): its "
                "focal length is unknown; photograph the target tilted by 20 to 40 degrees, to several "
                "sides, or state the heights of a target that was moved along z"
            )
    return alone


def agreeing(alone: dict[str, Alone], good: Good, mesh: float, findings: Findings) -> dict[str, Alone]:
    """Cameras that saw the target move alike; views that disagree are taken out of `alone` and `good`.

    With mesh, metres.
    """
    agreement = compare(alone, mesh)
    _remark_on_disagreement(agreement, alone, mesh, findings)
    for name, pose in agreement.wrong_views:
        findings.leave_out(
            name,
            pose,
            len(good[name].pop(pose)),
            "the target's pose is not the one the other cameras saw "
            "(its nodes are counted from another origin or turned, or it was moved between shots)",
        )
        del alone[name].poses[pose]
    together = {
        n: a for n, a in alone.items() if n not in agreement.wrong_cameras and n not in agreement.alone
    }
    if len(together) < 2:  # one camera, or cameras that have nothing in common: the first with the most views
        name = max(alone, key=lambda n: len(alone[n].poses))
        together = together or {name: alone[name]}
    return together


def _remark_on_disagreement(
    agreement: ViewAgreement, alone: Mapping[str, Alone], mesh: float, findings: Findings
) -> None:
    trusted = [n for n in alone if n not in agreement.wrong_cameras]
    for name in agreement.wrong_cameras:
        trial = compare({**{n: alone[n] for n in trusted}, name: mirrored(alone[name])}, mesh)
        who = name if len(alone) > 2 else f"{name} or {trusted[0]}"
        if name not in trial.wrong_cameras:
            findings.problems.append(
                f"the images of {who} are mirrored: flip them left to right, or take the mirror away"
            )
        else:
            findings.problems.append(
                f"{name} saw the target move differently from {' and '.join(trusted)}: are its views in "
                "the same order, and was the target still while all cameras took their image?"
            )
    for name in agreement.alone:
        findings.problems.append(
            f"{name} shares no view of the target with another camera: "
            "photograph the target where all cameras see it at once"
        )
