"""What to photograph next: the view of the target that would tell most about the rig."""

from dataclasses import dataclass, replace
from itertools import product

import cv2
import numpy as np

from wavefield.calibration.bundle import Fit
from wavefield.calibration.derived_uncertainty import derive
from wavefield.calibration.observations import Geometry, Observations
from wavefield.calibration.parameters import ParameterLayout, linearised
from wavefield.calibration.result import Calibration
from wavefield.calibration.trust import ENOUGH
from wavefield.rig import Camera
from wavefield.rig.lens import Array

_TILT = 25.0  # degrees: marks are still found well
_ASIDE = 0.3  # of the field's half width
_LEAST = 30  # nodes in an image: fewer are no view
_WELL = 1e-3  # m that z may be uncertain by, as `judge` has it
_SATURATED = 0.9  # of the uncertainty is left: one more view hardly helps
_KNOWN = 0.1  # of what `judge` allows: no one needs more


@dataclass(frozen=True)
class NextView:
    """A pose of the target, and what it would bring."""

    # (float, float): Turn of the target about the x axis, or about the y axis, degrees; positive raises its
    # +y, or its -x, side
    tilt: tuple[float, float]
    # (float, float): Where to hold it: (0, 0) is the middle of the field that all cameras see, (1, 0) its +x
    # edge
    place: tuple[float, float]
    # (float, float): Standard uncertainty of z now, and with this view, metres; NaN for one camera
    z_std: tuple[float, float]
    # (float, float): The same of a pixel of the camera that is known least, px
    reprojection: tuple[float, float]

    @property
    def helps(self) -> bool:
        """Whether a tenth of the uncertainty would go, of a rig that is not known very well already."""
        now, then = (_left(z, pixel) for z, pixel in zip(self.z_std, self.reprojection))
        return now > _KNOWN and then < _SATURATED * now

    @property
    def words(self) -> str:
        """A sentence for a person at the tank.

        Examples
        --------
        >>> NextView((0.0, -25.0), (0.0, 0.3), (8e-4, 5e-4), (0.2, 0.1)).words
        'raise its +x side by 25 degrees and hold it towards +y: z known to 0.50 mm in place of 0.80 mm'
        """
        by = abs(self.tilt[0] or self.tilt[1])
        side = ("+y" if self.tilt[0] > 0 else "-y") if self.tilt[0] else ("-x" if self.tilt[1] > 0 else "+x")
        where = [f"{'+' if at > 0 else '-'}{axis}" for at, axis in zip(self.place, "xy") if at]
        held = f"towards {' and '.join(where)}" if where else "in the middle"
        if np.isnan(self.z_std[0]):
            gain = f"pixels known to {self.reprojection[1]:.2f} px in place of {self.reprojection[0]:.2f} px"
        else:
            gain = f"z known to {1e3 * self.z_std[1]:.2f} mm in place of {1e3 * self.z_std[0]:.2f} mm"
        return f"raise its {side} side by {by:.0f} degrees and hold it {held}: {gain}"


def next_view(calibration: Calibration) -> NextView | None:
    """Find the view of the target that would reduce the rig's uncertainty most.

    Twenty poses: a tilt about either axis to either side, in the middle of the field and a third of the way
    to each edge. Each adds its information to that of the fit, its own six parameters taken out (Schur's
    complement), with nodes as uncertain as those seen so far; the one is chosen that leaves the least of the
    larger of two: z's uncertainty over 1 mm, the pixels' over .3 px.

    Examples
    --------
    >>> from wavefield.calibration import calibrate  # with views of a target so far
    >>> found = next_view(calibrate(views, 0.04))  # doctest: +SKIP
    >>> print(found.words)  # doctest: +SKIP
    raise its +x side by 25 degrees and hold it towards -x: z known to 0.31 mm in place of 0.52 mm
    """
    o, result, now = calibration.observations, calibration.fit, calibration.derived
    if o is None or result is None or now is None:
        return None
    best: tuple[float, NextView] | None = None
    tilts = [(_TILT, 0.0), (-_TILT, 0.0), (0.0, _TILT), (0.0, -_TILT)]
    places = [(0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)]
    for place, tilt in product(places, tilts):
        covariance = _with_view(o, result, tilt, place)
        if covariance is None:
            continue
        then = derive(o, replace(result, covariance=covariance), now.where == "near z = 0")
        pixels = max(now.reprojection.values()), max(then.reprojection.values())
        found = NextView(tilt, place, (now.z_std, then.z_std), pixels)
        left = _left(then.z_std, pixels[1])
        if best is None or left < best[0]:
            best = left, found
    return None if best is None else best[1]


