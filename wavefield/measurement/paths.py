"""Paths of particles in the images of each camera, and velocities of these particles at mid-time.

A path belongs to a particle that is at a node at mid-time. The particle has moved through the images of the
frames around. Its displacement in each step is read where it was then, from the MAP displacement of that
step. A polynomial through its positions in 2, 4 or 6 frames gives its velocity. The six frames are numbered 0
to 5, with mid-time between 2 and 3; the five steps between them are called bb, b, c, a, aa (two before,
before, centre, after, two after). Times are in frame intervals from mid-time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.compiled import compiled
from wavefield.measurement.displacement import CameraFlow, Flows
from wavefield.measurement.geometry import GridGeometry, Sight
from wavefield.measurement.regrid import (
    BlockLattice,
    Weights,
    place_of,
    spline_line,
    spline_slopes,
    spline_weights,
)
from wavefield.variables import PATH_WEIGHTS, Quality

Float = NDArray[Any]

EVEN_TIMES = np.arange(6) - 2.5  # times of the six frames around a step if they are evenly spaced
# frames from which z at mid-time is interpolated, by their number; for three, the first neighbour is missing
FRAMES_OF_Z = {6: (0, 1, 2, 3, 4, 5), 4: (1, 2, 3, 4), 3: (2, 3, 4), 2: (2, 3)}
# frames of a path: those of the step, also the one before, also the one after, both, all six
FRAMES_OF_PATH = ((2, 3), (1, 2, 3), (2, 3, 4), (1, 2, 3, 4), (0, 1, 2, 3, 4, 5))
# Correlation between the noise of successive displacements. Noise of the frame that they share would give
# -1/2; errors that depend on where the beads are would give 0. Errors of simulated records at 80 frames/s in
# good light give -0.14 to -0.21.
_NOISE_CORRELATION = -0.2


def elevation_gain(phase: Float, frames: int) -> Float:
    """Return the gain (measured over true) of z from 2, 4 or 6 frames; `phase`: that of waves, rad per frame.
    The gain is that of interpolation half-way between the middle two frames."""
    weights = {2: (1.0,), 4: (9 / 8, -1 / 8), 6: (150 / 128, -25 / 128, 3 / 128)}[frames]
    return np.asarray(sum(w * np.cos((n + 0.5) * phase) for n, w in enumerate(weights)))


def path_gain(phase: Float, frames: int) -> Float:
    """Return the gain (measured over true) of velocities along paths, for waves of `phase`, rad per frame.
    `frames` is the kind of path, a key of PATH_WEIGHTS."""
    own, *neighbours = PATH_WEIGHTS[frames]
    path = own + 2.0 * sum(w * np.cos(n * phase) for n, w in enumerate(neighbours, 1))
    return np.asarray(np.sinc(phase / (2.0 * np.pi)) * path)


def frame_weights(
    times: Float, frames: Sequence[int], smooth: bool = False, at: Float | float = 0.0
) -> tuple[Float, Float]:
    """Return a tuple of weights (6, ...) of six frames: for a value at the time `at`, and for its derivative.
    They follow from a polynomial through the frames numbered `frames` (0 to 5). If `smooth`, the derivative
    is from a fit of degree four to all six, with less noise. `times` (6,) and `at` are in frame intervals."""
    used = list(frames)
    powers = np.vander(times[used], increasing=True).T
    shape, count = np.shape(at), len(used)
    now = np.vander(np.ravel(at), count, increasing=True).T
    change = np.zeros_like(now)
    change[1:] = now[:-1] * np.arange(1, count)[:, None]
    value, rate = np.zeros((2, 6, now.shape[1]))
    value[used], rate[used] = np.linalg.solve(powers, now), np.linalg.solve(powers, change)
    if smooth:
        later = -np.diff(PATH_WEIGHTS[6], append=0.0)
        even = np.concatenate([-later[::-1], later])
        rate = even[:, None] + np.linalg.pinv(powers[:5]) @ (change[:5] - (powers[:5] @ even)[:, None])
    return value.reshape(6, *shape), rate.reshape(6, *shape)


def noise_of_displacements(weights: Float) -> Float:
    """Return factors (n, ...) that turn n noise variances into parts of the variance of a weighted sum.
    The sum of n successive displacements has the `weights` (n, ...); their noise is correlated."""
    padded = np.pad(weights, [(1, 1), *[(0, 0)] * (weights.ndim - 1)])
    return np.asarray(weights * (weights + _NOISE_CORRELATION * (padded[:-2] + padded[2:])))


def row_delay(name: str, geometry: GridGeometry) -> float:
    """Return a camera's rolling-shutter delay per row of the binned image, in frame intervals."""
    return dict(geometry.settings.row_delays).get(name, 0.0) * geometry.sights[name].binning


