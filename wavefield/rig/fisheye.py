"""Fisheye lenses: the distance from the axis is a polynomial of the angle to it, and not of its tangent.

Kannala and Brandt (2006), with OpenCV's terms: theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6
+ k4 theta^8). Points may be more than 90 degrees off the axis.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Terms = tuple[float, float, float, float]

MAX_ANGLE = np.pi * (1 - 1e-6)  # rad: straight behind the camera every direction is one


def distort(x: Array, y: Array, z: Array, k: Terms) -> tuple[Array, Array]:
    """Distorted positions of points in a camera's frame, in focal lengths."""
    rho = np.hypot(x, y)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.where(rho > 0.0, _bent(np.arctan2(rho, z), k)[0] / rho, np.where(z > 0.0, 1.0 / z, np.nan))
    return x * scale, y * scale


def distort_jacobian(x: Array, y: Array, z: Array, k: Terms) -> Array:
    """Derivatives of `distort` with respect to the points, (..., 2, 3)."""
    x, y, z = np.broadcast_arrays(x, y, z)
    rho2 = x * x + y * y
    rho = np.sqrt(rho2)
    bent, slope = _bent(np.arctan2(rho, z), k)
    slope = slope / (rho2 + z * z)
    axial = rho2 <= 1e-24 * z * z
    rho2, rho = np.where(axial, 1.0, rho2), np.where(axial, 1.0, rho)
    scale = np.where(axial, slope * z, bent / rho)
    along = np.where(axial, 0.0, (slope * z - scale) / rho2)
    out = np.empty((*x.shape, 2, 3))
    out[..., 0, 0] = scale + along * x * x
    out[..., 0, 1] = out[..., 1, 0] = along * x * y
    out[..., 1, 1] = scale + along * y * y
    out[..., 0, 2], out[..., 1, 2] = -slope * x, -slope * y
    return out


def term_derivatives(x: Array, y: Array, z: Array) -> Array:
    """Derivatives of `distort` with respect to k1 to k4, (..., 2, 4)."""
    rho = np.hypot(x, y)
    powers = np.arctan2(rho, z)[..., None] ** np.array([3, 5, 7, 9])
    unit = np.stack([x, y], -1) / np.where(rho > 0.0, rho, 1.0)[..., None]
    out: Array = unit[..., :, None] * powers[..., None, :]
    return out


def directions(x: Array, y: Array, k: Terms) -> tuple[Array, Array, Array]:
    """Unit vectors towards distorted positions: the inverse of `distort`; NaN where no angle gives them."""
    rho = np.hypot(x, y)
    widest = widest_angle(k)
    inside = rho <= _bent(np.array(widest), k)[0]
    theta = np.minimum(rho, widest)
    for _ in range(30):  # Newton, kept where the polynomial rises
        bent, slope = _bent(theta, k)
        step = np.where(inside, (bent - rho) / np.maximum(slope, 1e-3), 0.0)
        theta = np.clip(theta - step, 0.0, widest)
        if not np.max(np.abs(step), initial=0.0) > 1e-15:
            break
    theta = np.where(inside, theta, np.nan)
    across = np.sin(theta) / np.where(rho > 0.0, rho, 1.0)
    return x * across, y * across, np.cos(theta)


def widest_angle(k: Terms) -> float:
    """Largest angle to the axis, rad, up to which pixels move outwards."""
    roots = np.roots([9 * k[3], 7 * k[2], 5 * k[1], 3 * k[0], 1.0])  # of theta^2
    turning = roots[(np.abs(roots.imag) < 1e-12 * np.abs(roots)) & (roots.real > 0.0)].real
    return float(min(np.sqrt(turning.min(initial=np.inf)), MAX_ANGLE))


def _bent(theta: Array, k: Terms) -> tuple[Array, Array]:
    """Distance from the axis in focal lengths, and its derivative with respect to the angle."""
    t = theta * theta
    bent = theta * (1.0 + t * (k[0] + t * (k[1] + t * (k[2] + t * k[3]))))
    slope = 1.0 + t * (3 * k[0] + t * (5 * k[1] + t * (7 * k[2] + t * 9 * k[3])))
    return bent, slope
