"""The square and the triangle of a two-level target: in place of two dots, or between the dots."""

import cv2
import numpy as np
from scipy.spatial import cKDTree

from wavefield.calibration.points import Image, Nodes
from wavefield.calibration.smooth_map import SmoothMap
from wavefield.calibration.target_lattice import cross
from wavefield.rig.lens import Array
from wavefield.robust import robust_std

MARK_DEVIATIONS = 4.0  # robust deviations by which a mark differs from the usual dot
MAX_UNUSUAL = 6  # dots that may be marks: some are dusty
MIN_SKEWNESS = 0.08  # of a triangle; below 0.03 of most dots
MAX_RATIO = 1.75  # of the differences of square and triangle from a dot: dust makes one of them alone
PATCH_REACH = 0.19  # of a cell of one level: half the side of the patch around a dot
PATCH_SAMPLES = 25  # along each side of it
MAX_OFF_SITE = 0.16  # meshes: a mark between the dots beside its place


class PlateLevel:
    """Dots of one level: indices of its own lattice, pixels, the map between.
    In meshes a dot is at ``2 node + shift``: the second level's lattice is set off by one.
    """

    def __init__(self, node: Nodes, pixel: Array, shift: int = 0) -> None:
        self.node, self.pixel, self.shift = node, pixel, shift
        self.smooth = SmoothMap(node, pixel, 2.0)
        slopes = self.smooth.slopes(node)
        self.side = float(np.median(np.hypot(slopes[..., 0], slopes[..., 1])))

    def index_of(self, pixel: Array) -> Array:
        """Fractional indices (n, 2) of any pixels: the map inverted."""
        inverse = np.linalg.inv(self.smooth.matrix)
        q = np.c_[pixel, np.ones(len(pixel))] @ inverse.T
        index: Array = q[:, :2] / q[:, 2:]
        for _ in range(4):
            slopes = np.moveaxis(self.smooth.slopes(index), 1, 2)
            index = index + np.linalg.solve(slopes, (pixel - self.smooth(index))[..., None])[..., 0]
        return index


# Origin, x and y in meshes, right-handed seen from above: nodes are (mesh - origin) @ [x, y].T
PlateAxes = tuple[Nodes, Nodes, Nodes]


def marks_in_place(image: Image, level: PlateLevel) -> tuple[PlateAxes, Nodes] | None:
    """The frame of a square and a triangle in place of dots of a level, and their nodes (2, 2).
    They are the most unusual pair in a row, of which one is skewed; x points from square to triangle.
    """
    patch = _patches(image, level, level.node.astype(float), level.pixel)
    difference = np.abs(patch - np.median(patch, 0)).mean(1)
    middle = np.median(difference)
    spread = robust_std(difference - middle) + 1e-6
    edge = PATCH_REACH * level.side  # a patch that the image's edge cuts is no evidence
    far = ((level.pixel > edge) & (level.pixel < np.array(image.shape[::-1]) - 1 - edge)).all(1)
    unusual = np.argsort(np.where(far, -difference, 0.0))[:MAX_UNUSUAL]
    unusual = unusual[difference[unusual] > middle + MARK_DEVIATIONS * spread]
    skewness = {int(k): _skewness(patch[k]) for k in unusual}
    pairs = [
        (float(difference[s] + difference[t]), s, t)
        for s in skewness
        for t in skewness
        if skewness[t] > max(MIN_SKEWNESS, 2.0 * skewness[s])
        and abs(np.log((difference[s] - middle) / (difference[t] - middle))) < np.log(MAX_RATIO)
        and (level.node[s] == level.node[t]).any()
    ]
    if not pairs:
        return None
    square, triangle = level.node[list(max(pairs)[1:])]
    turns = [np.array(t) for t in ((1, 0), (0, 1), (-1, 0), (0, -1))]
    x = turns[int(np.argmax([t @ (triangle - square) for t in turns]))]
    y = np.array([-x[1], x[0]])
    if not _right_handed(level, square, x, y):
        y = -y
    return (2 * square + level.shift, x, y), np.stack([square, triangle])


def marks_between(image: Image, level: PlateLevel, other: PlateLevel, centre: Array) -> PlateAxes | None:
    """The frame of marks between the dots of a level's row (triangle) and of one of the other (square).
    The origin is the dot beside both of them; x points to the triangle, y to the square.
    """
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
    """Those of the pixels that are between two dots of a row or column of a level, in meshes."""
    mesh = 2 * level.index_of(pixel) + level.shift
    site = np.rint(mesh).astype(np.int64)
    good = (np.abs(mesh - site) < MAX_OFF_SITE).all(1) & (site.sum(1) % 2 == 1)
    return {int(k): site[k] for k in np.flatnonzero(good)}


def _right_handed(level: PlateLevel, index: Array, x: Nodes, y: Nodes) -> bool:
    slopes = level.smooth.slopes(np.asarray(index, float)[None])[0]
    return cross(x @ slopes, y @ slopes) < 0  # rows of images run downwards


def _square_first(patch: Array) -> Nodes | None:
    """The order of two patches with the square before the triangle; None if both are alike symmetric."""
    skewness = np.array([_skewness(one) for one in patch])
    return None if skewness.max() < 2.0 * skewness.min() else np.argsort(skewness)


def _patches(image: Image, level: PlateLevel, index: Array, pixel: Array) -> Array:
    """Surroundings of pixels in coordinates of the target, (n, samples), brightness 0 to 1."""
    a = PATCH_REACH * np.linspace(-1, 1, PATCH_SAMPLES)
    offset = np.stack(np.meshgrid(a, a), -1).reshape(-1, 2)
    places = level.smooth((index[:, None] + offset).reshape(-1, 2)).astype(np.float32)
    own = pixel - level.smooth(index)
    places = places.reshape(len(index), -1, 2) + own[:, None].astype(np.float32)
    x, y = places[..., 0], places[..., 1]
    values = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    low, high = np.percentile(values, [10, 95], axis=1, keepdims=True)
    out: Array = np.clip((values - low) / np.maximum(high - low, 1.0), 0, 1).astype(float)
    out[:, np.hypot(*offset.T) > PATCH_REACH] = 0  # dots of the other level may be in the corners
    return out


def _skewness(patch: Array) -> float:
    """Third moments of a patch over its size cubed: large for a triangle, small for symmetric shapes."""
    light = np.where(patch > 0.3, patch, 0.0)
    a = np.linspace(-1, 1, PATCH_SAMPLES)
    x, y = (v.ravel() for v in np.meshgrid(a, a))
    total = light.sum()
    x, y = x - light @ x / total, y - light @ y / total
    size = np.sqrt(light @ (x * x + y * y) / total)
    moments = [light @ (x**i * y ** (3 - i)) / total for i in range(4)]
    return float(np.hypot.reduce(moments) / size**3)
