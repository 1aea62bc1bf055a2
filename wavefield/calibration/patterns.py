"""Printed targets: chessboard, round dots, ChArUco."""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from wavefield.calibration.blobs import centroid_bias, centroids, find_blobs, mesh_length
from wavefield.calibration.points import TargetPoints
from wavefield.calibration.target import Target
from wavefield.calibration.target_lattice import Candidates, SmoothMap, TargetLattice
from wavefield.errors import CalibrationError

Array = NDArray[np.float64]
Node = NDArray[np.int64]

_ALONG = 0.42  # meshes along the edges of squares that place a corner of a ChArUco board
_TURNS = 12  # looks at a corner, the window brought along
LARGEST = 1500  # px; larger pictures are first searched at half size


def find_chessboard(image: NDArray[np.float32], target: Target) -> TargetPoints:
    """Find the inner corners of a chessboard that is wholly in view.

    With image (row, column).
    """
    nx, ny = shape_of(target)
    found = _chessboard_corners(image, (nx, ny))
    if found is None:
        raise CalibrationError(
            f"no chessboard with {nx} x {ny} inner corners was found; all of it must be in view and "
            "in focus, with a white margin around it"
        )
    pixel = found
    node = np.stack(np.meshgrid(np.arange(nx), np.arange(ny)), -1).reshape(-1, 2)
    pixel = _corner_subpixel(image, node, pixel)
    node, notes = _right_handed(image, node, pixel, (nx, ny))
    return make_points(image, node, pixel, notes)


def _chessboard_corners(image: NDArray[np.float32], shape: tuple[int, int]) -> Array | None:
    """Corners by every detector that OpenCV has, quick ones first: each misses boards that another finds."""
    small, factor = _searchable(image)
    whole = as_bytes(image)
    even = np.asarray(cv2.equalizeHist(small), np.uint8)
    normal, exhaustive, accurate = (
        cv2.CALIB_CB_NORMALIZE_IMAGE,
        cv2.CALIB_CB_EXHAUSTIVE,
        cv2.CALIB_CB_ACCURACY,
    )
    tries: list[tuple[NDArray[np.uint8], float, int]] = [
        (small, factor, normal | exhaustive),
        (small, factor, 0),
        (small, factor, normal),
        (small, factor, exhaustive),
        (small, factor, exhaustive | accurate),
        (even, factor, exhaustive | accurate),
    ]
    if factor != 1.0:
        tries += [(whole, 1.0, normal | exhaustive), (whole, 1.0, exhaustive | accurate)]
    for picture, scale, flags in tries:
        found, corners = cv2.findChessboardCornersSB(picture, shape, flags=flags)
        if found:
            return np.asarray((corners.reshape(-1, 2) + 0.5) * scale - 0.5, float)
    adaptive = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    for picture in (small, even):
        found, corners = cv2.findChessboardCorners(picture, shape, flags=adaptive | cv2.CALIB_CB_FILTER_QUADS)
        if found:
            return np.asarray((corners.reshape(-1, 2) + 0.5) * factor - 0.5, float)
    return None


