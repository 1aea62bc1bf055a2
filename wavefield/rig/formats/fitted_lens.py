"""A lens of other terms than ours, fitted over the whole image by one that has ours."""

from typing import Any

import numpy as np

from wavefield.errors import RigError
from wavefield.rig.lens import Array, apply_homography, distort, tilt_matrix
from wavefield.rig.rotation import rotation_about

MAX_MISFIT_PX = 0.2  # of a fitted lens, anywhere in the image
SAMPLES = 25  # of the image along each side

Terms = dict[str, Any]  # of a `Camera`: fx, fy, cx, cy, k1, k2, p1, p2, k3, tau_x, tau_y, skew


def image_lattice(size: tuple[int, int]) -> Array:
    """Pixels (n, 2) all over an image of a (width, height), up to its edges."""
    x, y = (np.linspace(0.0, side - 1.0, SAMPLES) for side in size)
    return np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)


def fit_lens(pixels: Array, tangents: Array) -> tuple[Terms, Array, float]:
    """Terms of a lens, rotation (3, 3) ahead of it, and misfit, px, of tangents (n, 2) onto pixels (n, 2).
    RigError if no lens of our terms fits to `MAX_MISFIT_PX`.
    """
    from scipy.optimize import least_squares  # a tenth of a second that no other rig needs

    middle = pixels.mean(0)
    focal = float(np.linalg.norm(np.ptp(pixels, 0)) / np.linalg.norm(np.ptp(tangents, 0)))
    points = np.column_stack([tangents, np.ones(len(tangents))])

    def misfit(p: Array) -> Array:
        a, b, c = rotation_about(p[12:]) @ points.T
        x, y = distort(a / c, b / c, (p[4], p[5], p[8]), (p[6], p[7]))
        x, y, _ = apply_homography(tilt_matrix(p[9], p[10]).real, x, y)
        X = focal * (1.0 + p[0]) * x + focal * p[11] * y + middle[0] + focal * p[2]
        Y = focal * (1.0 + p[1]) * y + middle[1] + focal * p[3]
        return np.concatenate([X - pixels[:, 0], Y - pixels[:, 1]])

    found = least_squares(misfit, np.zeros(15), method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    worst = float(np.abs(misfit(found)).max())
    if not worst <= MAX_MISFIT_PX:
        raise RigError(
            f"its lens model is not ours, and the nearest of ours misses it by {worst:.2g} px: "
            "calibrate again from its target points, as tables of points (docs/calibration.md)"
        )
    names = ("k1", "k2", "p1", "p2", "k3", "tau_x", "tau_y")
    terms = dict(zip(names, found[4:11].tolist(), strict=True))
    terms |= {"fx": focal * (1.0 + found[0]), "fy": focal * (1.0 + found[1]), "skew": focal * found[11]}
    terms |= {"cx": middle[0] + focal * found[2], "cy": middle[1] + focal * found[3]}
    return {name: float(value) for name, value in terms.items()}, rotation_about(found[12:]), worst
