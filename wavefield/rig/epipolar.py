"""What two cameras make of one point: its parallax, and the epipolar error, whatever the surface."""

import numpy as np
from numpy.typing import ArrayLike

from wavefield.rig.camera import Camera
from wavefield.rig.lens import Array
from wavefield.rig.rig import Rig


def parallax(rig: Rig, pair: tuple[str, str], x: ArrayLike, y: ArrayLike) -> Array:
    """How much further along x, y the second camera shows a point above still water, (2, ...), per height."""
    first, second = (rig[name].sight_line(x, y) for name in pair)
    return np.subtract(first, second)


def epipolar_distance(
    a: Camera, b: Camera, Xa: ArrayLike, Ya: ArrayLike, Xb: ArrayLike, Yb: ArrayLike
) -> Array:
    """Signed distance (n,) of matched pixels from the epipolar lines of their partners, px in image b.
    x_b^T E x_a over the length of its gradient with respect to distorted pixels of b.
    """
    xa = np.stack([*a.tangents(Xa, Ya), np.ones(np.shape(Xa))])
    Xb, Yb = np.asarray(Xb, float), np.asarray(Yb, float)
    xb = np.stack([*b.tangents(Xb, Yb), np.ones(np.shape(Xb))])
    R = b.R @ a.R.T
    t = b.T - R @ a.T
    line = np.cross(t, R @ xa, axis=0)  # in the tangents of b
    value = np.sum(xb * line, axis=0)
    # d(tangents)/d(pixels) of b by central differences: tangents are smooth in pixels
    h = 0.01
    gradient = [
        (line[0] * (p[0] - m[0]) + line[1] * (p[1] - m[1])) / (2 * h)
        for p, m in (
            (b.tangents(Xb + h, Yb), b.tangents(Xb - h, Yb)),
            (b.tangents(Xb, Yb + h), b.tangents(Xb, Yb - h)),
        )
    ]
    out: Array = value / np.hypot(*gradient)
    return out
