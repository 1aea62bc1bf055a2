"""Size of a pixel on the water: the unit of errors."""

import numpy as np

from wavefield.errors import RigError
from wavefield.grid import Grid
from wavefield.rig.camera import Camera
from wavefield.rig.rig import Rig


def pixel_sides(camera: Camera, x: float, y: float) -> tuple[float, float]:
    """Shorter and longer side, metres, of a camera's pixel on the still water; RigError if not in view."""
    jacobian = camera.jacobian(x, y, 0.0)[:, :2]
    if not np.isfinite(jacobian).all():
        raise RigError("a camera does not see the middle of the grid: is the grid in its view?")
    most, least = np.linalg.svd(jacobian, compute_uv=False)
    return float(1.0 / most), float(1.0 / least)


def pixel_at(camera: Camera, x: float, y: float) -> float:
    """Size of a camera's pixel on the still water, metres: the side of a square of the same area."""
    return float(np.sqrt(np.prod(pixel_sides(camera, x, y))))


def pixel_size(rig: Rig, grid: Grid) -> float:
    """Size of a pixel on the water, metres: of the coarsest camera, in the middle of the grid."""
    x, y = float(np.mean(grid.x)), float(np.mean(grid.y))
    return max(pixel_at(camera, x, y) for camera in rig.cameras.values())
