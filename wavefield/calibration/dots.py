"""Find a grid of dots, with or without marks of the origin."""

import cv2
import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from wavefield.calibration.blobs import dot_centres, find_blobs, make_points, right_handed, shape_of
from wavefield.calibration.lattice import (
    Candidates,
    TargetLattice,
    cross,
    independent_pair,
    map_of_nodes,
    most_central,
)
from wavefield.calibration.points import Image, Mask, Nodes, TargetPoints
from wavefield.calibration.target import Target
from wavefield.errors import CalibrationError
from wavefield.rig.lens import Array

MIN_NEIGHBOURS = 3  # of the eight around a ring that are dots
RADII = np.arange(0.0, 0.46, 0.03)  # meshes, of the profile of a ring
ANGLES = 2 * np.pi * np.arange(24) / 24
MIN_RING = 0.35  # of the dots' contrast, all around
MAX_HOLE = 0.6  # of the brightness of the ring
MAX_OUTSIDE = 0.3  # of the dots' contrast, beyond the ring
CELL = np.arange(-0.4, 0.41, 0.025)  # meshes around an odd dot
MAX_AROUND = 0.15  # of the dots' contrast: ground
MIN_AROUND = 0.2  # of a cell
MIN_LEAD = 2.5  # of the odd dot over the next
MIN_EXCESS = 5e-4  # of the dots' contrast, mean around the dot
CELL_MIDDLES = np.array([[-0.5, -0.5], [-0.5, 0.5], [0.5, -0.5], [0.5, 0.5]])


class _Cells:
    """Brightness around the nodes of a lattice of bright dots, relative to the ground, in units of the dots'
    contrast. Nodes are dots, and gaps among dots.
    """

    def __init__(self, image: Image, lattice: TargetLattice) -> None:
        filled = lattice.filled.astype(np.uint8)
        self.neighbours = cv2.filter2D(filled, -1, np.ones((3, 3)), borderType=cv2.BORDER_CONSTANT)
        places = np.argwhere((self.neighbours >= MIN_NEIGHBOURS) | (filled > 0))
        self.neighbours = self.neighbours[tuple(places.T)] - filled[tuple(places.T)]
        self.places: Nodes = places + lattice.node[0] - np.argwhere(lattice.filled)[0]
        self._image, self._map = image, map_of_nodes(lattice.node, lattice.pixel)
        at = lattice.node.astype(float)
        self._contrast = max(float(np.median(self._at(at) - self._ground(at))), 1.0)

    def _at(self, nodes: Array) -> Array:
        column, row = np.moveaxis(self._map(nodes.reshape(-1, 2)).reshape(nodes.shape), -1, 0)
        values: Array = map_coordinates(self._image, [row, column], order=1, mode="nearest")
        return values

    def _ground(self, nodes: Array) -> Array:
        """Brightness between the dots around each node, because light is rarely uniform."""
        return np.asarray(np.median(self._at(nodes[:, None] + CELL_MIDDLES), axis=1))

    def share(self, offset: Array) -> Array:
        """Relative brightness at offsets (..., 2), in meshes, from each node: (n, ...)."""
        at = self.places.reshape(-1, *(1,) * (offset.ndim - 1), 2) + offset
        ground = self._ground(self.places.astype(float)).reshape(-1, *(1,) * (offset.ndim - 1))
        return np.asarray((self._at(at) - ground) / self._contrast)


def find_rings(image: Image, lattice: TargetLattice) -> Nodes:
    """Nodes (n, 2) of bright rings in a lattice of bright dots, found as dots or as gaps of the lattice."""
    cells = _Cells(image, lattice)
    share = cells.share(RADII[:, None, None] * np.stack([np.cos(ANGLES), np.sin(ANGLES)], -1))
    profile = np.median(share, axis=2)
    closed = np.percentile(share, 10, axis=2).max(1) > MIN_RING
    hollow = profile[:, 0] < MAX_HOLE * profile.max(1)
    alone = profile[:, -1] < MAX_OUTSIDE
    return np.asarray(cells.places[closed & hollow & alone])


def find_odd_dot(image: Image, lattice: TargetLattice) -> Nodes:
    """The node (2,) of the one dot with something around it: a box, a circle, a larger disc.
    CalibrationError where none stands out.
    """
    cells = _Cells(image, lattice)
    share = cells.share(np.stack(np.meshgrid(CELL, CELL), -1).reshape(-1, 2))
    usual = np.median(share, axis=0).reshape(len(CELL), -1)
    around = (cv2.dilate(usual, np.ones((5, 5))) < MAX_AROUND).ravel()  # what is ground in most cells
    if around.sum() < MIN_AROUND * around.size:
        raise CalibrationError("the dots leave too little between them to find one that is marked")
    excess = np.where(cells.neighbours == 8, np.maximum(share[:, around], 0).mean(1), 0.0)
    first, second = np.sort(excess - np.median(excess[cells.neighbours == 8]))[[-1, -2]]
    if not first > max(MIN_LEAD * second, MIN_EXCESS):
        raise CalibrationError(
            "no dot has a box or a circle around it, or is larger than all others; it must be in view, with "
            "the eight dots around it (origin_mark: odd dot)"
        )
    return np.asarray(cells.places[int(np.argmax(excess))])


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


