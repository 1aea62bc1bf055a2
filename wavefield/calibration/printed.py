"""Find chessboards, ChArUco boards and AprilGrids with OpenCV."""

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.calibration.blobs import (
    as_bytes,
    corner_subpixel,
    halved,
    make_points,
    marker_dictionary,
    right_handed,
    shape_of,
)
from wavefield.calibration.lattice import SmoothMap, mesh_length
from wavefield.calibration.observations import LIMITS
from wavefield.calibration.points import Image, Nodes, TargetPoints
from wavefield.calibration.target import Target
from wavefield.errors import CalibrationError
from wavefield.rig.lens import Array

EDGE_LENGTH = 0.42  # meshes along the edges of squares that place a corner of a ChArUco board
MAX_ITERATIONS = 12  # of the window around such a corner
MAX_SEARCH_SIZE = 1500  # px; larger images are first searched at half size


def find_chessboard(image: Image, target: Target) -> TargetPoints:
    """Find the inner corners of a chessboard that is completely in view."""
    nx, ny = shape_of(target)
    pixel = _chessboard_corners(image, (nx, ny))
    if pixel is None:
        raise CalibrationError(
            f"no chessboard with {nx} x {ny} inner corners was found; all of it must be in view and "
            "in focus, with a white margin around it"
        )
    node = np.stack(np.meshgrid(np.arange(nx), np.arange(ny)), -1).reshape(-1, 2)
    pixel = _refined(image, node, pixel)
    node, notes = right_handed(image, node, pixel, (nx, ny))
    return make_points(image, node, pixel, notes)


def _refined(image: Image, node: Nodes, pixel: Array) -> Array:
    return corner_subpixel(image, pixel, int(np.clip(0.35 * mesh_length(node, pixel), 2, 7)))


def _chessboard_corners(image: Image, shape: tuple[int, int]) -> Array | None:
    """Corners by every detector that OpenCV has, quick ones first: each misses boards that another finds."""
    full = as_bytes(image)
    small, factor = halved(full, MAX_SEARCH_SIZE)
    equalized = np.asarray(cv2.equalizeHist(small), np.uint8)
    normal, exhaustive = cv2.CALIB_CB_NORMALIZE_IMAGE, cv2.CALIB_CB_EXHAUSTIVE
    accurate = exhaustive | cv2.CALIB_CB_ACCURACY
    tries: list[tuple[NDArray[np.uint8], float, int]] = [
        (small, factor, normal | exhaustive),
        (small, factor, 0),
        (small, factor, normal),
        (small, factor, exhaustive),
        (small, factor, accurate),
        (equalized, factor, accurate),
    ]
    if factor != 1.0:
        tries += [(full, 1.0, normal | exhaustive), (full, 1.0, accurate)]
    for picture, scale, flags in tries:
        found, corners = cv2.findChessboardCornersSB(picture, shape, flags=flags)
        if found:
            return np.asarray((corners.reshape(-1, 2) + 0.5) * scale - 0.5, float)
    adaptive = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FILTER_QUADS
    for picture in (small, equalized):
        found, corners = cv2.findChessboardCorners(picture, shape, flags=adaptive)
        if found:
            return np.asarray((corners.reshape(-1, 2) + 0.5) * factor - 0.5, float)
    return None