def find_charuco(image: NDArray[np.float32], target: Target) -> TargetPoints:
    """Find the chessboard corners of a ChArUco board, also when it is partly out of view.

    With image (row, column).
    """
    nx, ny = shape_of(target)
    code = getattr(cv2.aruco, target.dictionary, None)
    if not isinstance(code, int):
        raise CalibrationError(
            f"marker dictionary {target.dictionary!r} is not known; use OpenCV's name, e.g. DICT_4X4_50"
        )
    grey = as_bytes(image)
    dictionary = cv2.aruco.getPredefinedDictionary(code)
    board = cv2.aruco.CharucoBoard((nx, ny), target.mesh, float(target.marker or 0.0), dictionary)

    def detect(picture: NDArray[np.uint8]) -> tuple[NDArray[np.int64], Array]:
        most: tuple[NDArray[np.int64], Array] = (np.empty(0, np.int64), np.empty((0, 2)))
        for legacy in (
            False,
            True,
        ):  # boards with an even number of rows were made otherwise before OpenCV 4.6
            board.setLegacyPattern(legacy)
            corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(picture)
            if ids is not None and len(ids) > len(most[0]):
                most = ids.ravel().astype(np.int64), corners.reshape(-1, 2).astype(float)
        return most

    ids, pixel = detect(grey)
    if len(ids) < 8:
        if len(detect(np.ascontiguousarray(grey[:, ::-1]))[0]) > len(ids):
            raise CalibrationError(
                "the picture of the ChArUco board is mirrored; export it from the camera unflipped"
            )
        raise CalibrationError(
            f"only {len(ids)} corners of a ChArUco board of {nx} x {ny} squares were found; at least 8 are "
            "needed (check dictionary, focus and light)"
        )
    node = np.stack([ids % (nx - 1), ny - 2 - ids // (nx - 1)], -1)
    pixel = _between_markers(image, node, pixel, 0.5 * (1 - float(target.marker or 0.0) / target.mesh))
    return make_points(image, node, pixel, ())


def find_dots(image: NDArray[np.float32], target: Target) -> TargetPoints:
    """Find the centres of a rectangular grid of round dots, dark on bright or bright on dark.

    In perspective the centroid of a disc's picture is not the picture of its centre. The difference is
    computed by integrating the fitted map over the disc, and subtracted.

    With image (row, column).
    """
    shape = shape_of(target)
    best: tuple[Node, Array, NDArray[np.float32]] | None = None
    most = 0
    for polarity in (image, 255.0 - image):
        blobs, area = find_blobs(polarity)
        lattice = _dot_lattice(blobs, area, polarity.shape[::-1])
        if lattice is None:
            continue
        node, pixel = lattice.node, lattice.pixel
        most = max(most, len(node))
        fit = _window(node, shape)
        if fit is not None and (best is None or len(fit[0]) > len(best[0])):
            best = node[fit[0]] - fit[1], pixel[fit[0]], polarity
    if best is None:
        raise CalibrationError(
            f"no grid of {shape[0]} x {shape[1]} dots was found (the largest regular grid has {most}); "
            "all of it must be in view and in focus"
        )
    node, pixel, polarity = best
    span = node.max(0) + 1
    if tuple(span) != shape:  # the lattice's first axis is the target's second
        node = np.stack([node[:, 1], span[0] - 1 - node[:, 0]], -1)
    node, notes = _right_handed(None, node, pixel, shape)
    pixel, noise = centroids(polarity, node, pixel)
    if target.diameter is None:
        notes = (*notes, "centroids not corrected for perspective: state the target's diameter")
    else:
        pixel = pixel - centroid_bias(node, pixel, 0.5 * target.diameter / target.mesh)
    return make_points(image, node, pixel, notes, noise)


# -- shared -------------------------------------------------------------------------------------------


def shape_of(target: Target) -> tuple[int, int]:
    """Nodes along x and y of a target that has a shape."""
    assert target.shape is not None  # Target refuses these kinds without a shape
    return target.shape


def as_bytes(image: NDArray[np.float32]) -> NDArray[np.uint8]:
    """A picture as OpenCV's detectors want it."""
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def _searchable(image: NDArray[np.float32]) -> tuple[NDArray[np.uint8], float]:
    """The picture as bytes, small enough to be searched, and the factor back to its own pixels."""
    grey, factor = as_bytes(image), 1.0
    while max(grey.shape) > LARGEST:
        half = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        grey, factor = np.asarray(half, np.uint8), factor * 2
    return grey, factor


def _corner_subpixel(image: NDArray[np.float32], node: Node, pixel: Array) -> Array:
    half = int(np.clip(0.35 * mesh_length(node, pixel), 2, 7))
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 60, 1e-4)
    start = pixel.astype(np.float32).reshape(-1, 1, 2)
    return cv2.cornerSubPix(image, start, (half, half), (-1, -1), criteria).reshape(-1, 2).astype(float)


def _between_markers(image: NDArray[np.float32], node: Node, pixel: Array, gap: float) -> Array:
    """Corners where the squares' edges cross, seen through the gaps between squares and markers.

    The edges of a marker lie so near that a plain window takes part of them: only what lies within ``gap``
    (in meshes) of the squares' own edges counts, and all the more of their length does.
    """
    gx, gy = (cv2.Sobel(image, cv2.CV_32F, dx, 1 - dx, scale=0.125) for dx in (1, 0))
    try:
        slopes = SmoothMap(node, pixel, np.inf).slopes(node)
    except (ValueError, np.linalg.LinAlgError):
        return _corner_subpixel(image, node, pixel)
    height, width = image.shape
    out = pixel.copy()
    for k, (e1, e2) in enumerate(slopes):
        near = gap - 2.0 / min(np.hypot(*e1), np.hypot(*e2))  # the lens spreads a marker's edge by 2 px
        if near < 0.03:
            continue
        to_board = np.linalg.inv(np.stack([e1, e2], -1))
        reach = int(np.ceil(_ALONG * (np.abs(e1) + np.abs(e2)).max()))
        for _ in range(_TURNS):
            x, y = np.rint(out[k]).astype(int)
            if not (reach < x < width - reach - 1 and reach < y < height - reach - 1):
                break
            window = slice(y - reach, y + reach + 1), slice(x - reach, x + reach + 1)
            at = np.stack(np.meshgrid(*(np.arange(c - reach, c + reach + 1) for c in (x, y))), -1) - out[k]
            u, v = np.abs(np.einsum("ab,yxb->ayx", to_board, at))
            counts = (np.minimum(u, v) < near) & (np.maximum(u, v) < _ALONG)
            g = np.stack([gx[window][counts], gy[window][counts]])
            step = np.linalg.lstsq(g @ g.T, g @ np.sum(g * at[counts].T, axis=0), rcond=None)[0]
            out[k] += np.clip(step, -1, 1)
            if np.abs(step).max() < 1e-3:
                break
    return out


def _right_handed(
    image: NDArray[np.float32] | None, node: Node, pixel: Array, shape: tuple[int, int]
) -> tuple[Node, tuple[str, ...]]:
    """Number a full grid so that it is right-handed seen from above, and as unambiguously as possible.

    With an image, squares of a chessboard decide: the one between nodes (0, 0) and (1, 1) is dark.
    """
    last = np.array(shape) - 1
    smooth = SmoothMap(node, pixel, np.inf)
    e1, e2 = smooth.slopes(last[None] / 2)[0]
    if e1[0] * e2[1] - e1[1] * e2[0] > 0:
        node = np.stack([node[:, 0], last[1] - node[:, 1]], -1)
    turns = [node, last - node]
    if shape[0] == shape[1]:
        quarter = np.stack([node[:, 1], last[0] - node[:, 0]], -1)
        turns += [quarter, last - quarter]
    if image is not None:
        turns = [turn for turn in turns if _first_square_dark(image, turn, pixel, shape)] or turns

    def to_the_right(turn: Node) -> float:
        slope = np.linalg.lstsq(np.c_[turn, np.ones(len(turn))], pixel[:, 0], rcond=None)[0]
        return float(slope[0])

    chosen = max(turns, key=to_the_right)
    if len(turns) > 1:
        return chosen, (
            f"the target looks the same in {len(turns)} positions: x is taken to the right in the image",
        )
    return chosen, ()


def _first_square_dark(image: NDArray[np.float32], node: Node, pixel: Array, shape: tuple[int, int]) -> bool:
    a, b = (v.ravel() for v in np.meshgrid(np.arange(shape[0] - 1), np.arange(shape[1] - 1)))
    x, y = np.rint(SmoothMap(node, pixel, np.inf)(np.stack([a, b], -1) + 0.5)).astype(int).T
    height, width = image.shape
    grey = image[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)]
    even = (a + b) % 2 == 0
    return bool(np.median(grey[even]) < np.median(grey[~even]))


