"""Projection by lens and sensor, with derivatives.

(xc, yc, zc) is a point in the frame of a camera, with zc along the optical axis. The lens distorts the
tangents (a, b) = (xc / zc, yc / zc). The sensor, which may be tilted (Scheimpflug), turns distorted tangents
into pixels. All terms are those of OpenCV.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# order of the terms of a lens in arrays (12,)
LENS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "tau_x", "tau_y", "skew")


def distort(a: Array, b: Array, k: tuple[float, float, float], p: tuple[float, float]) -> tuple[Array, Array]:
    """Return the tangents (a, b) after lens distortion.
    k = (k1, k2, k3) are the radial terms and p = (p1, p2) the tangential terms, as in OpenCV."""
    r2 = a * a + b * b
    radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[2]))
    x, y = a * radial, b * radial
    if p[0] != 0.0 or p[1] != 0.0:
        ab = 2.0 * a * b
        x = x + p[0] * ab + p[1] * (r2 + 2.0 * a * a)
        y = y + p[0] * (r2 + 2.0 * b * b) + p[1] * ab
    return x, y


def distort_jacobian(
    a: Array, b: Array, k: tuple[float, float, float], p: tuple[float, float]
) -> tuple[Array, Array, Array]:
    """Return the derivatives of the distorted tangents (x, y) = `distort`(a, b).
    The order is dx/da, dx/db (which equals dy/da), dy/db."""
    r2 = a * a + b * b
    radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[2]))
    slope = 2.0 * (k[0] + r2 * (2.0 * k[1] + r2 * 3.0 * k[2]))  # 2 d radial / d(r2)
    xa = radial + slope * a * a + 2.0 * p[0] * b + 6.0 * p[1] * a
    cross = slope * a * b + 2.0 * p[0] * a + 2.0 * p[1] * b
    yb = radial + slope * b * b + 6.0 * p[0] * b + 2.0 * p[1] * a
    return xa, cross, yb


def tilt_matrix(tau_x: complex, tau_y: complex) -> NDArray[np.complex128]:
    """Return the homography (3, 3) of a tilted sensor, as in OpenCV's CALIB_TILTED_MODEL.
    The tilts tau_x and tau_y, rad, may be complex, for derivatives by a complex step."""
    cx, sx, cy, sy = np.cos(tau_x), np.sin(tau_x), np.cos(tau_y), np.sin(tau_y)
    about_y = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]], complex)
    about_x = np.array([[1, 0, 0], [0, cx, sx], [0, -sx, cx]], complex)
    rot = about_y @ about_x
    onto: NDArray[np.complex128] = (
        np.array([[rot[2, 2], 0, -rot[0, 2]], [0, rot[2, 2], -rot[1, 2]], [0, 0, 1]]) @ rot
    )
    return onto


def apply_homography(h: Array, x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Map points x, y by a homography h (3, 3).
    Returns the new x, the new y, and the denominator by which they were divided."""
    s = h[2, 0] * x + h[2, 1] * y + h[2, 2]
    return (h[0, 0] * x + h[0, 1] * y + h[0, 2]) / s, (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / s, s


def project(lens: Array, points: Array) -> tuple[Array, Array, Array]:
    """Project points (n, 3), metres, given in the frame of a camera, onto the camera's sensor.
    `lens` (12,) holds the terms in the order of `LENS`. Returns pixels (n, 2), their derivatives with respect
    to the points (n, 2, 3), px per metre, and their derivatives with respect to the lens terms (n, 2, 12)."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3, tau_x, tau_y, skew = lens.tolist()
    k, p = (k1, k2, k3), (p1, p2)
    zc = points[:, 2]
    a, b = points[:, 0] / zc, points[:, 1] / zc
    r2 = a * a + b * b
    u, v = distort(a, b, k, p)
    xa, cross, yb = distort_jacobian(a, b, k, p)
    by_tangent = np.stack([np.stack([xa, cross], -1), np.stack([cross, yb], -1)], -2)
    # sensor: pixel = K . tilt(u, v)
    h = tilt_matrix(tau_x, tau_y).real
    uv1 = np.stack([u, v, np.ones_like(u)])
    n = h @ uv1
    x, y = n[0] / n[2], n[1] / n[2]
    K = np.array([[fx, skew], [0.0, fy]])
    pixel = np.stack([x, y], -1) @ K.T + (cx, cy)

    def through_tilt(d: Array) -> Array:  # numerators' derivative (3, n) -> (n, 2) pixels
        moved: Array = np.stack([(d[0] - x * d[2]) / n[2], (d[1] - y * d[2]) / n[2]], -1) @ K.T
        return moved

    one = np.ones_like(u)
    by_u, by_v = through_tilt(h[:, :1] * one), through_tilt(h[:, 1:2] * one)
    by_ab = np.stack([by_u, by_v], -1) @ by_tangent
    by_point = np.empty((len(points), 2, 3))
    by_point[..., :2] = by_ab / zc[:, None, None]
    by_point[..., 2] = -(by_ab[..., 0] * a[:, None] + by_ab[..., 1] * b[:, None]) / zc[:, None]
    by_lens = np.zeros((len(points), 2, len(LENS)))
    by_lens[:, 0, 0], by_lens[:, 1, 1], by_lens[:, 0, 11] = x, y, y
    by_lens[:, 0, 2] = by_lens[:, 1, 3] = 1.0
    for column, du, dv in (
        (4, a * r2, b * r2),
        (5, a * r2**2, b * r2**2),
        (6, 2.0 * a * b, r2 + 2.0 * b * b),
        (7, r2 + 2.0 * a * a, 2.0 * a * b),
        (8, a * r2**3, b * r2**3),
    ):
        by_lens[..., column] = by_u * du[:, None] + by_v * dv[:, None]
    step = 1e-30  # complex-step derivative, exact to rounding
    by_lens[..., 9] = through_tilt((tilt_matrix(tau_x + 1j * step, tau_y).imag / step) @ uv1)
    by_lens[..., 10] = through_tilt((tilt_matrix(tau_x, tau_y + 1j * step).imag / step) @ uv1)
    return pixel, by_point, by_lens


def rotation_about(vector: ArrayLike) -> Array:
    """Return the rotation matrix (3, 3) of a rotation vector (3,), rad (Rodrigues' formula)."""
    x, y, z = np.asarray(vector, float)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = float(np.sqrt(x * x + y * y + z * z))
    half = 0.5 * angle
    # sinc avoids a division by zero
    turn: Array = np.eye(3) + np.sinc(angle / np.pi) * cross
    turn += 0.5 * np.sinc(half / np.pi) ** 2 * cross @ cross
    return turn
