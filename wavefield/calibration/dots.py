"""Find a grid of dots and the centres of these dots.

A blob is a bright connected shape in an image, a candidate for a dot.
"""

import cv2
import numpy as np
from scipy.spatial import cKDTree

from wavefield.calibration.lattice import (
    MAX_SEEDS,
    Candidates,
    SmoothMap,
    TargetLattice,
    cross,
    independent_pair,
    most_central,
)
from wavefield.calibration.observations import LIMITS, OUTLIER_DEVIATIONS
from wavefield.calibration.points import Image, Mask, Nodes, TargetPoints
from wavefield.calibration.target import Target
from wavefield.errors import CalibrationError
from wavefield.rig.lens import Array
from wavefield.robust import robust_std

MIN_AREA = 6.0  # px^2 within the outline through a blob's outermost pixels, as of a dot four pixels wide
# area of a blob over that of the ellipse with its moments: dot 1, square 0.95, triangle 0.83
MIN_FULLNESS = 0.7
MIN_CORE = 0.25  # of a dot's contrast; brighter pixels belong to the dot
MAX_WEIGHT = 0.8  # of a dot's brightness: brighter pixels have equal weight, as paint and light are uneven


def find_blobs(image: Image) -> tuple[Array, Array]:
    """Return centroids (n, 2), px, and areas (n,), px^2, of bright, nearly elliptic shapes in an image.
    Shapes that touch the edge of the image are left out."""
    ground = cv2.blur(image, (2 * (max(image.shape) // 16) + 1,) * 2)
    binary = (cv2.GaussianBlur(image, (0, 0), 1.0) > ground + 0.15 * np.std(image)).astype(np.uint8)
    height, width = image.shape
    centre, area = [], []
    outlines, levels = cv2.findContours(binary, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    around_hole = np.reshape(levels, (-1, 4))[:, 3] >= 0 if outlines else np.zeros(0, bool)
    for outline, of_hole in zip(outlines, around_hole, strict=True):
        x, y, w, h = cv2.boundingRect(outline)
        m = cv2.moments(outline)
        at_edge = x == 0 or y == 0 or x + w == width or y + h == height
        if of_hole or at_edge or m["m00"] < MIN_AREA:
            continue
        spread = np.sqrt(max(m["mu20"] * m["mu02"] - m["mu11"] ** 2, 1e-9)) / m["m00"]
        if m["m00"] > MIN_FULLNESS * 4 * np.pi * spread:
            centre.append((m["m10"] / m["m00"], m["m01"] / m["m00"]))
            area.append(m["m00"])
    return np.array(centre, float).reshape(-1, 2), np.array(area, float)


def centroids(image: Image, node: Nodes, pixel: Array) -> tuple[Array, Array]:
    """Return the centroids (n, 2), px, of bright dots in uneven light, and their standard errors (n,), px.
    `node` (n, 2) are the indices of the dots in their grid, `pixel` (n, 2) their approximate positions."""
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
        weight = (value - ground) / np.maximum(bright - ground, 1.0)
        background = weight < MIN_CORE
        if background.sum() > 20:  # remove the remaining unevenness around this dot
            plane = np.stack([np.ones(len(gx)), gx - pixel[k, 0], gy - pixel[k, 1]], -1)
            weight = weight - plane @ np.linalg.lstsq(plane[background], weight[background], rcond=None)[0]
        own = float(np.median(weight[weight > 0.5 * np.percentile(weight, 98)]))
        dot = _dilated(gx, gy, weight > MIN_CORE * own, pixel[k])
        weight = np.minimum(weight / own, MAX_WEIGHT)
        grain = robust_std(weight[~dot])
        x, y, weight = gx[dot].astype(float), gy[dot].astype(float), weight[dot]
        centre[k] = np.array([x @ weight, y @ weight]) / weight.sum()
        lever = np.sqrt((((x - centre[k, 0]) ** 2 + (y - centre[k, 1]) ** 2).sum()) / 2)
        noise[k] = grain * lever / weight.sum()
    return centre, noise


def _windows(image: Image, node: Nodes, pixel: Array) -> list[tuple[Nodes, Nodes, Array]]:
    """Return, for each dot, the columns, rows and grey values, (m,) each, of the m pixels around it.
    The pixels reach half-way to the neighbouring dots. `pixel` (n, 2) are the positions of the dots."""
    half_mesh = 0.5 * SmoothMap(node, pixel).slopes(node)
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
    """Return the connected part of a mask (n,) that is nearest to the point `at`, dilated by three pixels.
    x and y (n,) are the columns and rows of the n pixels; `at` is (column, row)."""
    row, column = y - y.min() + 4, x - x.min() + 4
    raster = np.zeros((row.max() + 5, column.max() + 5), np.uint8)
    raster[row, column] = mask
    label = cv2.connectedComponents(raster)[1]
    nearest = np.argmin(np.where(mask, np.hypot(x - at[0], y - at[1]), np.inf))
    raster = (label == label[row[nearest], column[nearest]]).astype(np.uint8)
    wide: Mask = cv2.dilate(raster, np.ones((7, 7), np.uint8))[row, column] > 0
    return wide


def centroid_bias(node: Nodes, pixel: Array, radius: float) -> Array:
    """Return the perspective error (n, 2), px: the centroid of a dot's image minus the image of its centre.
    `radius` is the radius of a dot in units of the distance between neighbouring dots."""
    smooth = SmoothMap(node, pixel)
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
    """Return the number of target nodes along x and y."""
    assert target.shape is not None  # `Target` requires the shape for the kinds that call this
    return target.shape


def number_right_handed(
    image: Image | None, node: Nodes, pixel: Array, shape: tuple[int, int]
) -> tuple[Nodes, tuple[str, ...]]:
    """Renumber the nodes of a complete grid right-handed seen from above; return indices (n, 2) and notes.
    `shape` is the number of nodes along x and y. If several numberings are possible, x is to the right in the
    image. `image` is given for a chessboard only, whose square between nodes (0, 0) and (1, 1) is dark."""
    last = np.array(shape) - 1
    if cross(*SmoothMap(node, pixel).slopes(last[None] / 2)[0]) > 0:
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
    """Tell whether the square of a chessboard between the nodes (0, 0) and (1, 1) is dark.
    `shape` is the number of inner corners along x and y."""
    a, b = (v.ravel() for v in np.meshgrid(np.arange(shape[0] - 1), np.arange(shape[1] - 1)))
    x, y = np.rint(SmoothMap(node, pixel)(np.stack([a, b], -1) + 0.5)).astype(int).T
    height, width = image.shape
    grey = image[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)]
    even = (a + b) % 2 == 0
    return bool(np.median(grey[even]) < np.median(grey[~even]))


def dot_centres(
    image: Image, node: Nodes, pixel: Array, target: Target, meshes: int = 1
) -> tuple[Array, Array, tuple[str, ...]]:
    """Return the centres (n, 2) of dots, px, their standard errors (n,), px, and notes for the user.
    If the target states the diameter of the dots, centres are corrected for perspective. `meshes` is the
    distance between dots with neighbouring indices in `node`, in units of the target's `mesh`."""
    centre, noise = centroids(image, meshes * node, pixel)  # with windows of one mesh
    if target.diameter is None:
        return centre, noise, ("centroids not corrected for perspective: state the target's diameter",)
    radius = 0.5 * target.diameter / target.mesh / meshes
    return centre - centroid_bias(node, centre, radius), noise, ()


def make_points(
    image: Image, node: Nodes, pixel: Array, notes: tuple[str, ...] = (), noise: Array | float = 0.0
) -> TargetPoints:
    """Make target points from node indices and pixels; leave out outliers from a smooth map between them.
    The uncertainty of a point is `noise`, px, or the scatter of the points about the map if larger."""
    smooth = SmoothMap(node, pixel)
    free = max(len(node) - 4 - len(smooth.powers), 1)
    limited = np.minimum(smooth.misfit, OUTLIER_DEVIATIONS * smooth.spread)
    map_std = float(np.sqrt(limited**2 @ np.ones(len(node)) / (2 * free)))
    inlier = smooth.inlier()
    if not inlier.all():
        notes = (*notes, f"{(~inlier).sum()} of {len(inlier)} points out of place were left out")
    std = np.maximum(np.broadcast_to(noise, len(node)), map_std)
    height, width = image.shape
    return TargetPoints(node[inlier], pixel[inlier], std[inlier], (width, height), notes)


def find_dots(image: Image, target: Target) -> TargetPoints:
    """Find the centres of all dots of a complete rectangular grid, dark on bright or bright on dark."""
    grids = []
    for polarity in (image, 255.0 - image):
        lattice = dot_lattice(*find_blobs(polarity), polarity.shape[::-1])
        if lattice is not None:
            grids.append((polarity, lattice))
    nx, ny = shape_of(target)
    if not grids:
        raise CalibrationError(f"no grid of {nx} x {ny} dots was found; it must be in view and in focus")
    polarity, lattice = max(grids, key=lambda grid: len(grid[1]))
    node, notes = _numbered_from_shape(lattice.node, lattice.pixel, (nx, ny))
    pixel, noise, more = dot_centres(polarity, node, lattice.pixel, target)
    return make_points(image, node, pixel, (*notes, *more), noise)


def _numbered_from_shape(node: Nodes, pixel: Array, shape: tuple[int, int]) -> tuple[Nodes, tuple[str, ...]]:
    """Number the dots of a complete grid with `shape` dots along x and y; return indices (n, 2) and notes.
    Raises a CalibrationError if the grid has another shape."""
    node = node - node.min(0)
    span = node.max(0) + 1
    if sorted(span) != sorted(shape) or len(node) != np.prod(shape):
        raise CalibrationError(
            f"no grid of {shape[0]} x {shape[1]} dots was found (the largest regular grid has {len(node)}); "
            "all of it must be in view and in focus, and rows must not be set off by half a dot"
        )
    if tuple(span) != shape:  # the lattice's first axis is the target's second
        node = np.stack([node[:, 1], span[0] - 1 - node[:, 0]], -1)
    return number_right_handed(None, node, pixel, shape)


def dot_lattice(centre: Array, area: Array, size: tuple[int, ...]) -> TargetLattice | None:
    """Return the largest of the grids of dots that grow from several dots near the middle of the image.
    `centre` (n, 2), px, and `area` (n,), px^2, describe bright shapes; `size` is the (width, height) of the
    image, px. Returns None if the grid has too few dots."""
    if len(centre) < LIMITS.min_nodes:
        return None
    tree = cKDTree(centre)
    best: TargetLattice | None = None
    for k in most_central(centre, MAX_SEEDS):
        _, near = tree.query(centre[k], 9)
        pair = independent_pair(centre[near[1:]] - centre[k])
        if pair is None:
            continue
        lattice = TargetLattice(centre[k], *pair)
        lattice.grow(Candidates(centre, area, 1.0), size)
        if best is None or len(lattice) > len(best):
            best = lattice
    return best if best and len(best) >= LIMITS.min_nodes and np.ptp(best.node, axis=0).min() >= 2 else None
