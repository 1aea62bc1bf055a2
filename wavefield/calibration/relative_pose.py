"""Relative pose of two cameras from matched features of natural texture.

Use it for cameras at sea with known lenses and unknown poses. The pose of the second
camera is the one for which sight lines of matched features meet. The measured distance between the cameras
gives the scale.
"""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from wavefield.calibration.camera_start import Pose
from wavefield.calibration.observations import MIN_MATCHES
from wavefield.errors import RigError
from wavefield.rig import Camera
from wavefield.rig.field import MAX_DISTANCE_RATIO
from wavefield.rig.lens import Array
from wavefield.rig.stereo import epipolar_distance

Pixels = tuple[Array, Array]  # matched pixels (n, 2) in one image and (n, 2) in the other

MAX_FEATURES = 6000  # per image, for speed
MAX_RATIO = 0.8  # of the best to the second-best descriptor distance; larger ones are ambiguous (Lowe 2004)
MAX_EPIPOLAR_ERROR = 3.0  # px, of a correct match: features are found to about a pixel


def match_features(one: NDArray[np.generic], other: NDArray[np.generic]) -> Pixels:
    """Return the pixels, (n, 2) in each of two images, of SIFT features (Lowe 2004) that match both ways."""
    sift = cv2.SIFT.create(nfeatures=MAX_FEATURES)
    found = [sift.detectAndCompute(_bytes(image), None) for image in (one, other)]
    if any(len(points) < 2 for points, _ in found):
        return np.empty((0, 2)), np.empty((0, 2))
    (points_a, features_a), (points_b, features_b) = found
    forward, backward = _best_matches(features_a, features_b), _best_matches(features_b, features_a)
    mutual = [(i, j) for i, j in forward.items() if backward.get(j) == i]
    a = np.array([points_a[i].pt for i, _ in mutual], float).reshape(-1, 2)
    b = np.array([points_b[j].pt for _, j in mutual], float).reshape(-1, 2)
    return a, b


def _best_matches(one: cv2.typing.MatLike, other: cv2.typing.MatLike) -> dict[int, int]:
    pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(one, other, k=2)
    best = [p for p in pairs if len(p) == 2 and p[0].distance < MAX_RATIO * p[1].distance]
    return {p[0].queryIdx: p[0].trainIdx for p in best}


def _bytes(image: NDArray[np.generic]) -> NDArray[np.uint8]:
    low, high = np.percentile(np.asarray(image)[::4, ::4], [0.5, 99.5])
    scaled = (image.astype(np.float32) - low) * (255.0 / max(high - low, 1e-6))
    return np.asarray(np.clip(scaled, 0, 255), np.uint8)


def place_second(one: Camera, other: Camera, matches: Pixels, distance: float) -> Camera:
    """Return camera `other` with a new pose relative to `one`, for which sight lines of `matches` meet.
    `distance` is the distance between the two cameras, metres. Raises a RigError for too few matches."""
    a, b = matches
    if len(a) < MIN_MATCHES:
        raise RigError(_too_few(len(a)))
    tangents = [np.stack(camera.tangents(*pixel.T), -1) for camera, pixel in ((one, a), (other, b))]
    reach = MAX_EPIPOLAR_ERROR / min(one.fx, other.fx)
    E, inliers = cv2.findEssentialMat(tangents[0], tangents[1], np.eye(3), cv2.RANSAC, 0.9999, reach)
    if E is None or E.shape != (3, 3):
        raise RigError(_too_few(0))
    good = inliers.ravel() > 0
    if good.sum() < MIN_MATCHES:
        raise RigError(_too_few(int(good.sum())))
    true = a[good], b[good]
    starts = _starts(np.asarray(E, float), tangents[0][good], tangents[1][good], 10 * reach)
    fits = [_fitted(one, other, true, distance, start) for start in starts]
    visible = [len(points_of(one, camera, true)) for camera, _ in fits]
    possible = [f for f, count in zip(fits, visible, strict=True) if 2 * count > max(visible)]
    return min(possible, key=lambda fit: fit[1])[0]


def _starts(E: Array, one: Array, other: Array, reach: float) -> list[Pose]:
    """Return start poses (rotation, unit translation) of the second camera relative to the first.
    They come from the essential matrix E and a homography; on a nearly flat surface only the latter is right.
    `one` and `other` (n, 2) are tangents of the matches' angles, `reach` is the homography's tolerance."""
    _, R, t, _ = cv2.recoverPose(E, one, other, np.eye(3))
    out = [(np.asarray(R, float), np.asarray(t, float).ravel())]
    H, _ = cv2.findHomography(one, other, cv2.RANSAC, reach)
    if H is not None:
        _, turns, ways, _ = cv2.decomposeHomographyMat(H, np.eye(3))
        for turn, way in zip(turns, ways, strict=True):
            length = float(np.linalg.norm(way))
            if length > 0:
                for sign in (1.0, -1.0):
                    out.append((np.asarray(turn, float), np.asarray(way, float).ravel() * sign / length))
    return out


def _fitted(
    one: Camera, other: Camera, matches: Pixels, distance: float, start: Pose
) -> tuple[Camera, float]:
    """Fit the pose of camera `other` to the matches; return the camera and the remaining robust loss.
    `start` is a pose (rotation, unit translation) relative to `one`; `distance`, m, separates the cameras."""
    R, t = start
    across = np.linalg.svd(t[None])[2][1:]  # two directions across t

    def placed(x: Array) -> Camera:
        turn = np.asarray(cv2.Rodrigues(x[:3])[0], float) @ R
        towards = t + x[3:] @ across
        towards = distance * towards / np.linalg.norm(towards)
        return replace(other, rotation=turn @ one.R, translation=turn @ one.T + towards)

    def misfit(x: Array) -> Array:
        return epipolar_distance(one, placed(x), *matches[0].T, *matches[1].T)

    fit = least_squares(misfit, np.zeros(5), loss="soft_l1", f_scale=0.5, x_scale=[1e-3] * 3 + [1e-2] * 2)
    return placed(np.asarray(fit.x, float)), float(fit.cost)


def _too_few(count: int) -> str:
    return (
        f"only {count} features match between both cameras, {MIN_MATCHES} at least are needed: the images "
        "must show texture, be taken at the same moment, and from sides that are not too different"
    )


def points_of(one: Camera, other: Camera, matches: Pixels) -> Array:
    """Return the points (m, 3), metres, where sight lines of matches meet in front of the two cameras."""
    a, b = matches
    near = np.abs(epipolar_distance(one, other, *a.T, *b.T)) < MAX_EPIPOLAR_ERROR
    if not near.any():
        return np.empty((0, 3))
    cameras = (one, a[near]), (other, b[near])
    tangents = [np.stack(camera.tangents(*pixel.T)) for camera, pixel in cameras]
    places = [np.column_stack([camera.R, camera.T]) for camera in (one, other)]
    homogeneous = cv2.triangulatePoints(*places, *tangents)
    points: Array = np.asarray(homogeneous[:3] / homogeneous[3], float).T
    depth, other_depth = (points @ camera.R[2] + camera.T[2] for camera in (one, other))
    ahead = np.isfinite(points).all(1) & (depth > 0) & (other_depth > 0)
    if ahead.any():
        ahead &= depth < MAX_DISTANCE_RATIO * np.median(depth[ahead])
    out: Array = points[ahead]
    return out
