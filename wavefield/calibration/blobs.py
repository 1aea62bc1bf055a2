"""Blobs in an image, and the order of printed boards found from them."""

import cv2
import numpy as np

from wavefield.calibration.lattice import SmoothMap, cross, map_of_nodes
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


def marker_dictionary(target: Target, kind: str) -> cv2.aruco.Dictionary:
    """OpenCV's dictionary of the target's markers."""
    code = getattr(cv2.aruco, target.dictionary, None)
    if not isinstance(code, int):
        example = "DICT_APRILTAG_36h11" if target.kind == "aprilgrid" else "DICT_4X4_50"
        raise CalibrationError(
            f"{kind} {target.dictionary!r} is unknown; use OpenCV's name, for example {example}"
        )
    return cv2.aruco.getPredefinedDictionary(code)


def as_bytes(image: Image) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """An image as OpenCV's detectors need it."""
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def halved(
    image: np.ndarray[tuple[int, ...], np.dtype[np.uint8]], max_side: int
) -> tuple[np.ndarray[tuple[int, ...], np.dtype[np.uint8]], float]:
    """An image whose sides were halved until none exceeds a limit, px, and the factor of its size."""
    factor = 1.0
    while max(image.shape) > max_side:
        half = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        image, factor = np.asarray(half, np.uint8), 2.0 * factor
    return image, factor


def corner_subpixel(image: Image, pixel: Array, half: int) -> Array:
    """Corners (n, 2) refined within square windows of 2 half + 1 pixels."""
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 60, 1e-4)
    start = pixel.astype(np.float32).reshape(-1, 1, 2)
    return cv2.cornerSubPix(image, start, (half, half), (-1, -1), criteria).reshape(-1, 2).astype(float)


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
