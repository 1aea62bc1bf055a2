"""Round dots of a target: where they are, and the bias of their centroids in perspective."""

import cv2
import numpy as np

from wavefield.calibration.points import Image, Mask, Nodes
from wavefield.calibration.smooth_map import SmoothMap, map_of_nodes
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
