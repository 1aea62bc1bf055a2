"""Grids of AprilTags, as Kalibr and others print them."""

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.calibration.patterns import as_bytes, make_points, shape_of
from wavefield.calibration.points import TargetPoints
from wavefield.calibration.target import Target
from wavefield.errors import CalibrationError

Array = NDArray[np.float64]

_FEWEST = 8  # tags


def find_aprilgrid(image: NDArray[np.float32], target: Target) -> TargetPoints:
    """Find the middles of the tags of an AprilGrid, also when it is partly out of view.

    With image (row, column).
    """
    nx, ny = shape_of(target)
    code = getattr(cv2.aruco, target.dictionary, None)
    if not isinstance(code, int):
        raise CalibrationError(
            f"tag family {target.dictionary!r} is not known; use OpenCV's name, e.g. DICT_APRILTAG_36h11"
        )
    ids, corners, edge = _detect(as_bytes(image), code)
    known = (ids < nx * ny) & (np.bincount(ids, minlength=nx * ny)[ids] == 1)
    room = np.array([_half(tag, edge) + 2 for tag in corners])[:, None]  # for the window around each corner
    size = np.array(image.shape[::-1])
    known &= ((corners.min(1) > room) & (corners.max(1) < size - 1 - room)).all(1)
    ids, corners = ids[known], corners[known]
    if len(ids) < _FEWEST:
        raise CalibrationError(
            f"only {len(ids)} tags of an AprilGrid of {nx} x {ny} were found; at least {_FEWEST} are needed "
            "(check dictionary, focus and light, and that the image is not mirrored)"
        )
    node = np.stack([ids % nx, ids // nx], -1).astype(np.int64)
    return make_points(image, node, _middles(_refined(image, corners, edge)), ())


def _detect(image: NDArray[np.uint8], code: int) -> tuple[NDArray[np.int64], Array, float]:
    """Numbers (n,) and corners (n, 4, 2) of tags, and what fraction of their sides their black border is.

    The border is two cells wide (Kalibr) or one.
    """
    most: tuple[NDArray[np.int64], Array, float] = (np.empty(0, np.int64), np.empty((0, 4, 2)), 0.0)
    dictionary = cv2.aruco.getPredefinedDictionary(code)
    for border in (2, 1):
        how = cv2.aruco.DetectorParameters()
        how.markerBorderBits = border
        how.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_CONTOUR
        corners, ids, _ = cv2.aruco.ArucoDetector(dictionary, how).detectMarkers(image)
        if ids is not None and len(ids) > len(most[0]):
            edge = border / (dictionary.markerSize + 2 * border)
            most = ids.ravel().astype(np.int64), np.asarray(corners, float).reshape(-1, 4, 2), edge
    return most


def _refined(image: NDArray[np.float32], corners: Array, edge: float) -> Array:
    """Corners where the edges of each tag cross, seen in windows that reach no cell within its border."""
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 60, 1e-4)
    out = np.empty_like(corners)
    for k, tag in enumerate(corners):
        half = _half(tag, edge)
        start = tag.astype(np.float32).reshape(-1, 1, 2)
        out[k] = cv2.cornerSubPix(image, start, (half, half), (-1, -1), criteria).reshape(-1, 2)
    return out


def _half(tag: Array, edge: float) -> int:
    """Half of the side of a window that reaches no cell within a tag's border, px."""
    side = float(np.hypot(*(tag - np.roll(tag, 1, axis=0)).T).min())
    return int(np.clip(0.8 * edge * side, 2, 15))


def _middles(corners: Array) -> Array:
    """Where the diagonals of quadrangles (n, 4, 2) cross."""
    a, b, c, d = np.moveaxis(corners, 1, 0)
    p, q = c - a, d - b
    along = ((b - a)[:, 0] * q[:, 1] - (b - a)[:, 1] * q[:, 0]) / (p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])
    return np.asarray(a + along[:, None] * p)