MIN_DOTS = 9
MAX_SEEDS = 6
MIN_FULLNESS = 0.3  # of a ring: its area over that of an ellipse of its moments


def find_dots(image: Image, target: Target) -> TargetPoints:
    """Find the centres of a rectangular grid of round dots, dark on bright or bright on dark.
    With marks the grid may be partly out of view.
    """
    if target.marked_dots:
        return _find_with_marks(image, target)
    shape = shape_of(target)
    best: tuple[Nodes, Array, Image] | None = None
    most = 0
    for polarity in (image, 255.0 - image):
        lattice = dot_lattice(*find_blobs(polarity), polarity.shape[::-1])
        if lattice is None:
            continue
        node, pixel = lattice.node, lattice.pixel
        most = max(most, len(node))
        window = _rectangle_within(node, shape)
        if window is not None and (best is None or len(window[0]) > len(best[0])):
            inside, first = window
            best = node[inside] - first, pixel[inside], polarity
    if best is None:
        raise CalibrationError(
            f"no grid of {shape[0]} x {shape[1]} dots was found (the largest regular grid has {most}); "
            "all of it must be in view and in focus, or marks must number it "
            "(origin_mark: ring, or odd dot); "
            "grids whose rows are set off by half a dot (asymmetric) are not supported"
        )
    node, pixel, polarity = best
    span = node.max(0) + 1
    if tuple(span) != shape:  # the lattice's first axis is the target's second
        node = np.stack([node[:, 1], span[0] - 1 - node[:, 0]], -1)
    node, notes = right_handed(None, node, pixel, shape)
    pixel, noise, more = dot_centres(polarity, node, pixel, target)
    return make_points(image, node, pixel, (*notes, *more), noise)


def _find_with_marks(image: Image, target: Target) -> TargetPoints:
    rings = target.origin_mark == "ring"
    grids = [
        (polarity, lattice)
        for polarity in (image, 255.0 - image)
        if (lattice := dot_lattice(*find_blobs(polarity, MIN_FULLNESS), polarity.shape[::-1])) is not None
    ]
    if not grids:
        raise CalibrationError(
            f"no grid of at least {MIN_DOTS} dots was found; it must be in view and in focus"
        )
    polarity, lattice = max(grids, key=lambda one: (rings and len(find_rings(*one)) == 3, len(one[1])))
    marks = find_rings(polarity, lattice) if rings else find_odd_dot(polarity, lattice)[None]
    dots = ~(lattice.node[:, None] == marks).all(2).any(1)
    node, pixel = lattice.node[dots], lattice.pixel[dots]
    node, turned = (
        (numbered_from_rings(node, pixel, marks), ())
        if rings
        else right_handed(None, node - marks, pixel, (1, 1))
    )
    span = tuple((np.ptp(node, axis=0) + 1).tolist())
    if target.shape is not None and (span[0] > target.shape[0] or span[1] > target.shape[1]):
        raise CalibrationError(
            f"{span[0]} x {span[1]} dots were found along x and y, more than the {target.shape[0]} x "
            f"{target.shape[1]} that are stated as the target's shape"
        )
    pixel, noise, notes = dot_centres(polarity, node, pixel, target)
    return make_points(image, node, pixel, (*turned, *notes), noise)


def dot_lattice(centre: Array, area: Array, size: tuple[int, ...]) -> TargetLattice | None:
    """The largest lattice grown from dots near the middle and their nearest neighbours.
    None where it has less than three dots along either axis.
    """
    if len(centre) < MIN_DOTS:
        return None
    tree = cKDTree(centre)
    best: TargetLattice | None = None
    for k in most_central(centre, MAX_SEEDS):
        _, near = tree.query(centre[k], MIN_DOTS)
        pair = independent_pair(centre[near[1:]] - centre[k])
        if pair is None:
            continue
        lattice = TargetLattice(centre[k], *pair)
        lattice.grow(Candidates(centre, area, 1.0), size)
        if best is None or len(lattice) > len(best):
            best = lattice
    return best if best and len(best) >= MIN_DOTS and np.ptp(best.node, axis=0).min() >= 2 else None


def _rectangle_within(node: Nodes, shape: tuple[int, int]) -> tuple[Mask, Nodes] | None:
    """Nodes of the full rectangle of this shape (either way round) that is a lattice, and its first node."""
    filled = set(map(tuple, node))
    for nx, ny in {shape, shape[::-1]}:
        for i in range(node[:, 0].min(), node[:, 0].max() - nx + 2):
            for j in range(node[:, 1].min(), node[:, 1].max() - ny + 2):
                if all((i + a, j + b) in filled for a in range(nx) for b in range(ny)):
                    first = np.array([i, j])
                    inside = ((node >= first) & (node < first + np.array([nx, ny]))).all(1)
                    return (inside, first) if inside.sum() == len(node) else None
    return None
