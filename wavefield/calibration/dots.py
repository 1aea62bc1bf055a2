"""Find a grid of dots, with or without three rings that mark its origin; blobs and their centres."""

import cv2
import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from wavefield.calibration.lattice import (
    Candidates,
    SmoothMap,
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
from wavefield.robust import robust_std

MIN_AREA = 12  # px^2
MAX_AREA = 0.02  # of the image
MIN_CORE = 0.25  # of a dot's contrast: brighter pixels belong to it
EVEN = 0.8  # of a dot's own brightness: brighter parts of it count alike
DEFAULT_NOISE = 0.02  # of a dot's contrast, where too little background is in view to estimate it


def find_blobs(image: Image, min_fullness: float = 0.9) -> tuple[Array, Array]:
    """Centres (n, 2), px, and areas (n,), px^2, of bright blobs that are closed and nearly elliptic."""
    ground = cv2.blur(image, (2 * (max(image.shape) // 16) + 1,) * 2)
    binary = (cv2.GaussianBlur(image, (0, 0), 1.0) > ground + 0.15 * np.std(image)).astype(np.uint8)
    count, label, box, centre = cv2.connectedComponentsWithStats(binary)
    height, width = image.shape
    dots = []
    for k in range(1, count):
        x, y, w, h, area = box[k]
        at_edge = x == 0 or y == 0 or x + w == width or y + h == height
        if area < MIN_AREA or at_edge or area > MAX_AREA * image.size:
            continue
        rows, columns = np.nonzero(label[y : y + h, x : x + w] == k)
        covariance = np.cov(np.stack([columns, rows])) + np.eye(2) / 12
        fullness = area / (4 * np.pi * np.sqrt(max(np.linalg.det(covariance), 1e-9)))  # 1 for an ellipse
        if min_fullness < fullness < 1.1:
            dots.append(k)
    return centre[dots].astype(float), box[dots, 4].astype(float)


def centroids(image: Image, node: Nodes, pixel: Array) -> tuple[Array, Array]:
    """Centroids (n, 2) of bright dots in evened light, and their uncertainty from noise (n,), px."""
    windows = _windows(image, node, pixel)
    level = np.array([np.percentile(value, [10, 98]) for _, _, value in windows])
    middle, extent = pixel.mean(0), np.ptp(pixel)

    def quadratic(points: Array) -> Array:
        u, v = ((points - middle) / extent).T
        return np.stack([np.ones_like(u), u, v, u * u, v * v, u * v], -1)

    light = np.linalg.lstsq(quadratic(pixel), level, rcond=None)[0]
    centre, noise = np.empty_like(pixel), np.empty(len(pixel))
    for k, (gx, gy, value) in enumerate(windows):
        ground, bright = (quadratic(np.stack([gx, gy], -1).astype(float)) @ light).T
        share = (value - ground) / np.maximum(bright - ground, 1.0)
        background = share < MIN_CORE
        if background.sum() > 20:  # the remaining unevenness around this dot
            plane = np.stack([np.ones(len(gx)), gx - pixel[k, 0], gy - pixel[k, 1]], -1)
            share = share - plane @ np.linalg.lstsq(plane[background], share[background], rcond=None)[0]
        own = float(np.median(share[share > 0.5 * np.percentile(share, 98)]))
        dot = _dilated(gx, gy, share > MIN_CORE * own, pixel[k])
        share = np.minimum(share / own, EVEN)  # paint and light on a dot are seldom even
        grain = robust_std(share[~dot]) if (~dot).sum() > 20 else DEFAULT_NOISE
        x, y, share = gx[dot].astype(float), gy[dot].astype(float), share[dot]
        centre[k] = np.array([x @ share, y @ share]) / share.sum()
        lever = np.sqrt((((x - centre[k, 0]) ** 2 + (y - centre[k, 1]) ** 2).sum()) / 2)
        noise[k] = grain * lever / share.sum()
    return centre, noise


def _windows(image: Image, node: Nodes, pixel: Array) -> list[tuple[Nodes, Nodes, Array]]:
    """Columns, rows and greys of the pixels of each dot's cell: within half a mesh of it."""
    half_mesh = 0.5 * SmoothMap(node, pixel, np.inf).slopes(node)
    inverse = np.linalg.inv(np.moveaxis(half_mesh, 1, 2))
    reach = np.ceil(np.abs(half_mesh).sum(1)).astype(int)
    height, width = image.shape
    out = []
    for k, ((x, y), (rx, ry)) in enumerate(zip(np.rint(pixel).astype(int), reach)):
        columns = np.arange(max(x - rx, 0), min(x + rx + 1, width))
        rows = np.arange(max(y - ry, 0), min(y + ry + 1, height))
        gx, gy = (v.ravel() for v in np.meshgrid(columns, rows))
        inside = (np.abs(inverse[k] @ (np.stack([gx, gy]) - pixel[k][:, None])) < 0.98).all(0)
        gx, gy = gx[inside], gy[inside]
        out.append((gx, gy, image[gy, gx].astype(float)))
    return out


def _dilated(x: Nodes, y: Nodes, mask: Mask, at: Array) -> Mask:
    """The part of a mask over listed pixels that contains a place, widened by three pixels."""
    row, column = y - y.min() + 4, x - x.min() + 4
    raster = np.zeros((row.max() + 5, column.max() + 5), np.uint8)
    raster[row, column] = mask
    label = cv2.connectedComponents(raster)[1]
    nearest = np.argmin(np.where(mask, np.hypot(x - at[0], y - at[1]), np.inf))
    raster = (label == label[row[nearest], column[nearest]]).astype(np.uint8)
    wide: Mask = cv2.dilate(raster, np.ones((7, 7), np.uint8))[row, column] > 0
    return wide


def centroid_bias(node: Nodes, pixel: Array, radius: float) -> Array:
    """Centroid of the image of a disc (radius in meshes) minus the image of its centre, (n, 2), px."""
    smooth = map_of_nodes(node, pixel)
    rings, spokes = 4, 12
    r = radius * np.sqrt((np.arange(rings) + 0.5) / rings)  # rings of equal area
    a = 2 * np.pi * np.arange(spokes) / spokes
    offset = (r[:, None, None] * np.stack([np.cos(a), np.sin(a)], -1)).reshape(-1, 2)
    samples = (node[:, None] + offset).reshape(-1, 2)
    place = smooth(samples).reshape(len(node), -1, 2)
    area = np.abs(np.linalg.det(smooth.slopes(samples))).reshape(len(node), -1, 1)
    out: Array = (place * area).sum(1) / area.sum(1) - smooth(node.astype(float))
    return out


def shape_of(target: Target) -> tuple[int, int]:
    """Nodes along x and y of a target that has a shape."""
    assert target.shape is not None  # Target refuses these kinds without a shape
    return target.shape


def right_handed(
    image: Image | None, node: Nodes, pixel: Array, shape: tuple[int, int]
) -> tuple[Nodes, tuple[str, ...]]:
    """Number a full grid so that it is right-handed seen from above, and as unambiguously as possible.
    With an image, squares of a chessboard decide: the one between nodes (0, 0) and (1, 1) is dark.
    """
    last = np.array(shape) - 1
    if cross(*SmoothMap(node, pixel, np.inf).slopes(last[None] / 2)[0]) > 0:
        node = np.stack([node[:, 0], last[1] - node[:, 1]], -1)
    turns = [node, last - node]
    if shape[0] == shape[1]:
        quarter = np.stack([node[:, 1], last[0] - node[:, 0]], -1)
        turns += [quarter, last - quarter]
    if image is not None:
        turns = [turn for turn in turns if _first_square_dark(image, turn, pixel, shape)] or turns

    def to_the_right(turn: Nodes) -> float:
        slope = np.linalg.lstsq(np.c_[turn, np.ones(len(turn))], pixel[:, 0], rcond=None)[0]
        return float(slope[0])

    notes: tuple[str, ...] = ()
    if len(turns) > 1:
        notes = (
            f"the target has the same image in {len(turns)} positions: x is taken to the right in the image",
        )
    return max(turns, key=to_the_right), notes


def _first_square_dark(image: Image, node: Nodes, pixel: Array, shape: tuple[int, int]) -> bool:
    a, b = (v.ravel() for v in np.meshgrid(np.arange(shape[0] - 1), np.arange(shape[1] - 1)))
    x, y = np.rint(SmoothMap(node, pixel, np.inf)(np.stack([a, b], -1) + 0.5)).astype(int).T
    height, width = image.shape
    grey = image[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)]
    even = (a + b) % 2 == 0
    return bool(np.median(grey[even]) < np.median(grey[~even]))


def dot_centres(
    image: Image, node: Nodes, pixel: Array, target: Target, meshes: int = 1
) -> tuple[Array, Array, tuple[str, ...]]:
    """Centres of dots (n, 2), px, their uncertainty from noise (n,), and notes; nodes are `meshes` apart.
    In perspective a disc's centroid is not its centre's image: the difference is integrated and subtracted.
    """
    centre, noise = centroids(image, meshes * node, pixel)  # in cells of one mesh
    if target.diameter is None:
        return centre, noise, ("centroids not corrected for perspective: state the target's diameter",)
    radius = 0.5 * target.diameter / target.mesh / meshes
    return centre - centroid_bias(node, centre, radius), noise, ()


def make_points(
    image: Image, node: Nodes, pixel: Array, notes: tuple[str, ...] = (), noise: Array | float = 0.0
) -> TargetPoints:
    """Points with their uncertainty: from noise, or the misfit of a smooth map where that is larger."""
    try:
        smooth = map_of_nodes(node, pixel)
    except ValueError:
        raise CalibrationError("the points found are not on a plane target; photograph it again") from None
    free = max(len(node) - 4 - len(smooth.powers), 1)
    limited = np.minimum(smooth.misfit, 6 * smooth.spread)
    map_std = float(np.sqrt(limited**2 @ np.ones(len(node)) / (2 * free)))
    inlier = smooth.misfit < max(6 * smooth.spread * 1.2, 0.1)
    if not inlier.all():
        notes = (*notes, f"{(~inlier).sum()} of {len(inlier)} points out of place were left out")
    std = np.maximum(np.broadcast_to(noise, len(node)), map_std)
    height, width = image.shape
    return TargetPoints(node[inlier], pixel[inlier], std[inlier], (width, height), notes)


MIN_NEIGHBOURS = 3  # of the eight around a ring that are dots
RADII = np.arange(0.0, 0.46, 0.03)  # meshes, of the profile of a ring
ANGLES = 2 * np.pi * np.arange(24) / 24
MIN_RING = 0.35  # of the dots' contrast, all around
MAX_HOLE = 0.6  # of the brightness of the ring
MAX_OUTSIDE = 0.3  # of the dots' contrast, beyond the ring
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
    With three rings the grid may be partly out of view.
    """
    if target.ringed:
        return _find_with_rings(image, target)
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
            "all of it must be in view and in focus, or three rings must number it (origin_mark: ring); "
            "grids whose rows are set off by half a dot (asymmetric) are not supported"
        )
    node, pixel, polarity = best
    span = node.max(0) + 1
    if tuple(span) != shape:  # the lattice's first axis is the target's second
        node = np.stack([node[:, 1], span[0] - 1 - node[:, 0]], -1)
    node, notes = right_handed(None, node, pixel, shape)
    pixel, noise, more = dot_centres(polarity, node, pixel, target)
    return make_points(image, node, pixel, (*notes, *more), noise)


def _find_with_rings(image: Image, target: Target) -> TargetPoints:
    grids = [
        (polarity, lattice)
        for polarity in (image, 255.0 - image)
        if (lattice := dot_lattice(*find_blobs(polarity, MIN_FULLNESS), polarity.shape[::-1])) is not None
    ]
    if not grids:
        raise CalibrationError(
            f"no grid of at least {MIN_DOTS} dots was found; it must be in view and in focus"
        )
    polarity, lattice = max(grids, key=lambda one: (len(find_rings(*one)) == 3, len(one[1])))
    rings = find_rings(polarity, lattice)
    dots = ~(lattice.node[:, None] == rings).all(2).any(1)
    node, pixel = lattice.node[dots], lattice.pixel[dots]
    node = numbered_from_rings(node, pixel, rings)
    span = tuple((np.ptp(node, axis=0) + 1).tolist())
    if target.shape is not None and (span[0] > target.shape[0] or span[1] > target.shape[1]):
        raise CalibrationError(
            f"{span[0]} x {span[1]} dots were found along x and y, more than the {target.shape[0]} x "
            f"{target.shape[1]} that are stated as the target's shape"
        )
    pixel, noise, notes = dot_centres(polarity, node, pixel, target)
    return make_points(image, node, pixel, notes, noise)


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
