"""Round dots of a target: where they are, and what perspective does to their centroids."""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from wavefield.calibration.target_lattice import SmoothMap
from wavefield.robust import robust_std

Array = NDArray[np.float64]
Node = NDArray[np.int64]


def find_blobs(image: NDArray[np.float32], least: float = 0.9) -> tuple[Array, Array]:
    """Centres (n, 2) and areas (n,) of bright, closed blobs.

    With image (row, column); returns centre, area Px, px^2..
    """
    ground = cv2.blur(image, (2 * (max(image.shape) // 16) + 1,) * 2)
    binary = (cv2.GaussianBlur(image, (0, 0), 1.0) > ground + 0.15 * np.std(image)).astype(np.uint8)
    count, label, box, centre = cv2.connectedComponentsWithStats(binary)
    height, width = image.shape
    keep = []
    for k in range(1, count):
        x, y, w, h, area = box[k]
        if area < 12 or x == 0 or y == 0 or x + w == width or y + h == height or area > 0.02 * image.size:
            continue
        rows, columns = np.nonzero(label[y : y + h, x : x + w] == k)
        spread = np.cov(np.stack([columns, rows])) + np.eye(2) / 12
        fullness = area / (4 * np.pi * np.sqrt(max(np.linalg.det(spread), 1e-9)))  # 1 for an ellipse
        if least < fullness < 1.1:
            keep.append(k)
    return centre[keep].astype(float), box[keep, 4].astype(float)


def centroids(image: NDArray[np.float32], node: Node, pixel: Array) -> tuple[Array, Array]:
    """Centroids of light of bright dots, the light evened out first, and the uncertainty from noise, px."""
    half_mesh = 0.5 * SmoothMap(node, pixel, np.inf).slopes(node)
    inverse = np.linalg.inv(np.moveaxis(half_mesh, 1, 2))
    reach = np.ceil(np.abs(half_mesh).sum(1)).astype(int)
    height, width = image.shape
    windows = []
    level = np.empty((len(pixel), 2))
    for k, ((x, y), (rx, ry)) in enumerate(zip(np.rint(pixel).astype(int), reach)):
        gx, gy = np.meshgrid(
            np.arange(max(x - rx, 0), min(x + rx + 1, width)),
            np.arange(max(y - ry, 0), min(y + ry + 1, height)),
        )
        inside = (np.abs(inverse[k] @ (np.stack([gx.ravel(), gy.ravel()]) - pixel[k][:, None])) < 0.98).all(0)
        gx, gy = gx.ravel()[inside], gy.ravel()[inside]
        windows.append((gx, gy, image[gy, gx].astype(float)))
        level[k] = np.percentile(windows[-1][2], [10, 98])
    at = (pixel - pixel.mean(0)) / np.ptp(pixel)
    basis = np.stack([np.ones(len(at)), *at.T, at[:, 0] ** 2, at[:, 1] ** 2, at[:, 0] * at[:, 1]], -1)
    light = np.linalg.lstsq(basis, level, rcond=None)[0]

    def lit(x: Array, y: Array) -> tuple[Array, Array]:
        u, v = (np.stack([x, y], -1) - pixel.mean(0)).T / np.ptp(pixel)
        ground, bright = (np.stack([np.ones_like(u), u, v, u * u, v * v, u * v], -1) @ light).T
        return ground, np.maximum(bright - ground, 1.0)

    centre, noise = np.empty_like(pixel), np.empty(len(pixel))
    for k, (gx, gy, value) in enumerate(windows):
        ground, contrast = lit(gx.astype(float), gy.astype(float))
        share = (value - ground) / contrast
        outside = share < 0.25
        if outside.sum() > 20:  # what light leaves uneven around this dot
            plane = np.stack([np.ones(len(gx)), gx - pixel[k, 0], gy - pixel[k, 1]], -1)
            share = share - plane @ np.linalg.lstsq(plane[outside], share[outside], rcond=None)[0]
        wide = cv2.dilate(_raster(gx, gy, share > 0.25), np.ones((7, 7), np.uint8))
        dot = wide[gy - gy.min() + 4, gx - gx.min() + 4] > 0
        grain = robust_std(share[~dot]) if (~dot).sum() > 20 else 0.02
        gx, gy, share = gx[dot].astype(float), gy[dot].astype(float), share[dot]
        centre[k] = np.array([gx @ share, gy @ share]) / share.sum()
        lever = np.sqrt((((gx - centre[k, 0]) ** 2 + (gy - centre[k, 1]) ** 2).sum()) / 2)
        noise[k] = grain * lever / share.sum()
    return centre, noise


def _raster(x: NDArray[np.int64], y: NDArray[np.int64], value: NDArray[np.bool_]) -> NDArray[np.uint8]:
    out = np.zeros((y.max() - y.min() + 9, x.max() - x.min() + 9), np.uint8)
    out[y - y.min() + 4, x - x.min() + 4] = value
    return out


def centroid_bias(node: Node, pixel: Array, radius: float) -> Array:
    """Centroid of the picture of a disc minus the picture of its centre, px; radius in meshes."""
    smooth = SmoothMap(node, pixel, max(1.0, 0.1 * mesh_length(node, pixel)))
    rings, spokes = 4, 12
    r = radius * np.sqrt((np.arange(rings) + 0.5) / rings)  # rings of equal area
    a = 2 * np.pi * np.arange(spokes) / spokes
    offset = (r[:, None, None] * np.stack([np.cos(a), np.sin(a)], -1)).reshape(-1, 2)
    at = (node[:, None] + offset).reshape(-1, 2)
    place = smooth(at).reshape(len(node), -1, 2)
    area = np.abs(np.linalg.det(smooth.slopes(at))).reshape(len(node), -1, 1)
    out: Array = (place * area).sum(1) / area.sum(1) - smooth(node.astype(float))
    return out


def mesh_length(node: Node, pixel: Array) -> float:
    """Shortest distance between neighbouring nodes, px (first percentile)."""
    distance, near = cKDTree(node).query(node, k=5, distance_upper_bound=1.01)
    a, b = np.nonzero(np.isfinite(distance) & (distance > 0))
    if not len(a):
        return 4.0
    return float(np.percentile(np.hypot(*(pixel[a] - pixel[near[a, b]]).T), 1))
