"""Find a two-level target: dots on the two levels of a stepped plate.

The mesh is the distance between rows of dots, half of the spacing in a row. The dots of each level form a
lattice of cells two meshes wide. The dots of the other level are near the middles of these cells, shifted by
the parallax between the levels. A square and a triangle between the dots mark the axes.
"""

import cv2
import numpy as np
from scipy.spatial import cKDTree

from wavefield.calibration.dots import dot_centres, find_blobs, make_points
from wavefield.calibration.lattice import (
    MAX_MISFIT,
    Candidates,
    SmoothMap,
    TargetLattice,
    cross,
    most_central,
)
from wavefield.calibration.observations import LIMITS
from wavefield.calibration.points import Image, Nodes, TargetPoints
from wavefield.calibration.target import Target
from wavefield.errors import CalibrationError
from wavefield.rig.lens import Array

PATCH_REACH = 0.19  # cells: half the side of the patch around a dot
PATCH_SAMPLES = 25  # along each side of a patch


class PlateLevel:
    """Dots of one level of a stepped plate, with a smooth map from the indices `node` (n, 2) to pixels.
    A dot is at ``2 node + shift`` on the plate, in units of the distance between rows of dots; `shift` is 0
    on the first level and 1 on the second."""

    def __init__(self, node: Nodes, pixel: Array, shift: int = 0) -> None:
        self.node, self.pixel, self.shift = node, pixel, shift
        self.smooth = SmoothMap(node, pixel)
        slopes = self.smooth.slopes(node)
        self.side = float(np.median(np.hypot(slopes[..., 0], slopes[..., 1])))

    def index_of(self, pixel: Array) -> Array:
        """Return the indices (n, 2) of pixels (n, 2) in the grid of this level; whole numbers are dots."""
        inverse = np.linalg.inv(self.smooth.matrix)
        q = np.c_[pixel, np.ones(len(pixel))] @ inverse.T
        index: Array = q[:, :2] / q[:, 2:]
        for _ in range(4):
            slopes = np.moveaxis(self.smooth.slopes(index), 1, 2)
            index = index + np.linalg.solve(slopes, (pixel - self.smooth(index))[..., None])[..., 0]
        return index


# origin and unit steps x and y, in distances between rows of dots, right-handed seen from above
PlateAxes = tuple[Nodes, Nodes, Nodes]


def marks_between(image: Image, level: PlateLevel, other: PlateLevel, centre: Array) -> PlateAxes | None:
    """Return the origin and unit steps x and y, (2,) each, of the axes that a triangle and a square mark.
    Units are the distance between rows of dots. The triangle is between dots of `level`, the square between
    dots of `other`, and the origin is the dot next to the two marks. `centre` (n, 2), px, are all bright
    shapes. Returns None if the marks are not found."""
    near = [cKDTree(one.pixel).query(centre)[0] < 0.1 * one.side for one in (level, other)]
    rest = centre[~near[0] & ~near[1]]
    if len(rest) < 2:
        return None
    triangles, squares = (_sites_between(one, rest) for one in (level, other))
    for t, triangle in triangles.items():
        for s, square in squares.items():
            if s == t or (np.abs(triangle - square) != 1).any():
                continue
            places = rest[[s, t]]
            order = _square_first(_patches(image, level, level.index_of(places), places))
            along = int((triangle[0] - level.shift) % 2 == 0)  # the axis of the rows
            origin = np.where(np.arange(2) == along, square, triangle)
            x, y = triangle - origin, square - origin
            if order is not None and order[0] == 0 and _right_handed(level, (origin - level.shift) / 2, x, y):
                return origin, x, y
    return None


def _sites_between(level: PlateLevel, pixel: Array) -> dict[int, Nodes]:
    """Return the grid positions (2,) of pixels that lie midway between two dots; others are left out.
    Positions are in units of the distance between rows of dots; keys are indices into `pixel` (n, 2)."""
    mesh = 2 * level.index_of(pixel) + level.shift
    site = np.rint(mesh).astype(np.int64)
    good = (np.abs(mesh - site) < MAX_MISFIT).all(1) & (site.sum(1) % 2 == 1)
    return {int(k): site[k] for k in np.flatnonzero(good)}


def _right_handed(level: PlateLevel, index: Array, x: Nodes, y: Nodes) -> bool:
    """Tell whether the steps x and y (2,) from the dot `index` (2,) are right-handed seen from above."""
    slopes = level.smooth.slopes(np.asarray(index, float)[None])[0]
    return cross(x @ slopes, y @ slopes) < 0  # image rows run downwards


