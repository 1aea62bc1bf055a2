"""Poses of a calibration target, and its images in the cameras."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from wavefield.compiled import compiled
from wavefield.rig import Camera
from wavefield.tank.scene_parts import Chessboard, Dots, Strings

Array = NDArray[np.float64]

SHARES_OF_OFFSET = (1.0, 0.8, 0.6, 0.4, 0.2, 0.0)  # parts of a board's offset, tried until it is in view


@dataclass(frozen=True)
class Pose:
    """Position and orientation of a target: the point p of the target is at ``rotation @ p + origin``."""

    rotation: Array  # (3, 3): From the axes of the target to those of the world
    origin: Array  # (3,): Position of the target's origin, metres


def poses(number: int, tilt: float, x: tuple[float, float], y: tuple[float, float], seed: int) -> list[Pose]:
    """Return `number` random poses of a target in the field with limits x and y, m.
    Each is tilted in another direction, by at most `tilt` degrees."""
    rng = np.random.default_rng([seed, 8])
    size = min(x[1] - x[0], y[1] - y[0])
    out = []
    for i in range(number):
        towards = 2 * np.pi * (i + rng.uniform(-0.2, 0.2)) / number + 0.4
        angle = np.radians(tilt) * rng.uniform(0.8, 1.0)
        about_x, about_y = angle * np.sin(towards), 0.75 * angle * np.cos(towards)
        turn = np.radians(rng.uniform(-8, 8))
        centre = np.array([rng.uniform(-0.08, 0.08) * size, rng.uniform(-0.08, 0.08) * size, 0.0])
        centre += [0.5 * (x[0] + x[1]), 0.5 * (y[0] + y[1]), (0.02 + 0.22 * i / max(number - 1, 1)) * size]
        rotation = Rotation.from_euler("XYZ", [about_x, about_y, turn]).as_matrix()
        out.append(Pose(rotation, centre))
    return out


def move_into_view(pose: Pose, board: Chessboard | Dots, middle: Array, cameras: Iterable[Camera]) -> Pose:
    """Return the pose of a board, moved towards `middle` (3,), m, until all cameras see the whole board.
    If that is impossible, the pose is returned unchanged."""
    # the corners of a chessboard can only be numbered if all of it is visible
    around = 1.5 if isinstance(board, Chessboard) else 0.5  # the outer squares and half a white one
    half = ((np.array(board.shape) - 1) / 2 + around) * board.mesh
    corners = np.array([(sx, sy, 0.0) for sx in (-1, 1) for sy in (-1, 1)]) * (*half, 0.0)
    for share in SHARES_OF_OFFSET:
        moved = replace(pose, origin=middle + share * (pose.origin - middle))
        x, y, z = (corners @ moved.rotation.T + moved.origin).T
        if all(camera.sees(x, y, z).all() for camera in cameras):
            return moved
    return pose


BAND_ROWS = 128  # image rows drawn at a time; more would need up to 0.4 GB more
FRAME_WIDTH = 0.04  # width of the frame that holds the strings, m
FRAME_SHADE = 0.35  # brightness of this frame relative to that of the strings

# Gauss-Legendre quadrature over a pixel, (9, 3): column, row, weight
_POINTS, _WEIGHTS = (values / 2 for values in np.polynomial.legendre.leggauss(3))
_QUADRATURE = np.stack(
    [np.repeat(_POINTS, 3), np.tile(_POINTS, 3), np.multiply.outer(_WEIGHTS, _WEIGHTS).ravel()], axis=1
)


def draw(camera: Camera, target: Strings | Chessboard | Dots, pose: Pose, blur: float) -> NDArray[np.float32]:
    """Return the image of a target (row, column), in grey levels of 255, without background or noise.
    `blur` is the standard deviation of a point's image, px."""
    # seen from a camera in the target's own axes, the target is the plane z = 0
    own = replace(camera, rotation=camera.R @ pose.rotation, translation=camera.R @ pose.origin + camera.T)
    width, height = camera.size
    columns = np.arange(-1.0, width + 1)  # one more on each side, for the derivatives
    bands = []
    if isinstance(target, Strings):
        marks = np.array([[0, 0, target.origin_disc], [1, 0, target.x_disc]]) / [1, 1, 2 * target.mesh]
        frame = np.array([target.half + 0.5, FRAME_WIDTH / target.mesh, FRAME_SHADE])
    for top in range(0, height, BAND_ROWS):
        rows = np.arange(top - 1.0, min(top + BAND_ROWS, height) + 1)
        s, t = (a / target.mesh for a in own.unproject(columns, rows[:, None]))
        if isinstance(target, Strings):
            bands.append(_strings(s, t, target.width / target.mesh, marks, frame, blur, _QUADRATURE))
        else:
            nx, ny = target.shape
            s, t = s + (nx - 1) / 2, t + (ny - 1) / 2
            if isinstance(target, Dots):
                radius = target.diameter / 2 / target.mesh
                bands.append(_dots(s, t, nx, ny, radius, blur, _QUADRATURE))
            else:
                bands.append(_chessboard(s, t, nx, ny, blur, _QUADRATURE))
    return np.concatenate(bands) * np.float32(target.brightness)