def middle_row(sight: Sight) -> float:
    """Return the number of the middle row of the binned image, which is read at the time of the frame."""
    return 0.5 * (sight.camera.size[1] - 1)


Mask = NDArray[np.bool_]
Real = Any  # np.float32: mypy does not follow numba's arithmetic
F = np.float32
# NaN must propagate, but sums may be reordered
_LOOSE = {"contract", "reassoc"}


@compiled(error_model="numpy", fastmath=_LOOSE)
def _nearest(c: Float, nx: int, ny: int, x: Real, y: Real) -> tuple[Real, Real, int]:
    """Return the two spline coefficients c[2n], c[2n + 1] of the block nearest to x, y, and its number n.
    x, y are in blocks on a lattice of nx by ny blocks. The outermost blocks are not used."""
    i = np.int64(min(F(nx) - F(2), max(F(1), x + F(0.5))))  # max(1, NaN) is 1
    j = np.int64(min(F(ny) - F(2), max(F(1), y + F(0.5))))
    n: Any = j * nx + i
    return c[2 * n], c[2 * n + 1], n


@compiled(error_model="numpy", fastmath=_LOOSE)
def _inside(nx: int, ny: int, x: Real, y: Real) -> bool:
    """Return whether the position x, y, in blocks, lies on a lattice of nx by ny blocks."""
    half = F(0.5)
    return bool(-half < x < F(nx) - half and -half < y < F(ny) - half)


@compiled(error_model="numpy", fastmath=_LOOSE)
def _lines(c: Float, first: np.uintp, down: np.uintp, w: Weights) -> Weights:
    """Return four sums, one per lattice row, of four neighbouring coefficients along x, weighted by w.
    `first` is the index in c (flat) of the first coefficient, `down` the distance between rows in c."""
    step = np.uintp(2)
    return (
        spline_line(c, first, step, w),
        spline_line(c, first + down, step, w),
        spline_line(c, first + down + down, step, w),
        spline_line(c, first + down + down + down, step, w),
    )


@compiled(error_model="numpy", fastmath=_LOOSE)
def _dot(a: Weights, b: Weights) -> Real:
    """Return the inner product of two tuples of four numbers."""
    return (a[0] * b[0] + a[1] * b[1]) + (a[2] * b[2] + a[3] * b[3])


@compiled(error_model="numpy", fastmath=_LOOSE)
def displacement_at(c: Float, nx: int, ny: int, x: Real, y: Real) -> tuple[Real, Real]:
    """Return the displacement (u, v) at x, y, in blocks, from its spline coefficients c (flat)."""
    i, t = place_of(x, nx)
    j, s = place_of(y, ny)
    wx, wy = spline_weights(t), spline_weights(s)
    first, down = np.uintp(((j - 1) * nx + i - 1) * 2), np.uintp(nx * 2)
    return _dot(_lines(c, first, down, wx), wy), _dot(_lines(c, first + np.uintp(1), down, wx), wy)


