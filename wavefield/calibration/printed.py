"""Find chessboards and ChArUco boards with OpenCV."""

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.calibration.dots import make_points, number_right_handed, shape_of
from wavefield.calibration.lattice import mesh_length
from wavefield.calibration.observations import LIMITS
from wavefield.calibration.points import Image, Nodes, TargetPoints
from wavefield.calibration.target import Target
from wavefield.errors import CalibrationError
from wavefield.rig.lens import Array

MAX_SEARCH_SIZE = 1500  # px; larger images are halved for the search: OpenCV's detectors are slow on them


def find_chessboard(image: Image, target: Target) -> TargetPoints:
    """Find the inner corners of a chessboard, all of which must be in view."""
    nx, ny = shape_of(target)
    pixel = _chessboard_corners(image, (nx, ny))
    if pixel is None:
        raise CalibrationError(
            f"no chessboard with {nx} x {ny} inner corners was found; all of it must be in view and "
            "in focus, with a white margin around it"
        )
    node = np.stack(np.meshgrid(np.arange(nx), np.arange(ny)), -1).reshape(-1, 2)
    pixel = _refined(image, node, pixel)
    node, notes = number_right_handed(image, node, pixel, (nx, ny))
    return make_points(image, node, pixel, notes)


def _refined(image: Image, node: Nodes, pixel: Array, reach: float = 0.35) -> Array:
    """Return the corners (n, 2), px, refined by OpenCV's `cornerSubPix`.
    `reach` is half the width of the search windows, in distances between neighbouring corners."""
    half = int(np.clip(reach * mesh_length(node, pixel), 2, 7))
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 60, 1e-4)
    start = pixel.astype(np.float32).reshape(-1, 1, 2)
    return cv2.cornerSubPix(image, start, (half, half), (-1, -1), criteria).reshape(-1, 2).astype(float)


def _chessboard_corners(image: Image, shape: tuple[int, int]) -> Array | None:
    """Return the corners (n, 2), px, from the first OpenCV detector that finds them, or None.
    `shape` is the number of inner corners along x and y."""
    picture, factor = _as_bytes(image), 1.0
    while max(picture.shape) > MAX_SEARCH_SIZE:
        half = cv2.resize(picture, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        picture, factor = np.asarray(half, np.uint8), 2.0 * factor
    sector, classic = cv2.findChessboardCornersSB, cv2.findChessboardCorners
    adaptive = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FILTER_QUADS
    for detector, flags in (
        (sector, cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE),
        (sector, 0),
        (sector, cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY),
        (classic, adaptive),
    ):
        found, corners = detector(picture, shape, flags=flags)
        if found:
            return np.asarray((corners.reshape(-1, 2) + 0.5) * factor - 0.5, float)
    return None


def _as_bytes(image: Image) -> NDArray[np.uint8]:
    """Round the grey values of an image to integers from 0 to 255."""
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def find_charuco(image: Image, target: Target) -> TargetPoints:
    """Find the chessboard corners of a ChArUco board, which may be partly out of view.
    Raises a CalibrationError if too few are found, or if the marker dictionary is unknown."""
    nx, ny = shape_of(target)
    grey, marker = _as_bytes(image), float(target.marker or 0.0)
    code = getattr(cv2.aruco, target.dictionary, None)
    if not isinstance(code, int):
        raise CalibrationError(
            f"marker dictionary {target.dictionary!r} is unknown; use OpenCV's name, for example DICT_4X4_50"
        )
    dictionary = cv2.aruco.getPredefinedDictionary(code)
    board = cv2.aruco.CharucoBoard((nx, ny), target.mesh, marker, dictionary)

    ids, pixel = np.empty(0, np.int64), np.empty((0, 2))
    # OpenCV before 4.6 made boards with an even number of rows in another layout
    for legacy in (False, True):
        board.setLegacyPattern(legacy)
        corners, numbers, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(grey)
        if numbers is not None and len(numbers) > len(ids):
            ids, pixel = numbers.ravel().astype(np.int64), corners.reshape(-1, 2).astype(float)
    if len(ids) < LIMITS.min_nodes:
        raise CalibrationError(
            f"only {len(ids)} corners of a ChArUco board of {nx} x {ny} squares were found; at least "
            f"{LIMITS.min_nodes} are needed (check dictionary, focus and light; markers are dark on bright; "
            "mirrored images are not recognised)"
        )
    node = np.stack([ids % (nx - 1), ny - 2 - ids // (nx - 1)], -1)
    gap = 0.5 * (1 - marker / target.mesh)  # distance between a corner and the nearest marker, meshes
    pixel = _refined(image, node, pixel, gap)
    return make_points(image, node, pixel)