def make_points(
    image: NDArray[np.float32], node: Node, pixel: Array, notes: tuple[str, ...], noise: Array | float = 0.0
) -> TargetPoints:
    """Points with their uncertainty: what noise causes, or the scatter about a smooth map if larger."""
    try:
        smooth = SmoothMap(node, pixel, max(1.0, 0.1 * mesh_length(node, pixel)))
    except ValueError:
        raise CalibrationError("the points found do not lie on a plane target; photograph it again") from None
    free = max(len(node) - 4 - len(smooth.powers), 1)
    scatter = float(
        np.sqrt(np.minimum(smooth.misfit, 6 * smooth.spread) ** 2 @ np.ones(len(node)) / (2 * free))
    )
    keep = smooth.misfit < max(6 * smooth.spread * 1.2, 0.1)
    if (~keep).any():
        notes = (*notes, f"{(~keep).sum()} of {len(keep)} points out of place were left out")
    std = np.maximum(np.broadcast_to(noise, len(node)), scatter)
    height, width = image.shape
    return TargetPoints(node[keep], pixel[keep], std[keep], (width, height), notes)


# -- dots ---------------------------------------------------------------------------------------------


def _dot_lattice(blobs: Array, area: Array, size: tuple[int, int]) -> TargetLattice | None:
    """The largest lattice grown from blobs near the middle and their nearest neighbours."""
    if len(blobs) < 9:
        return None
    tree = cKDTree(blobs)
    best: TargetLattice | None = None
    for k in np.argsort(np.hypot(*(blobs - np.median(blobs, 0)).T))[:6]:
        _, near = tree.query(blobs[k], min(9, len(blobs)))
        arms = blobs[near[1:]] - blobs[k]
        for b in range(1, len(arms)):
            cross = arms[0][0] * arms[b][1] - arms[0][1] * arms[b][0]
            if abs(cross) < 0.3 * np.hypot(*arms[0]) * np.hypot(*arms[b]):
                continue
            lattice = TargetLattice(blobs[k], arms[0], arms[b])
            lattice.grow(Candidates(blobs, area, 1.0), size)
            if best is None or len(lattice) > len(best):
                best = lattice
            break
    return best


def _window(node: Node, shape: tuple[int, int]) -> tuple[NDArray[np.bool_], Node] | None:
    """Nodes of the full rectangle of this shape (either way round) within a lattice, and its first node."""
    known = set(map(tuple, node))
    for nx, ny in {shape, shape[::-1]}:
        for i in range(node[:, 0].min(), node[:, 0].max() - nx + 2):
            for j in range(node[:, 1].min(), node[:, 1].max() - ny + 2):
                if all((i + a, j + b) in known for a in range(nx) for b in range(ny)):
                    first = np.array([i, j])
                    inside = ((node >= first) & (node < first + np.array([nx, ny]))).all(1)
                    return (inside, first) if inside.sum() == len(node) else None
    return None
