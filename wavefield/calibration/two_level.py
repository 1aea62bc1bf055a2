"""Dots on two parallel planes, as stereo PIV has them: one level's lattice, then the other's, then the marks.

The dots of one level form a square lattice; those of the other lie in the middle of its cells, displaced by
the parallax between the levels, so that rows seem unevenly spaced. A square in place of a dot marks the
origin, a triangle the x axis; both lie on one level.
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from wavefield.calibration.blobs import centroid_bias, centroids, find_blobs
from wavefield.calibration.patterns import make_points
from wavefield.calibration.points import TargetPoints
from wavefield.calibration.target import Target
from wavefield.calibration.target_lattice import Candidates, SmoothMap, TargetLattice
from wavefield.errors import CalibrationError

Array = NDArray[np.float64]
Node = NDArray[np.int64]

FEWEST = 12  # dots of a level
_FULL = 0.7  # a blob's area over that of an ellipse of its moments; .83 for a triangle
_OFF = 0.4  # of a cell: most that the parallax may set the other level's dots off the middles
_ODD = 6.0  # robust deviations by which a mark differs from the usual dot
_HALF = 0.4  # of all blobs: a level that has them needs no rival
_REACH = 0.19  # of a cell of one level: what is looked at around a dot
_PATCH = 25  # samples along each side of a dot's patch


def find_two_level(image: NDArray[np.float32], target: Target) -> TargetPoints:
    """Find the dots of a two-level target, dark on bright or bright on dark, also partly out of view.

    The parallax between the levels must be less than a mesh, else dots are taken for their neighbours.

    With image (row, column).
    """
    best: tuple[int, NDArray[np.float32], _Level, _Level] | None = None
    for polarity in (image, 255.0 - image):
        centre, area = find_blobs(polarity, _FULL)
        one = _first_level(centre, area, polarity.shape[::-1])
        other = None if one is None else _second_level(one, centre)
        if one is not None and other is not None:
            count = len(one.node) + len(other.node)
            if best is None or count > best[0]:
                best = count, polarity, one, other
    if best is None:
        raise CalibrationError(
            f"no two levels of at least {FEWEST} dots each were found; the target must be in focus, its dots "
            "at least four pixels wide"
        )
    _, polarity, one, other = best
    for marked, second in ((one, other), (other, one)):
        marks = _marks(polarity, marked)
        if marks:
            return _numbered(polarity, marked, second, marks, target)
    raise CalibrationError(
        "the square that marks the origin and the triangle that marks x are not both in view on one "
        f"level of the target ({len(one.node)} and {len(other.node)} dots were found)"
    )


class _Level:
    """Dots of one level: indices of its own lattice, pixels, the map between.

    In meshes a dot lies at ``2 node + shift``: the second level's lattice is set off by one.
    """

    def __init__(self, node: Node, pixel: Array, shift: int = 0) -> None:
        self.node, self.pixel, self.shift = node, pixel, shift
        self.smooth = SmoothMap(node, pixel, 2.0)
        slopes = self.smooth.slopes(node)
        self.side = float(np.median(np.hypot(slopes[..., 0], slopes[..., 1])))

    @property
    def meshes(self) -> Node:
        """Places of the dots in meshes."""
        return 2 * self.node + self.shift

    def index_of(self, pixel: Array) -> Array:
        """Indices, not whole, of any pixels: the map inverted."""
        inverse = np.linalg.inv(self.smooth.matrix)
        q = np.c_[pixel, np.ones(len(pixel))] @ inverse.T
        at: Array = q[:, :2] / q[:, 2:]
        for _ in range(4):
            slopes = np.moveaxis(self.smooth.slopes(at), 1, 2)
            at = at + np.linalg.solve(slopes, (pixel - self.smooth(at))[..., None])[..., 0]
        return at


def _first_level(centre: Array, area: Array, size: tuple[int, int]) -> _Level | None:
    """The largest lattice whose cells have a dot of the other level about their middle."""
    if len(centre) < 2 * FEWEST:
        return None
    tree = cKDTree(centre)
    best, most = None, 0
    for k in np.argsort(np.hypot(*(centre - np.median(centre, 0)).T))[:5]:
        for e1, e2 in _arms(centre, tree, int(k)):
            lattice = TargetLattice(centre[k], e1, e2)
            lattice.grow(Candidates(centre, area, 1.0), size)
            if len(lattice) <= max(most, FEWEST - 1):
                continue
            level = _trimmed(lattice.node, lattice.pixel)
            if level is not None and len(level.node) > most and _middles_filled(level, centre):
                best, most = level, len(level.node)
                if most > _HALF * len(centre):
                    return best
    return best


def _trimmed(node: Node, pixel: Array, shift: int = 0) -> _Level | None:
    """The level without what does not lie where the others say."""
    try:
        level = _Level(node, pixel, shift)
    except (ValueError, np.linalg.LinAlgError):
        return None
    sound = level.smooth.misfit < max(6 * level.smooth.spread, 0.05 * level.side)
    if sound.sum() < FEWEST:
        return None
    return level if sound.all() else _Level(node[sound], pixel[sound], shift)


def _arms(centre: Array, tree: cKDTree, k: int) -> list[tuple[Array, Array]]:
    """Pairs of vectors from a dot to others that repeat around it, shortest cells first."""
    _, near = tree.query(centre[k], min(22, len(centre)))
    around = centre[near[1:]] - centre[k]
    lengths = np.hypot(*around.T)
    reach = cKDTree(around)
    back = reach.query(-around)[0] < 0.15 * lengths  # a dot opposite
    around = around[back]
    out = []
    for a in range(len(around)):
        for b in range(len(around)):
            one, two = around[a], around[b]
            cross = one[0] * two[1] - one[1] * two[0]
            size = np.hypot(*one) * np.hypot(*two)
            shorter = min(one @ one, two @ two)
            if cross < 0.5 * size or one[0] < 0 or abs(one @ two) > 0.6 * shorter:
                continue  # each lattice once, by its shortest vectors
            if reach.query(one + two)[0] < 0.15 * np.sqrt(size):
                out.append((cross, one, two))
    out.sort(key=lambda row: row[0])
    return [(one, two) for _, one, two in out[:12]]


def _middles_filled(level: _Level, centre: Array) -> bool:
    """Whether the other dots lie about the middles of the cells, and not on their edges."""
    rest = _others(level, centre)
    if len(rest) < FEWEST:
        return False
    off = np.mod(level.index_of(rest), 1.0) - 0.5
    return bool(np.mean((np.abs(off) < _OFF).all(1)) > 0.8)


def _others(level: _Level, centre: Array) -> Array:
    """Dots that are not the level's own, where it reaches."""
    taken, _ = cKDTree(level.pixel).query(centre)
    rest = centre[taken > 0.1 * level.side]
    if not len(rest):
        return np.empty((0, 2))
    at = level.index_of(rest)
    out: Array = rest[((at > level.node.min(0) - 1.6) & (at < level.node.max(0) + 1.6)).all(1)]
    return out


