"""The horizon in an image: where it is, and the vertical that it gives."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.rig import Camera
from wavefield.rig.lens import Array

EARTH_RADIUS = 6.371e6 / 0.87  # m; light is bent by the air as if the Earth were larger (Bomford 1980)
SMOOTHING = 2.0  # px: of the mean image, for its gradient
COLUMNS = 160  # at which the horizon is searched, at most
EDGES = 4  # of each column that may be the horizon, the strongest ones
MAX_MISFIT = 1.0  # px, of a point of the horizon from its line
MIN_SHARE = 0.7  # of the columns that show the line
MIN_CONTRAST = 5.0  # noise levels of the gradient
TRIALS = 2000
MAX_SKY_MOTION = 0.5  # of the changes with time above the line over those below it
BAND = 0.05  # of the image's height on either side of the line, where the two are compared


def dip(height: float) -> float:
    """Angle of the horizon below the horizontal, rad, from a height above the sea, m; usual refraction."""
    return float(np.sqrt(2.0 * max(height, 0.0) / EARTH_RADIUS))


def find_horizon(images: Sequence[NDArray[np.generic]], camera: Camera) -> Array | None:
    """Points (X, Y) of the horizon, (n, 2), px, in images (row, column) of a camera that does not move.
    None without a straight line across the undistorted mean image; a roll of up to 45 degrees is allowed.
    """
    stack = [np.asarray(image, np.float32) for image in images]
    smooth = cv2.GaussianBlur(np.asarray(np.mean(stack, axis=0), np.float32), (0, 0), SMOOTHING)
    mean = np.asarray(smooth, np.float32)
    gradient = np.zeros_like(mean)
    # steep across the horizon; below it the images change (waves), above it they hardly do
    gradient[1:-1] = 0.5 * (mean[2:] - mean[:-2])
    points, strength = _edges(gradient)
    if len(points) < 2:
        return None
    tangents = np.stack(camera.tangents(*points.T), axis=-1)
    columns = len(np.unique(points[:, 0]))
    inlier = _line(tangents, points[:, 0], strength, MAX_MISFIT / camera.fy)
    found = points[inlier]
    if len(np.unique(found[:, 0])) < MIN_SHARE * columns:
        return None
    if len(stack) > 1 and not _sea_below(stack, found):
        return None
    return found


def _edges(gradient: NDArray[np.float32]) -> tuple[Array, Array]:
    """Strongest local extremes of the gradient in some columns: (n, 2), px, and their strengths (n,)."""
    width = gradient.shape[1]
    noise = 1.4826 * float(np.median(np.abs(gradient)))
    points, strength = [], []
    for column in np.unique(np.linspace(4, width - 5, COLUMNS).astype(int)):
        line = np.abs(gradient[:, column])
        inner = line[1:-1]
        rows = 1 + np.flatnonzero((inner >= line[:-2]) & (inner > line[2:]) & (inner > MIN_CONTRAST * noise))
        rows = rows[np.argsort(line[rows])[::-1][:EDGES]]
        before, here, after = line[rows - 1], line[rows], line[rows + 1]
        peak = rows + 0.5 * (before - after) / np.minimum(before - 2.0 * here + after, -1e-9)
        points += [(float(column), float(row)) for row in peak]
        strength += here.tolist()
    return np.array(points, float).reshape(-1, 2), np.array(strength, float)


def _line(tangents: Array, column: Array, strength: Array, reach: float) -> NDArray[np.bool_]:
    """Points on the line, nearly from side to side, with the most strength on it (RANSAC), (n,)."""
    rng = np.random.default_rng(0)
    weight = np.minimum(strength, np.median(strength))
    best, inlier = 0.0, np.zeros(len(tangents), bool)
    for first, second in rng.integers(0, len(tangents), (TRIALS, 2)):
        along = tangents[second] - tangents[first]
        length = float(np.hypot(*along))
        if abs(along[0]) < 0.7 * length or length < 50 * reach:
            continue
        across = np.abs((tangents - tangents[first]) @ np.array([-along[1], along[0]]) / length)
        near = across < reach
        if (score := float(weight[near].sum())) > best:
            best, inlier = score, near
    for _ in range(3):
        if inlier.sum() < 2:
            break
        slope, offset = np.polyfit(tangents[inlier, 0], tangents[inlier, 1], 1)
        inlier = np.abs(tangents[:, 1] - slope * tangents[:, 0] - offset) < reach * np.hypot(1.0, slope)
    return inlier


def _sea_below(stack: Sequence[NDArray[np.float32]], line: Array) -> bool:
    """Whether what is well below a line (n, 2) changes with time, and what is above it hardly does."""
    height, width = stack[0].shape
    slope, offset = np.polyfit(line[:, 0], line[:, 1], 1)
    change = np.std(stack, axis=0)
    rows = np.arange(height)[:, None] - (offset + slope * np.arange(width))
    above, below = change[rows < -BAND * height], change[rows > BAND * height]
    if above.size < width or below.size < width:
        return bool(above.size < below.size)  # the line is at the image's edge: mostly sea
    return bool(np.median(above) < MAX_SKY_MOTION * np.percentile(below, 90))


def sight_lines(camera: Camera, points: Array) -> Array:
    """Unit sight lines (n, 3) of pixels (n, 2) in the camera's own frame."""
    a, b = camera.tangents(*points.T)
    rays = np.stack([a, b, np.ones_like(a)], axis=-1)
    return np.asarray(rays / np.linalg.norm(rays, axis=1)[:, None])
