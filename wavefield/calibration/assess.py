"""Check target views before a calibration and the fitted rig after it; report problems in sentences.

A pose is one position of the target, which several cameras photograph; a view is the image of one pose by one
camera. A node is a marked point of the target, for example a dot. Findings are problems and notes.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from wavefield.calibration.bundle import Fit
from wavefield.calibration.camera_start import (
    PoseConsistency,
    SingleCamera,
    calibrate_single,
    compare_poses,
    mirrored,
)
from wavefield.calibration.model_choice import PredictedErrors
from wavefield.calibration.observations import LIMITS, Findings, Observations, collect
from wavefield.calibration.points import TargetPoints
from wavefield.errors import CalibrationError
from wavefield.rig import Rig
from wavefield.rig.lens import Array
from wavefield.rig.stereo import epipolar_distance, triangulate
from wavefield.rig.water_level import WaterPlane, fit_plane


@dataclass(frozen=True)
class FlatSurface:
    """Target nodes in one pose, usually flat on z = 0, triangulated from two or more cameras.
    z is the measured minus the expected height of each node, so it is zero for a perfect rig."""

    x: Array  # (n,): Measured position of each node, metres
    y: Array  # (n,)
    z: Array  # (n,)
    plane: WaterPlane  # The plane through these nodes

    @property
    def rms(self) -> float:
        """Root mean square of z, metres, over the nodes that are not outliers from the fitted plane."""
        return _rms(self.z[self.plane.kept])

    @property
    def tilt(self) -> float:
        """Angle between z = 0 and the plane fitted to the nodes, milliradians."""
        return float(1e3 * np.hypot(*self.plane.slope))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def flat_surface(observations: Observations, fit: Fit, rig: Rig, pose: str) -> FlatSurface | None:
    """Triangulate with `rig` the target nodes of the pose named `pose` that two or more cameras see.
    `fit` gives the expected heights. Returns None if fewer than ten nodes can be triangulated."""
    o = observations
    N, C = len(o.nodes), len(o.cameras)
    apparent, sight = np.full((C, 2, N), np.nan), np.full((C, 2, N), np.nan)
    for c, name in enumerate(o.cameras):
        rows = (o.camera == c) & (o.pose == o.poses.index(pose))
        apparent[c][:, o.node[rows]] = np.stack(rig[name].unproject(*o.pixel[rows].T))
        sight[c] = np.stack(rig[name].sight_line(*apparent[c]))
    x, y, z, _ = triangulate(apparent, sight)
    z = z - fit.geometry.offset[:, 2] - o.nominal[:, 2]
    measured = np.isfinite(z)
    if measured.sum() < 10:
        return None
    x, y, z = x[measured], y[measured], z[measured]
    return FlatSurface(x, y, z, fit_plane(x, y, z))


def epipolar_residuals(observations: Observations, rig: Rig) -> dict[tuple[str, str], Array]:
    """Return signed distances (m,), px, of target nodes from their epipolar lines, by pair of camera names.
    Distances are in the image of the pair's second camera. Pairs without a common node are left out."""
    o = observations
    key = o.pose * len(o.nodes) + o.node
    out = {}
    for a, b in combinations(range(len(o.cameras)), 2):
        rows_a, rows_b = np.flatnonzero(o.camera == a), np.flatnonzero(o.camera == b)
        _, ia, ib = np.intersect1d(key[rows_a], key[rows_b], return_indices=True)
        if len(ia):
            one, other = o.cameras[a], o.cameras[b]
            pa, pb = o.pixel[rows_a[ia]], o.pixel[rows_b[ib]]
            out[one, other] = epipolar_distance(rig[one], rig[other], *pa.T, *pb.T)
    return out


def _pixel_on_target(fit: Fit, observations: Observations, camera: int) -> float:
    """Return the width, metres, of a pixel of camera number `camera`, projected to the target (median)."""
    g = fit.geometry
    world = g.world(observations)[observations.camera == camera]
    depth = (world @ g.R[camera].T + g.T[camera])[:, 2]
    return float(np.median(depth) / np.sqrt(g.lens[camera, 0] * g.lens[camera, 1]))


def residual_summary(
    observations: Observations, fit: Fit, rig: Rig, reference: str
) -> tuple[dict[str, Any], FlatSurface | None]:
    """Return residuals (rms, largest) as a nested dict, and the triangulated nodes of the pose `reference`.
    The dict has the keys ``cameras``, ``epipolar`` and ``flat_target``; an inner key ends with its unit. If
    too few nodes can be triangulated, the nodes are None and ``flat_target`` is missing."""
    o = observations
    cameras = {}
    for c, name in enumerate(o.cameras):
        rows = o.camera == c
        rms = _rms(fit.residual[rows])
        views = {}
        for p in np.unique(o.pose[rows]):
            view = rows & (o.pose == p)
            views[o.poses[p]] = {"points": int(view.sum()), "rms_px": _rms(fit.residual[view])}
        cameras[name] = {
            "rms_px": rms,
            "rms_mm": 1e3 * _pixel_on_target(fit, o, c) * rms,
            "max_px": float(np.abs(fit.residual[rows]).max()),
            "position_m": [float(v) for v in rig[name].centre],
            "views": views,
        }
    out: dict[str, Any] = {
        "cameras": cameras,
        "epipolar": {
            f"{a} - {b}": {
                "rms_px": _rms(d),
                "median_px": float(np.median(np.abs(d))),
                "max_px": float(np.abs(d).max()),
                "points": len(d),
            }
            for (a, b), d in epipolar_residuals(o, rig).items()
        },
    }
    surface = flat_surface(o, fit, rig, reference)
    if surface is not None:
        out["flat_target"] = {
            "view": reference,
            "nodes": len(surface.z),
            "z_rms_mm": 1e3 * surface.rms,
            "z_about_its_plane_rms_mm": 1e3 * surface.plane.rms,
            "tilt_mrad": surface.tilt,
        }
    return out, surface


