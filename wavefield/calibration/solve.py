"""Calibrate a rig from target points, and report each problem in a sentence."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any

import numpy as np

from wavefield.calibration.assess import (
    Views,
    assess_rig,
    calibrate_each,
    consistent_cameras,
    usable_views,
)
from wavefield.calibration.bundle import TERMS, Fit, covariance_to_dict, fit
from wavefield.calibration.camera_start import PhysicalFrame, physical_frame, start_geometry
from wavefield.calibration.model_choice import (
    PredictedErrors,
    choose_model,
    predict_errors,
    terms_of,
)
from wavefield.calibration.observations import (
    MIN_OUTLIER_PX,
    OUTLIER_DEVIATIONS,
    Findings,
    Geometry,
    Observations,
    collect,
)
from wavefield.calibration.points import Mask
from wavefield.calibration.target import Target
from wavefield.rig import Rig
from wavefield.rig.lens import LENS
from wavefield.robust import robust_std

MAX_ROUNDS = 4  # of fitting and rejecting outliers, so that up to four views can be rejected


@dataclass(frozen=True)
class Calibration:
    """A calibrated rig, its uncertainties and its problems.

    Parameters
    ----------
    rig : Rig
        The cameras; empty if no camera could be calibrated.
    usable : bool
        Whether the rig is good enough for measurements.
    problems : tuple of str
        Why the rig is not usable, and which target images to retake.
    notes : tuple of str
        Remarks, for example on views that were left out.
    model : str
        The camera model, as the names of its free terms.
    observations : Observations, optional
        The points that were fitted.
    fit : Fit, optional
        The joint fit.
    predicted : PredictedErrors, optional
        Standard uncertainties of projected positions and of z, from the covariance of the parameters.
    left_out : dict of str to int
        Number of points left out, by view ("camera pose").
    target_std : float
        Given standard uncertainty of the positions of the target's nodes along each axis, metres.
    reference : str
        The pose of the target that defines z = 0 and the axes.
    """

    rig: Rig
    usable: bool
    problems: tuple[str, ...]
    notes: tuple[str, ...] = ()
    model: str = ""
    observations: Observations | None = None
    fit: Fit | None = None
    predicted: PredictedErrors | None = None
    left_out: Mapping[str, int] = field(default_factory=dict)
    target_std: float = 0.0
    reference: str = ""


def calibrate(
    views: Views,
    target: Target | float,
    *,
    flat: str = "flat",
    model: str = "auto",
    target_std: float = 0.0,
    camera_distance: Mapping[str, float] | None = None,
) -> Calibration:
    """Calibrate all cameras of a rig from their views of a target.

    Parameters
    ----------
    views : mapping of camera to mapping of pose to TargetPoints
        The points of each image. A pose is one position of the target; it has the same name in all cameras.
        If points are ``placed``, their positions in the frame of the rig are known (a target moved along z
        by known steps).
    target : Target or float
        The target, or the distance between its neighbouring nodes, metres.
    flat : str, default "flat"
        Name of the pose on the plane z = 0; its axes become those of the rig. If the name is empty, the pose
        that most cameras saw defines them; level the rig on the water afterwards.
    model : str, default "auto"
        Free terms of the camera model, such as ``f tilt k1`` (`wavefield.calibration.bundle.TERMS`).
        ``auto`` chooses the model with the least expected error where the rig will be used (`model_choice`).
    target_std : float, default 0
        Standard uncertainty of the positions of the target's nodes along each axis, metres. If it is given,
        the fit estimates these errors too; level the rig on the water at rest afterwards.
    camera_distance : mapping of str to float, optional
        Distances of cameras from the origin that you measured, metres. Only they can reveal that the
        distance between the target's nodes is wrong.

    Returns
    -------
    Calibration
        The rig, whether it is ``usable``, and its ``problems``. Bad points give problems, not exceptions.

    Raises
    ------
    CalibrationError
        If the camera model is not made of known terms.

    Examples
    --------
    The paper's cameras from points of four tilted views and a flat one:

    >>> import cv2
    >>> from wavefield.calibration import TargetPoints
    >>> from wavefield.tank.rigs import paper_rig
    >>> exact, node = paper_rig(), np.mgrid[-8:9, -6:7].reshape(2, -1).T
    >>> board = np.column_stack([0.1 * node, np.zeros(len(node))])
    >>> views, noise = {name: {} for name in exact}, np.random.default_rng(1)
    >>> for turn in ((0.4, 0, 0), (-0.3, 0.2, 0), (0, -0.4, 0), (0.2, 0.3, 0), (0, 0, 0)):
    ...     points = board @ cv2.Rodrigues(np.array(turn, float))[0].T
    ...     for name, camera in exact.cameras.items():
    ...         pixel = np.stack(camera.project(*points.T), axis=-1) + noise.normal(0, 0.01, (len(node), 2))
    ...         pose = "tilted by {} and {}".format(*turn) if any(turn) else "flat"
    ...         views[name][pose] = TargetPoints(node, pixel, np.full(len(node), 0.01), camera.size)
    >>> found = calibrate(views, 0.1)
    >>> found.usable, found.rig["cam3"].centre.round(3).tolist()
    (True, [0.003, 0.002, 4.35])
    """
    mesh, origin = (target, (0.0, 0.0)) if isinstance(target, float | int) else (target.mesh, target.origin)
    findings = Findings()
    usable = usable_views(views, findings)
    single = calibrate_each(usable, mesh, origin, flat, findings)
    if not single:
        return Calibration(
            Rig({}), False, tuple(findings.problems), tuple(findings.notes), left_out=findings.left_out
        )
    consistent = consistent_cameras(single, usable, mesh, findings)
    observations = collect({name: usable[name] for name in consistent}, mesh, origin)
    frame = physical_frame(observations, flat, findings)
    geometry = start_geometry(observations, consistent, frame)
    observations, result, chosen = _fit_and_choose(
        observations, geometry, frame, terms_of(model), target_std, findings
    )
    predicted = predict_errors(observations, result, frame.level)
    assess_rig(observations, result, predicted, target_std, camera_distance or {}, findings)
    cameras = dict(zip(observations.cameras, result.geometry.cameras(observations.sizes), strict=True))
    calibration = Calibration(
        Rig(cameras),
        not findings.problems,
        tuple(findings.problems),
        tuple(findings.notes),
        chosen,
        observations,
        result,
        predicted,
        findings.left_out,
        target_std,
        observations.poses[frame.reference],
    )
    return replace(calibration, rig=Rig(cameras, _provenance(calibration)))


def _fit_and_choose(
    observations: Observations,
    start: Geometry,
    frame: PhysicalFrame,
    model: tuple[str, ...] | None,
    target_std: float,
    findings: Findings,
) -> tuple[Observations, Fit, str]:
    """Fit all cameras, reject outliers, and choose the camera model if `model` is None.
    Returns the observations kept, the fit, and the free terms of the model."""
    o = observations
    terms = model or ("f", "aspect", "c", "k1")

    def run(terms: tuple[str, ...], begin: Geometry, scale: float | None = None) -> Fit:
        begin = _restricted(begin, terms, o)
        models = [terms] * len(o.cameras)
        return fit(o, begin, models, frame.reference, target_std, scale, frame.placed)

    result = run(terms, start)
    for _ in range(MAX_ROUNDS):
        inlier = _inliers(o, result, findings)
        if inlier.all():
            break
        o = o.only(inlier)
        result = run(terms, result.geometry)
    if model:
        return o, result, " ".join(model)
    scale, begin = result.scale, result.geometry
    name, result = choose_model(lambda terms: run(terms, begin, scale), o, frame.level)
    return o, result, name


def _restricted(geometry: Geometry, terms: Sequence[str], observations: Observations) -> Geometry:
    """Return the geometry with lens terms outside `terms` reset to those of an ideal lens.
    An ideal lens has no distortion, and its principal point is the image centre. `observations` gives sizes.
    """
    lens = geometry.lens.copy()
    free = {"fx", "fy"}.union(*(TERMS[term] for term in terms))
    fixed = [column for column, name in enumerate(LENS) if name not in free]
    perfect = np.zeros_like(lens)
    perfect[:, 2:4] = (np.array(observations.sizes) - 1) / 2
    lens[:, fixed] = perfect[:, fixed]
    if "aspect" not in terms:
        lens[:, :2] = np.sqrt(lens[:, :1] * lens[:, 1:2])
    return replace(geometry, lens=lens)


def _inliers(o: Observations, result: Fit, findings: Findings) -> Mask:
    """Return a mask (n,) of the observations to keep; rejected ones are recorded in `findings`.
    A view that is much worse than the others is rejected whole. Else, single bad points are rejected."""
    deviation = np.abs(result.residual).max(axis=1) / o.std
    view = o.camera * len(o.poses) + o.pose
    spread = {
        v: robust_std((result.residual[view == v] / o.std[view == v, None]).ravel())
        for v in np.unique(view).tolist()
    }
    typical = float(np.median(list(spread.values())))
    worst = max(spread, key=lambda v: spread[v])
    px = robust_std(result.residual[view == worst].ravel())

    def leave_out(v: int, points: Mask, reason: str = "") -> None:
        camera, pose = divmod(v, len(o.poses))
        findings.leave_out(o.cameras[camera], o.poses[pose], int(points.sum()), reason)

    if spread[worst] > OUTLIER_DEVIATIONS * typical and px > MIN_OUTLIER_PX and len(spread) > 4:
        leave_out(
            worst,
            view == worst,
            f"its points miss the common fit by {px:.2f} px, {spread[worst] / typical:.0f} times "
            "as much as those of the other views (target moved or bent, image blurred?)",
        )
        others: Mask = view != worst
        return others
    limit = OUTLIER_DEVIATIONS * np.array([max(spread[v], typical) for v in view.tolist()])
    inlier: Mask = deviation <= limit
    for v in np.unique(view[~inlier]).tolist():
        leave_out(v, ~inlier & (view == v))
    return inlier


def _provenance(calibration: Calibration) -> dict[str, Any]:
    """Return the results of the calibration as a dict of numbers, texts and lists, for the rig file."""
    o, result, errors = calibration.observations, calibration.fit, calibration.predicted
    assert o is not None
    assert result is not None
    assert errors is not None
    std = np.sqrt(np.diag(result.covariance))
    cameras = {}
    for c, name in enumerate(o.cameras):
        rows = o.camera == c
        first = result.layout.camera[c]
        columns = [*(k for k, _ in result.layout.lens[c]), *range(first, first + 6)]
        cameras[name] = {
            "views": [o.poses[p] for p in np.unique(o.pose[rows])],
            "points": int(rows.sum()),
            "rms_px": float(np.sqrt(np.mean(result.residual[rows] ** 2))),
            "max_px": float(np.abs(result.residual[rows]).max()),
            "reprojection_std_px": errors.reprojection[name],
            "parameter_std": {result.layout.names[k].split()[-1]: float(std[k]) for k in columns},
        }
    return {
        "made": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "usable": calibration.usable,
        "problems": list(calibration.problems),
        "notes": list(calibration.notes),
        "model": calibration.model,
        "mesh_m": float(o.mesh),
        "target_std_m": float(calibration.target_std),
        "reference_view": calibration.reference,
        "z_std_m": errors.z_std,
        "left_out_points": dict(calibration.left_out),
        "cameras": cameras,
        "parameter_units": "f, aspect: log of the focal lengths; c: px; R: rad; T: m; k, p: 1; tau: rad",
        "covariance": covariance_to_dict(result.layout.names, result.covariance, o.cameras),
    }
