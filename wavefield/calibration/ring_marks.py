"""Three rings in place of dots of a grid: the origin, one further along x and one further along y."""

import cv2
import numpy as np
from scipy.ndimage import map_coordinates

from wavefield.calibration.points import Image, Nodes
from wavefield.calibration.smooth_map import map_of_nodes
from wavefield.calibration.target_lattice import TargetLattice, cross
from wavefield.errors import CalibrationError
from wavefield.rig.lens import Array

MIN_NEIGHBOURS = 3  # of the eight around a ring that are dots
RADII = np.arange(0.0, 0.46, 0.03)  # meshes, of the profile of a ring
ANGLES = 2 * np.pi * np.arange(24) / 24
MIN_RING = 0.35  # of the dots' contrast, all around
MAX_HOLE = 0.6  # of the brightness of the ring
MAX_OUTSIDE = 0.3  # of the dots' contrast, beyond the ring
CELL_MIDDLES = np.array([[-0.5, -0.5], [-0.5, 0.5], [0.5, -0.5], [0.5, 0.5]])


def find_rings(image: Image, lattice: TargetLattice) -> Nodes:
    """Nodes (n, 2) of bright rings in a lattice of bright dots, found as dots or as gaps of the lattice."""
    node, pixel = lattice.node, lattice.pixel
    filled = lattice.filled.astype(np.uint8)
    neighbours = cv2.filter2D(filled, -1, np.ones((3, 3)), borderType=cv2.BORDER_CONSTANT)
    first = node[0] - np.argwhere(lattice.filled)[0]
    places = np.argwhere((neighbours >= MIN_NEIGHBOURS) | (filled > 0)) + first
    smooth = map_of_nodes(node, pixel)

    def values_at(nodes: Array) -> Array:
        column, row = np.moveaxis(smooth(nodes.reshape(-1, 2)).reshape(nodes.shape), -1, 0)
        values: Array = map_coordinates(image, [row, column], order=1, mode="nearest")
        return values

    def ground(nodes: Array) -> Array:
        """Between the dots around each node: light is seldom even."""
        return np.asarray(np.median(values_at(nodes[:, None] + CELL_MIDDLES), axis=1))

    offset = RADII[:, None, None] * np.stack([np.cos(ANGLES), np.sin(ANGLES)], -1)
    at = node.astype(float)
    contrast = float(np.median(np.subtract(values_at(at), ground(at))))
    share = values_at(places[:, None, None] + offset) - ground(places.astype(float))[:, None, None]
    share = share / max(contrast, 1.0)
    profile = np.median(share, axis=2)
    closed = np.percentile(share, 10, axis=2).max(1) > MIN_RING
    hollow = profile[:, 0] < MAX_HOLE * profile.max(1)
    alone = profile[:, -1] < MAX_OUTSIDE
    return np.asarray(places[closed & hollow & alone])


def numbered_from_rings(node: Nodes, pixel: Array, rings: Nodes) -> Nodes:
    """Indices of nodes (n, 2) counted from the ring at the right angle, right-handed seen from above.
    CalibrationError unless the rings are three whose arms follow the rows and columns.
    """
    if len(rings) != 3:
        raise CalibrationError(
            f"{len(rings)} of the three rings that mark origin, x and y were found; all must be in view "
            "and in focus"
        )
    smooth = map_of_nodes(node, pixel)
    for k in range(3):
        origin, one, two = np.roll(rings, -k, 0)
        for x_arm, y_arm in ((one - origin, two - origin), (two - origin, one - origin)):
            x, y = np.sign(x_arm), np.sign(y_arm)
            slopes = smooth.slopes(origin[None])[0]
            along_axes = np.abs(x).sum() == np.abs(y).sum() == 1 and x @ y == 0
            if along_axes and cross(x @ slopes, y @ slopes) < 0:  # rows of images run downwards
                return np.asarray((node - origin) @ np.stack([x, y], -1))
    raise CalibrationError("the three rings do not stand at a right angle along the rows and columns of dots")
