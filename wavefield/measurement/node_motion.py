"""Motion of the water at the nodes by least squares over the cameras: one pass over all fields."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.compiled import compiled

Float = NDArray[Any]

LEAST_PIVOT = 1e-9  # of a diagonal: less, and the cameras do not determine a direction
NODES_AT_ONCE = 256  # whose sums stay in the cache

njit = compiled(error_model="numpy", fastmath={"contract", "reassoc"})


@njit
def _weigh(
    moved: tuple[Float, Float], noise: tuple[Float, Float], missing: tuple[Float, Float], w: Float
) -> None:
    """Inverse mean variance of one camera's components; 0 where it does not see the node."""
    (x, y), (n0, n1), (m0, m1) = moved, noise, missing
    for k in range(len(w)):
        seen = np.isfinite(x[k]) and np.isfinite(y[k])
        w[k] = 2.0 / np.float64(n0[k] + n1[k] + m0[k] + m1[k]) if seen else 0.0


@njit
def _add_matrix(jacobian: tuple[Float, ...], w: Float, sums: tuple[Float, ...]) -> None:
    x, y, z = jacobian
    a, b, c, d, e, f = sums
    for k in range(len(w)):
        p, q, r = np.float64(x[k]), np.float64(y[k]), np.float64(z[k])
        wp, wq, wr = w[k] * p, w[k] * q, w[k] * r
        a[k] += wp * p
        b[k] += wp * q
        c[k] += wp * r
        d[k] += wq * q
        e[k] += wq * r
        f[k] += wr * r


@njit
def _add_right(jacobian: tuple[Float, ...], w: Float, observed: Float, sums: tuple[Float, ...]) -> None:
    x, y, z = jacobian
    p, q, r = sums
    for k in range(len(w)):
        s = w[k] * np.float64(observed[k]) if w[k] > 0.0 else 0.0
        p[k] += np.float64(x[k]) * s
        q[k] += np.float64(y[k]) * s
        r[k] += np.float64(z[k]) * s


@njit
def _factor(sums: tuple[Float, ...]) -> None:
    """Replace a normal matrix [[a, b, c], [b, d, e], [c, e, f]] by 1/a, b/a, c/a, 1/d1, e1/d1, 1/f1.
    The result is NaN where the cameras do not determine a direction.
    """
    a, b, c, d, e, f = sums
    for k in range(len(a)):
        lb, lc = b[k] / a[k], c[k] / a[k]
        d1, e1 = d[k] - b[k] * lb, e[k] - b[k] * lc
        le = e1 / d1
        f1 = f[k] - c[k] * lc - e1 * le
        ok = d1 > LEAST_PIVOT * d[k] and f1 > LEAST_PIVOT * f[k]
        a[k], b[k], c[k], d[k], e[k] = 1.0 / a[k], lb, lc, 1.0 / d1, le
        f[k] = 1.0 / f1 if ok else np.nan


@njit
def _solve(matrix: tuple[Float, ...], right: tuple[Float, ...], out: tuple[Float, ...]) -> None:
    a, b, c, d, e, f = matrix
    p, q, r = right
    to_x, to_y, to_z = out
    for k in range(len(a)):
        q1 = q[k] - b[k] * p[k]
        z = (r[k] - c[k] * p[k] - e[k] * q1) * f[k]
        y = q1 * d[k] - e[k] * z
        to_x[k], to_y[k], to_z[k] = p[k] * a[k] - b[k] * y - c[k] * z, y, z


@njit
def _add_rest(
    jacobian: tuple[Float, ...],
    w: Float,
    moved: Float,
    solution: tuple[Float, ...],
    matrix: tuple[Float, ...],
    noise: Float,
    sums: tuple[Float, ...],
) -> None:
    """Add one row's squared misfit, that over its noise, and its part of the variance of the solution."""
    x, y, z = jacobian
    dx, dy, dz = solution
    a, b, c, d, e, f = matrix
    square, chi2, vx, vy, vz = sums
    for k in range(len(w)):
        p, q, r = np.float64(x[k]), np.float64(y[k]), np.float64(z[k])
        rest = np.float64(moved[k]) - (p * dx[k] + q * dy[k] + r * dz[k])
        rest = rest * rest if w[k] > 0.0 else 0.0
        n = np.float64(noise[k])
        square[k] += rest
        chi2[k] += rest / n
        p, q, r = w[k] * p, w[k] * q, w[k] * r
        q -= b[k] * p
        gz = (r - c[k] * p - e[k] * q) * f[k]
        gy = q * d[k] - e[k] * gz
        gx = p * a[k] - b[k] * gy - c[k] * gz
        vx[k] += gx * gx * n
        vy[k] += gy * gy * n
        vz[k] += gz * gz * n


