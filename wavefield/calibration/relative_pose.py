"""A pair of cameras placed by what both see, and a rig levelled on the mean surface of moving water.

For cameras of which only the lenses are known, as at sea: features of natural texture are matched, the second
camera is turned until sight lines meet, a stated distance gives the scale, and the plane through the
surface of many instants is the level.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from wavefield.errors import RigError
from wavefield.rig import Camera, Rig
from wavefield.rig.epipolar import epipolar_distance
from wavefield.rig.water_level import level

Array = NDArray[np.float64]
Pixels = tuple[Array, Array]  # (n, 2) in one image and in the other

FEWEST = 30  # matches by which a camera is placed
_FEATURES = 6000  # per image
_RATIO = 0.8  # of the best distance to the second best, below which a match is no accident
_NEAR = 3.0  # px from the epipolar line: further is a false match
_AHEAD = 0.9  # of the most points that lie before both cameras: what else might be meant
_FAR = 3.0  # times the median distance: further out, towards the horizon, depth is only noise


@dataclass(frozen=True)
class Levelled:
    """A rig in the frame of the water's mean surface."""

    rig: Rig  # z = 0 on the mean surface, z up
    # How far z was turned, and its standard uncertainty from the scatter of the instants, degrees; the
    # uncertainty is NaN for one instant
    tilt: float
    tilt_std: float
    rms: float  # Of the points about the plane, metres
    miss: float  # Median distance of the matches from their epipolar lines, px
    points: int  # What it rests on
    instants: int

    @property
    def sentence(self) -> str:
        """All this for a person."""
        return (
            f"{self.points} points of {self.instants} instants: sight lines miss each other by "
            f"{self.miss:.2f} px (median); the frame was turned by {self.tilt:.2f} +- {self.tilt_std:.2f} "
            f"degrees; the surface lies {100 * self.rms:.2g} cm (rms) about its plane"
        )


def match_features(one: NDArray[Any], other: NDArray[Any]) -> Pixels:
    """Features of natural texture that two images share.

    SIFT (Lowe 2004), each the other's best, clearly better than the second best.

    With one, other (row, column); returns (n, 2): Their pixels (X, Y).
    """
    sift: Any = cv2.SIFT.create(nfeatures=_FEATURES)
    found = [sift.detectAndCompute(_bytes(image), None) for image in (one, other)]
    if any(len(points) < 2 for points, _ in found):
        return np.empty((0, 2)), np.empty((0, 2))
    best = [_best(found[a][1], found[b][1]) for a, b in ((0, 1), (1, 0))]
    both = [(i, j) for i, j in best[0].items() if best[1].get(j) == i]
    a, b = (np.array([found[k][0][pair[k]].pt for pair in both], float).reshape(-1, 2) for k in (0, 1))
    return a, b


def _best(one: Any, other: Any) -> dict[int, int]:
    pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(one, other, k=2)
    return {
        p[0].queryIdx: p[0].trainIdx for p in pairs if len(p) == 2 and p[0].distance < _RATIO * p[1].distance
    }


def _bytes(image: NDArray[Any]) -> NDArray[np.uint8]:
    low, high = np.percentile(image[::4, ::4], [0.5, 99.5])
    even = (image.astype(np.float32) - low) * (255.0 / max(high - low, 1e-6))
    return np.asarray(np.clip(even, 0, 255), np.uint8)


def place_second(one: Camera, other: Camera, matches: Pixels, distance: float) -> Camera:
    """Place a camera of known lens beside another by what both see.

    To begin with the essential matrix by RANSAC (Nister 2004), and what the homography of the sea's plane may
    mean; then the turn and the direction to the second camera by least squares of the distances to epipolar
    lines, in pixels, wrong matches weighed down. The start that leaves least is taken.

    With matches (n, 2).
    """
    a, b = matches
    if len(a) < FEWEST:
        raise RigError(_few(len(a)))
    seen = [np.stack(camera.tangents(*pixel.T), -1) for camera, pixel in ((one, a), (other, b))]
    reach = _NEAR / min(one.fx, other.fx)
    E, agree = cv2.findEssentialMat(seen[0], seen[1], np.eye(3), cv2.RANSAC, 0.9999, reach)
    if E is None or E.shape != (3, 3):
        raise RigError(_few(0))
    good = agree.ravel() > 0
    if good.sum() < FEWEST:
        raise RigError(_few(int(good.sum())))
    kept = a[good], b[good]
    fits = [
        _fitted(one, other, kept, distance, R, t)
        for R, t in _starts(np.asarray(E, float), seen[0][good], seen[1][good], 10 * reach)
    ]
    ahead = [len(points_of(one, camera, kept)) for camera, _ in fits]
    likely = [fit for fit, count in zip(fits, ahead, strict=True) if count > _AHEAD * max(ahead)]
    return min(likely, key=lambda fit: fit[1])[0]


