"""Predict errors of projected pixels and of z from the covariance of a fit; choose the camera model."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from wavefield.calibration.bundle import TERMS, Fit, linearised
from wavefield.calibration.observations import LIMITS, MAX_MATCHES, Observations, common_extent
from wavefield.errors import CalibrationError
from wavefield.rig.lens import Array

HEIGHT = 0.05  # m: errors are predicted within this distance of z = 0, the height of laboratory waves
CELLS = 8  # along each side of an image; the coverage is the fraction of cells with a node


@dataclass(frozen=True)
class PredictedErrors:
    """Standard uncertainties of projected pixels and of z due to the calibration, and image coverage.
    The uncertainties are means over the volume where the rig will be used."""

    reprojection: Mapping[str, float]  # Of a projected point, px, by camera; rms over volume and axes
    z_std: float  # Of z, metres, rms over the volume; NaN for one camera
    coverage: Mapping[str, float]  # Fraction of each image's cells with a node in any view
    volume: str = "near z = 0"  # The volume, in words


def predict_errors(observations: Observations, result: Fit, level: bool = True) -> PredictedErrors:
    """Return the errors of projected pixels and of z that follow from the covariance of a fit.
    The errors hold near z = 0 where all cameras see it or, if `level` is false, at the target nodes."""
    o = observations
    points = volume_points(o, result, level)
    _, J, by_point = project_points(o, result, points)
    C, n = len(o.cameras), len(points)
    cov = result.covariance
    reprojection = np.sqrt(np.einsum("cnip,pq,cniq->c", J, cov, J, optimize=True) / (2 * n))
    z_std = float("nan")
    if C > 1:
        A = by_point.transpose(1, 0, 2, 3).reshape(n, 2 * C, 3)
        back = np.linalg.pinv(A)[:, 2]  # derivative of z by the pixels
        dz = -np.einsum("nk,nkp->np", back, J.transpose(1, 0, 2, 3).reshape(n, 2 * C, -1))
        z_std = float(np.sqrt(np.einsum("np,pq,nq->", dz, cov, dz, optimize=True) / n))
    coverage = {}
    for c, name in enumerate(o.cameras):
        cell = np.floor(CELLS * (o.pixel[o.camera == c] + 0.5) / np.array(o.sizes[c])).astype(int)
        coverage[name] = len(np.unique(cell.clip(0, CELLS - 1), axis=0)) / CELLS**2
    return PredictedErrors(
        {name: float(r) for name, r in zip(o.cameras, reprojection, strict=True)},
        z_std,
        coverage,
        "near z = 0" if level else "where the target was",
    )


def project_points(observations: Observations, result: Fit, points: Array) -> tuple[Array, Array, Array]:
    """Return the pixels (C, n, 2) of points (n, 3), metres, in all C cameras, and two arrays of derivatives.
    The first is by the p parameters of the fit, (C, n, 2, p), the second by the point, (C, n, 2, 3), px/m."""
    o = observations
    C, n = len(o.cameras), len(points)
    # treat the points as a target whose pose is fixed in the frame of the rig
    probe = Observations.of_points(o.cameras, o.sizes, (*o.poses, "volume"), n)
    geometry = replace(result.geometry.with_pose(np.eye(3), np.zeros(3)), offset=points)
    plan = result.layout.with_pose("volume", free=False)
    pixel, J, by_point = linearised(geometry, plan, np.zeros(len(plan.names)), probe)
    return pixel.reshape(C, n, 2), J.reshape(C, n, 2, -1), by_point.reshape(C, n, 2, 3)


def volume_points(o: Observations, result: Fit, level: bool) -> Array:
    """Return points (n, 3), m, near z = 0 where all cameras see it, to predict errors of the rig.
    If `level` is false, return observed target nodes instead."""
    g = result.geometry
    if not level:
        world = g.world(o)
        some: Array = world[np.linspace(0, len(world) - 1, min(len(world), MAX_MATCHES)).astype(int)]
        return some
    cameras = g.cameras(o.sizes)
    lo, hi = common_extent(cameras, o.nominal[np.unique(o.node)])
    x, y = np.linspace(lo[0], hi[0], 17)[1:-1], np.linspace(lo[1], hi[1], 17)[1:-1]
    X, Y, Z = np.meshgrid(x, y, [-HEIGHT, 0.0, HEIGHT], indexing="ij")
    points = np.stack([X.ravel(), Y.ravel(), Z.ravel()], axis=-1)
    inside = np.ones(len(points), bool)
    for camera in cameras:
        inside &= camera.sees(*points.T)
    used: Array = points[inside] if inside.sum() >= LIMITS.min_nodes else points
    return used


# The third is the model of Aubourg et al. (2019). A sensor tilt is nearly equivalent to a shift of the
# principal point, and better conditioned. No candidate frees both: the condition number would be 1e8 or more.
CANDIDATES = (
    *("f c k1", "f tilt k1", "f aspect c k1"),
    *("f aspect c k1 k2 p", "f aspect c k1 k2 p k3"),
)
EQUIVALENT_RATIO = 1.05  # of expected errors; below it, the model with fewer parameters is preferred


def terms_of(model: str) -> tuple[str, ...] | None:
    """Return the free terms of a camera model such as ``f tilt k1``, as a tuple; None for ``auto``.
    Raises a CalibrationError for an unknown term, or if f is missing."""
    terms = tuple(model.split())
    if terms == ("auto",):
        return None
    if "f" not in terms or not set(terms) <= set(TERMS):
        raise CalibrationError(
            f"camera model {model!r} is not made of {', '.join(TERMS)} (f is needed), nor auto"
        )
    return terms


def choose_model(
    fit_model: Callable[[tuple[str, ...]], Fit],
    observations: Observations,
    level: bool,
) -> tuple[str, Fit]:
    """Return the camera model with the smallest expected error where the rig will be used, and its fit.
    `fit_model` fits the rig with given free lens terms. The rig will be used near z = 0 or, if `level` is
    false, near the target nodes. Of models within 5 % of the smallest error, the one with fewest parameters
    is taken."""
    o, count = observations, 2 * len(observations)
    fits = {name: fit_model(tuple(name.split())) for name in CANDIDATES}

    def bic(name: str) -> float:
        chi2 = max(fits[name].chi2, 1e-300)
        return float(count * np.log(chi2 / count) + len(fits[name].layout.names) * np.log(count))

    reference = min(fits, key=bic)
    # The BIC is dominated by the images' edges. It may choose a lens that fits these slightly better but
    # predicts the middle ten times worse, so a focused criterion (Claeskens and Hjort 2003) decides.
    expected = _expected(fits, reference, o, volume_points(o, fits[reference], level))
    near = [name for name in fits if expected[name] <= EQUIVALENT_RATIO * min(expected.values())]
    best = min(near, key=lambda name: len(fits[name].layout.names))
    return best, fits[best]


def _expected(fits: Mapping[str, Fit], reference: str, o: Observations, points: Array) -> dict[str, float]:
    """Return the expected rms error, px, of projected points (n, 3), by camera model.
    The squared error is variance plus squared bias. This bias is the difference from the model `reference`,
    whose square is reduced by the part due to noise."""
    pixel: dict[str, Array] = {}
    variance: dict[str, float] = {}
    for name, f in fits.items():
        pixel[name], J, _ = project_points(o, f, points)
        variance[name] = float(np.einsum("cnip,pq,cniq->", J, f.covariance, J, optimize=True))
    size = pixel[reference].size
    out = {}
    for name in fits:
        apart = float(np.sum((pixel[name] - pixel[reference]) ** 2))
        # squared bias: the difference from the reference model, minus the part that noise explains
        own = max(0.0, apart - abs(variance[name] - variance[reference]))
        out[name] = float(np.sqrt((variance[name] + own) / size))
    return out
