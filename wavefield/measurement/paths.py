"""Velocity along the particles' paths: a cubic in time by four or six places in one camera's images."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from wavefield.compiled import compiled
from wavefield.measurement.regrid import (
    BlockLattice,
    Weights,
    place_of,
    spline_line,
    spline_slopes,
    spline_weights,
)
from wavefield.variables import PATH_WEIGHTS

Float = NDArray[Any]
Mask = NDArray[np.bool_]

Real = Any  # np.float32: mypy does not follow numba's arithmetic
Step = TypeVar("Step")

F = np.float32


# NaN must propagate; sums may be taken in any order
_LOOSE = {"contract", "reassoc"}


@compiled(error_model="numpy", fastmath=_LOOSE)
def _nearest(c: Float, nx: int, ny: int, x: Real, y: Real) -> tuple[Real, Real, int]:
    """Both fields at the block nearest to a place, in blocks, and that block; the first one of a NaN."""
    i = np.int64(min(F(nx) - F(2), max(F(1), x + F(0.5))))  # of two, `max` returns the first beside a NaN
    j = np.int64(min(F(ny) - F(2), max(F(1), y + F(0.5))))
    n: Any = j * nx + i
    return c[2 * n], c[2 * n + 1], n


@compiled(error_model="numpy", fastmath=_LOOSE)
def _inside(nx: int, ny: int, x: Real, y: Real) -> bool:
    """Whether a place, in blocks, is in the image; fields are read at its edge from beyond it."""
    half = F(0.5)
    return bool(-half < x < F(nx) - half and -half < y < F(ny) - half)


@compiled(error_model="numpy", fastmath=_LOOSE)
def _lines(c: Float, first: np.uintp, down: np.uintp, w: Weights) -> Weights:
    """Four blocks along x, weighed, of four rows."""
    step = np.uintp(2)
    return (
        spline_line(c, first, step, w),
        spline_line(c, first + down, step, w),
        spline_line(c, first + down + down, step, w),
        spline_line(c, first + down + down + down, step, w),
    )


@compiled(error_model="numpy", fastmath=_LOOSE)
def _dot(a: Weights, b: Weights) -> Real:
    return (a[0] * b[0] + a[1] * b[1]) + (a[2] * b[2] + a[3] * b[3])


@compiled(error_model="numpy", fastmath=_LOOSE)
def displacement_at(c: Float, nx: int, ny: int, x: Real, y: Real) -> tuple[Real, Real]:
    """Both fields at a place, in blocks."""
    i, t = place_of(x, nx)
    j, s = place_of(y, ny)
    wx, wy = spline_weights(t), spline_weights(s)
    first, down = np.uintp(((j - 1) * nx + i - 1) * 2), np.uintp(nx * 2)
    return _dot(_lines(c, first, down, wx), wy), _dot(_lines(c, first + np.uintp(1), down, wx), wy)


@compiled(error_model="numpy", fastmath=_LOOSE)
def _solve_near(
    c: Float, nx: int, ny: int, part: Real, x: Real, y: Real, u: Real, v: Real
) -> tuple[Real, Real, Real, Real, Weights]:
    """Solve p = x - part f(p) by one Newton step from p = x - part (u, v), all in blocks.
    Returns p, f there, and how p follows a shift of x: (1 + part G)^-1, row by row.
    """
    px, py = x - part * u, y - part * v
    i, t = place_of(px, nx)
    j, s = place_of(py, ny)
    wx, wy, dx, dy = spline_weights(t), spline_weights(s), spline_slopes(t), spline_slopes(s)
    first, down = np.uintp(((j - 1) * nx + i - 1) * 2), np.uintp(nx * 2)
    second = first + np.uintp(1)
    lu, lv = _lines(c, first, down, wx), _lines(c, second, down, wx)
    fu, fv, uy, vy = _dot(lu, wy), _dot(lv, wy), _dot(lu, dy), _dot(lv, dy)
    ux, vx = _dot(_lines(c, first, down, dx), wy), _dot(_lines(c, second, down, dx), wy)
    a, b, d, e = F(1) + part * ux, part * uy, part * vx, F(1) + part * vy
    scale = F(1) / (a * e - b * d)
    a, b, d, e = e * scale, -b * scale, -d * scale, a * scale
    rx, ry = part * (u - fu), part * (v - fv)
    sx, sy = a * rx + b * ry, d * rx + e * ry
    return px + sx, py + sy, fu + ux * sx + uy * sy, fv + vx * sx + vy * sy, (a, b, d, e)


@compiled(error_model="numpy", fastmath=_LOOSE)
def _extended(after: bool, before: bool, u: Real, v: Real, ua: Real, va: Real, ub: Real, vb: Real) -> Weights:
    """Displacements after and before; where one was not measured, the path is extrapolated."""
    if not after:
        ua, va = (F(2) * u - ub, F(2) * v - vb) if before else (u, v)
    if not before:
        ub, vb = F(2) * u - ua, F(2) * v - va
    return ua, va, ub, vb


@compiled(error_model="numpy", fastmath=_LOOSE)
def _read_path(
    splines: tuple[Float, Float, Float, Float, Float],
    measured: tuple[Mask, Mask, Mask, Mask],
    shape: tuple[int, int],
    lattice: tuple[Real, Real, Real],
    x: Float,
    y: Float,
    outer_weights: tuple[Real, Real],
    out: Float,
    block: NDArray[np.int64],
) -> None:
    """Fill out (6, n) and block (5, n); fields of five steps in time order, empty where there is none."""
    bb, b, c, a, aa = splines
    has_bb, has_b, has_a, has_aa = measured
    ny, nx = shape
    x0, y0, step = lattice
    near, far = outer_weights
    across, half, bend = F(1) / step, F(0.5), F(1 / 16)
    for k in range(x.size):
        if not (np.isfinite(x[k]) and np.isfinite(y[k])):
            out[:, k] = np.nan
            block[:, k] = -1
            block[2, k] = 0
            continue
        px, py = (x[k] - x0) * across, (y[k] - y0) * across
        # from the nearest blocks, all within half a block's change of the field
        u, v, n = _nearest(c, nx, ny, px, py)
        u, v, n = _nearest(c, nx, ny, px - half * across * u, py - half * across * v)
        ua, va, ub, vb = u, v, u, v
        na = nb = 0
        if has_a.size:
            ua, va, na = _nearest(a, nx, ny, px + half * across * u, py + half * across * v)
        if has_b.size:
            for _ in range(2):
                ub, vb, nb = _nearest(b, nx, ny, px - across * (half * u + ub), py - across * (half * v + vb))
        after, before = has_a.size > 0 and has_a[na], has_b.size > 0 and has_b[nb]
        ua, va, ub, vb = _extended(after, before, u, v, ua, va, ub, vb)
        kx, ky = bend * across * (ua - ub), bend * across * (va - vb)
        # in blocks from here on: the fields' unit is px
        sx, sy, u, v, g = _solve_near(c, nx, ny, half * across, px + kx, py + ky, u, v)
        n = _nearest(c, nx, ny, sx, sy)[2]
        ua, va, ub, vb = u, v, u, v
        ax, ay = sx + across * u, sy + across * v
        bx, by = sx - across * u, sy - across * v
        if has_a.size:
            ua, va = displacement_at(a, nx, ny, ax, ay)
            na = _nearest(a, nx, ny, ax, ay)[2]
        if has_b.size:
            wb, zb, _ = _nearest(b, nx, ny, bx, by)
            bx, by, ub, vb, _ = _solve_near(b, nx, ny, across, sx, sy, wb, zb)
            nb = _nearest(b, nx, ny, bx, by)[2]
        after = has_a.size > 0 and has_a[na] and _inside(nx, ny, ax, ay)
        before = has_b.size > 0 and has_b[nb] and _inside(nx, ny, bx, by)
        ua, va, ub, vb = _extended(after, before, u, v, ua, va, ub, vb)
        # the bend as it is now moves the place of departure a little, and with it all places
        kx, ky = bend * across * (ua - ub) - kx, bend * across * (va - vb) - ky
        us, vs = displacement_at(c, nx, ny, sx + g[0] * kx + g[1] * ky, sy + g[2] * kx + g[3] * ky)
        out[0, k] = us - (ua - F(2) * u + ub) / F(24)
        out[1, k] = vs - (va - F(2) * v + vb) / F(24)
        out[2, k], out[3, k] = us, vs
        out[4, k], out[5, k] = bend * (ua - ub), bend * (va - vb)
        block[0, k] = block[4, k] = -1
        block[1, k] = nb if before else -1
        block[2, k] = n
        block[3, k] = na if after else -1
        if after and before and has_aa.size > 0 and has_bb.size > 0:
            ax, ay = ax + across * ua, ay + across * va
            wb, zb, _ = _nearest(bb, nx, ny, bx - across * ub, by - across * vb)
            bx, by, wb, zb, _ = _solve_near(bb, nx, ny, across, bx, by, wb, zb)
            na, nb = _nearest(aa, nx, ny, ax, ay)[2], _nearest(bb, nx, ny, bx, by)[2]
            if has_aa[na] and has_bb[nb] and _inside(nx, ny, ax, ay) and _inside(nx, ny, bx, by):
                wa, za = displacement_at(aa, nx, ny, ax, ay)
                out[0, k] = us + near * (ua - F(2) * u + ub) + far * (wa - F(2) * u + wb)
                out[1, k] = vs + near * (va - F(2) * v + vb) + far * (za - F(2) * v + zb)
                block[0, k], block[4, k] = nb, na


def five(steps: Sequence[Step | None]) -> Sequence[Step | None]:
    """Five steps, None where none is given on either side."""
    missing = [None] * (2 - len(steps) // 2)
    return [*missing, *steps, *missing]


def read_path(
    splines: Sequence[Float | None],
    valid: Sequence[Mask | None],
    lattice: BlockLattice,
    X: Float,
    Y: Float,
    frames: int = 6,
) -> tuple[Float, NDArray[np.int64]]:
    """dX/dt dt at mid-time at pixels X, Y, displacement over the step, and bend, px, (6,) + the shape of X.
    Splines (ny, nx, 2), px, of an odd number of steps. Also returns the blocks read, 5 per X, or -1.
    """
    nodes = np.shape(X)
    xs, ys = (np.ascontiguousarray(v, dtype=np.float32).ravel() for v in (X, Y))
    out, block = np.empty((6, xs.size), np.float32), np.empty((5, xs.size), np.int64)
    none, nothing = np.zeros(0, np.float32), np.zeros(0, np.bool_)
    bb, b, c, a, aa = (
        none if f is None else np.ascontiguousarray(f, np.float32).ravel() for f in five(splines)
    )
    has = [nothing if f is None else np.ascontiguousarray(f).ravel() for f in five(valid)]
    place = F(lattice.x0), F(lattice.y0), F(lattice.step)
    # X0 = X - d01/2 + (d12 - d-10)/16, the bend being (d12 - d-10)/16; dX/dt dt = (26 d01 - d-10 - d12)/24 of
    # four frames; of six (34 d01 + 10 (d-10 + d12) - 3 (d-2-1 + d23))/48, with 0.4 of the variance by noise,
    # or (2134 d01 - 116 (d-10 + d12) + 9 (d-2-1 + d23))/1920, exact to the fifth degree; paths are parabolas
    # if one end is missing, straight if both are
    near, far = (F(weight) for weight in PATH_WEIGHTS[max(frames, 6)][1:])
    measured = has[0], has[1], has[3], has[4]
    _read_path((bb, b, c, a, aa), measured, lattice.shape, place, xs, ys, (near, far), out, block)
    return out.reshape(6, *nodes), block.reshape(5, *nodes)
