"""Which target some images show, where the stated one is not found in them."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.calibration.blobs import find_blobs
from wavefield.calibration.dots import dot_lattice
from wavefield.calibration.find import scaled
from wavefield.calibration.points import Image, Nodes
from wavefield.calibration.printed_points import as_bytes, halved
from wavefield.calibration.strings import find_strings
from wavefield.calibration.target import Target
from wavefield.errors import CalibrationError, FrameError
from wavefield.images import read_image
from wavefield.rig.lens import Array

IMAGES_TRIED = 3
MIN_MARKERS = 6  # of a board: fewer may be found in texture
MIN_DOTS = 25
MIN_CORNERS = 20
MAX_MISFIT = 0.05  # of the mesh, rms, with the distortion of the lens
MIN_SHARE = 0.5  # of the blobs of an image: lattices grow in texture too
MAX_SIDE = 1500  # px; larger images are searched at half size
_TAGS = ("DICT_APRILTAG_36h11",)
_MARKERS = ("DICT_4X4_250", "DICT_5X5_250", "DICT_6X6_250", "DICT_7X7_250", "DICT_ARUCO_ORIGINAL")


def likely_target(paths: Sequence[Path], stated: Target) -> str:
    """What most of some images show, for a note; empty if it is as stated or nothing that is known."""
    if not paths:
        return ""
    tried = [paths[k] for k in np.unique(np.linspace(0, len(paths) - 1, IMAGES_TRIED).astype(int))]
    found = Counter(words for path in tried if (words := _shown(path, stated)))
    words, count = found.most_common(1)[0] if found else ("", 0)
    return words if count > len(tried) / 2 else ""


def _shown(path: Path, stated: Target) -> str:
    try:
        image = scaled(read_image(path))
    except (CalibrationError, FrameError):
        return ""
    small, _ = halved(as_bytes(image), MAX_SIDE)
    # a chessboard's squares and the holes of a grid of strings are blobs too: dots come last
    if _has_strings(image):
        return "" if stated.kind == "strings" else _words("strings", "strings", stated)
    for kind, dictionaries in (("aprilgrid", _TAGS), ("charuco", _MARKERS)):
        if any(_has_markers(small, name) for name in dictionaries):
            return _words(kind, "AprilTags" if kind == "aprilgrid" else "a ChArUco board", stated)
    if shape := _chessboard(small):
        nx, ny = shape
        known = stated.kind == "chessboard" and sorted(stated.shape or ()) == sorted(shape)
        return "" if known else f"these look like a chessboard: `kind: chessboard, shape: [{nx}, {ny}]`"
    if _has_dots(image) and stated.kind != "two-level":
        return _words("dots", "dots", stated)
    return ""


def _words(kind: str, what: str, stated: Target) -> str:
    if kind == stated.kind:
        return f"these look like {what} of another `shape` or `dictionary`"
    return f"these look like {what}: `kind: {kind}`"


def _has_markers(image: NDArray[np.uint8], name: str) -> bool:
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    _, ids, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(image)
    return ids is not None and len(np.unique(ids)) >= MIN_MARKERS


def _chessboard(image: NDArray[np.uint8]) -> tuple[int, int] | None:
    """Inner corners along the longer and the shorter side of a chessboard."""
    flags = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE
    found, corners, meta = cv2.findChessboardCornersSBWithMeta(image, (4, 4), flags)
    if not found:
        return None
    rows, columns = meta.shape[:2]
    node = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), -1).reshape(-1, 2)
    if len(node) < MIN_CORNERS or not _is_plane_grid(node, np.asarray(corners.reshape(-1, 2), float)):
        return None
    return max(rows, columns), min(rows, columns)


def _has_strings(image: Image) -> bool:
    try:
        return len(find_strings(image, Target("strings", mesh=0.1))) > 0
    except CalibrationError:
        return False


def _has_dots(image: Image) -> bool:
    for polarity in (image, 255.0 - image):
        centre, area = find_blobs(polarity)
        lattice = dot_lattice(centre, area, polarity.shape[::-1])
        enough = lattice is not None and len(lattice) >= max(MIN_DOTS, MIN_SHARE * len(centre))
        if lattice is not None and enough and _is_plane_grid(lattice.node, lattice.pixel):
            return True
    return False


def _is_plane_grid(node: Nodes, pixel: Array) -> bool:
    """Whether points (n, 2), px, are a plane grid in perspective; what is found in texture is not."""
    homography, _ = cv2.findHomography(node.astype(float), pixel.astype(float))
    if homography is None:
        return False
    there = cv2.perspectiveTransform(node[None].astype(float), homography)[0]
    mesh = np.sqrt(
        abs(np.linalg.det(np.linalg.lstsq(node - node.mean(0), pixel - pixel.mean(0), rcond=None)[0]))
    )
    return bool(np.sqrt(np.mean((there - pixel) ** 2)) < MAX_MISFIT * mesh)