def _square_first(patch: Array) -> Nodes | None:
    """Return the order (2,) of two marks that puts the square before the triangle, or None if unclear.
    `patch` (2, samples) holds the images of the two marks."""
    skewness = np.array([_skewness(one) for one in patch])
    return None if skewness.max() < 2.0 * skewness.min() else np.argsort(skewness)


def _patches(image: Image, level: PlateLevel, index: Array, pixel: Array) -> Array:
    """Return the images around n marks, as patches (n, samples) of brightness from 0 to 1.
    `pixel` (n, 2) are the positions of the marks, `index` (n, 2) the same positions as indices in `level`."""
    a = PATCH_REACH * np.linspace(-1, 1, PATCH_SAMPLES)
    offset = np.stack(np.meshgrid(a, a), -1).reshape(-1, 2)
    places = level.smooth((index[:, None] + offset).reshape(-1, 2)).astype(np.float32)
    own = pixel - level.smooth(index)
    places = places.reshape(len(index), -1, 2) + own[:, None].astype(np.float32)
    x, y = places[..., 0], places[..., 1]
    values = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    low, high = np.percentile(values, [10, 95], axis=1, keepdims=True)
    out: Array = np.clip((values - low) / np.maximum(high - low, 1.0), 0, 1).astype(float)
    out[:, np.hypot(*offset.T) > PATCH_REACH] = 0  # the corners may hold dots of the other level
    return out


def _skewness(patch: Array) -> float:
    """Return the asymmetry of a patch (samples,), large for triangles: norm of third moments over size^3."""
    light = np.where(patch > 0.3, patch, 0.0)
    a = np.linspace(-1, 1, PATCH_SAMPLES)
    x, y = (v.ravel() for v in np.meshgrid(a, a))
    total = light.sum()
    x, y = x - light @ x / total, y - light @ y / total
    size = np.sqrt(light @ (x * x + y * y) / total)
    moments = [light @ (x**i * y ** (3 - i)) / total for i in range(4)]
    return float(np.hypot.reduce(moments) / size**3)


MAX_PARALLAX = 0.4  # cells: distance of the other level's dots from the middles of the cells
DECISIVE_FRACTION = 0.4  # of all dots; a level with more of them ends the search


def find_two_level(image: Image, target: Target) -> TargetPoints:
    """Find the dots of a two-level target. Its two marks must be in view; some dots may be out of view.
    The parallax between the levels must be less than the distance between rows of dots."""
    best: tuple[int, Image, PlateLevel, PlateLevel, Array] | None = None
    for polarity in (image, 255.0 - image):
        centre, area = find_blobs(polarity)
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
            f"no two levels of at least {LIMITS.min_nodes} dots each were found; the target must be in "
            "focus, its dots at least five pixels wide"
        )
    _, polarity, one, other, centre = best
    for marked, second in ((one, other), (other, one)):
        axes = marks_between(polarity, marked, second, centre)
        if axes:
            return _numbered(polarity, marked, second, axes, target)
    raise CalibrationError(
        "the triangle and the square that mark the axes between the dots are not both in view "
        f"({len(one.node)} and {len(other.node)} dots were found)"
    )


def _first_level(centre: Array, area: Array, size: tuple[int, ...]) -> PlateLevel | None:
    """Return the largest grid of dots whose cells hold dots of another level, or None.
    `centre` (n, 2), px, and `area` (n,), px^2, describe the dots of the two levels; `size` is the (width,
    height) of the image, px."""
    if len(centre) < 2 * LIMITS.min_nodes:
        return None
    tree = cKDTree(centre)
    best, most = None, 0
    for k in most_central(centre, 5):
        for e1, e2 in _repeated_vectors(centre, tree, k):
            lattice = TargetLattice(centre[k], e1, e2)
            lattice.grow(Candidates(centre, area, 1.0), size)
            if len(lattice) <= max(most, LIMITS.min_nodes - 1):
                continue
            level = _without_outliers(lattice.node, lattice.pixel)
            if level is not None and len(level.node) > most and _middles_filled(level, centre):
                best, most = level, len(level.node)
                if most > DECISIVE_FRACTION * len(centre):
                    return best
    return best


def _without_outliers(node: Nodes, pixel: Array, shift: int = 0) -> PlateLevel | None:
    """Make a level from dots with indices `node` and positions `pixel`, (n, 2) each, without outliers.
    Returns None if too few dots are left. `PlateLevel` describes `shift`."""
    try:
        level = PlateLevel(node, pixel, shift)
    except (CalibrationError, np.linalg.LinAlgError):
        return None
    inlier = level.smooth.inlier()
    if inlier.sum() < LIMITS.min_nodes:
        return None
    return level if inlier.all() else PlateLevel(node[inlier], pixel[inlier], shift)


