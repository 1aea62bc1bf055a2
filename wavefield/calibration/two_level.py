"""Dots on two parallel planes, as in stereo PIV: one level's lattice, then the other's, then the marks.

The dots of one level form a square lattice; those of the other are in the middle of its cells, displaced by
the parallax between the levels, so that rows seem unevenly spaced. A square and a triangle mark origin and x.
"""

import numpy as np
from scipy.spatial import cKDTree

from wavefield.calibration.blobs import find_blobs
from wavefield.calibration.points import Image, Mask, Nodes, TargetPoints
from wavefield.calibration.printed_points import dot_centres, make_points
from wavefield.calibration.target import Target
from wavefield.calibration.target_lattice import Candidates, TargetLattice, cross, most_central
from wavefield.calibration.two_level_marks import PlateAxes, PlateLevel, marks_between, marks_in_place
from wavefield.errors import CalibrationError
from wavefield.rig.lens import Array

MIN_DOTS = 12  # of a level
MIN_FULLNESS = 0.7  # a blob's area over that of an ellipse of its moments; 0.83 for a triangle
MIN_MARK_WIDTH = 4.7  # px, of a dot in place of which a triangle is recognised: dust passes for smaller ones
MAX_PARALLAX = 0.4  # of a cell: most that the other level's dots may be off the middles
DECISIVE_FRACTION = 0.4  # of all blobs: a level that has them is taken without further trials


def find_two_level(image: Image, target: Target) -> TargetPoints:
    """Find the dots of a two-level target, dark on bright or bright on dark, also partly out of view.
    The parallax between the levels must be less than a mesh, else dots are taken for their neighbours.
    """
    best: tuple[int, Image, PlateLevel, PlateLevel, Array] | None = None
    for polarity in (image, 255.0 - image):
        centre, area = find_blobs(polarity, MIN_FULLNESS)
        strong = Candidates(centre, area, 1.0).strong if len(area) else np.zeros(0, bool)
        dots, area = centre[strong], area[strong]  # without specks
        one = _first_level(dots, area, polarity.shape[::-1])
        other = None if one is None else _second_level(one, dots)
        if one is not None and other is not None:
            count = len(one.node) + len(other.node)
            if best is None or count > best[0]:
                best = count, polarity, one, other, centre
    if best is None:
        raise CalibrationError(
            f"no two levels of at least {MIN_DOTS} dots each were found; the target must be in focus, its "
            "dots at least five pixels wide"
        )
    _, polarity, one, other, centre = best
    for marked, second in ((one, other), (other, one)):
        between = marks_between(polarity, marked, second, centre)
        in_place = None
        if not between and _width(marked, target) >= MIN_MARK_WIDTH:
            in_place = marks_in_place(polarity, marked)
        if between:
            return _numbered(polarity, marked, second, (between, np.empty((0, 2), int)), target)
        if in_place:
            return _numbered(polarity, marked, second, in_place, target)
    width = min(_width(level, target) for level in (one, other))
    small = f"; dots are {width:.1f} px wide: in their place marks are recognised from five on: come closer"
    raise CalibrationError(
        "the square that marks the origin and the triangle that marks x are not both in view on one level of "
        f"the target ({len(one.node)} and {len(other.node)} dots were found)"
        f"{small if width < MIN_MARK_WIDTH else ''}"
    )


def _width(level: PlateLevel, target: Target) -> float:
    """The smaller axis of a usual dot's image, px; a large one where the target's diameter is not stated."""
    if not target.diameter:
        return np.inf
    sizes = np.linalg.svd(level.smooth.slopes(level.node), compute_uv=False)[:, 1]
    return float(np.median(sizes)) * target.diameter / (2.0 * target.mesh)


def _first_level(centre: Array, area: Array, size: tuple[int, ...]) -> PlateLevel | None:
    """The largest lattice whose cells have a dot of the other level about their middle."""
    if len(centre) < 2 * MIN_DOTS:
        return None
    tree = cKDTree(centre)
    best, most = None, 0
    for k in most_central(centre, 5):
        for e1, e2 in _repeated_vectors(centre, tree, k):
            lattice = TargetLattice(centre[k], e1, e2)
            lattice.grow(Candidates(centre, area, 1.0), size)
            if len(lattice) <= max(most, MIN_DOTS - 1):
                continue
            level = _without_outliers(lattice.node, lattice.pixel)
            if level is not None and len(level.node) > most and _middles_filled(level, centre):
                best, most = level, len(level.node)
                if most > DECISIVE_FRACTION * len(centre):
                    return best
    return best


