"""Grids of AprilTags, as Kalibr and others print them."""

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.calibration.points import Image, Nodes, TargetPoints
from wavefield.calibration.printed_points import (
    as_bytes,
    corner_subpixel,
    make_points,
    marker_dictionary,
    shape_of,
)
from wavefield.calibration.target import Target
from wavefield.errors import CalibrationError
from wavefield.rig.lens import Array

MIN_TAGS = 8


def find_aprilgrid(image: Image, target: Target) -> TargetPoints:
    """Find the middles of the tags of an AprilGrid, also when it is partly out of view."""
    nx, ny = shape_of(target)
    ids, corners, border = _detect(as_bytes(image), marker_dictionary(target, "tag family"))
    usable = (ids < nx * ny) & (np.bincount(ids, minlength=nx * ny)[ids] == 1)
    margin = np.array([_half_window(tag, border) + 2 for tag in corners])[:, None]
    size = np.array(image.shape[::-1])
    usable &= ((corners.min(1) > margin) & (corners.max(1) < size - 1 - margin)).all(1)
    ids, corners = ids[usable], corners[usable]
    if len(ids) < MIN_TAGS:
        raise CalibrationError(
            f"only {len(ids)} tags of an AprilGrid of {nx} x {ny} were found; at least {MIN_TAGS} are needed "
            "(check dictionary, focus and light, and that the image is not mirrored)"
        )
    node = np.stack([ids % nx, ids // nx], -1).astype(np.int64)
    refined = np.array([corner_subpixel(image, tag, _half_window(tag, border)) for tag in corners])
    return make_points(image, node, _middles(refined))


def _detect(image: NDArray[np.uint8], dictionary: cv2.aruco.Dictionary) -> tuple[Nodes, Array, float]:
    """Numbers (n,) and corners (n, 4, 2) of tags, and the fraction of their sides that is black border.
    The border is two cells wide (Kalibr) or one.
    """
    best: tuple[Nodes, Array, float] = (np.empty(0, np.int64), np.empty((0, 4, 2)), 0.0)
    for cells in (2, 1):
        parameters = cv2.aruco.DetectorParameters()
        parameters.markerBorderBits = cells
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_CONTOUR
        corners, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(image)
        if ids is not None and len(ids) > len(best[0]):
            border = cells / (dictionary.markerSize + 2 * cells)
            best = ids.ravel().astype(np.int64), np.asarray(corners, float).reshape(-1, 4, 2), border
    return best


def _half_window(tag: Array, border: float) -> int:
    """Half the side of a window that reaches no cell within a tag's border, px."""
    side = float(np.hypot(*(tag - np.roll(tag, 1, axis=0)).T).min())
    return int(np.clip(0.8 * border * side, 2, 15))


def _middles(corners: Array) -> Array:
    """Where the diagonals of quadrangles (n, 4, 2) cross."""
    a, b, c, d = np.moveaxis(corners, 1, 0)
    p, q = c - a, d - b
    along = ((b - a)[:, 0] * q[:, 1] - (b - a)[:, 1] * q[:, 0]) / (p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])
    return np.asarray(a + along[:, None] * p)