@njit
def _recede(axis: Float, solution: tuple[Float, ...], bend: Float, chord: Float, out: Float) -> None:
    """What moves away from a camera at a constant speed slows down in its image."""
    x, y, z = solution
    for k in range(len(out)):
        away = axis[0] * x[k] + axis[1] * y[k] + axis[2] * z[k]
        out[k] = np.float32(np.float64(bend[k]) + 0.25 * away * np.float64(chord[k]))


@njit
def _add_removed(
    first: tuple[Float, ...],
    second: tuple[Float, ...],
    missing: tuple[Float, Float],
    w: Float,
    parts: Float,
    sums: tuple[Float, Float, Float],
) -> None:
    """Add what the prior removed from one camera, and the water's motion in it, weighed; and count it."""
    x0, y0, z0 = first
    x1, y1, z1 = second
    m0, m1 = missing
    removed, total, count = sums
    for k in range(len(w)):
        size = parts[0] * np.float64(x0[k] * x0[k] + x1[k] * x1[k])
        size += parts[1] * np.float64(y0[k] * y0[k] + y1[k] * y1[k])
        size += parts[2] * np.float64(z0[k] * z0[k] + z1[k] * z1[k])
        seen = w[k] > 0.0
        removed[k] += w[k] * np.sqrt(np.float64(m0[k] + m1[k]) * size) if seen else 0.0
        total[k] += w[k] * size
        count[k] += 1.0 if seen else 0.0


@njit
def solve_nodes(
    jacobian: Float,
    moved: Float,
    chord: Float,
    bend: Float,
    noise: Float,
    missing: Float,
    parts: Float,
    axes: Float,
    out: Float,
) -> None:
    """Fill out (16, n): d, chord, bend, variance of d by noise (3 each), variance by the prior over parts,
    eps = |J d - moved| / sqrt(2N), chi^2 / dof, and the factor on the noise where chi^2 exceeds its mean.
    Float32 (2N, 3, n) jacobian, (2N, n) others; float64 parts (3,) and axes (N, 3).
    """
    rows, n = moved.shape
    work = np.empty((23, NODES_AT_ONCE))
    weight = np.empty((rows // 2, NODES_AT_ONCE))
    bent = np.empty(NODES_AT_ONCE, np.float32)
    for first in range(0, n, NODES_AT_ONCE):
        last = min(first + NODES_AT_ONCE, n)
        size = last - first
        work[:] = 0.0
        s = work[:, :size]
        matrix = s[0], s[1], s[2], s[3], s[4], s[5]
        d, ch, be = (s[6], s[7], s[8]), (s[9], s[10], s[11]), (s[12], s[13], s[14])
        sums = s[15], s[16], s[17], s[18], s[19]
        removed, total, count = s[20], s[21], s[22]
        for c in range(rows // 2):
            i, j = 2 * c, 2 * c + 1
            w = weight[c, :size]
            one = jacobian[i, 0, first:last], jacobian[i, 1, first:last], jacobian[i, 2, first:last]
            two = jacobian[j, 0, first:last], jacobian[j, 1, first:last], jacobian[j, 2, first:last]
            lost = missing[i, first:last], missing[j, first:last]
            both = moved[i, first:last], moved[j, first:last]
            _weigh(both, (noise[i, first:last], noise[j, first:last]), lost, w)
            _add_matrix(one, w, matrix)
            _add_matrix(two, w, matrix)
            _add_right(one, w, both[0], d)
            _add_right(two, w, both[1], d)
            _add_right(one, w, chord[i, first:last], ch)
            _add_right(two, w, chord[j, first:last], ch)
            _add_removed(one, two, lost, w, parts, (removed, total, count))
        _factor(matrix)
        _solve(matrix, d, d)
        _solve(matrix, ch, ch)
        for i in range(rows):
            w, at = weight[i // 2, :size], bent[:size]
            row = jacobian[i, 0, first:last], jacobian[i, 1, first:last], jacobian[i, 2, first:last]
            _recede(axes[i // 2], ch, bend[i, first:last], chord[i, first:last], at)
            _add_right(row, w, at, be)
            _add_rest(row, w, moved[i, first:last], d, matrix, noise[i, first:last], sums)
        _solve(matrix, be, be)
        for k in range(size):
            at_node = first + k
            for m in range(9):
                out[m, at_node] = s[6 + m, k]
            cameras = count[k]
            ok = s[6, k] == s[6, k] and cameras > 1.0
            freedom = 2.0 * cameras - 3.0
            for m in range(3):
                out[9 + m, at_node] = s[17 + m, k]
            out[12, at_node] = (removed[k] / max(total[k], 1e-30)) ** 2
            out[13, at_node] = np.sqrt(s[15, k] / (2.0 * cameras)) if ok else np.nan
            out[14, at_node] = s[16, k] / freedom if ok else np.nan
            # one pseudo-observation shrinks chi^2 towards 1
            out[15, at_node] = max((1.0 + s[16, k]) / (1.0 + freedom), 1.0) if ok else np.nan