def _repeated_vectors(centre: Array, tree: cKDTree, k: int) -> list[tuple[Array, Array]]:
    """Return pairs of steps (2,), px, from dot k that may be sides of a cell; smallest cells first.
    There must be dots at the end of each step, at the opposite of each, and at the sum of the two."""
    _, near = tree.query(centre[k], min(22, len(centre)))
    vectors = centre[near[1:]] - centre[k]
    ends = cKDTree(vectors)
    vectors = vectors[ends.query(-vectors)[0] < 0.15 * np.hypot(*vectors.T)]  # also a dot on the other side
    out = []
    for one in vectors:
        for two in vectors:
            area = cross(one, two)
            size = np.hypot(*one) * np.hypot(*two)
            shorter = min(one @ one, two @ two)
            if area < 0.5 * size or one[0] < 0 or abs(one @ two) > 0.6 * shorter:
                continue  # consider each lattice once, with its shortest vectors
            if ends.query(one + two)[0] < 0.15 * np.sqrt(size):
                out.append((area, one, two))
    out.sort(key=lambda row: row[0])
    return [(one, two) for _, one, two in out[:12]]


def _middles_filled(level: PlateLevel, centre: Array) -> bool:
    """Tell whether most dots that do not belong to `level` are near the middles of its cells.
    `centre` (n, 2), px, are all dots."""
    rest = _other_dots(level, centre)
    if len(rest) < LIMITS.min_nodes:
        return False
    off = np.mod(level.index_of(rest), 1.0) - 0.5
    return bool(np.mean((np.abs(off) < MAX_PARALLAX).all(1)) > 0.8)


def _other_dots(level: PlateLevel, centre: Array) -> Array:
    """Return the dots (m, 2) among `centre` (n, 2), px, in the area of `level` that do not belong to it."""
    distance, _ = cKDTree(level.pixel).query(centre)
    rest = centre[distance > 0.1 * level.side]
    if not len(rest):
        return np.empty((0, 2))
    index = level.index_of(rest)
    out: Array = rest[((index > level.node.min(0) - 1.6) & (index < level.node.max(0) + 1.6)).all(1)]
    return out


def _second_level(one: PlateLevel, centre: Array) -> PlateLevel | None:
    """Return the level whose dots are near the middles of the cells of `one`; None for too few dots.
    `centre` (n, 2), px, are all dots. Parallax shifts the dots of this level from the middles, by an amount
    that may change linearly over the image."""
    rest = _other_dots(one, centre)
    if len(rest) < LIMITS.min_nodes:
        return None
    index = one.index_of(rest)
    off = np.angle(np.exp(2j * np.pi * (index - 0.5)).mean(0)) / (2 * np.pi)
    for _ in range(3):  # start from a constant parallax, then fit one that is linear in the indices
        node = np.floor(index - off).astype(np.int64)
        parallax = index - node - 0.5
        basis = np.c_[np.ones(len(index)), index]
        inlier = (np.abs(parallax - np.median(parallax - off, 0) - off) < 0.22).all(1)
        if inlier.sum() < LIMITS.min_nodes:
            return None
        off = basis @ np.linalg.lstsq(basis[inlier], parallax[inlier], rcond=None)[0]
    node = np.floor(index - off).astype(np.int64)
    inlier = (np.abs(index - node - 0.5 - off) < 0.15).all(1)
    _, first = np.unique(node[inlier], axis=0, return_index=True)
    if len(first) < LIMITS.min_nodes:
        return None
    return _without_outliers(node[inlier][first], rest[inlier][first], shift=1)


def _numbered(
    image: Image, marked: PlateLevel, second: PlateLevel, axes: PlateAxes, target: Target
) -> TargetPoints:
    """Return the target points of the two levels, with indices that count from the origin of `axes`.
    The level `marked` is at z = 0, and `axes` are given in its units."""
    origin, x, y = axes

    def located(level: PlateLevel) -> TargetPoints:
        node = (2 * level.node + level.shift - origin) @ np.stack([x, y], -1)
        pixel, noise, notes = dot_centres(image, level.node, level.pixel, target, meshes=2)
        return make_points(image, node, pixel, notes, noise)

    one, two = located(marked), located(second)
    return TargetPoints(
        np.concatenate([one.node, two.node]),
        np.concatenate([one.pixel, two.pixel]),
        np.concatenate([one.std, two.std]),
        one.size,
        tuple(dict.fromkeys((*one.notes, *two.notes))),
        np.concatenate([np.zeros(len(one)), np.full(len(two), -float(target.depth or 0.0))]),
    )
