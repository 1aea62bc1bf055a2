"""Points and displacements in space, from pixels and image displacements of several cameras."""

from collections.abc import Sequence
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import ArrayLike

from wavefield.rig.camera import Camera
from wavefield.rig.lens import Array
from wavefield.rig.rig import Rig


def triangulate(apparent: ArrayLike, sight: ArrayLike) -> tuple[Array, Array, Array, Array]:
    """Find the points x, y, z (...), metres, nearest to the sight lines of N cameras by least squares.
    Camera k sees the point on the line (x, y) = p_k + D_k z. `apparent` holds p_k, where this line meets z =
    0, metres, and `sight` the sight-line coefficients D_k; both are (N, 2, ...), NaN if a camera does not see
    the point. The last result is the residual of each camera (N, 2, ...), metres on z = 0. The results are
    NaN if the cameras do not determine the point."""
    p, D = np.asarray(apparent, float), np.asarray(sight, float)
    visible = np.isfinite(p).all(1) & np.isfinite(D).all(1)
    weight = np.where(visible, 1.0, 0.0)[:, None]
    p0, D0 = np.where(visible[:, None], p, 0.0), np.where(visible[:, None], D, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        total = np.sum(weight, axis=0)
        p_mean, D_mean = np.sum(weight * p0, axis=0) / total, np.sum(weight * D0, axis=0) / total
        dp, dD = p0 - p_mean, D0 - D_mean
        square = np.sum(weight * dD * dD, axis=(0, 1))
        # sight lines within 1e-4 rad of each other do not determine the height
        square = np.where(square > 1e-8 * total[0], square, np.nan)
        # for two cameras: z = -(dD . dp) / |dD|^2 with dp = p_2 - p_1 and dD = D_2 - D_1
        z = -np.sum(weight * dp * dD, axis=(0, 1)) / square
    x, y = p_mean + D_mean * z
    return x, y, z, p - (np.stack([x, y]) - D * z)


def jacobians(cameras: Sequence[Camera], x: ArrayLike, y: ArrayLike, z: ArrayLike) -> Array:
    """Return the derivatives of the pixel coordinates of N cameras by x, y, z, at positions x, y, z, metres.
    The result is (..., 2N, 3), px per metre, with the rows X_1, Y_1, X_2, Y_2, ..."""
    shape = np.broadcast_shapes(np.shape(x), np.shape(y), np.shape(z))
    out = np.empty((*shape, 2 * len(cameras), 3))
    for n, camera in enumerate(cameras):
        out[..., 2 * n : 2 * n + 2, :] = camera.jacobian(x, y, z)
    return out


def solve_displacement(jacobian: ArrayLike, displacement: ArrayLike) -> Array:
    """Find the displacement d in space (..., 3), metres, from the displacements in the images of N cameras.
    d minimises |J d - dX|^2, where J is `jacobian` (..., 2N, 3), px per metre, and dX is `displacement`
    (..., 2N), px. Rows that are not finite are left out. NaN if the others do not determine d."""
    J, dX = np.broadcast_arrays(np.asarray(jacobian, float), np.asarray(displacement, float)[..., None])
    seen = np.isfinite(dX[..., 0]) & np.isfinite(J[..., 0])
    j0, j1, j2 = np.moveaxis(np.where(seen[..., None], J, 0.0), (-2, -1), (1, 0))
    s = np.moveaxis(np.where(seen, dX[..., 0], 0.0), -1, 0)
    # normal equations [[a, b, c], [b, d, e], [c, e, f]] (x, y, z) = (p, q, r)
    a, b, c, d, e, f = (sum(m * n) for m, n in combinations_with_replacement((j0, j1, j2), 2))
    p, q, r = (sum(m * s) for m in (j0, j1, j2))
    with np.errstate(divide="ignore", invalid="ignore"):  # Cholesky decomposition
        lb, lc = b / a, c / a
        d1, e1 = d - b * lb, e - b * lc
        le = e1 / d1
        f1 = f - c * lc - e1 * le
        q1 = q - lb * p
        z = (r - lc * p - le * q1) / f1
        y = q1 / d1 - le * z
        x = p / a - lb * y - lc * z
    # after a small pivot the cameras do not determine a direction
    ok = (seen.sum(axis=-1) >= 3) & (a > 0.0) & (d1 > 1e-9 * d) & (f1 > 1e-9 * f)
    return np.where(ok[..., None], np.stack([x, y, z], axis=-1), np.nan)


def parallax(rig: Rig, pair: tuple[str, str], x: ArrayLike, y: ArrayLike) -> Array:
    """Return the difference between two cameras' sight lines at x, y (m) on z = 0, in m per m of height.
    It is (dx/dz, dy/dz) along the first sight line minus that along the second, (2, ...)."""
    first, second = (rig[name].sight_line(x, y) for name in pair)
    return np.subtract(first, second)


def epipolar_distance(
    a: Camera, b: Camera, Xa: ArrayLike, Ya: ArrayLike, Xb: ArrayLike, Yb: ArrayLike
) -> Array:
    """Return the signed distances (n,), px, of pixels in image b from the epipolar lines of their matches.
    (Xa, Ya) are the matching pixels in the image of camera `a`, (Xb, Yb) those in the image of camera `b`.
    Lens distortion is taken into account."""
    xa = np.stack([*a.tangents(Xa, Ya), np.ones(np.shape(Xa))])
    Xb, Yb = np.asarray(Xb, float), np.asarray(Yb, float)
    xb = np.stack([*b.tangents(Xb, Yb), np.ones(np.shape(Xb))])
    R = b.R @ a.R.T
    t = b.T - R @ a.T
    line = np.cross(t, R @ xa, axis=0)  # in the tangents of b
    value = np.sum(xb * line, axis=0)
    # derivatives of tangents by pixels of b, from central differences
    h = 0.01
    gradient = [
        (line[0] * (p[0] - m[0]) + line[1] * (p[1] - m[1])) / (2 * h)
        for p, m in (
            (b.tangents(Xb + h, Yb), b.tangents(Xb - h, Yb)),
            (b.tangents(Xb, Yb + h), b.tangents(Xb, Yb - h)),
        )
    ]
    out: Array = value / np.hypot(*gradient)
    return out
