"""The view of the target to photograph next: the one that would reduce the rig's uncertainty most."""

from dataclasses import dataclass, replace
from itertools import product

import cv2
import numpy as np

from wavefield.calibration.bundle import Fit, ParameterLayout, linearised
from wavefield.calibration.model_choice import predict_errors
from wavefield.calibration.observations import LIMITS, Geometry, Observations, common_extent
from wavefield.calibration.result import Calibration
from wavefield.rig.lens import Array

TILT = 25.0  # degrees: marks are still found well
ASIDE = 0.3  # of the field's half width
MIN_NODES_IN_IMAGE = 30
HELPFUL_RATIO = 0.9  # of the uncertainty: a view that leaves more hardly helps
WELL_KNOWN = 0.1  # of the limits: no further view is needed
TILTS = ((TILT, 0.0), (-TILT, 0.0), (0.0, TILT), (0.0, -TILT))
PLACES = ((0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))


@dataclass(frozen=True)
class NextView:
    """A pose of the target, and the uncertainty with it."""

    # Turn of the target about the x axis, or about the y axis, degrees; positive raises its +y, or -x, side
    tilt: tuple[float, float]
    # Where to hold it: (0, 0) is the middle of the field that all cameras see, (1, 0) its +x edge
    place: tuple[float, float]
    z_std: tuple[float, float]  # Uncertainty of z now, and with this view, metres; NaN for one camera
    reprojection: tuple[float, float]  # The same of a pixel of the least certain camera, px

    @property
    def helps(self) -> bool:
        """Whether a tenth of the uncertainty would go, of a rig that is not well known already."""
        now, then = (_relative_to_limits(*errors) for errors in zip(self.z_std, self.reprojection))
        return now > WELL_KNOWN and then < HELPFUL_RATIO * now

    @property
    def words(self) -> str:
        """A sentence for the user: how to hold the target, and the gain in z or, without z, in pixels."""
        by = abs(self.tilt[0] or self.tilt[1])
        side = ("+y" if self.tilt[0] > 0 else "-y") if self.tilt[0] else ("-x" if self.tilt[1] > 0 else "+x")
        ways = [f"{'+' if at > 0 else '-'}{axis}" for at, axis in zip(self.place, "xy") if at]
        held = f"towards {' and '.join(ways)}" if ways else "in the middle"
        if np.isnan(self.z_std[0]):
            gain = f"pixels known to {self.reprojection[1]:.2f} px in place of {self.reprojection[0]:.2f} px"
        else:
            gain = f"z known to {1e3 * self.z_std[1]:.2f} mm in place of {1e3 * self.z_std[0]:.2f} mm"
        return f"raise its {side} side by {by:.0f} degrees and hold it {held}: {gain}"


def next_view(calibration: Calibration) -> NextView | None:
    """The view of the target, of twenty, that would reduce the rig's uncertainty most; None if there is none.
    It leaves the least of the larger of two: z's uncertainty and the pixels', each over its limit.
    """
    o, result, now = calibration.observations, calibration.fit, calibration.predicted
    if o is None or result is None or now is None:
        return None
    best: tuple[float, NextView] | None = None
    # tilted about either axis to either side, in the middle of the field and a third of the way to each edge
    for place, tilt in product(PLACES, TILTS):
        covariance = _covariance_with_view(o, result, tilt, place)
        if covariance is None:
            continue
        then = predict_errors(o, replace(result, covariance=covariance), now.volume == "near z = 0")
        pixels = max(now.reprojection.values()), max(then.reprojection.values())
        remaining = _relative_to_limits(then.z_std, pixels[1])
        if best is None or remaining < best[0]:
            best = remaining, NextView(tilt, place, (now.z_std, then.z_std), pixels)
    return None if best is None else best[1]


def _relative_to_limits(z_std: float, reprojection: float) -> float:
    """The larger of the two uncertainties over their limits."""
    return float(np.nanmax([z_std / LIMITS.max_z_std, reprojection / LIMITS.max_reprojection_std]))


def _covariance_with_view(
    o: Observations, result: Fit, tilt: tuple[float, float], place: tuple[float, float]
) -> Array | None:
    """Covariance of the fit's parameters with one more view; None where no camera would see enough of it."""
    nodes, geometry, plan = _one_more_view(o, result, tilt, place)
    if not len(nodes):
        return None
    count = len(result.layout.names)
    _, J, _ = linearised(geometry, plan, np.zeros(count + 6), nodes)
    J = J.reshape(-1, count + 6) / (result.scale * np.repeat(nodes.std, 2))[:, None]
    normal = J.T @ J
    a, b = slice(0, count), slice(count, None)
    information = normal[a, a] - normal[a, b] @ np.linalg.pinv(normal[b, b], hermitian=True) @ normal[b, a]
    # (C^-1 + L L')^-1 without inverting C, which may be near singular
    value, vector = np.linalg.eigh(information)
    L = vector[:, value > 0] * np.sqrt(value[value > 0])
    CL = result.covariance @ L
    return np.asarray(result.covariance - CL @ np.linalg.solve(np.eye(L.shape[1]) + L.T @ CL, CL.T))


def _one_more_view(
    o: Observations, result: Fit, tilt: tuple[float, float], place: tuple[float, float]
) -> tuple[Observations, Geometry, ParameterLayout]:
    """Nodes that the cameras would see of the target in one more pose, and geometry and layout with it."""
    g, p = result.geometry, len(o.poses)
    cameras = g.cameras(o.sizes)
    lo, hi = common_extent(cameras, o.plan)
    middle = (lo + hi) / 2 + ASIDE * np.array(place) * (hi - lo) / 2
    turn = np.asarray(cv2.Rodrigues(np.radians([*tilt, 0.0]))[0], float)
    centre = np.array([*middle, 0.0]) - turn @ o.plan.mean(axis=0)
    world = (o.plan + g.offset) @ turn.T + centre
    std = np.array([np.median(o.std[o.camera == c]) for c in range(len(cameras))])
    inside = [np.flatnonzero(camera.sees(*world.T)) for camera in cameras]
    inside = [nodes if len(nodes) >= MIN_NODES_IN_IMAGE else nodes[:0] for nodes in inside]
    camera = np.repeat(np.arange(len(cameras)), [len(nodes) for nodes in inside])
    node = np.concatenate(inside)
    view = replace(
        o,
        poses=(*o.poses, "next"),
        camera=camera,
        pose=np.full(len(node), p),
        node=node,
        pixel=np.zeros((len(node), 2)),
        std=std[camera],
    )
    return view, g.with_pose(turn, centre), result.layout.with_pose("next", range(6))