def find_charuco(image: Image, target: Target) -> TargetPoints:
    """Find the chessboard corners of a ChArUco board, also when it is partly out of view."""
    nx, ny = shape_of(target)
    grey, marker = as_bytes(image), float(target.marker or 0.0)
    dictionary = marker_dictionary(target, "marker dictionary")
    board = cv2.aruco.CharucoBoard((nx, ny), target.mesh, marker, dictionary)

    def detect(picture: NDArray[np.uint8]) -> tuple[Nodes, Array]:
        best: tuple[Nodes, Array] = (np.empty(0, np.int64), np.empty((0, 2)))
        # boards with an even number of rows were made otherwise before OpenCV 4.6
        for legacy in (False, True):
            board.setLegacyPattern(legacy)
            corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(picture)
            if ids is not None and len(ids) > len(best[0]):
                best = ids.ravel().astype(np.int64), corners.reshape(-1, 2).astype(float)
        return best

    ids, pixel = detect(grey)
    if len(ids) < LIMITS.min_nodes:
        if len(detect(np.ascontiguousarray(grey[:, ::-1]))[0]) > len(ids):
            raise CalibrationError(
                "the image of the ChArUco board is mirrored; export it from the camera unflipped"
            )
        raise CalibrationError(
            f"only {len(ids)} corners of a ChArUco board of {nx} x {ny} squares were found; at least "
            f"{LIMITS.min_nodes} are needed (check dictionary, focus and light)"
        )
    node = np.stack([ids % (nx - 1), ny - 2 - ids // (nx - 1)], -1)
    pixel = _between_markers(image, node, pixel, 0.5 * (1 - marker / target.mesh))
    return make_points(image, node, pixel)


def _between_markers(image: Image, node: Nodes, pixel: Array, gap: float) -> Array:
    """Corners where the squares' edges cross, from the gaps (meshes) between squares and markers.
    Only pixels of the gap are used: a plain window would contain part of the markers' edges.
    """
    gx, gy = (cv2.Sobel(image, cv2.CV_32F, dx, 1 - dx, scale=0.125) for dx in (1, 0))
    try:
        slopes = SmoothMap(node, pixel, np.inf).slopes(node)
    except (ValueError, np.linalg.LinAlgError):
        return _refined(image, node, pixel)
    height, width = image.shape
    out = pixel.copy()
    for k, (e1, e2) in enumerate(slopes):
        near = gap - 2.0 / min(np.hypot(*e1), np.hypot(*e2))  # the lens spreads a marker's edge by 2 px
        if near < 0.03:
            continue
        to_board = np.linalg.inv(np.stack([e1, e2], -1))
        reach = int(np.ceil(EDGE_LENGTH * (np.abs(e1) + np.abs(e2)).max()))
        for _ in range(MAX_ITERATIONS):
            x, y = np.rint(out[k]).astype(int)
            if not (reach < x < width - reach - 1 and reach < y < height - reach - 1):
                break
            window = slice(y - reach, y + reach + 1), slice(x - reach, x + reach + 1)
            offset = (
                np.stack(np.meshgrid(*(np.arange(c - reach, c + reach + 1) for c in (x, y))), -1) - out[k]
            )
            u, v = np.abs(np.einsum("ab,yxb->ayx", to_board, offset))
            used = (np.minimum(u, v) < near) & (np.maximum(u, v) < EDGE_LENGTH)
            g = np.stack([gx[window][used], gy[window][used]])
            step = np.linalg.lstsq(g @ g.T, g @ np.sum(g * offset[used].T, axis=0), rcond=None)[0]
            out[k] += np.clip(step, -1, 1)
            if np.abs(step).max() < 1e-3:
                break
    return out


def find_aprilgrid(image: Image, target: Target) -> TargetPoints:
    """Find the middles of the tags of an AprilGrid, also when it is partly out of view."""
    nx, ny = shape_of(target)
    ids, corners, border = _detect(as_bytes(image), marker_dictionary(target, "tag family"))
    usable = (ids < nx * ny) & (np.bincount(ids, minlength=nx * ny)[ids] == 1)
    margin = np.array([_half_window(tag, border) + 2 for tag in corners])[:, None]
    size = np.array(image.shape[::-1])
    usable &= ((corners.min(1) > margin) & (corners.max(1) < size - 1 - margin)).all(1)
    ids, corners = ids[usable], corners[usable]
    if len(ids) < LIMITS.min_nodes:
        raise CalibrationError(
            f"only {len(ids)} tags of an AprilGrid of {nx} x {ny} were found; {LIMITS.min_nodes} or more are "
            "needed (check dictionary, focus and light, and that the image is not mirrored)"
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
