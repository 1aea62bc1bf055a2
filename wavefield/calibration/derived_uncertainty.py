"""What the uncertainty of the parameters means for pixels and for z.

The parameters are correlated, so their own uncertainties say little.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from wavefield.calibration.bundle import Fit
from wavefield.calibration.observations import Observations
from wavefield.calibration.parameters import linearised
from wavefield.rig.lens import Array

HEIGHT = 0.05  # of the volume about z = 0 in which errors are stated, metres


@dataclass(frozen=True)
class Derived:
    """Predicted errors of the rig."""

    # Standard uncertainty of a pixel of each camera within 5 cm of z = 0, px (rms over the field and axes)
    reprojection: Mapping[str, float]
    # Standard uncertainty of z within 5 cm of z = 0 (rms over the field), metres; NaN for one camera
    z_std: float
    z_tilt: float  # Of which the part that is a tilted plane, and so is mended by levelling, metres
    # Fraction of each image, in cells of an eighth of its side, that held a node in some view
    coverage: Mapping[str, float]
    # (str, str, float): The strongest correlations between parameters
    correlation: list[tuple[str, str, float]]
    condition: float  # Condition number of the scaled normal matrix
    where: str = "near z = 0"  # The volume, in words


def derive(observations: Observations, result: Fit, level: bool = True) -> Derived:
    """Propagate the covariance of the fit."""
    o = observations
    points = volume(o, result, level)
    _, J, by_point = at_points(o, result, points)
    C, n = len(o.cameras), len(points)
    cov = result.covariance
    reach = np.sqrt(np.einsum("cnip,pq,cniq->c", J, cov, J, optimize=True) / (2 * n))
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
    order = np.argsort(upper, axis=None)[::-1][:12]
    pairs = [np.unravel_index(k, upper.shape) for k in order]
    names = result.layout.names
    strongest = [(names[i], names[j], float(unit[i, j])) for i, j in pairs if upper[i, j] > 0.9]
    coverage = {}
    for c, name in enumerate(o.cameras):
        cell = np.floor(8 * (o.pixel[o.camera == c] + 0.5) / np.array(o.sizes[c])).astype(int).clip(0, 7)
        coverage[name] = len(np.unique(cell, axis=0)) / 64
    return Derived(
        {name: float(r) for name, r in zip(o.cameras, reach, strict=True)},
        z_std,
        z_tilt,
        coverage,
        strongest,
        float(np.linalg.cond(unit)),
        "near z = 0" if level else "where the target was",
    )


def at_points(observations: Observations, result: Fit, points: Array) -> tuple[Array, Array, Array]:
    """What a fit predicts at points of the physical frame, and how that hangs on its parameters."""
    o = observations
    # the points as if they were a target in the reference frame: no pose parameter moves it
    C, n = len(o.cameras), len(points)
    probe = Observations(
        o.cameras,
        (*o.poses, "volume"),
        o.sizes,
        np.zeros((n, 2), np.int64),
        1.0,
        np.repeat(np.arange(C), n),
        np.full(C * n, len(o.poses)),
        np.tile(np.arange(n), C),
        np.zeros((C * n, 2)),
        np.ones(C * n),
    )
    g = result.geometry
    there = type(g)(
        g.lens,
        g.R,
        g.T,
        np.concatenate([g.pose_R, np.eye(3)[None]]),
        np.concatenate([g.pose_t, np.zeros((1, 3))]),
        points,
    )
    plan = type(result.layout)(
        result.layout.names, result.layout.lens, result.layout.camera, (*result.layout.pose, ())
    )
    pixel, J, by_point = linearised(there, plan, np.zeros(len(plan.names)), probe)
    return pixel.reshape(C, n, 2), J.reshape(C, n, 2, -1), by_point.reshape(C, n, 2, 3)


def volume(o: Observations, result: Fit, level: bool) -> Array:
    """Points where the rig will be used.

    Returns (n, 3): Over the field that all cameras see, within `HEIGHT` of z = 0 (over the target's extent if
    they have none in common).
    """
    if not level:
        seen: Array = result.geometry.world(o)
        some: Array = seen[np.linspace(0, len(seen) - 1, min(len(seen), 600)).astype(int)]
        return some
    g = result.geometry
    box = np.stack([g.camera(c, o.sizes[c]).corners() for c in range(len(o.cameras))])
    lo, hi = box.min(axis=1).max(axis=0), box.max(axis=1).min(axis=0)
    if not np.isfinite(box).all() or not (hi > lo).all():
        plan = o.plan[np.unique(o.node), :2]
        lo, hi = plan.min(axis=0), plan.max(axis=0)
    x, y = np.linspace(lo[0], hi[0], 17)[1:-1], np.linspace(lo[1], hi[1], 17)[1:-1]
    X, Y, Z = np.meshgrid(x, y, [-HEIGHT, 0.0, HEIGHT], indexing="ij")
    points = np.stack([X.ravel(), Y.ravel(), Z.ravel()], axis=-1)
    inside = np.ones(len(points), bool)
    for c in range(len(o.cameras)):
        inside &= g.camera(c, o.sizes[c]).sees(*points.T)
    used: Array = points[inside] if inside.sum() >= 30 else points
    return used
