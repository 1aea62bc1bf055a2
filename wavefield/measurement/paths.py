"""Velocity along the particles' paths: a cubic in time through four places in one camera's images."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.compiled import compiled
from wavefield.measurement.regrid import Lattice, place_of, spline_at, spline_weights

Float = NDArray[Any]
Mask = NDArray[np.bool_]

_STEPS = 4  # fixed-point steps: the last moves by less than a thousandth of a pixel


@compiled(error_model="numpy", fastmath={"contract"})
def _at(
    c: Float,
    nx: int,
    ny: int,
    across: float,
    x0: float,
    y0: float,
    step_x: np.uintp,
    step_y: np.uintp,
    x: float,
    y: float,
) -> tuple[float, float, int]:
    """Fields 0 and 1 at a place, and the block nearest to it."""
    i, t = place_of((x - x0) * across, nx)
    j, s = place_of((y - y0) * across, ny)
    wx, wy = spline_weights(t), spline_weights(s)
    first = np.uintp(((j - 1) * nx + i - 1) * 2)
    block = min(j + int(s + 0.5), ny - 1) * nx + min(i + int(t + 0.5), nx - 1)
    return (
        float(spline_at(c, first, step_x, step_y, wx, wy)),
        float(spline_at(c, first + np.uintp(1), step_x, step_y, wx, wy)),
        block,
    )


@compiled(error_model="numpy", fastmath={"contract"})
def _read_path(
    b: Float,
    c: Float,
    a: Float,
    has_b: Float,
    has_a: Float,
    nx: int,
    ny: int,
    x: Float,
    y: Float,
    x0: float,
    y0: float,
    step: float,
    steps: int,
    out: Float,
    block: Float,
) -> None:
    across = 1.0 / step
    sx, sy = np.uintp(2), np.uintp(nx * 2)
    for k in range(x.size):
        if not (np.isfinite(x[k]) and np.isfinite(y[k])):
            out[0, k] = out[1, k] = np.nan
            block[:, k] = 0
            continue
        u, v, n = _at(c, nx, ny, across, x0, y0, sx, sy, x[k], y[k])
        xs, ys = x[k] - 0.5 * u, y[k] - 0.5 * v
        xb, yb = xs - u, ys - v
        ub, vb, ua, va = u, v, u, v
        nb, na = n, n
        for _ in range(steps):
            u, v, n = _at(c, nx, ny, across, x0, y0, sx, sy, xs, ys)
            if has_a.size:
                ua, va, na = _at(a, nx, ny, across, x0, y0, sx, sy, xs + u, ys + v)
            if has_b.size:
                ub, vb, nb = _at(b, nx, ny, across, x0, y0, sx, sy, xb, yb)
                xb, yb = xs - ub, ys - vb
            after, before = has_a.size > 0 and has_a[na], has_b.size > 0 and has_b[nb]
            if not after:  # the path goes on as it came
                ua, va = (2 * u - ub, 2 * v - vb) if before else (u, v)
            if not before:
                ub, vb = 2 * u - ua, 2 * v - va
            xs, ys = x[k] - 0.5 * u + (ua - ub) / 16.0, y[k] - 0.5 * v + (va - vb) / 16.0
        out[0, k], out[1, k] = (26.0 * u - ub - ua) / 24.0, (26.0 * v - vb - va) / 24.0
        block[0, k] = nb if has_b.size > 0 and has_b[nb] else -1
        block[1, k] = n
        block[2, k] = na if has_a.size > 0 and has_a[na] else -1


def read_path(
    splines: Sequence[Float | None],
    valid: Sequence[Mask | None],
    lattice: Lattice,
    X: NDArray[Any],
    Y: NDArray[Any],
) -> tuple[Float, NDArray[np.int64]]:
    """Displacement per step, at mid-time, of what is then at given pixels.

    Parameters
    ----------
    splines : sequence of three ndarray of float32, (ny, nx, 2), or None
        Spline coefficients of the displacements of the step before, of this step and of the step after, px,
        each at the place of departure. That of this step must be there.
    valid : sequence of three ndarray of bool, (ny, nx), or None
        Blocks that were measured: only there the steps before and after are asked.
    lattice : Lattice
        Block centres, px.
    X, Y : ndarray, shape S
        Places at mid-time, px; NaN gives NaN.

    Returns
    -------
    d : ndarray of float32, (2,) + S
        dX/dt dt at mid-time, px.
    block : ndarray of int, (3,) + S
        Flat index of the block read in each of the three; -1 where it was not measured.

    Notes
    -----
    With d01 the displacement of the step, d-10 and d12 of its neighbours along the path,

        X0 = X - d01/2 + (d12 - d-10)/16,    dX/dt dt = (26 d01 - d-10 - d12)/24.

    The particle is at X at mid-time; the middle of its chord lies (d12 - d-10)/16 beside. What is missing at
    one end is extrapolated: the path is then a parabola, and a straight line if both ends are missing.

    Examples
    --------
    >>> lattice = Lattice(2.0, 2.0, 5.0, (8, 8))
    >>> same = np.full((8, 8, 2), 1.5, np.float32)
    >>> at = np.array([20.0])
    >>> d, block = read_path((None, same, None), (None, None, None), lattice, at, at)
    >>> d[:, 0].tolist()
    [1.5, 1.5]
    """
    nodes = np.shape(X)
    xs, ys = (np.ascontiguousarray(v, dtype=np.float64).ravel() for v in (X, Y))
    out, block = np.empty((2, xs.size), np.float32), np.empty((3, xs.size), np.int64)
    none, nothing = np.zeros(0, np.float32), np.zeros(0, np.bool_)
    b, c, a = (none if f is None else np.ascontiguousarray(f, np.float32).ravel() for f in splines)
    has_b, _, has_a = (nothing if f is None else np.ascontiguousarray(f).ravel() for f in valid)
    ny, nx = lattice.shape
    _read_path(
        b, c, a, has_b, has_a, nx, ny, xs, ys, lattice.x0, lattice.y0, lattice.step, _STEPS, out, block
    )
    return out.reshape(2, *nodes), block.reshape(3, *nodes)