def _left(z_std: float, reprojection: float) -> float:
    # how far from well known, by the worse of the two
    return float(np.nanmax([z_std / _WELL, reprojection / ENOUGH]))


def _with_view(
    o: Observations, result: Fit, tilt: tuple[float, float], place: tuple[float, float]
) -> Array | None:
    # covariance of the fit's parameters once the target was seen so
    seen, geometry, plan = _seen(o, result, tilt, place)
    if not len(seen):
        return None
    count = len(result.layout.names)
    _, J, _ = linearised(geometry, plan, np.zeros(count + 6), seen)
    J = J.reshape(-1, count + 6) / (result.scale * np.repeat(seen.std, 2))[:, None]
    normal = J.T @ J
    a, b = slice(0, count), slice(count, None)
    information = normal[a, a] - normal[a, b] @ np.linalg.pinv(normal[b, b], hermitian=True) @ normal[b, a]
    # (C^-1 + L L')^-1 without inverting C, which may be near singular
    value, vector = np.linalg.eigh(information)
    L = vector[:, value > 0] * np.sqrt(value[value > 0])
    CL = result.covariance @ L
    return np.asarray(result.covariance - CL @ np.linalg.solve(np.eye(L.shape[1]) + L.T @ CL, CL.T))


def _seen(
    o: Observations, result: Fit, tilt: tuple[float, float], place: tuple[float, float]
) -> tuple[Observations, Geometry, ParameterLayout]:
    # what the cameras would see of the target in one more pose, and geometry and parameters with that pose
    g, p = result.geometry, len(o.poses)
    cameras = [g.camera(c, size) for c, size in enumerate(o.sizes)]
    lo, hi = _field(cameras, o.plan)
    middle = (lo + hi) / 2 + _ASIDE * np.array(place) * (hi - lo) / 2
    turn = np.asarray(cv2.Rodrigues(np.radians([*tilt, 0.0]))[0], float)
    centre = np.array([*middle, 0.0]) - turn @ o.plan.mean(axis=0)
    world = (o.plan + g.offset) @ turn.T + centre
    std = np.array([np.median(o.std[o.camera == c]) for c in range(len(cameras))])
    inside = [np.flatnonzero(camera.sees(*world.T)) for camera in cameras]
    inside = [nodes if len(nodes) >= _LEAST else nodes[:0] for nodes in inside]
    camera = np.repeat(np.arange(len(cameras)), [len(nodes) for nodes in inside])
    node = np.concatenate(inside)
    seen = replace(
        o,
        poses=(*o.poses, "next"),
        camera=camera,
        pose=np.full(len(node), p),
        node=node,
        pixel=np.zeros((len(node), 2)),
        std=std[camera],
    )
    more = replace(
        g, pose_R=np.concatenate([g.pose_R, turn[None]]), pose_t=np.concatenate([g.pose_t, centre[None]])
    )
    plan, count = result.layout, len(result.layout.names)
    own = tuple((count + k, k) for k in range(6))
    names = (*plan.names, *(f"next {k}" for k in range(6)))
    return seen, more, ParameterLayout(names, plan.lens, plan.camera, (*plan.pose, own))


def _field(cameras: list[Camera], plan: Array) -> tuple[Array, Array]:
    box = np.stack([camera.corners() for camera in cameras])
    lo, hi = box.min(axis=1).max(axis=0), box.max(axis=1).min(axis=0)
    if np.isfinite(box).all() and (hi > lo).all():
        return lo, hi
    return plan[:, :2].min(axis=0), plan[:, :2].max(axis=0)