@compiled()
def _step(d: float, blur: float) -> float:
    """Return the brightness, 0 to 1, at the distance d, px, inside a straight blurred edge.
    d is negative outside; `blur` is the standard deviation of the blur, px."""
    if d > 4.5 * blur:
        return 1.0
    if d < -4.5 * blur:
        return 0.0
    return 0.5 * (1.0 + math.erf(d / (1.4142135623730951 * blur)))


@compiled()
def _disc(
    ds: float, dt: float, radius: float, sx: float, sy: float, tx: float, ty: float, blur: float
) -> float:
    """Return the brightness, 0 to 1, of a blurred disc at (ds, dt) from its centre, in the units of `radius`.
    sx, sy and tx, ty are the derivatives of ds and of dt by column and row; `blur` is in px."""
    r = math.hypot(ds, dt)
    if r < 1e-12:
        return 1.0
    slope = math.hypot((ds * sx + dt * tx) / r, (ds * sy + dt * ty) / r)
    # blurring a curved edge would enlarge the disc; the second term keeps its area
    return _step((radius - r) / slope - 0.5 * blur * blur * slope / radius, blur)


@compiled()
def _slopes(a: Array, i: int, j: int) -> tuple[float, float]:
    """Return the derivatives by column and by row of an array at the pixel (i, j) of an image.
    The array has a border of one pixel around the image."""
    return 0.5 * (a[i + 1, j + 2] - a[i + 1, j]), 0.5 * (a[i + 2, j + 1] - a[i, j + 1])


@compiled()
def _strings(
    s: Array, t: Array, width: float, marks: Array, frame: Array, blur: float, quadrature: Array
) -> NDArray[np.float32]:
    rows, columns = s.shape[0] - 2, s.shape[1] - 2
    out = np.zeros((rows, columns), np.float32)
    edge, thickness, shade = frame
    for i in range(rows):
        for j in range(columns):
            s0, t0 = s[i + 1, j + 1], t[i + 1, j + 1]
            sx, sy = _slopes(s, i, j)
            tx, ty = _slopes(t, i, j)
            gs, gt = math.hypot(sx, sy), math.hypot(tx, ty)
            near = 4.5 * blur + 1.0
            outer = max(abs(s0), abs(t0))
            if not outer < edge + thickness + near * max(gs, gt):
                continue  # beyond the frame, or not a number
            on = (
                abs(s0 - round(s0)) < 0.5 * width + near * gs or abs(t0 - round(t0)) < 0.5 * width + near * gt
            )
            on = on or outer > edge - near * max(gs, gt)
            for m in range(marks.shape[0]):
                far = marks[m, 2] + near * (gs + gt)
                on = on or (abs(s0 - marks[m, 0]) < far and abs(t0 - marks[m, 1]) < far)
            if not on:
                continue
            total = 0.0
            for p, q, weight in quadrature:
                u, v = s0 + p * sx + q * sy, t0 + p * tx + q * ty
                du, dv = abs(u - round(u)) / gs, abs(v - round(v)) / gt
                hu, hv = 0.5 * width / gs, 0.5 * width / gt
                dark = 1.0 - (_step(hu - du, blur) - _step(-hu - du, blur))
                dark *= 1.0 - (_step(hv - dv, blur) - _step(-hv - dv, blur))
                inside = _step((edge - abs(u)) / gs, blur) * _step((edge - abs(v)) / gt, blur)
                dark = 1.0 - inside * (1.0 - dark)
                for m in range(marks.shape[0]):
                    dark *= 1.0 - _disc(u - marks[m, 0], v - marks[m, 1], marks[m, 2], sx, sy, tx, ty, blur)
                far = edge + thickness
                with_frame = _step((far - abs(u)) / gs, blur) * _step((far - abs(v)) / gt, blur)
                total += weight * (1.0 - dark + shade * (with_frame - inside))
            out[i, j] = total
    return out


