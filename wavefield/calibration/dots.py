"""Rectangular grids of round dots."""

import numpy as np
from scipy.spatial import cKDTree

from wavefield.calibration.blobs import find_blobs
from wavefield.calibration.points import Image, Mask, Nodes, TargetPoints
from wavefield.calibration.printed_points import dot_centres, make_points, right_handed, shape_of
from wavefield.calibration.ring_marks import find_odd_dot, find_rings, numbered_from_rings
from wavefield.calibration.target import Target
from wavefield.calibration.target_lattice import Candidates, TargetLattice, independent_pair, most_central
from wavefield.errors import CalibrationError
from wavefield.rig.lens import Array

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
            "all of it must be in view and in focus, or marks must number it (origin_mark: ring, or odd dot)"
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