@compiled(error_model="numpy", fastmath=_LOOSE)
def _solve_near(
    c: Float, nx: int, ny: int, part: Real, x: Real, y: Real, u: Real, v: Real
) -> tuple[Real, Real, Real, Real, Weights]:
    """Find the position p for which p + part f(p) = (x, y), by one Newton step from (x, y) - part (u, v).
    f is the displacement with the spline coefficients c. Returns p_x, p_y, f_x(p), f_y(p) and the tuple of
    derivatives (dp_x/dx, dp_x/dy, dp_y/dx, dp_y/dy)."""
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
def _read_path(
    splines: tuple[Float, Float, Float, Float, Float],
    measured: tuple[Mask, Mask, Mask, Mask],
    shape: tuple[int, int],
    lattice: tuple[Real, Real, Real],
    x: Float,
    y: Float,
    weights: Float,
    out: Float,
    block: NDArray[np.int64],
) -> None:
    """Do the work of `read_path` on flat arrays: write the motion to out (6, n), the blocks to block (5, n).
    Arrays of missing steps are empty. `weights` (5, 2, 5, m) of `path_weights` are for all pixels (m = 1) or
    for each (m = n). `lattice` is x0, y0 and step of the lattice of `shape`."""
    bb, b, c, a, aa = splines
    has_bb, has_b, has_a, has_aa = measured
    ny, nx = shape
    x0, y0, step = lattice
    across, half = F(1) / step, F(0.5)
    for k in range(x.size):
        if not (np.isfinite(x[k]) and np.isfinite(y[k])):
            out[:, k] = np.nan
            block[:, k] = -1
            block[2, k] = 0
            continue
        m = k if weights.shape[3] > 1 else 0
        px, py = (x[k] - x0) * across, (y[k] - y0) * across
        # first guess: the displacements at the nearest blocks
        part = weights[3, 0, 2, m] * across
        u, v, n = _nearest(c, nx, ny, px, py)
        u, v, n = _nearest(c, nx, ny, px - part * u, py - part * v)
        ua, va, ub, vb = u, v, u, v
        na = nb = 0
        if has_a.size:
            ua, va, na = _nearest(a, nx, ny, px + (across - part) * u, py + (across - part) * v)
        if has_b.size:
            for _ in range(2):
                ub, vb, nb = _nearest(b, nx, ny, px - part * u - across * ub, py - part * v - across * vb)
        after, before = has_a.size > 0 and has_a[na], has_b.size > 0 and has_b[nb]
        w = weights[int(before) + 2 * int(after), 0]
        part = w[2, m] * across
        kx, ky = -across * (w[1, m] * ub + w[3, m] * ua), -across * (w[1, m] * vb + w[3, m] * va)
        # positions are in blocks from here on, displacements in px
        sx, sy, u, v, g = _solve_near(c, nx, ny, part, px + kx, py + ky, u, v)
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
        w, r = weights[int(before) + 2 * int(after), 0], weights[int(before) + 2 * int(after), 1]
        # the better path begins at a slightly different position; correct all displacements along it for that
        change = w[2, m] * across - part
        kx = -across * (w[1, m] * ub + w[3, m] * ua) - change * u - kx
        ky = -across * (w[1, m] * vb + w[3, m] * va) - change * v - ky
        us, vs = displacement_at(c, nx, ny, sx + g[0] * kx + g[1] * ky, sy + g[2] * kx + g[3] * ky)
        eu, ev = us - u, vs - v
        ua, va, ub, vb = ua + eu, va + ev, ub + eu, vb + ev
        out[0, k] = r[1, m] * ub + r[2, m] * us + r[3, m] * ua
        out[1, k] = r[1, m] * vb + r[2, m] * vs + r[3, m] * va
        out[2, k], out[3, k] = us, vs
        out[4, k] = (half - w[2, m]) * us - w[1, m] * ub - w[3, m] * ua
        out[5, k] = (half - w[2, m]) * vs - w[1, m] * vb - w[3, m] * va
        block[0, k] = block[4, k] = -1
        block[1, k] = nb if before else -1
        block[2, k] = n
        block[3, k] = na if after else -1
        if after and before and has_aa.size > 0 and has_bb.size > 0:
            ax, ay = ax + across * (ua - eu), ay + across * (va - ev)
            wb, zb, _ = _nearest(bb, nx, ny, bx - across * (ub - eu), by - across * (vb - ev))
            bx, by, wb, zb, _ = _solve_near(bb, nx, ny, across, bx, by, wb, zb)
            na, nb = _nearest(aa, nx, ny, ax, ay)[2], _nearest(bb, nx, ny, bx, by)[2]
            if has_aa[na] and has_bb[nb] and _inside(nx, ny, ax, ay) and _inside(nx, ny, bx, by):
                wa, za = displacement_at(aa, nx, ny, ax, ay)
                r = weights[4, 1]
                wa, za, wb, zb = wa + eu, za + ev, wb + eu, zb + ev
                out[0, k] = r[0, m] * wb + r[1, m] * ub + r[2, m] * us + r[3, m] * ua + r[4, m] * wa
                out[1, k] = r[0, m] * zb + r[1, m] * vb + r[2, m] * vs + r[3, m] * va + r[4, m] * za
                block[0, k], block[4, k] = nb, na


def path_weights(times: Float, frames: int, at: Float | float = 0.0) -> Float:
    """Return the weights (5, 2, 5, m) of five successive displacements along a path, at m times `at`.

    Axis 0: which frames exist (`FRAMES_OF_PATH`). Axis 1: 0 gives the displacement from the step's first
    frame to the time `at`, 1 the displacement per interval at `at`. Axis 2: the five displacements. `frames`
    is the kind of path; times are in frame intervals from mid-time. Take even times, a step from frame 0 to
    frame 1, positions X0 in frame 0 and X at mid-time, and displacements d_ij from frame i to j. Then four
    frames give X0 = X - d01/2 + (d12 - d-10)/16 and dX/dt dt = (26 d01 - d-10 - d12)/24. Six give (34 d01 +
    10 (d-10 + d12) - 3 (d-2-1 + d23))/48 with 0.4 times the noise variance (frames = 6), or (2134 d01 - 116
    (d-10 + d12) + 9 (d-2-1 + d23))/1920, exact to the fifth degree (frames = 7).
    """
    at = np.ravel(at)
    out = np.empty((5, 2, 5, at.size))
    for n, some in enumerate(FRAMES_OF_PATH):
        value, rate = frame_weights(times, some, len(some) == frames == 6, at)
        if len(some) == 6:
            value = frame_weights(times, FRAMES_OF_PATH[3], at=at)[0]
        way, out[n, 1] = (np.cumsum(one[::-1], axis=0)[::-1][1:] for one in (value, rate))
        out[n, 0] = way - [[1], [1], [0], [0], [0]]
    return out