def _second_level(one: _Level, centre: Array) -> _Level | None:
    """The other level: dots off the middles of the first one's cells by a parallax that varies slowly."""
    rest = _others(one, centre)
    if len(rest) < FEWEST:
        return None
    at = one.index_of(rest)
    off = np.angle(np.exp(2j * np.pi * (at - 0.5)).mean(0)) / (2 * np.pi)
    for _ in range(3):  # first one parallax for all, then one that varies as a plane
        node = np.floor(at - off).astype(np.int64)
        left = at - node - 0.5
        basis = np.c_[np.ones(len(at)), at]
        sound = (np.abs(left - np.median(left - off, 0) - off) < 0.22).all(1)
        if sound.sum() < FEWEST:
            return None
        off = basis @ np.linalg.lstsq(basis[sound], left[sound], rcond=None)[0]
    node = np.floor(at - off).astype(np.int64)
    sound = (np.abs(at - node - 0.5 - off) < 0.15).all(1)
    _, first = np.unique(node[sound], axis=0, return_index=True)
    if len(first) < FEWEST:
        return None
    return _trimmed(node[sound][first], rest[sound][first], shift=1)


def _marks(image: NDArray[np.float32], level: _Level) -> tuple[Node, Node] | None:
    """Nodes of the square and of the triangle: the two dots that look unlike the usual one."""
    patch = _patches(image, level)
    usual = np.median(patch, 0)
    odd = np.abs(patch - usual).mean(1)
    middle = np.median(odd)
    spread = 1.4826 * np.median(np.abs(odd - middle)) + 1e-6
    strange = np.flatnonzero(odd > middle + _ODD * spread)
    if len(strange) < 2:
        return None
    strange = strange[np.argsort(-odd[strange])][:2]
    lean = [_lean(patch[k]) for k in strange]
    square, triangle = strange[np.argsort(lean)]
    if max(lean) < 2.0 * min(lean):  # a triangle leans to three sides, a square to none
        return None
    return level.node[square], level.node[triangle]