Views = Mapping[str, Mapping[str, TargetPoints]]
UsableViews = dict[str, dict[str, TargetPoints]]

MIN_STD = 1e-4  # px: no image gives a smaller uncertainty


def usable_views(views: Views, findings: Findings) -> UsableViews:
    """Return the usable views, by camera and pose: enough nodes, and the most frequent image size.
    Rejected views, and cameras without a usable view, are recorded in `findings`."""
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
    """Return the most frequent image size (width, height), px, of the camera `name`; None without views.
    If the camera's images differ in size, a problem is added to `findings`."""
    sizes = {pose: (int(points.size[0]), int(points.size[1])) for pose, points in by_pose.items()}
    if not sizes:
        return None
    common = Counter(sizes.values()).most_common(1)[0][0]
    odd = [f"{pose} ({s[0]} x {s[1]})" for pose, s in sizes.items() if s != common]
    if odd:
        findings.problems.append(
            f"the images of {name} have different sizes, most {common[0]} x {common[1]}, but "
            f"{', '.join(odd)}: take all views with the same settings of the camera"
        )
    return common


def _finite(points: TargetPoints) -> TargetPoints:
    """Return the points with finite position and uncertainty, of at least `MIN_STD` px."""
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
    flat: str,
    findings: Findings,
) -> dict[str, SingleCamera]:
    """Calibrate each camera from the views of this camera alone; return those that succeed, by name.
    Problems are added to `findings`, and bad views are removed from `usable` in place. `mesh` is the distance
    between neighbouring target nodes and `origin` the position of node (0, 0), in metres; `flat` is the name
    of the pose on z = 0."""
    single: dict[str, SingleCamera] = {}
    for name, views in usable.items():
        if not views:
            continue
        try:
            single[name] = calibrate_single(collect({name: views}, mesh, origin))
        except CalibrationError as error:
            findings.problems.append(str(error))
    for name, camera in single.items():
        for pose in [p for p in usable[name] if p not in camera.poses]:
            findings.leave_out(name, pose, len(usable[name].pop(pose)), "its points are not a plane grid")
        if camera.known_heights:
            continue
        tilted = [p for p in camera.poses if p != flat]
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
    """Return the largest group of cameras that agree on the poses of the target, by name.
    If no two cameras share a pose, return the camera with most views. Views that contradict other cameras are
    removed from `single` and `usable` in place. `mesh` is the distance between neighbouring nodes, metres."""
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
    excluded = consistency.wrong_cameras + consistency.unlinked
    consistent = {name: camera for name, camera in single.items() if name not in excluded}
    if consistent:
        return consistent
    # no two cameras share a pose: keep the one with the most views
    name = max(single, key=lambda n: len(single[n].poses))
    return {name: single[name]}


def _report_inconsistency(
    consistency: PoseConsistency, single: Mapping[str, SingleCamera], mesh: float, findings: Findings
) -> None:
    """Add a problem to `findings` for each camera that contradicts the others or shares no pose with them.
    `mesh` is the distance between neighbouring target nodes, metres."""
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
    for name in consistency.unlinked:
        findings.problems.append(
            f"{name} shares no view of the target with another camera: "
            "photograph the target where all cameras see it at once"
        )


def assess_rig(
    o: Observations,
    result: Fit,
    errors: PredictedErrors,
    target_std: float,
    camera_distance: Mapping[str, float],
    findings: Findings,
) -> None:
    """Check predicted errors, image coverage and camera distances of a fitted rig against `LIMITS`.
    Problems and notes are added to `findings`. `camera_distance` holds the user's measured distances from the
    origin, metres, by camera; `target_std` is the standard uncertainty of node positions, metres."""
    for c, name in enumerate(o.cameras):
        stated = camera_distance.get(name)
        if stated:
            distance = float(np.linalg.norm(result.geometry.R[c].T @ result.geometry.T[c]))
            if abs(np.log(distance / stated)) > LIMITS.max_distance_error:
                findings.problems.append(
                    f"{name} is {distance:.2f} m from the origin by this calibration, not {stated:.2f} m as "
                    f"stated: the mesh is given as {1e3 * o.mesh:g} mm; measure it, "
                    f"it may be {1e3 * o.mesh * stated / distance:.3g} mm"
                )
        if not errors.reprojection[name] < LIMITS.max_reprojection_std:
            findings.problems.append(
                f"{name} is determined to {errors.reprojection[name]:.2f} px only {errors.volume}: "
                "photograph more tilted views that fill its image"
            )
    if len(o.cameras) > 1 and not errors.z_std < LIMITS.max_z_std:
        findings.problems.append(
            f"z would be uncertain by {1e3 * errors.z_std:.1f} mm: photograph more tilted views"
        )
    if len(o.cameras) == 1:
        findings.notes.append("one camera only: z and the velocity need two at least")
    if target_std > 0.0:
        findings.notes.append(
            "the target is uncertain, and so is its plane: level the rig on the water at rest"
        )
    for name, coverage in errors.coverage.items():
        if coverage < LIMITS.min_coverage:
            findings.notes.append(
                f"the target's views cover {100 * coverage:.0f} % of {name}'s image: its edges are "
                "extrapolated"
            )