def five(steps: Sequence[Any]) -> list[Any]:
    """Return a list of five steps, made from one, three or five steps by adding None at each end."""
    missing = [None] * (2 - len(steps) // 2)
    return [*missing, *steps, *missing]


def read_path(
    splines: Sequence[Float | None],
    valid: Sequence[Mask | None],
    lattice: BlockLattice,
    X: Float,
    Y: Float,
    weights: Float,
) -> tuple[Float, NDArray[np.int64]]:
    """Return a tuple: the motion of the particles that are at pixels X, Y at mid-time, and the blocks read.

    The motion has the shape (6,) + X.shape, px; each pair of rows is along X, then Y. Rows 0, 1: dX/dt dt at
    mid-time. Rows 2, 3: displacement from frame to frame. Rows 4, 5: mean position in the step's two frames
    minus that at mid-time. The blocks, (5,) + X.shape, are flat indices in the five steps, -1 if a step was
    not read. `splines` are coefficients (ny, nx, 2), px, of one, three or five steps, None if missing;
    `valid` are masks of measured blocks; `weights` come from `path_weights`.
    """
    nodes = np.shape(X)
    weights = np.asarray(weights, np.float32)
    xs, ys = (np.ascontiguousarray(v, dtype=np.float32).ravel() for v in (X, Y))
    out, block = np.empty((6, xs.size), np.float32), np.empty((5, xs.size), np.int64)
    none, nothing = np.zeros(0, np.float32), np.zeros(0, np.bool_)
    bb, b, c, a, aa = (
        none if f is None else np.ascontiguousarray(f, np.float32).ravel() for f in five(splines)
    )
    has = [nothing if f is None else np.ascontiguousarray(f).ravel() for f in five(valid)]
    place = F(lattice.x0), F(lattice.y0), F(lattice.step)
    measured = has[0], has[1], has[3], has[4]
    _read_path((bb, b, c, a, aa), measured, lattice.shape, place, xs, ys, weights, out, block)
    return out.reshape(6, *nodes), block.reshape(5, *nodes)


@dataclass(frozen=True)
class CameraDisplacements:
    """Displacements, in the images of N cameras, of the particles that are at the nodes at mid-time."""

    jacobian: Float  # (2N, 3, ny, nx): px per metre
    moved: Float  # (2N, ny, nx): displacement per step at mid-time, px; NaN where not seen
    noise: Float  # (2N, ny, nx): variance due to noise, px^2
    missing: Float  # (2N, ny, nx): variance of waves that the prior suppresses, px^2
    rejected: NDArray[np.uint16]  # (N, ny, nx): bits of `Quality`: why not measured; `OUTSIDE` if not seen
    frames: NDArray[np.uint8]  # (ny, nx): positions along the paths: 2, 4 or 6, the fewest of all cameras
    chord: Float  # (2N, ny, nx): displacement over the step, px
    bend: Float  # (2N, ny, nx): mean position in the step's two frames minus that at mid-time, px
    axes: Float  # (N, 3): viewing direction of each camera over its distance from the field's middle, 1/m

    def without(self, n: int) -> CameraDisplacements:
        """Return these displacements without camera number n, counted from 0."""
        rows, cameras = [2 * n, 2 * n + 1], n
        of_rows = ("jacobian", "moved", "noise", "missing", "chord", "bend")
        parts = {name: np.delete(getattr(self, name), rows, axis=0) for name in of_rows}
        parts |= {name: np.delete(getattr(self, name), cameras, axis=0) for name in ("rejected", "axes")}
        return replace(self, **parts)


def displacements_at_nodes(
    names: Sequence[str],
    steps: Sequence[Flows | None],
    z: Float,
    geometry: GridGeometry,
    path_frames: int,
    times: Float,
    every: int = 1,
) -> CameraDisplacements:
    """Read the displacements in the images of cameras `names`, for particles at the nodes at mid-time.
    z (ny, nx) is the nodes' elevation, m; only every `every`-th node each way is used. `steps` are
    displacements by camera in 1, 3 or 5 successive steps; `times` (6,) of frames are in frame intervals."""
    z = z[::every, ::every]
    count, shape = len(names), z.shape
    jacobian = np.empty((2 * count, 3, *shape), np.float32)
    moved, chord, bend, noise, missing = np.empty((5, 2 * count, *shape), np.float32)
    rejected = np.empty((count, *shape), np.uint16)
    frames = np.full(shape, 6, np.uint8)
    axes = np.empty((count, 3))
    middle = np.array([np.mean(geometry.x), np.mean(geometry.y), 0.0])
    for n, name in enumerate(names):
        sight = geometry.sights[name]
        at = sight.at(z, every)
        visible = sight.sees(at[0], at[1])
        X, Y = np.where(visible, at[:2], np.float32(np.nan))
        path = [None if f is None else f.get(name) for f in steps]
        rows = slice(2 * n, 2 * n + 2)
        jacobian[rows] = at[2:].reshape(2, 3, *shape)
        delay = row_delay(name, geometry)
        late = delay * (np.nan_to_num(Y) - middle_row(sight)) if delay else 0.0
        weights = path_weights(times, path_frames, -late)
        found, block, noise[rows], missing[rows] = _along_path(path, sight, X, Y, weights)
        if delay:  # a particle that moves down is read later in the next frame: its interval is longer
            found[:2] /= 1.0 + delay * found[1]
        moved[rows], chord[rows], bend[rows] = found[:2], found[2:4], found[4:]
        axes[n] = sight.camera.R[2] / (sight.camera.R[2] @ middle + sight.camera.T[2])
        here = path[len(path) // 2]
        assert here is not None
        rejected[n] = np.where(visible, here.rejected.ravel()[block[2]], np.uint16(Quality.OUTSIDE))
        near, far = ((block[[2 - n, 2 + n]] >= 0).all(axis=0) for n in (1, 2))
        positions = (2 + 2 * near + 2 * far).astype(np.uint8)  # along each path
        frames = np.where(visible, np.minimum(frames, positions), frames)
    return CameraDisplacements(jacobian, moved, noise, missing, rejected, frames, chord, bend, axes)


def _along_path(
    path: Sequence[CameraFlow | None], sight: Sight, X: Float, Y: Float, weights: Float
) -> tuple[Float, NDArray[np.int64], Float, Float]:
    """Return a tuple for one camera: motion and blocks from `read_path` at X, Y, px, and two variances, px^2.
    The variances are due to noise, and due to waves that the prior suppresses. In `path`, the displacements
    in successive steps, missing steps are None."""
    here = path[len(path) // 2]
    assert here is not None
    splines = [None if f is None else f.spline for f in path]
    valid = [None if f is None else f.valid for f in path]
    d, block = read_path(splines, valid, sight.lattice, X, Y, weights)
    noises = [(here if f is None else f).noise for f in five(path)]
    flat = tuple(np.ascontiguousarray(one.reshape(len(one), -1)) for one in noises)
    variance = np.stack([noise_of_displacements(one) for one in weights[:, 1]]).astype(np.float32)
    noise = np.empty((len(here.noise), block[0].size), np.float32)
    _noise_along(flat, block.reshape(5, -1), variance, noise)
    missing = np.take(here.missing.reshape(len(here.missing), -1), block[2], axis=1)
    return d, block, noise.reshape(-1, *block.shape[1:]), missing


@compiled(error_model="numpy")
def _noise_along(noises: tuple[Float, ...], block: NDArray[np.int64], weights: Float, out: Float) -> None:
    """Write the noise variance of displacements along n paths to out (c, n), from the noise in five steps.
    `noises` are (c, blocks) for each step; `block` (5, n) are the blocks read, -1 if none. `weights` (5, 5,
    m) are for the cases of `FRAMES_OF_PATH` (axis 0) and the steps (axis 1)."""
    bb, b, c, a, aa = noises
    for k in range(block.shape[1]):
        before, after = block[1, k] >= 0, block[3, k] >= 0
        far = block[0, k] >= 0 and block[4, k] >= 0
        m = k if weights.shape[2] > 1 else 0
        w = weights[int(before) + 2 * int(after) + int(far), :, m]
        for i in range(len(out)):
            total = w[2] * c[i, block[2, k]]
            if before:
                total += w[1] * b[i, block[1, k]]
            if after:
                total += w[3] * a[i, block[3, k]]
            if far:
                total += w[0] * bb[i, block[0, k]] + w[4] * aa[i, block[4, k]]
            out[i, k] = total
