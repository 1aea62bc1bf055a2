"""From target points to a rig: the whole way, with everything that can be wrong told in a sentence."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.calibration.bundle import Fit, fit
from wavefield.calibration.compare import Agreement, chained, compare, mirrored
from wavefield.calibration.derived import Derived, derive
from wavefield.calibration.model_choice import MODELS, Choice, choose, terms_of
from wavefield.calibration.observations import LENS, Geometry, Observations, collect
from wavefield.calibration.points import TargetPoints
from wavefield.calibration.rest import covariance_to_dict
from wavefield.calibration.result import Calibration
from wavefield.calibration.start import FEWEST_NODES, Alone, calibrate_alone, mean_rotation
from wavefield.calibration.target import Target
from wavefield.errors import CalibrationError
from wavefield.rig import Rig
from wavefield.rig.camera import Array
from wavefield.robust import robust_std

Views = Mapping[str, Mapping[str, TargetPoints]]

SPREAD = 10.0  # degrees between views of the target, below which the focal length is a guess


def calibrate(  # noqa: C901
    views: Views,
    target: Target | float,
    *,
    flat: str | Sequence[str] = "flat",
    model: str | Sequence[str] = "auto",
    target_std: float = 0.0,
    camera_distance: Mapping[str, float] | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> Calibration:
    """Calibrate a rig from views of a plane target.

    Parameters
    ----------
    views : mapping of camera to mapping of pose to TargetPoints
        What was found in each image. The same name of a pose is the same pose of the target for all cameras.
    target : Target or float
        The target, or its mesh, metres.
    flat : str or sequence of str, default "flat"
        The pose on the plane z = 0; its axes are those of the physical frame. Further names are poses
        on the same plane, turned or shifted. Empty: the first pose defines the frame, to be levelled later.
    model : str or sequence of str, default "auto"
        Camera model: a name of `wavefield.calibration.model_choice.MODELS`, a list of terms,
        or ``auto``, the simplest that the data support (Bayes' information criterion).
    target_std : float, default 0
        Uncertainty of the target's nodes per axis, metres. If given, the nodes' offsets are solved for,
        with this as prior; take the level from the water at rest afterwards.
    camera_distance : mapping of str to float, optional
        Distance of cameras from the origin as measured by hand, metres: the only check on the mesh.
    provenance : mapping, optional
        Added to the rig's provenance, such as the images' names.

    Returns
    -------
    Calibration
        ``usable`` says whether it can be trusted, ``problems`` why not. Bad input gives no exception.

    Notes
    -----
    Each camera by Zhang's method, then a comparison of the poses that the cameras found each on its own,
    then one fit of all cameras and poses (bundle adjustment) with Huber's loss.

    Examples
    --------
    The paper's cameras from points of four tilted views and a flat one:

    >>> import cv2
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
    flats = [name for name in ([flat] if isinstance(flat, str) else flat) if name]
    problems: list[str] = []
    notes: list[str] = []
    left_out: dict[str, int] = {}

    good = _sound_views(views, problems, notes, left_out)
    alone: dict[str, Alone] = {}
    for name in good:
        if not good[name]:
            continue
        try:
            alone[name] = calibrate_alone(collect({name: good[name]}, mesh, origin))
        except CalibrationError as error:
            problems.append(str(error))
    for name, camera in alone.items():
        for pose in [p for p in good[name] if p not in camera.poses]:
            notes.append(f"{name} {pose}: its points are no plane grid; left out")
            left_out[f"{name} {pose}"] = len(good[name].pop(pose))
        tilted = [p for p in camera.poses if p not in flats]
        if len(camera.poses) < 3:
            problems.append(
                f"{name} has {len(camera.poses)} usable view{'s' * (len(camera.poses) != 1)} of the target; "
                "photograph at least five tilted ones and a flat one"
            )
        elif len(tilted) < 2 or camera.spread < SPREAD:
            problems.append(
                f"the views of {name} are parallel (at most {camera.spread:.1f} degrees apart): its "
                "focal length is unknown; photograph the target tilted by 20 to 40 degrees, to several sides"
            )
    if not alone:
        if not problems:
            problems.append("no camera has a view of the target: photograph it with all cameras")
        return Calibration(Rig({}), False, tuple(problems), tuple(notes), left_out=left_out)

    agreement = compare(alone, mesh)
    _tell_disagreement(agreement, alone, mesh, problems, notes)
    for name, pose in agreement.wrong_views:
        left_out[f"{name} {pose}"] = len(good[name].pop(pose))
        del alone[name].poses[pose]
    together = {
        n: a for n, a in alone.items() if n not in agreement.wrong_cameras and n not in agreement.alone
    }
    if len(together) < 2:  # one camera, or cameras that have nothing in common: the first with the most views
        name = max(alone, key=lambda n: len(alone[n].poses))
        together = together or {name: alone[name]}
    good = {name: dict(good[name]) for name in together}

    observations = collect(good, mesh, origin)
    reference = _reference(observations, flats, problems, notes)
    flat_indices = [observations.poses.index(p) for p in flats if p in observations.poses]
    geometry = _together(observations, together, reference)
    for p in flat_indices:  # on the plane exactly: the fit turns them about z only
        c, d = geometry.pose_R[p][0, 0], geometry.pose_R[p][1, 0]
        c, d = c / np.hypot(c, d), d / np.hypot(c, d)
        geometry.pose_R[p] = np.array([[c, -d, 0.0], [d, c, 0.0], [0.0, 0.0, 1.0]])
        geometry.pose_t[p, 2] = 0.0

    settled = _settle(observations, geometry, reference, flat_indices, model, target_std, notes, left_out)
    observations, result, chosen, table = settled
    rig_cameras = {
        name: result.geometry.camera(c, observations.sizes[c]) for c, name in enumerate(observations.cameras)
    }
    derived = derive(observations, result)
    _judge(observations, result, derived, target_std, camera_distance or {}, mesh, problems, notes)
    calibration = Calibration(
        Rig(rig_cameras),
        not problems,
        tuple(problems),
        tuple(notes),
        chosen,
        tuple(table),
        observations,
        result,
        derived,
        left_out,
        target_std,
        observations.poses[reference],
    )
    stated = {**_provenance(calibration, mesh), **(provenance or {})}
    return replace(calibration, rig=Rig(rig_cameras, stated))


def _sound_views(
    views: Views, problems: list[str], notes: list[str], left_out: dict[str, int]
) -> dict[str, dict[str, TargetPoints]]:
    """Views with enough points, of one size per camera."""
    good: dict[str, dict[str, TargetPoints]] = {}
    for name, of_camera in views.items():
        sizes: dict[tuple[int, int], list[str]] = {}
        for pose, points in of_camera.items():
            sizes.setdefault((int(points.size[0]), int(points.size[1])), []).append(pose)
        good[name] = {}
        if len(sizes) > 1:
            common = max(sizes, key=lambda s: len(sizes[s]))
            odd = [f"{pose} ({s[0]} x {s[1]})" for s in sizes if s != common for pose in sizes[s]]
            problems.append(
                f"the images of {name} have different sizes, most {common[0]} x {common[1]}, but "
                f"{', '.join(odd)}: take all views with the same settings of the camera"
            )
        for pose, given in of_camera.items():
            points = _finite(given)
            if len(sizes) > 1 and tuple(points.size) != common:
                left_out[f"{name} {pose}"] = len(points)
                continue
            if len(points) < FEWEST_NODES:
                what = f"only {len(points)} nodes of the target" if len(points) else "no target"
                notes.append(f"{name} {pose}: {what} found; left out")
                left_out[f"{name} {pose}"] = len(points)
            else:
                good[name][pose] = points
        if not good[name]:
            problems.append(f"no target was found in any view of {name}: photograph it again")
    if not views:
        problems.append("there are no views of the target")
    return good


def _finite(points: TargetPoints) -> TargetPoints:
    """Points that are numbers; no uncertainty is below what an image can give."""
    sound = np.isfinite(points.pixel).all(axis=-1) & np.isfinite(points.std)
    return replace(
        points,
        node=points.node[sound],
        pixel=points.pixel[sound],
        std=np.maximum(points.std[sound], 1e-4),
    )


def _tell_disagreement(
    agreement: Agreement, alone: Mapping[str, Alone], mesh: float, problems: list[str], notes: list[str]
) -> None:
    for name, pose in agreement.wrong_views:
        notes.append(
            f"{name} {pose}: the target's pose is not the one the other cameras saw "
            "(its nodes are counted from another origin or turned, or it was moved between shots); left out"
        )
    if agreement.wrong_cameras:
        trusted = [n for n in alone if n not in agreement.wrong_cameras]
        for name in agreement.wrong_cameras:
            trial = compare({**{n: alone[n] for n in trusted}, name: mirrored(alone[name])}, mesh)
            who = name if len(alone) > 2 else f"{name} or {trusted[0]}"
            if name not in trial.wrong_cameras:
                problems.append(
                    f"the images of {who} are mirrored: flip them left to right, or take the mirror away"
                )
            else:
                problems.append(
                    f"{name} saw the target move differently from {' and '.join(trusted)}: are its views in "
                    "the same order, and was the target still while all cameras took their image?"
                )
    for name in agreement.alone:
        problems.append(
            f"{name} shares no view of the target with another camera: "
            "photograph the target where all cameras see it at once"
        )


def _reference(
    observations: Observations, flats: Sequence[str], problems: list[str], notes: list[str]
) -> int:
    """The pose that defines the frame."""
    for name in flats:
        if name in observations.poses:
            return observations.poses.index(name)
    if flats:
        problems.append(
            f"no camera has a usable flat view ({', '.join(flats)}): photograph the target on the plane z = 0"
        )
    else:
        notes.append(
            f"no flat view: z = 0 is the target's plane in view {observations.poses[0]}; "
            "level the rig on the water at rest before measuring"
        )
    # the pose that most cameras saw
    seen = [
        len(np.unique(observations.camera[observations.pose == p])) for p in range(len(observations.poses))
    ]
    return int(np.argmax(seen))


def _together(observations: Observations, alone: Mapping[str, Alone], reference: int) -> Geometry:
    """All cameras and poses in the frame of the reference pose, from what each camera found on its own."""
    o = observations
    pose = o.poses[reference]
    first = max(alone, key=lambda n: (pose in alone[n].poses, len(alone[n].poses)))
    links = chained(alone, first)
    in_first: dict[str, tuple[Array, Array]] = {}
    for p in o.poses:
        found = []
        for name, (R, t) in links.items():
            if p in alone[name].poses:
                Rp, tp = alone[name].poses[p]
                found.append((R.T @ Rp, R.T @ (tp - t)))
        in_first[p] = (
            mean_rotation(np.stack([R for R, _ in found])),
            np.median([t for _, t in found], axis=0),
        )
    Q, origin = in_first[pose]
    lens = np.stack([alone[name].lens for name in o.cameras])
    R = np.stack([links[name][0] @ Q for name in o.cameras])
    T = np.stack([links[name][0] @ origin + links[name][1] for name in o.cameras])
    pose_R = np.stack([Q.T @ in_first[p][0] for p in o.poses])
    pose_t = np.stack([Q.T @ (in_first[p][1] - origin) for p in o.poses])
    return Geometry(lens, R, T, pose_R, pose_t, np.zeros((len(o.nodes), 3)))


def _settle(
    observations: Observations,
    start: Geometry,
    reference: int,
    flats: Sequence[int],
    model: str | Sequence[str],
    target_std: float,
    notes: list[str],
    left_out: dict[str, int],
) -> tuple[Observations, Fit, str, list[Choice]]:
    """Joint fit, leaving out what does not fit, and the choice of the model."""
    o = observations
    table: list[Choice] = []
    auto = isinstance(model, str) and model == "auto"
    terms = MODELS["paper"] if auto else terms_of(model)
    name = "paper" if auto else model if isinstance(model, str) else " ".join(model)

    def run(terms: tuple[str, ...], begin: Geometry, scale: float | None = None) -> Fit:
        return fit(
            o, _restricted(begin, terms, o), [terms] * len(o.cameras), reference, flats, target_std, scale
        )

    result = run(terms, start)
    for _ in range(4):
        keep = _fitting(o, result, notes, left_out, reference)
        if keep.all():
            break
        o = o.only(keep)
        result = run(terms, result.geometry)
    if auto:
        scale, begin = result.scale, result.geometry
        name, fits, table = choose(lambda terms: run(terms, begin, scale), 2 * len(o), o.sizes)
        result = fits[name]
    return o, result, name, table


def _restricted(geometry: Geometry, terms: Sequence[str], observations: Observations) -> Geometry:
    """The start for a model: terms that are not free are those of a perfect camera."""
    lens = geometry.lens.copy()
    free = {"f": (0, 1), "c": (2, 3), "k1": (4,), "k2": (5,), "p": (6, 7), "k3": (8,), "tilt": (9, 10)}
    fixed = [column for term, columns in free.items() if term not in terms for column in columns]
    perfect = np.zeros_like(lens)
    for c, size in enumerate(observations.sizes):
        perfect[c, 2:4] = (size[0] - 1) / 2, (size[1] - 1) / 2
    lens[:, fixed] = perfect[:, fixed]
    lens[:, LENS.index("skew")] = 0.0
    if "aspect" not in terms:
        lens[:, :2] = np.sqrt(lens[:, :1] * lens[:, 1:2])
    return replace(geometry, lens=lens)


def _fitting(
    o: Observations, result: Fit, notes: list[str], left_out: dict[str, int], reference: int
) -> NDArray[np.bool_]:
    """Which observations fit: whole views first, then points."""
    size = np.abs(result.residual).max(axis=1) / o.std
    view = o.camera * len(o.poses) + o.pose
    scatter = {
        v: robust_std((result.residual[view == v] / o.std[view == v, None]).ravel()) for v in np.unique(view)
    }
    usual = float(np.median(list(scatter.values())))
    worst = max(scatter, key=lambda v: scatter[v])
    px = robust_std(result.residual[view == worst].ravel())
    if scatter[worst] > 6.0 * usual and px > 0.1 and len(scatter) > 4:
        label = f"{o.cameras[worst // len(o.poses)]} {o.poses[worst % len(o.poses)]}"
        notes.append(
            f"{label}: its points miss the common fit by {px:.2f} px, {scatter[worst] / usual:.0f} times "
            "as much as those of the other views (target moved or bent, image blurred?); left out"
        )
        left_out[label] = int((view == worst).sum())
        return view != worst
    limit = 6.0 * np.array([max(scatter[v], usual) for v in view.tolist()])
    keep = size <= limit
    for v in np.unique(view[~keep]):
        label = f"{o.cameras[v // len(o.poses)]} {o.poses[v % len(o.poses)]}"
        left_out[label] = left_out.get(label, 0) + int((~keep & (view == v)).sum())
    return keep


def _judge(
    o: Observations,
    result: Fit,
    derived: Derived,
    target_std: float,
    camera_distance: Mapping[str, float],
    mesh: float,
    problems: list[str],
    notes: list[str],
) -> None:
    """Whether the rig can be trusted, from what it predicts of itself."""
    for c, name in enumerate(o.cameras):
        stated = camera_distance.get(name)
        if stated:
            found = float(np.linalg.norm(result.geometry.R[c].T @ result.geometry.T[c]))
            if abs(np.log(found / stated)) > 0.05:
                problems.append(
                    f"{name} stands {found:.2f} m from the origin by this calibration, not {stated:.2f} m as "
                    f"stated: the mesh is given as {1e3 * mesh:g} mm; measure it, "
                    f"it may be {1e3 * mesh * stated / found:.3g} mm"
                )
        reach = derived.reprojection[name]
        if not reach < 0.3:
            problems.append(
                f"{name} is determined to {reach:.2f} px only near z = 0: photograph more tilted views "
                "that fill its image"
            )
    if len(o.cameras) > 1 and not derived.z_std < 1e-3:
        problems.append(f"z would be uncertain by {1e3 * derived.z_std:.1f} mm: photograph more tilted views")
    if len(o.cameras) == 1:
        notes.append("one camera only: z and the velocity need two at least")
    if target_std > 0.0:
        notes.append("the target is uncertain, and so is its plane: level the rig on the water at rest")
    for name in o.cameras:
        cover = derived.coverage[name]
        if cover < 0.4:
            notes.append(
                f"the target's views cover {100 * cover:.0f} % of {name}'s image: its edges are extrapolated"
            )


def _provenance(calibration: Calibration, mesh: float) -> dict[str, Any]:
    """Plain numbers that stay with the rig."""
    o, result, derived = calibration.observations, calibration.fit, calibration.derived
    assert o is not None
    assert result is not None
    assert derived is not None
    std = np.sqrt(np.diag(result.covariance))
    cameras = {}
    for c, name in enumerate(o.cameras):
        rows = o.camera == c
        columns = [k for k, _ in result.layout.lens[c]] + list(
            range(result.layout.camera[c], result.layout.camera[c] + 6)
        )
        cameras[name] = {
            "views": [o.poses[p] for p in np.unique(o.pose[rows])],
            "points": int(rows.sum()),
            "rms_px": float(np.sqrt(np.mean(result.residual[rows] ** 2))),
            "max_px": float(np.abs(result.residual[rows]).max()),
            "reprojection_std_px": derived.reprojection[name],
            "parameter_std": {result.layout.names[k].split()[-1]: float(std[k]) for k in columns},
        }
    return {
        "made": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "usable": calibration.usable,
        "problems": list(calibration.problems),
        "notes": list(calibration.notes),
        "model": calibration.model,
        "mesh_m": float(mesh),
        "target_std_m": float(calibration.target_std),
        "reference_view": calibration.reference,
        "z_std_m": derived.z_std,
        "left_out_points": dict(calibration.left_out),
        "cameras": cameras,
        "parameter_units": "f, aspect: log of the focal lengths; c: px; R: rad; T: m; k, p: 1; tau: rad",
        "covariance": covariance_to_dict(result.layout.names, result.covariance, o.cameras),
    }
