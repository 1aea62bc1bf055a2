"""How large a pixel is on the water: the unit in which errors are told."""

import numpy as np

from wavefield.grid import Grid
from wavefield.rig import Rig


def pixel_size(rig: Rig, grid: Grid) -> float:
    """Size of a pixel on the water: of the camera that resolves least, in the middle of the grid.

    Parameters
    ----------
    rig : Rig
        The cameras.
    grid : Grid
        The nodes.

    Returns
    -------
    float
        Geometric mean over the two directions, m (the paper's rig: 1.8 mm).
    """
    x, y = float(np.mean(grid.x)), float(np.mean(grid.y))
    return max(
        float(1.0 / np.sqrt(abs(np.linalg.det(camera.jacobian(x, y, 0.0)[:, :2]))))
        for camera in rig.cameras.values()
    )
