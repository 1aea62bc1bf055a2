"""Motion of the water at the nodes, by weighted least squares over the cameras."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.compiled import compiled
from wavefield.measurement.displacement import Flows
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.paths import CameraDisplacements, displacements_at_nodes
from wavefield.variables import Quality

Float = NDArray[Any]
Mask = NDArray[np.bool_]
Matrix = tuple[Any, Any, Any, Any, Any, Any]  # numbers in numba, whose arithmetic mypy does not follow

LEAST_PIVOT = 1e-9  # least pivot over its diagonal element at which the cameras determine all directions
MAX_MISFIT = 12.0  # largest median over the nodes of chi^2 per degree of freedom; above, cameras contradict
MAX_NODE_MISFIT = 3 * MAX_MISFIT  # the same for a single node
MIN_NODES = 50  # fewest nodes for a median

njit = compiled(error_model="numpy", fastmath={"contract", "reassoc"})


@njit
def _row(jacobian: Float, i: int, k: int) -> tuple[Any, Any, Any]:
    """Return the three elements of row i of a Jacobian (2N, 3, n) at node k, in double precision."""
    return np.float64(jacobian[i, 0, k]), np.float64(jacobian[i, 1, k]), np.float64(jacobian[i, 2, k])


@njit
def _factored(a: Any, b: Any, c: Any, d: Any, e: Any, f: Any) -> Matrix:
    """Factorise the matrix [[a, b, c], [b, d, e], [c, e, f]] as L D L^T, with the pivots a, d1, f1.
    Returns 1/a, b/a, c/a, 1/d1, e1/d1, 1/f1. The last is NaN if cameras do not determine all unknowns."""
    lb, lc = b / a, c / a
    d1, e1 = d - b * lb, e - b * lc
    le = e1 / d1
    f1 = f - c * lc - e1 * le
    determined = d1 > LEAST_PIVOT * d and f1 > LEAST_PIVOT * f
    return 1.0 / a, lb, lc, 1.0 / d1, le, 1.0 / f1 if determined else np.nan


@njit
def _solved(matrix: Matrix, p: Any, q: Any, r: Any) -> tuple[Any, Any, Any]:
    """Return the three unknowns for the right side (p, q, r); `matrix` comes from `_factored`."""
    a, b, c, d, e, f = matrix
    q1 = q - b * p
    z = (r - c * p - e * q1) * f
    y = q1 * d - e * z
    return p * a - b * y - c * z, y, z


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
    """Solve for the motion of the water at n nodes, seen by N cameras, and write it to out (16, n).

    Rows 0-2: displacement d at mid-time, per step. Rows 3-5: displacement from frame to frame. Rows 6-8: mean
    position in both frames minus that at mid-time. Rows 9-11: variance of d due to noise. Row 12: variance of
    suppressed waves over `parts` (3,), the relative variances of u, v, w. Row 13: misfit |J d - moved| /
    sqrt(2N), px. Row 14: chi^2 per degree of freedom. Row 15: factor (at least 1) on the noise variance due
    to chi^2. `jacobian` is (2N, 3, n), `axes` (N, 3), other fields (2N, n), as in `CameraDisplacements`.
    """
    rows, n = moved.shape
    weight = np.empty(rows)
    for k in range(n):
        a = b = c = d = e = f = 0.0
        px = py = pz = qx = qy = qz = 0.0
        removed = total = cameras = 0.0
        for i in range(rows):
            first, second = i - i % 2, i - i % 2 + 1  # rows of this camera along X and Y
            seen = np.isfinite(moved[first, k]) and np.isfinite(moved[second, k])
            n0, n1, m0, m1 = noise[first, k], noise[second, k], missing[first, k], missing[second, k]
            w = 2.0 / np.float64(n0 + n1 + m0 + m1) if seen else 0.0
            weight[i] = w
            x, y, z = _row(jacobian, i, k)
            wx, wy, wz = w * x, w * y, w * z
            a, b, c = a + wx * x, b + wx * y, c + wx * z
            d, e, f = d + wy * y, e + wy * z, f + wz * z
            s = w * np.float64(moved[i, k]) if seen else 0.0
            t = w * np.float64(chord[i, k]) if seen else 0.0
            px, py, pz = px + x * s, py + y * s, pz + z * s
            qx, qy, qz = qx + x * t, qy + y * t, qz + z * t
            if i == second and seen:
                size = 0.0
                for m in range(3):
                    size += parts[m] * np.float64(jacobian[first, m, k] ** 2 + jacobian[i, m, k] ** 2)
                removed += w * np.sqrt(np.float64(m0 + m1) * size)
                total += w * size
                cameras += 1.0
        matrix = _factored(a, b, c, d, e, f)
        dx, dy, dz = _solved(matrix, px, py, pz)
        cx, cy, cz = _solved(matrix, qx, qy, qz)
        px = py = pz = square = chi2 = vx = vy = vz = 0.0
        for i in range(rows):
            w = weight[i]
            x, y, z = _row(jacobian, i, k)
            # a point that moves away from the camera at constant speed slows down in the image
            away = axes[i // 2, 0] * cx + axes[i // 2, 1] * cy + axes[i // 2, 2] * cz
            steady = np.float32(np.float64(bend[i, k]) + 0.25 * away * np.float64(chord[i, k]))
            s = w * np.float64(steady) if w > 0.0 else 0.0
            px, py, pz = px + x * s, py + y * s, pz + z * s
            rest = np.float64(moved[i, k]) - (x * dx + y * dy + z * dz)
            rest = rest * rest if w > 0.0 else 0.0
            variance = np.float64(noise[i, k])
            square += rest
            chi2 += rest / variance
            gx, gy, gz = _solved(matrix, w * x, w * y, w * z)
            vx, vy, vz = vx + gx * gx * variance, vy + gy * gy * variance, vz + gz * gz * variance
        bx, by, bz = _solved(matrix, px, py, pz)
        out[0, k], out[1, k], out[2, k] = dx, dy, dz
        out[3, k], out[4, k], out[5, k] = cx, cy, cz
        out[6, k], out[7, k], out[8, k] = bx, by, bz
        out[9, k], out[10, k], out[11, k] = vx, vy, vz
        ok, freedom = dx == dx and cameras > 1.0, 2.0 * cameras - 3.0
        out[12, k] = (removed / max(total, 1e-30)) ** 2
        out[13, k] = np.sqrt(square / (2.0 * cameras)) if ok else np.nan
        out[14, k] = chi2 / freedom if ok else np.nan
        # one pseudo-observation shrinks chi^2 towards 1
        out[15, k] = max((1.0 + chi2) / (1.0 + freedom), 1.0) if ok else np.nan


_NODES_FOR_MEAN_FLOW = 500  # about as many nodes suffice for a median


@dataclass(frozen=True)
class Motion:
    """Motion of the particles that are at the nodes at mid-time; displacements are per step."""

    d: Float  # (3, ny, nx): dx, dy, dz at mid-time, metres; NaN where fewer than two cameras see the node
    noise: Float  # (3, ny, nx): variance of d due to noise, m^2
    missing: Float  # (3, ny, nx): variance of waves that the prior suppresses, m^2
    eps_piv: Float  # (ny, nx): rms misfit of the displacements in the images, px
    misfit: Float  # (ny, nx): chi^2 of this misfit per degree of freedom; NaN as d
    noise_factor: Float  # (ny, nx): factor on `noise` due to the misfit, at least 1; NaN as d
    # (ny, nx): bits of `Quality`: why the displacement of a camera was rejected; `FILLED` where fewer than
    # two cameras measured or they contradict each other; `TWO_FRAME_MEAN` for paths through fewer than four
    # frames
    quality: NDArray[np.uint16]
    frames: NDArray[np.uint8]  # (ny, nx): positions along the paths: 2, 4 or 6, the fewest of all cameras
    chord: Float  # (3, ny, nx): displacement over the step, metres
    bend: Float  # (3, ny, nx): mean position in the step's two frames minus that at mid-time, metres
    left_out: str | None = None  # the camera that contradicted the others, which agree without it


def velocity(
    steps: Sequence[Flows | None],
    z: Float,
    geometry: GridGeometry,
    path_frames: int,
    times: Float,
    may_leave_out: bool = True,
) -> Motion | None:
    """Compute the motion of the water at the nodes at mid-time, by least squares over the cameras.

    The motion d minimises sum w |J d - dX|^2, with weights w, the 2N x 3 Jacobian J of N cameras on the
    surface z (ny, nx), metres, and the image velocity per step dX (`read_path`). `steps` are displacements by
    camera in one, three or five successive steps; d belongs to the middle one. Noise is independent between
    cameras; suppression by the prior is common to all. With `may_leave_out`, a camera that contradicts the
    others is left out. None if fewer than two cameras have displacements in the middle step.
    """
    names = _cameras(steps)
    if len(names) < 2:
        return None
    displacements = displacements_at_nodes(names, steps, z, geometry, path_frames, times)
    parts = geometry.wave_variances
    motion = solve_motion(displacements, parts)
    measured = (displacements.rejected == 0).all(axis=0)

    @cache
    def by_others(n: int) -> Motion:
        return solve_motion(displacements.without(n), parts)

    outlier = None
    if may_leave_out:
        typical = median_misfit(motion.misfit, measured)
        outlier = outlier_camera(len(names), typical, lambda n: median_misfit(by_others(n).misfit, measured))
    if outlier is not None:
        motion = replace(by_others(outlier), left_out=names[outlier])
    # if cameras contradict each other and no single one explains it, nodes that agree do so by chance
    explained = outlier is not None or median_misfit(motion.misfit, measured) <= MAX_MISFIT
    against = motion.misfit > (MAX_NODE_MISFIT if explained else 0.0)
    rejected = np.where(against, np.uint16(Quality.REJECTED_EPS | Quality.FILLED), np.uint16(0))
    return replace(motion, quality=motion.quality | rejected)


def outlier_camera(n_cameras: int, misfit: float, misfit_without: Callable[[int], float]) -> int | None:
    """Return the index of the only camera without which the others agree; None if there is not exactly one.

    `misfit` is the median chi^2 per degree of freedom with all cameras, `misfit_without(n)` without camera n.
    Of three cameras in a line, one that has moved along this line is not found: any two agree.
    """
    if n_cameras < 3 or not misfit > MAX_MISFIT:
        return None
    limit = min(MAX_MISFIT, 0.1 * misfit)
    explain = [n for n in range(n_cameras) if misfit_without(n) < limit]
    return explain[0] if len(explain) == 1 else None


def median_misfit(misfit: Float, measured: Mask) -> float:
    """Return the median of the misfit (ny, nx) over `measured` nodes; 0 if there are fewer than MIN_NODES."""
    good = measured & np.isfinite(misfit)
    return float(np.median(misfit[good])) if good.sum() >= MIN_NODES else 0.0


def mean_flow(
    steps: Sequence[Flows | None],
    z: Float,
    geometry: GridGeometry,
    path_frames: int,
    times: Float,
) -> tuple[float, float] | None:
    """Return the median displacement (dx, dy) of the water per step, metres, over a part of the nodes.
    It is (0, 0) if no node was measured, and None if fewer than two cameras have displacements."""
    names = _cameras(steps)
    if len(names) < 2:
        return None
    every = max(1, round(np.sqrt(z.size / _NODES_FOR_MEAN_FLOW)))
    displacements = displacements_at_nodes(names, steps, z, geometry, path_frames, times, every)
    chord = solve_motion(displacements, geometry.wave_variances).chord
    measured = np.isfinite(chord).all(axis=0)
    if not measured.any():
        return 0.0, 0.0
    return float(np.median(chord[0][measured])), float(np.median(chord[1][measured]))


def _cameras(steps: Sequence[Flows | None]) -> list[str]:
    """Return the names of the cameras with a displacement in the middle step of `steps`."""
    return list(steps[len(steps) // 2] or {})


def solve_motion(displacements: CameraDisplacements, parts: Float) -> Motion:
    """Compute the motion of the water by least squares; `parts` (3,) are `GridGeometry.wave_variances`."""
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


def image_variance(displacements: CameraDisplacements, parts: Float) -> Float:
    """Return the variance of displacements in each image, (N, ny, nx), px^2, averaged over X and Y.
    The motion of the water that causes them has the component variances `parts` (3,), m^2."""
    square = np.einsum("kiyx,i->kyx", np.square(displacements.jacobian), parts)
    return np.asarray(0.5 * (square[::2] + square[1::2]))
