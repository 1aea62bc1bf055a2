"""Uncertainty of pixels and of z that follows from the covariance of a fit's parameters.

The parameters are correlated, so their own uncertainties are of little use.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from wavefield.calibration.bundle import Fit
from wavefield.calibration.observations import Observations, common_extent
from wavefield.calibration.parameters import linearised
from wavefield.rig.lens import Array

HEIGHT = 0.05  # metres about z = 0 of the volume in which errors are stated
MIN_POINTS_IN_VIEW = 30  # of the volume, for those in view of all cameras to be used alone
MAX_POINTS = 600  # of the target, where the volume is that of its views
CELLS = 8  # along each side of an image, for the coverage
STRONG_CORRELATION = 0.9


@dataclass(frozen=True)
class PredictedErrors:
    """Predicted errors of the rig."""

    # Standard uncertainty of a pixel of each camera within 5 cm of z = 0, px (rms over the field and axes)
    reprojection: Mapping[str, float]
    # Standard uncertainty of z within 5 cm of z = 0 (rms over the field), metres; NaN for one camera
    z_std: float
    z_tilt: float  # Of which the part that is a tilted plane, and so is corrected by levelling, metres
    # Fraction of each image, in cells of an eighth of its side, that held a node in some view
    coverage: Mapping[str, float]
    correlation: list[tuple[str, str, float]]  # The strongest correlations between parameters
    condition: float  # Condition number of the scaled normal matrix
    volume: str = "near z = 0"  # Where, in words


def predict_errors(observations: Observations, result: Fit, level: bool = True) -> PredictedErrors:
    """Propagate the covariance of the fit."""
    o = observations
    points = volume(o, result, level)
    _, J, by_point = at_points(o, result, points)
    C, n = len(o.cameras), len(points)
    cov = result.covariance
    reprojection = np.sqrt(np.einsum("cnip,pq,cniq->c", J, cov, J, optimize=True) / (2 * n))
    z_std = z_tilt = float("nan")
    if C > 1:
        A = by_point.transpose(1, 0, 2, 3).reshape(n, 2 * C, 3)
        back = np.linalg.pinv(A)[:, 2]  # z row
        dz = -np.einsum("nk,nkp->np", back, J.transpose(1, 0, 2, 3).reshape(n, 2 * C, -1))
        z_std = float(np.sqrt(np.einsum("np,pq,nq->", dz, cov, dz, optimize=True) / n))
        plane = np.column_stack([np.ones(n), points[:, :2]])
        fitted = plane @ np.linalg.lstsq(plane, dz, rcond=None)[0]
        z_tilt = float(np.sqrt(np.einsum("np,pq,nq->", fitted, cov, fitted, optimize=True) / n))
    std = np.sqrt(np.diag(cov))
    unit = cov / np.outer(std, std)
    upper = np.abs(np.triu(unit, 1))
    pairs = [np.unravel_index(k, upper.shape) for k in np.argsort(upper, axis=None)[::-1][:12]]
    names = result.layout.names
    strongest = [
        (names[i], names[j], float(unit[i, j])) for i, j in pairs if upper[i, j] > STRONG_CORRELATION
    ]
    coverage = {}
    for c, name in enumerate(o.cameras):
        cell = np.floor(CELLS * (o.pixel[o.camera == c] + 0.5) / np.array(o.sizes[c])).astype(int)
        coverage[name] = len(np.unique(cell.clip(0, CELLS - 1), axis=0)) / CELLS**2
    return PredictedErrors(
        {name: float(r) for name, r in zip(o.cameras, reprojection, strict=True)},
        z_std,
        z_tilt,
        coverage,
        strongest,
        float(np.linalg.cond(unit)),
        "near z = 0" if level else "where the target was",
    )


def at_points(observations: Observations, result: Fit, points: Array) -> tuple[Array, Array, Array]:
    """Pixels (C, n, 2) of points of the physical frame, and their derivatives.
    These are (C, n, 2, p) with respect to the fit's parameters, and (C, n, 2, 3) to the points.
    """
    o = observations
    C, n = len(o.cameras), len(points)
    # the points as if they were a target in the reference frame: no pose parameter moves it
    probe = Observations.of_points(o.cameras, o.sizes, (*o.poses, "volume"), n)
    geometry = replace(result.geometry.with_pose(np.eye(3), np.zeros(3)), offset=points)
    plan = result.layout.with_pose("volume", ())
    pixel, J, by_point = linearised(geometry, plan, np.zeros(len(plan.names)), probe)
    return pixel.reshape(C, n, 2), J.reshape(C, n, 2, -1), by_point.reshape(C, n, 2, 3)


def volume(o: Observations, result: Fit, level: bool) -> Array:
    """Points (n, 3), metres, where the rig will be used: within `HEIGHT` of z = 0 over the common field.
    Over the target's extent if the cameras have none in common; without a level, where the target was.
    """
    g = result.geometry
    if not level:
        world = g.world(o)
        some: Array = world[np.linspace(0, len(world) - 1, min(len(world), MAX_POINTS)).astype(int)]
        return some
    cameras = g.cameras(o.sizes)
    lo, hi = common_extent(cameras, o.plan[np.unique(o.node)])
    x, y = np.linspace(lo[0], hi[0], 17)[1:-1], np.linspace(lo[1], hi[1], 17)[1:-1]
    X, Y, Z = np.meshgrid(x, y, [-HEIGHT, 0.0, HEIGHT], indexing="ij")
    points = np.stack([X.ravel(), Y.ravel(), Z.ravel()], axis=-1)
    inside = np.ones(len(points), bool)
    for camera in cameras:
        inside &= camera.sees(*points.T)
    used: Array = points[inside] if inside.sum() >= MIN_POINTS_IN_VIEW else points
    return used