@compiled()
def _dots(
    s: Array, t: Array, nx: int, ny: int, radius: float, blur: float, quadrature: Array
) -> NDArray[np.float32]:
    rows, columns = s.shape[0] - 2, s.shape[1] - 2
    out = np.zeros((rows, columns), np.float32)
    for i in range(rows):
        for j in range(columns):
            s0, t0 = s[i + 1, j + 1], t[i + 1, j + 1]
            if not (-1.0 < s0 < nx and -1.0 < t0 < ny):
                continue
            cs, ct = min(max(round(s0), 0), nx - 1), min(max(round(t0), 0), ny - 1)
            sx, sy = _slopes(s, i, j)
            tx, ty = _slopes(t, i, j)
            near = radius + (4.5 * blur + 1.0) * (math.hypot(sx, sy) + math.hypot(tx, ty))
            if math.hypot(s0 - cs, t0 - ct) > near:
                continue
            total = 0.0
            for p, q, weight in quadrature:
                u, v = s0 + p * sx + q * sy, t0 + p * tx + q * ty
                total += weight * _disc(u - cs, v - ct, radius, sx, sy, tx, ty, blur)
            out[i, j] = total
    return out


@compiled()
def _chessboard(s: Array, t: Array, nx: int, ny: int, blur: float, quadrature: Array) -> NDArray[np.float32]:
    rows, columns = s.shape[0] - 2, s.shape[1] - 2
    out = np.zeros((rows, columns), np.float32)
    for i in range(rows):
        for j in range(columns):
            s0, t0 = s[i + 1, j + 1], t[i + 1, j + 1]
            if not (-3.0 < s0 < nx + 2 and -3.0 < t0 < ny + 2):
                continue
            sx, sy = _slopes(s, i, j)
            tx, ty = _slopes(t, i, j)
            gs, gt = math.hypot(sx, sy), math.hypot(tx, ty)
            total = 0.0
            for p, q, weight in quadrature:
                u, v = s0 + p * sx + q * sy, t0 + p * tx + q * ty
                # +1 on dark squares, -1 on light ones; the sign turns at each inner corner line
                signs = 1.0
                for w, g, last in ((u, gs, nx - 1), (v, gt, ny - 1)):
                    line = min(max(round(w), 0), last)
                    side = 2.0 * _step((w - line) / g, blur) - 1.0
                    signs *= side if int(line) % 2 == 0 else -side
                # squares end one beyond the inner corners; a white margin of half a square follows
                board = _step((u + 1) / gs, blur) * _step((nx - u) / gs, blur)
                board *= _step((v + 1) / gt, blur) * _step((ny - v) / gt, blur)
                plate = _step((u + 1.5) / gs, blur) * _step((nx + 0.5 - u) / gs, blur)
                plate *= _step((v + 1.5) / gt, blur) * _step((ny + 0.5 - v) / gt, blur)
                total += weight * plate * (1.0 - board * (0.5 + 0.5 * signs) * 0.95)
            out[i, j] = total
    return out
