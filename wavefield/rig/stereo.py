"""From positions and displacements seen by several cameras to points and displacements in space.

Pure functions on arrays, a few milliseconds for the 30,000 nodes of a grid.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numba import float64, guvectorize
from numpy.typing import ArrayLike, NDArray

from wavefield.rig.camera import Camera

Array = NDArray[np.float64]
Pair = tuple[ArrayLike, ArrayLike]


def triangulate_pair(
    apparent_a: Pair, apparent_b: Pair, sight_a: Pair, sight_b: Pair
) -> tuple[Array, Array, Array, Array]:
    """Point seen by two cameras, image a's position taken as exact.

    Parameters
    ----------
    apparent_a, apparent_b : (x, y) of array_like, shape S
        Apparent positions on the plane z = 0 of the same piece of surface in images a and b, metres.
    sight_a, sight_b : (Dx, Dy) of array_like, shape S
        Sight lines (`Camera.sight_line`), each taken at its own apparent position.

    Returns
    -------
    x, y, z : ndarray, S
        Position, metres; NaN where a position is, or where the two lines of sight are parallel.
    eps_y : ndarray, S
        Mismatch across the line of sight, metres.

    Notes
    -----
    With d = x_b - x_a and dD = D_b - D_a, z = -(dD . d) / |dD|^2 minimises |d + dD z|, and
    eps_y = (dD_y d_x - dD_x d_y) / |dD| is what is left. The standard uncertainty of z is that of
    eps_y over |dD|, if matching errs alike along and across.

    Examples
    --------
    >>> x, y, z, eps = triangulate_pair((0.0, 0.0), (0.02, 0.0), (0.5, 0.0), (-0.5, 0.0))
    >>> print(float(x), float(z))
    0.01 0.02
    """
    xa, ya = (np.asarray(v, float) for v in apparent_a)
    dx, dy = np.asarray(apparent_b[0], float) - xa, np.asarray(apparent_b[1], float) - ya
    ax, ay = (np.asarray(v, float) for v in sight_a)
    Dx, Dy = np.asarray(sight_b[0], float) - ax, np.asarray(sight_b[1], float) - ay
    square = Dx * Dx + Dy * Dy
    with np.errstate(divide="ignore", invalid="ignore"):
        square = np.where(square > 0.0, square, np.nan)
        z = -(Dx * dx + Dy * dy) / square
        eps_y = (Dy * dx - Dx * dy) / np.sqrt(square)
    return xa + ax * z, ya + ay * z, z, eps_y


def triangulate_pairs(
    difference: ArrayLike, parallax: ArrayLike, std: ArrayLike | None = None
) -> tuple[Array, Array, Array]:
    """Elevation from all pairs of cameras together.

    Parameters
    ----------
    difference : array_like, (P, 2, ...)
        d = x_b - x_a of the P pairs: apparent position in image b less that in image a, metres.
    parallax : array_like, (P, 2, ...)
        dD = D_b - D_a of the same pairs.
    std : array_like, broadcastable to (P, ...), optional
        Standard uncertainty of each difference per axis, metres; all alike if left out.

    Returns
    -------
    z : ndarray, (...)
        Elevation, metres. A pair with NaN is left out; NaN where none is left.
    eps_y : ndarray, (P, ...)
        Mismatch of each pair across its line of sight, metres.
    z_std : ndarray, (...)
        Standard uncertainty of z for independent pairs of the stated ``std`` (per unit of it, if left out).

    Notes
    -----
    z = -sum w (dD . d) / sum w |dD|^2 with w = 1 / std^2.
    """
    d, D = np.asarray(difference, float), np.asarray(parallax, float)
    dx, dy, Dx, Dy = d[:, 0], d[:, 1], D[:, 0], D[:, 1]
    along, square = Dx * dx + Dy * dy, Dx * Dx + Dy * Dy
    weight = np.ones(1) if std is None else 1.0 / np.square(np.asarray(std, float))
    with np.errstate(divide="ignore", invalid="ignore"):
        eps_y = (Dy * dx - Dx * dy) / np.sqrt(square)
        weight = np.where(
            np.isfinite(along), weight.reshape(weight.shape + (1,) * (along.ndim - weight.ndim)), 0
        )
        total = np.sum(weight * square, axis=0)
        total = np.where(total > 0.0, total, np.nan)
        z = -np.sum(weight * np.where(np.isfinite(along), along, 0.0), axis=0) / total
    return z, eps_y, 1.0 / np.sqrt(total)


def triangulate(
    apparent: ArrayLike, sight: ArrayLike, std: ArrayLike | None = None
) -> tuple[Array, Array, Array, Array]:
    """Point nearest to the lines of sight of all cameras.

    Parameters
    ----------
    apparent : array_like, (N, 2, ...)
        Apparent positions (x, y) on the plane z = 0 in N cameras, metres; NaN where a camera does not see it.
    sight : array_like, (N, 2, ...)
        Sight lines (Dx, Dy) of those cameras, each at its own apparent position.
    std : array_like, broadcastable to (N, ...), optional
        Standard uncertainty of each position per axis, metres; all alike if left out.

    Returns
    -------
    x, y, z : ndarray, (...)
        Position, metres; NaN where fewer than two cameras see the point.
    eps : ndarray, (N, 2, ...)
        What each camera's apparent position is off, x_k - (x - D_k z), metres.

    Notes
    -----
    Least squares for x_k = x - D_k z + error with weights w_k = 1 / std_k^2. The same as
    `triangulate_pairs` over every pair of cameras with weights w_a w_b / sum w.
    """
    p, D = np.asarray(apparent, float), np.asarray(sight, float)
    seen = np.isfinite(p).all(1) & np.isfinite(D).all(1)
    weight = np.ones(1) if std is None else 1.0 / np.square(np.asarray(std, float))
    weight = np.where(seen, weight.reshape(weight.shape + (1,) * (seen.ndim - weight.ndim)), 0.0)[:, None]
    p0, D0 = np.where(seen[:, None], p, 0.0), np.where(seen[:, None], D, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        total = np.sum(weight, axis=0)
        p_mean, D_mean = np.sum(weight * p0, axis=0) / total, np.sum(weight * D0, axis=0) / total
        dp, dD = p0 - p_mean, D0 - D_mean
        square = np.sum(weight * dD * dD, axis=(0, 1))
        # two lines of sight within a ten-thousandth of a radian give no height
        square = np.where(square > 1e-8 * total[0], square, np.nan)
        z = -np.sum(weight * dp * dD, axis=(0, 1)) / square
    x, y = p_mean + D_mean * z
    return x, y, z, p - (np.stack([x, y]) - D * z)


def jacobians(cameras: Sequence[Camera], x: ArrayLike, y: ArrayLike, z: ArrayLike) -> Array:
    """Jacobians of several cameras, stacked for `solve_displacement`.

    Parameters
    ----------
    cameras : sequence of Camera
        The N cameras.
    x, y, z : array_like, broadcastable to shape S
        Positions, metres.

    Returns
    -------
    ndarray, S + (2N, 3)
        Derivatives of (X_1, Y_1, X_2, Y_2, ...) with respect to (x, y, z), px per metre.
    """
    shape = np.broadcast_shapes(np.shape(x), np.shape(y), np.shape(z))
    out = np.empty((*shape, 2 * len(cameras), 3))
    for n, camera in enumerate(cameras):
        out[..., 2 * n : 2 * n + 2, :] = camera.jacobian(x, y, z)
    return out


def _solve_one(jacobian: Array, seen: Array, weight: Array, out: Array, eps: Array, std: Array) -> None:
    a = b = c = d = e = f = 0.0  # normal matrix [[a, b, c], [b, d, e], [c, e, f]]
    p = q = r = 0.0
    rows = 0
    for i in range(seen.size):
        s, w = seen[i], weight[i]
        if not (np.isfinite(s) and w > 0.0 and np.isfinite(jacobian[i, 0])):
            continue
        rows += 1
        j0, j1, j2 = jacobian[i, 0], jacobian[i, 1], jacobian[i, 2]
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
    # Cholesky: exact for what the cameras see well, and a pivot tells when they do not see a direction
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
            out[k] = np.nan
            std[k] = np.nan
        eps[0] = np.nan
        return
    q1 = q - lb * p
    z = (r - lc * p - le * q1) / f1
    y = q1 / d1 - le * z
    x = p / a - lb * y - lc * z
    out[0], out[1], out[2] = x, y, z
    m = lb * le - lc
    std[0] = np.sqrt(1.0 / a + lb * lb / d1 + m * m / f1)
    std[1] = np.sqrt(1.0 / d1 + le * le / f1)
    std[2] = np.sqrt(1.0 / f1)
    total = 0.0
    for i in range(seen.size):
        if np.isfinite(seen[i]) and weight[i] > 0.0 and np.isfinite(jacobian[i, 0]):
            miss = seen[i] - (jacobian[i, 0] * x + jacobian[i, 1] * y + jacobian[i, 2] * z)
            total += miss * miss
    eps[0] = np.sqrt(total / rows)


_solve: Any = guvectorize(
    [(float64[:, :], float64[:], float64[:], float64[:], float64[:], float64[:])],
    "(n,m),(n),(n)->(m),(),(m)",
    nopython=True,
    cache=True,
)(_solve_one)


def solve_displacement(
    jacobian: ArrayLike, displacement: ArrayLike, std: ArrayLike | None = None
) -> tuple[Array, Array, Array]:
    """Displacement in space from the displacements on the sensors of N cameras.

    Parameters
    ----------
    jacobian : array_like, (..., 2N, 3)
        Derivatives of (X_1, Y_1, X_2, Y_2, ...) with respect to (x, y, z), px per metre (`jacobians`).
    displacement : array_like, (..., 2N)
        (dX_1, dY_1, dX_2, dY_2, ...), px; NaN where a camera has none: the others do the work.
    std : array_like, broadcastable to (..., 2N), optional
        Standard uncertainty of each displacement, px; all alike if left out. Infinite leaves one out.

    Returns
    -------
    d : ndarray, (..., 3)
        (dx, dy, dz), metres; NaN where fewer than two cameras are left.
    eps_piv : ndarray, (...)
        Misfit |J d - dX| / sqrt(number of rows used), px.
    d_std : ndarray, (..., 3)
        Standard uncertainty of (dx, dy, dz), metres, for independent errors of the stated ``std``
        (metres per px, if left out).

    Notes
    -----
    d = argmin sum w (J d - dX)^2 with w = 1 / std^2: normal equations, 3 x 3, in closed form.
    For two cameras eps_piv is the paper's eps' = |J d - dX| / 2.
    """
    J, seen = np.asarray(jacobian, float), np.asarray(displacement, float)
    with np.errstate(divide="ignore"):
        weight = np.ones(1) if std is None else 1.0 / np.square(np.asarray(std, float))
    out: tuple[Array, Array, Array] = _solve(
        J, seen, np.broadcast_to(weight, np.broadcast_shapes(weight.shape, seen.shape[-1:]))
    )
    return out