def _without_outliers(node: Nodes, pixel: Array, shift: int = 0) -> PlateLevel | None:
    """The level without dots that are off the smooth map through the others."""
    try:
        level = PlateLevel(node, pixel, shift)
    except (ValueError, np.linalg.LinAlgError):
        return None
    inlier = level.smooth.misfit < max(6 * level.smooth.spread, 0.05 * level.side)
    if inlier.sum() < MIN_DOTS:
        return None
    return level if inlier.all() else PlateLevel(node[inlier], pixel[inlier], shift)


def _repeated_vectors(centre: Array, tree: cKDTree, k: int) -> list[tuple[Array, Array]]:
    """Pairs of vectors from a dot to others that repeat around it, shortest cells first."""
    _, near = tree.query(centre[k], min(22, len(centre)))
    vectors = centre[near[1:]] - centre[k]
    ends = cKDTree(vectors)
    vectors = vectors[ends.query(-vectors)[0] < 0.15 * np.hypot(*vectors.T)]  # with a dot opposite
    out = []
    for one in vectors:
        for two in vectors:
            area = cross(one, two)
            size = np.hypot(*one) * np.hypot(*two)
            shorter = min(one @ one, two @ two)
            if area < 0.5 * size or one[0] < 0 or abs(one @ two) > 0.6 * shorter:
                continue  # each lattice once, by its shortest vectors
            if ends.query(one + two)[0] < 0.15 * np.sqrt(size):
                out.append((area, one, two))
    out.sort(key=lambda row: row[0])
    return [(one, two) for _, one, two in out[:12]]


def _middles_filled(level: PlateLevel, centre: Array) -> bool:
    """Whether the other dots are about the middles of the cells, and not on their edges."""
    rest = _other_dots(level, centre)
    if len(rest) < MIN_DOTS:
        return False
    off = np.mod(level.index_of(rest), 1.0) - 0.5
    return bool(np.mean((np.abs(off) < MAX_PARALLAX).all(1)) > 0.8)


def _other_dots(level: PlateLevel, centre: Array) -> Array:
    """Dots within the level's extent that are not its own, (n, 2), px."""
    distance, _ = cKDTree(level.pixel).query(centre)
    rest = centre[distance > 0.1 * level.side]
    if not len(rest):
        return np.empty((0, 2))
    index = level.index_of(rest)
    out: Array = rest[((index > level.node.min(0) - 1.6) & (index < level.node.max(0) + 1.6)).all(1)]
    return out


def _second_level(one: PlateLevel, centre: Array) -> PlateLevel | None:
    """The other level: dots off the middles of the first one's cells by a parallax that varies slowly."""
    rest = _other_dots(one, centre)
    if len(rest) < MIN_DOTS:
        return None
    index = one.index_of(rest)
    off = np.angle(np.exp(2j * np.pi * (index - 0.5)).mean(0)) / (2 * np.pi)
    for _ in range(3):  # first one parallax for all, then one that varies as a plane
        node = np.floor(index - off).astype(np.int64)
        parallax = index - node - 0.5
        basis = np.c_[np.ones(len(index)), index]
        inlier = (np.abs(parallax - np.median(parallax - off, 0) - off) < 0.22).all(1)
        if inlier.sum() < MIN_DOTS:
            return None
        off = basis @ np.linalg.lstsq(basis[inlier], parallax[inlier], rcond=None)[0]
    node = np.floor(index - off).astype(np.int64)
    inlier = (np.abs(index - node - 0.5 - off) < 0.15).all(1)
    _, first = np.unique(node[inlier], axis=0, return_index=True)
    if len(first) < MIN_DOTS:
        return None
    return _without_outliers(node[inlier][first], rest[inlier][first], shift=1)


def _numbered(
    image: Image, marked: PlateLevel, second: PlateLevel, marks: tuple[PlateAxes, Nodes], target: Target
) -> TargetPoints:
    """Nodes of both levels in meshes, counted from the origin."""
    (origin, x, y), replaced = marks
    no_mark = ~(marked.node[:, None] == replaced).all(2).any(1)

    def located(level: PlateLevel, dots: Mask) -> TargetPoints:
        own = level.node[dots]
        node = (2 * own + level.shift - origin) @ np.stack([x, y], -1)
        pixel, noise, notes = dot_centres(image, own, level.pixel[dots], target, meshes=2)
        return make_points(image, node, pixel, notes, noise)

    one, two = located(marked, no_mark), located(second, np.ones(len(second.node), bool))
    return TargetPoints(
        np.concatenate([one.node, two.node]),
        np.concatenate([one.pixel, two.pixel]),
        np.concatenate([one.std, two.std]),
        one.size,
        tuple(dict.fromkeys((*one.notes, *two.notes))),
        np.concatenate([np.zeros(len(one)), np.full(len(two), -float(target.depth or 0.0))]),
    )