def _starts(E: Array, one: Array, other: Array, reach: float) -> list[tuple[Array, Array]]:
    """Turns and directions to begin with: what is nearly flat is seen alike from two places.

    That of the essential matrix alone may be the wrong one of the two; the homography has both.
    """
    _, R, t, _ = cv2.recoverPose(E, one, other, np.eye(3))
    out = [(np.asarray(R, float), np.asarray(t, float).ravel())]
    H, _ = cv2.findHomography(one, other, cv2.RANSAC, reach)
    if H is not None:
        _, turns, ways, _ = cv2.decomposeHomographyMat(H, np.eye(3))
        for turn, way in zip(turns, ways, strict=True):
            length = float(np.linalg.norm(way))
            if length > 0:
                out += [
                    (np.asarray(turn, float), np.asarray(way, float).ravel() * s / length)
                    for s in (1.0, -1.0)
                ]
    return out


def _fitted(
    one: Camera, other: Camera, matches: Pixels, distance: float, R: Array, t: Array
) -> tuple[Camera, float]:
    """The second camera by least squares from a start, and what is left of the misses."""
    aside = np.linalg.svd(t[None])[2][1:]  # two directions across t

    def placed(x: Array) -> Camera:
        turn = np.asarray(cv2.Rodrigues(x[:3])[0], float) @ R
        towards = t + x[3:] @ aside
        towards = distance * towards / np.linalg.norm(towards)
        return replace(other, rotation=turn @ one.R, translation=turn @ one.T + towards)

    def misses(x: Array) -> Array:
        return epipolar_distance(one, placed(x), *matches[0].T, *matches[1].T)

    fit = least_squares(misses, np.zeros(5), loss="soft_l1", f_scale=0.5, x_scale=[1e-3] * 3 + [1e-2] * 2)
    return placed(np.asarray(fit.x, float)), float(fit.cost)


def _few(count: int) -> str:
    return (
        f"only {count} features are seen alike by both cameras, {FEWEST} at least are needed: the images "
        "must show texture, be taken at the same moment, and from sides that are not too different"
    )


def points_of(one: Camera, other: Camera, matches: Pixels) -> Array:
    """Where sight lines meet, in the rig's frame, whatever that is.

    With matches (n, 2); returns (m, 3): Metres.
    """
    a, b = matches
    near = np.abs(epipolar_distance(one, other, *a.T, *b.T)) < _NEAR
    rays = []
    for camera, pixel in ((one, a[near]), (other, b[near])):
        x, y = camera.tangents(*pixel.T)
        ray = np.stack([x, y, np.ones(len(x))], -1) @ camera.R
        rays.append(ray / np.linalg.norm(ray, axis=1)[:, None])
    u, v = rays
    between = other.centre - one.centre
    cosine = np.sum(u * v, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        along_u = (u @ between - cosine * (v @ between)) / (1 - cosine**2)
        along_v = (cosine * (u @ between) - v @ between) / (1 - cosine**2)
    points = 0.5 * (one.centre + along_u[:, None] * u + other.centre + along_v[:, None] * v)
    ahead = np.isfinite(points).all(1) & (along_u > 0) & (along_v > 0)
    if ahead.any():
        ahead &= along_u < _FAR * np.median(along_u[ahead])
    out: Array = points[ahead]
    return out


def level_on_water(rig: Rig, matches: Sequence[Mapping[tuple[str, str], Pixels]]) -> Levelled:
    """Bring z = 0 to the mean surface of moving water.

    With matches (str, str).
    """
    each = []
    misses = []
    for instant in matches:
        some = [points_of(rig[a], rig[b], found) for (a, b), found in instant.items()]
        each.append(np.concatenate(some) if some else np.empty((0, 3)))
        misses += [epipolar_distance(rig[a], rig[b], *p.T, *q.T) for (a, b), (p, q) in instant.items()]
    points = np.concatenate(each) if each else np.empty((0, 3))
    if len(points) < FEWEST:
        raise RigError(_few(len(points)))
    moved, plane = level(rig, *points.T)
    up = _up(rig, moved)
    tilts = [_angle(up, _up(rig, level(rig, *own.T)[0])) for own in each if len(own) >= FEWEST]
    std = float(np.sqrt(np.mean(np.square(tilts)) / (len(tilts) - 1))) if len(tilts) > 1 else float("nan")
    miss = np.abs(np.concatenate(misses))
    return Levelled(
        moved,
        _angle(up, np.array([0.0, 0.0, 1.0])),
        std,
        plane.rms,
        float(np.median(miss[miss < _NEAR])) if (miss < _NEAR).any() else float("nan"),
        len(points),
        len(each),
    )


def _up(old: Rig, new: Rig) -> Array:
    """The new frame's z in the old one: a camera's rotation says both."""
    name = next(iter(old))
    out: Array = (old[name].R.T @ new[name].R)[:, 2]
    return out


def _angle(a: Array, b: Array) -> float:
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))
