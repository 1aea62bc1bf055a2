"""Motion of the water at the nodes by least squares over the cameras: one pass over all fields."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.compiled import compiled
from wavefield.measurement.displacement import Flows
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.outliers import (
    MAX_MISFIT,
    MAX_NODE_MISFIT,
    median_misfit,
    outlier_camera,
    outlier_regions,
)
from wavefield.measurement.paths import EVEN_TIMES, CameraDisplacements, displacements_at_nodes
from wavefield.measurement.settings import Settings
from wavefield.variables import Quality

Float = NDArray[Any]

LEAST_PIVOT = 1e-9  # of a diagonal: less, and the cameras do not determine a direction
NODES_AT_ONCE = 256  # whose sums stay in the cache

njit = compiled(error_model="numpy", fastmath={"contract", "reassoc"})


@njit
def _weigh(
    moved: tuple[Float, Float], noise: tuple[Float, Float], missing: tuple[Float, Float], w: Float
) -> None:
    """Inverse mean variance of the two components of one camera; 0 where it does not see the node."""
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
    """Factorize a normal matrix [[a, b, c], [b, d, e], [c, e, f]]: 1/a, b/a, c/a, 1/d1, e1/d1, 1/f1.
    NaN where the cameras do not determine a direction.
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
    """Add the squared misfit of one row, the same over its noise, and its part of the variance of d."""
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
    """Correct the bend for motion along the view: a receding point slows down in the image."""
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
    """Add the variance removed by the prior in one camera, and that of the water's motion in it; count it."""
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
    """Fill out (16, n): d, chord, bend, noise variance of d (3 each), variance by the prior over parts,
    eps = |J d - moved| / sqrt(2N), chi^2 / dof, and the factor on the noise where chi^2 exceeds its mean.
    Float32 jacobian (2N, 3, n), others (2N, n); float64 parts (3,) and axes (N, 3).
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


Regions = Mapping[str, NDArray[np.bool_]]

_OUTLIER_FRACTION = 0.8  # of the nodes: a camera that contradicts at so many is left out of the step
# Of u, v, w by deep-water waves in all directions: they move the water along as much as up and down.
WAVE_VARIANCES = np.array([0.5, 0.5, 1.0])
_MAX_INCONSISTENT_FRACTION = 0.01  # of the nodes, by chance
_NODES_FOR_MEAN_FLOW = 3000
_WINDOW_REACH_PX = 20  # half a window of the coarse levels


@dataclass(frozen=True)
class Motion:
    """Displacement per step of the surface water at the nodes, at mid-time."""

    d: Float  # (3, ny, nx): (dx, dy, dz), metres; NaN where fewer than two cameras see the node
    noise: Float  # (3, ny, nx): variance of d by noise, and of waves that the prior removes, m^2
    missing: Float
    eps_piv: Float  # (ny, nx): misfit of the cameras' displacements, px
    # (ny, nx): chi^2 of the misfit per degree of freedom; NaN where fewer than two cameras see the node
    misfit: Float
    noise_factor: (
        Float  # (ny, nx): factor on the variance of noise by the misfit, at least 1; NaN as the misfit
    )
    # (ny, nx): bits of `Quality`: why a camera's displacement was rejected; `FILLED` where not enough of them
    # were measured or they contradict each other; `TWO_FRAME_MEAN` where a path has fewer than four places
    quality: NDArray[np.uint16]
    frames: NDArray[np.uint8]  # (ny, nx): places of the paths: 2, 4 or 6, the fewest of all cameras'
    # (3, ny, nx): displacement over the step; mean of the places in its two frames less that at mid-time;
    # metres
    chord: Float
    bend: Float
    left_out: str | None = None  # the camera that contradicted the others, which agree without it
    regions: Regions = field(default_factory=dict)  # (ny, nx): the same in parts of the field

    @property
    def inconsistent(self) -> bool:
        """Whether cameras contradict each other over more than single nodes."""
        against = self.misfit[np.isfinite(self.misfit)] > MAX_MISFIT
        return bool(
            self.left_out or self.regions or against.sum() > _MAX_INCONSISTENT_FRACTION * against.size
        )


def velocity(
    steps: Sequence[Flows | None],
    z: Float,
    geometry: GridGeometry,
    path_frames: int,
    regions: Regions | None = None,
    times: Float = EVEN_TIMES,
) -> Motion | None:
    """Displacement per step of the surface water at the nodes, at mid-time.

    d = argmin sum w (J d - dX)^2, with J the 2N x 3 Jacobian at the position of the node on the surface z
    (ny, nx), metres, at mid-time, and dX the image velocity there (`read_path`). dX/dt = J dx/dt is exact,
    while displacements would also need the curvature of the projection. eps' = |J d - dX| / sqrt(2N).

    The noise of the cameras is independent. What the prior removes is the same in all cameras, so averaging
    does not reduce it; it is divided among the components (`component_variances`). Cameras are left out in
    given regions, or where they contradict the others. Times of the six frames are in intervals from mid-
    time.
    """
    names = _cameras(steps)
    if len(names) < 2:
        return None
    displacements = displacements_at_nodes(names, steps, z, geometry, path_frames, times)
    parts = component_variances(geometry.settings)
    motion = solve_motion(displacements, parts)
    measured = (displacements.rejected == 0).all(axis=0)

    @cache
    def by_others(n: int) -> Motion:
        return solve_motion(displacements.without(n), parts)

    def misfit_without(n: int) -> Float:
        return by_others(n).misfit

    outlier = None
    if regions is None:
        reach = max(1, round(_WINDOW_REACH_PX * geometry.pixel / geometry.grid.step))
        found = outlier_regions(motion.misfit, measured, len(names), misfit_without, reach)
        typical = median_misfit(motion.misfit, measured)
        outlier = outlier_camera(len(names), typical, lambda n: median_misfit(misfit_without(n), measured))
        if outlier in found and (found[outlier] & measured).sum() < _OUTLIER_FRACTION * measured.sum():
            outlier = None  # not everywhere
        regions = {names[n]: where for n, where in found.items()} if outlier is None else {}
    if outlier is not None:
        motion = replace(by_others(outlier), left_out=names[outlier])
    for name, where in regions.items():
        motion = _patched(motion, by_others(names.index(name)), where)
    motion = replace(motion, regions=regions)
    # where most contradict each other and no one camera explains it, some nodes agree by chance
    explained = outlier is not None or median_misfit(motion.misfit, measured) <= MAX_MISFIT
    against = motion.misfit > (MAX_NODE_MISFIT if explained else 0.0)
    rejected = np.where(against, np.uint16(Quality.REJECTED_EPS | Quality.FILLED), np.uint16(0))
    return replace(motion, quality=motion.quality | rejected)


def mean_flow(
    steps: Sequence[Flows | None],
    z: Float,
    geometry: GridGeometry,
    path_frames: int,
    times: Float = EVEN_TIMES,
) -> tuple[float, float] | None:
    """Median displacement of the water over the step, (dx, dy), metres, by all cameras at some nodes.
    None if fewer than two cameras have displacements.
    """
    names = _cameras(steps)
    if len(names) < 2:
        return None
    every = max(1, round(np.sqrt(z.size / _NODES_FOR_MEAN_FLOW)))
    displacements = displacements_at_nodes(names, steps, z, geometry, path_frames, times, every)
    chord = solve_motion(displacements, component_variances(geometry.settings)).chord
    measured = np.isfinite(chord).all(axis=0)
    if not measured.any():
        return 0.0, 0.0
    return float(np.median(chord[0][measured])), float(np.median(chord[1][measured]))


def _cameras(steps: Sequence[Flows | None]) -> list[str]:
    return list(steps[len(steps) // 2] or {})


def _patched(motion: Motion, other: Motion, where: NDArray[np.bool_]) -> Motion:
    """One motion, replaced by another in a part of the field."""
    names = (
        "d",
        "noise",
        "missing",
        "eps_piv",
        "misfit",
        "noise_factor",
        "quality",
        "frames",
        "chord",
        "bend",
    )
    return replace(motion, **{n: np.where(where, getattr(other, n), getattr(motion, n)) for n in names})


def solve_motion(displacements: CameraDisplacements, parts: Float) -> Motion:
    """Solve for the motion by least squares over the cameras.
    parts: relative variances of u, v, w that the prior removes (`component_variances`).
    """
    names = ("jacobian", "moved", "chord", "bend", "noise", "missing")
    fields = {name: np.ascontiguousarray(getattr(displacements, name), np.float32) for name in names}
    flat = [f.reshape(*f.shape[:-2], -1) for f in fields.values()]
    shape = displacements.frames.shape
    out = np.empty((16, displacements.frames.size), np.float32)
    solve_nodes(*flat, parts, displacements.axes, out)  # type: ignore[call-arg]
    d, chord, bend, noise = out[:12].reshape(4, 3, *shape)
    removed, eps, misfit, noise_factor = out[12:].reshape(4, *shape)
    accepted = (displacements.rejected == 0).sum(axis=0)
    why = np.bitwise_or.reduce(displacements.rejected & ~np.uint16(Quality.OUTSIDE), axis=0)
    quality = np.where(accepted >= 2, np.uint16(0), why | np.uint16(Quality.FILLED))
    quality |= np.where(displacements.frames < 4, np.uint16(Quality.TWO_FRAME_MEAN), np.uint16(0))
    return Motion(
        d=d,
        noise=noise,
        missing=parts.astype(np.float32)[:, None, None] * removed,
        eps_piv=eps,
        misfit=misfit,
        noise_factor=noise_factor,
        quality=quality,
        frames=displacements.frames,
        chord=chord,
        bend=bend,
    )


def component_variances(settings: Settings) -> Float:
    """Relative variances of u, v, w that the prior removes: those of waves, or equal in a light sheet."""
    return WAVE_VARIANCES if settings.sheet_thickness is None else np.ones(3)


def image_variance(displacements: CameraDisplacements, parts: Float) -> Float:
    """Variance in each camera's image, (N, ny, nx), px^2, of motion with component variances `parts`, m^2.
    Mean of both image components.
    """
    square = np.einsum("kiyx,i->kyx", np.square(displacements.jacobian), parts)
    return np.asarray(0.5 * (square[::2] + square[1::2]))
