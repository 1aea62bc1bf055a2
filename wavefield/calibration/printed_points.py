"""Printed targets: what all their finders share."""

import cv2
import numpy as np

from wavefield.calibration.blobs import centroid_bias, centroids
from wavefield.calibration.points import Image, Nodes, TargetPoints
from wavefield.calibration.smooth_map import SmoothMap, map_of_nodes
from wavefield.calibration.target import Target
from wavefield.calibration.target_lattice import cross
from wavefield.errors import CalibrationError
from wavefield.rig.lens import Array


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