def _patches(image: NDArray[np.float32], level: _Level) -> Array:
    """Surroundings of every dot in coordinates of the target, (n, samples), brightness 0 to 1."""
    a = _REACH * np.linspace(-1, 1, _PATCH)
    offset = np.stack(np.meshgrid(a, a), -1).reshape(-1, 2)
    at = level.smooth((level.node[:, None] + offset).reshape(-1, 2)).astype(np.float32)
    own = level.pixel - level.smooth(level.node)
    at = at.reshape(len(level.node), -1, 2) + own[:, None].astype(np.float32)
    values = cv2.remap(image, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    low, high = np.percentile(values, [10, 95], axis=1, keepdims=True)
    out: Array = np.clip((values - low) / np.maximum(high - low, 1.0), 0, 1).astype(float)
    out[:, np.hypot(*offset.T) > _REACH] = 0  # dots of the other level may lie in the corners
    return out


def _lean(patch: Array) -> float:
    """Third moments of a patch over those that its size lets expect: large for a triangle alone."""
    light = np.where(patch > 0.3, patch, 0.0)
    a = np.linspace(-1, 1, _PATCH)
    x, y = (v.ravel() for v in np.meshgrid(a, a))
    total = light.sum()
    x, y = x - light @ x / total, y - light @ y / total
    size = np.sqrt(light @ (x * x + y * y) / total)
    moments = [light @ (x**i * y ** (3 - i)) / total for i in range(4)]
    return float(np.hypot.reduce(moments) / size**3)


def _numbered(
    image: NDArray[np.float32], marked: _Level, second: _Level, marks: tuple[Node, Node], target: Target
) -> TargetPoints:
    """Nodes of both levels in meshes, x from the square to the triangle, right-handed seen from above."""
    square, triangle = marks
    slopes = marked.smooth.slopes(square[None].astype(float))[0]
    turns = [np.array(t) for t in ((1, 0), (0, 1), (-1, 0), (0, -1))]
    x = turns[int(np.argmax([t @ (triangle - square) for t in turns]))]
    y = np.array([-x[1], x[0]])
    along, up = x @ slopes, y @ slopes
    if along[0] * up[1] - along[1] * up[0] > 0:  # rows count down: seen from above y lies to the left of x
        y = -y
    origin = 2 * square + marked.shift
    parts = []
    for level in (marked, second):
        keep = np.ones(len(level.node), bool)
        if level is marked:
            keep = ~(level.node == square).all(1) & ~(level.node == triangle).all(1)
        node = (level.meshes[keep] - origin) @ np.stack([x, y], -1)
        parts.append(_measured(image, level, keep, node, target))
    one, two = parts
    depth = float(target.depth or 0.0)
    return TargetPoints(
        np.concatenate([one.node, two.node]),
        np.concatenate([one.pixel, two.pixel]),
        np.concatenate([one.std, two.std]),
        one.size,
        tuple(dict.fromkeys((*one.notes, *two.notes))),
        np.concatenate([np.zeros(len(one)), np.full(len(two), -depth)]),
    )


def _measured(
    image: NDArray[np.float32], level: _Level, keep: NDArray[np.bool_], node: Node, target: Target
) -> TargetPoints:
    """Dots of a level to a hundredth of a pixel."""
    own = level.node[keep]
    notes: tuple[str, ...] = ()
    pixel, noise = centroids(image, 2 * own, level.pixel[keep])  # half a cell: the other level stays outside
    if target.diameter is None:
        notes = ("centroids not corrected for perspective: state the target's diameter",)
    else:
        pixel = pixel - centroid_bias(own, pixel, 0.25 * target.diameter / target.mesh)
    return make_points(image, node, pixel, notes, noise)
