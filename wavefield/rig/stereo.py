"""Points and displacements in space from those in the images of several cameras."""

import math
from collections.abc import Sequence

import numpy as np
from numba import float64, void
from numba.core.types import Array as ArrayType
from numpy.typing import ArrayLike

from wavefield.compiled import compiled
from wavefield.rig.camera import Camera
from wavefield.rig.lens import Array
from wavefield.rig.rig import Rig


def triangulate(apparent: ArrayLike, sight: ArrayLike) -> tuple[Array, Array, Array, Array]:
    """Find the points x, y, z (...), metres, nearest to the sight lines of N cameras by least squares.
    Camera k sees the point on the line x = x_k + D_k z. `apparent` holds x_k, the apparent positions on z =
    0, metres, and `sight` holds D_k, the sight-line coefficients; both are (N, 2, ...), NaN if a camera does
    not see the point. The last result holds the residuals (N, 2, ...), metres on z = 0. NaN if
    undetermined."""
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
        # for two cameras: z = -(dD . d) / |dD|^2 with d = x_2 - x_1 and dD = D_2 - D_1
        z = -np.sum(weight * dp * dD, axis=(0, 1)) / square
    x, y = p_mean + D_mean * z
    return x, y, z, p - (np.stack([x, y]) - D * z)


def jacobians(cameras: Sequence[Camera], x: ArrayLike, y: ArrayLike, z: ArrayLike) -> Array:
    """Return the derivatives of the pixels of N cameras with respect to x, y, z, px per metre.
    The result is (..., 2N, 3), with the rows X_1, Y_1, X_2, Y_2, ... at positions x, y, z, metres."""
    shape = np.broadcast_shapes(np.shape(x), np.shape(y), np.shape(z))
    out = np.empty((*shape, 2 * len(cameras), 3))
    for n, camera in enumerate(cameras):
        out[..., 2 * n : 2 * n + 2, :] = camera.jacobian(x, y, z)
    return out


_inputs = [ArrayType(float64, axes, "A", readonly=True) for axes in (3, 2, 2, 2)]


@compiled(void(*_inputs, float64[:, ::1], float64[:, ::1]))
def _solve(jacobian: Array, observed: Array, weight: Array, noise: Array, out: Array, std: Array) -> None:
    """Solve the weighted 3 x 3 normal equations of each point.
    Fills `out` (n, 3), the solutions, and `std` (n, 3), their standard uncertainties, in place. `noise` holds
    the variances of the observations."""
    for n in range(observed.shape[0]):
        a = b = c = d = e = f = 0.0  # normal matrix [[a, b, c], [b, d, e], [c, e, f]]
        p = q = r = 0.0
        rows = 0
        for i in range(observed.shape[1]):
            s, w = observed[n, i], weight[n, i]
            if not (np.isfinite(s) and w > 0.0 and np.isfinite(jacobian[n, i, 0])):
                continue
            rows += 1
            j0, j1, j2 = jacobian[n, i, 0], jacobian[n, i, 1], jacobian[n, i, 2]
            w0, w1, w2 = w * j0, w * j1, w * j2
            a += w0 * j0
            b += w0 * j1
            c += w0 * j2
            d += w1 * j1
            e += w1 * j2
            f += w2 * j2
            p += w0 * s
            q += w1 * s
            r += w2 * s
        # Cholesky decomposition; after a small pivot the cameras do not determine a direction
        ok = rows >= 3 and a > 0.0
        if ok:
            lb, lc = b / a, c / a
            d1, e1 = d - b * lb, e - b * lc
            ok = d1 > 1e-9 * d
            if ok:
                le = e1 / d1
                f1 = f - c * lc - e1 * le
                ok = f1 > 1e-9 * f
        if not ok:
            for k in range(3):
                out[n, k] = np.nan
                std[n, k] = np.nan
            continue
        q1 = q - lb * p
        z = (r - lc * p - le * q1) / f1
        y = q1 / d1 - le * z
        x = p / a - lb * y - lc * z
        out[n, 0], out[n, 1], out[n, 2] = x, y, z
        vx = vy = vz = 0.0
        for i in range(observed.shape[1]):
            if np.isfinite(observed[n, i]) and weight[n, i] > 0.0 and np.isfinite(jacobian[n, i, 0]):
                j0, j1, j2 = jacobian[n, i, 0], jacobian[n, i, 1], jacobian[n, i, 2]
                w = weight[n, i]
                w0, w1, w2 = w * j0, w * j1, w * j2
                w1 -= lb * w0
                kz = (w2 - lc * w0 - le * w1) / f1
                ky = w1 / d1 - le * kz
                kx = w0 / a - lb * ky - lc * kz
                vx += kx * kx * noise[n, i]
                vy += ky * ky * noise[n, i]
                vz += kz * kz * noise[n, i]
        std[n, 0], std[n, 1], std[n, 2] = np.sqrt(vx), np.sqrt(vy), np.sqrt(vz)


def solve_displacement(
    jacobian: ArrayLike, displacement: ArrayLike, std: ArrayLike | None = None, noise: ArrayLike | None = None
) -> tuple[Array, Array]:
    """Find the displacement d in space from the displacements dX in the images of N cameras.
    d minimises sum (J d - dX)^2 / std^2, where J is `jacobian` (..., 2N, 3), px per metre, dX is
    `displacement` (..., 2N), px, and `std` (..., 2N) is in px. Returns d (..., 3), metres, and its standard
    uncertainty. This follows from `noise` (..., 2N), the standard uncertainty of dX in px, or from `std` if
    there is none. NaN if undetermined."""
    J, observed = np.asarray(jacobian, float), np.asarray(displacement, float)
    with np.errstate(divide="ignore"):
        weight = np.ones(1) if std is None else 1.0 / np.square(np.asarray(std, float))
        variance = 1.0 / weight if noise is None else np.square(np.asarray(noise, float))
    shape = np.broadcast_shapes(J.shape[:-2], *(f.shape[:-1] for f in (observed, weight, variance)))
    count, rows = math.prod(shape), observed.shape[-1]
    weight, variance, observed = (
        np.broadcast_to(f, (*shape, rows)).reshape(count, rows) for f in (weight, variance, observed)
    )
    J = np.broadcast_to(J, (*shape, rows, 3)).reshape(count, rows, 3)
    d, d_std = np.empty((count, 3)), np.empty((count, 3))
    _solve(J, observed, weight, variance, d, d_std)
    return d.reshape(*shape, 3), d_std.reshape(*shape, 3)


def parallax(rig: Rig, pair: tuple[str, str], x: ArrayLike, y: ArrayLike) -> Array:
    """Return the parallax of a pair of cameras per height of a point, (2, ...).
    It is the first camera's sight-line coefficients at x, y, metres, minus those of the second."""
    first, second = (rig[name].sight_line(x, y) for name in pair)
    return np.subtract(first, second)


def epipolar_distance(
    a: Camera, b: Camera, Xa: ArrayLike, Ya: ArrayLike, Xb: ArrayLike, Yb: ArrayLike
) -> Array:
    """Return the signed distances (n,) of pixels in image b from the epipolar lines of their matches, px.
    (Xa, Ya) are the matching pixels in image a, and (Xb, Yb) those in image b. Lens distortion is taken into
    account."""
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
