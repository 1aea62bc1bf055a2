"""The field that all cameras of a rig see, and the size of their pixels on the water."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from wavefield.errors import RigError
from wavefield.grid import Grid, largest_rectangle
from wavefield.rig.camera import Camera
from wavefield.rig.rig import Rig

HORIZON_SAMPLES = 65  # sampled pixels along each side of an image that shows the horizon
MAX_DISTANCE_RATIO = 3.0  # of the farthest to the nearest water; beyond it pixels are too coarse
DEFAULT_HEIGHT = 0.01  # of the nearest camera's distance: half of the default search range of z
CORNER_CANDIDATES = 401  # along each axis, so that the rectangle is accurate to 0.25 %


def common_field(
    cameras: Iterable[Camera],
    step: float | None = None,
    height: float | tuple[float, float] | None = None,
    margin: float = 16.0,
) -> Grid:
    """Make a grid on the largest rectangle of the water that every camera sees.

    Parameters
    ----------
    cameras : iterable of Camera
        The cameras that must see every node.
    step : float, optional
        Distance between nodes, metres. By default four pixels of the coarsest camera, rounded up to 1, 2 or
        5 times a power of ten.
    height : float or (float, float), optional
        Largest elevation up and down, or the lowest and the highest elevation, metres. Water between these
        elevations stays in view. The default is 1 % of the distance of the nearest camera.
    margin : float, default 16
        Smallest distance from the images' edges, px.

    Returns
    -------
    Grid
        Nodes at whole multiples of the step, in a rectangle with sides along x and y.

    Raises
    ------
    RigError
        If the cameras have no common field, or one narrower than one step.

    Examples
    --------
    >>> from wavefield.rig import Camera
    >>> down = Camera(1000, 1000, 499.5, 499.5, ((1, 0, 0), (0, -1, 0), (0, 0, -1)), (0, 0, 4), (1000, 1000))
    >>> common_field([down], height=0.0, margin=0.0)
    Grid(x=(-1.98, 1.98), y=(-1.98, 1.98), step=0.02)
    """
    cameras = list(cameras)
    views = [view_on_water(camera) for camera in cameras]
    lo = np.max([points.min(axis=0) for points in views], axis=0)
    hi = np.min([points.max(axis=0) for points in views], axis=0)
    if not (hi > lo).all():
        raise RigError("the cameras have no common field at z = 0: is it the right rig for these images?")
    if height is None:
        middle = np.array([*(0.5 * (lo + hi)), 0.0])
        height = DEFAULT_HEIGHT * min(float(np.linalg.norm(camera.centre - middle)) for camera in cameras)
    elevations = height if isinstance(height, tuple) else (-height, height)
    x, y = np.linspace(lo[0], hi[0], CORNER_CANDIDATES), np.linspace(lo[1], hi[1], CORNER_CANDIDATES)
    visible = np.ones((CORNER_CANDIDATES, CORNER_CANDIDATES), bool)
    for camera in cameras:
        for z in set(elevations):
            visible &= camera.sees(x[None, :], y[:, None], z, margin)
    (y0, y1), (x0, x1) = largest_rectangle(visible)
    y1, x1 = y1 - 1, x1 - 1
    if step is None:
        centre = 0.5 * (x[x0] + x[x1]), 0.5 * (y[y0] + y[y1])
        step = _round_up(4.0 * max(pixel_sides(camera, *centre)[1] for camera in cameras))
    ends = []
    for first, last in ((x[x0], x[x1]), (y[y0], y[y1])):
        # both ends are visible, and so are whole multiples between them
        nodes = np.ceil(first / step - 1e-9), np.floor(last / step + 1e-9)
        if nodes[1] - nodes[0] < 1:
            raise RigError(f"the cameras' common field is narrower than one grid step of {step} m")
        ends.append((round(float(nodes[0] * step), 9), round(float(nodes[1] * step), 9)))
    return Grid(ends[0], ends[1], step)


def view_on_water(camera: Camera) -> NDArray[np.float64]:
    """Return points (x, y) on z = 0, (n, 2), metres, that span the view of a camera.
    They are the four corners of the image, or samples of the near water if the camera sees the horizon.
    RigError if the camera sees no water."""
    corners = camera.corners()
    if np.isfinite(corners).all():
        return corners
    pixel = [np.linspace(0.0, n - 1.0, HORIZON_SAMPLES) for n in camera.size]
    x, y = camera.unproject(*np.meshgrid(*pixel))
    distance = np.sqrt((x - camera.centre[0]) ** 2 + (y - camera.centre[1]) ** 2 + camera.centre[2] ** 2)
    visible = np.isfinite(distance)
    if not visible.any():
        raise RigError("a camera does not see the water: is z = 0 its level, and z up?")
    visible &= distance < MAX_DISTANCE_RATIO * distance[visible].min()
    return np.stack([x[visible], y[visible]], axis=-1)


def _round_up(length: float) -> float:
    """Round a length up to 1, 2, 5 or 10 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(round(power * next(m for m in (1, 2, 5, 10) if m * power >= length * (1 - 1e-9)), 12))


def pixel_sides(camera: Camera, x: float, y: float) -> tuple[float, float]:
    """Return the shorter and the longer side, metres, of a camera's pixel projected to (x, y) on still water.
    RigError if the point is not in front of the camera."""
    jacobian = camera.jacobian(x, y, 0.0)[:, :2]
    if not np.isfinite(jacobian).all():
        raise RigError("a camera does not see the middle of the grid: is the grid in its view?")
    most, least = np.linalg.svd(jacobian, compute_uv=False)
    return float(1.0 / most), float(1.0 / least)


def pixel_at(camera: Camera, x: float, y: float) -> float:
    """Return the size, metres, of a camera's pixel projected to (x, y) on the water: the root of its area."""
    return float(np.sqrt(np.prod(pixel_sides(camera, x, y))))


def pixel_size(rig: Rig, grid: Grid) -> float:
    """Return the largest size, metres, of any camera's pixel projected to the middle of the grid."""
    x, y = float(np.mean(grid.x)), float(np.mean(grid.y))
    return max(pixel_at(camera, x, y) for camera in rig.cameras.values())
