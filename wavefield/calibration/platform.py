"""Level and height of cameras on a platform above the sea, from the horizon and the mean surface.

`up` is the vertical unit vector in the rig's frame. Matched features are on the waves, not on the mean
surface; averaged over many instants, the elevation of the waves is zero.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import t as student_t

from wavefield.calibration.observations import MAX_MATCHES, OUTLIER_DEVIATIONS
from wavefield.calibration.relative_pose import MAX_EPIPOLAR_ERROR, Pixels
from wavefield.parabola import parabola_vertex
from wavefield.rig import Camera
from wavefield.rig.field import MAX_DISTANCE_RATIO
from wavefield.rig.lens import Array
from wavefield.rig.stereo import epipolar_distance
from wavefield.robust import robust_std

EARTH_RADIUS = 6.371e6 / 0.87  # m; refraction by air acts as if the Earth were larger (Bomford 1980)
SMOOTHING = 2.0  # px: standard deviation of the Gaussian that smooths the mean image
EDGES = 4  # strongest edges of a column that are tried as the horizon
MIN_COLUMNS = 0.7  # fraction of the columns in which the line must be found; ships and piles hide it
TRIALS = 2000  # of RANSAC; with one true edge in eight, thirty of them pick two points of the line


def dip(height: float) -> float:
    """Return the angle, rad, of the sea horizon below the horizontal, with refraction, at a height, m."""
    return float(np.sqrt(2.0 * max(height, 0.0) / EARTH_RADIUS))


def find_horizon(mean: NDArray[np.generic], camera: Camera) -> Array | None:
    """Return points (n, 2), px, of the horizon in the mean image of a fixed camera; None if none is found.
    The image is averaged over many instants. The horizon is straight in the undistorted image, with a roll of
    up to 45 degrees."""
    smooth = np.asarray(cv2.GaussianBlur(np.asarray(mean, np.float32), (0, 0), SMOOTHING), float)
    steepness = np.abs(np.gradient(smooth, axis=0))
    above, here, below = steepness[:-2], steepness[1:-1], steepness[2:]
    noise = 1.4826 * float(np.median(steepness))
    edge = np.where((here >= above) & (here > below) & (here > OUTLIER_DEVIATIONS * noise), here, 0.0)
    row = np.argsort(-edge, axis=0)[:EDGES]  # the steepest of each column
    column = np.broadcast_to(np.arange(edge.shape[1]), row.shape)
    found = edge[row, column] > 0
    at = row[found], column[found]
    if len(at[0]) < 2:
        return None
    points = np.column_stack([at[1], 1 + at[0] + parabola_vertex(above[at], here[at], below[at])])
    tangents = np.stack(camera.tangents(*points.T), axis=-1)
    horizon = points[_line(tangents, here[at], 1.0 / camera.fy)]  # within a pixel
    return None if np.unique(horizon[:, 0]).size < MIN_COLUMNS * np.unique(at[1]).size else horizon


def _line(tangents: Array, strength: Array, reach: float) -> NDArray[np.bool_]:
    """Return a mask (n,) of the edge points on the straight line with the largest sum of gradients (RANSAC).
    `tangents` (n, 2) are undistorted positions of the edge points, `strength` (n,) grey-value gradients;
    `reach` is the largest distance from the line, in units of tangents."""
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


def sight_lines(camera: Camera, points: Array) -> Array:
    """Return unit vectors (n, 3) along the sight lines of pixels (n, 2), in the camera's frame."""
    a, b = camera.tangents(*points.T)
    rays = np.stack([a, b, np.ones_like(a)], axis=-1)
    return np.asarray(rays / np.linalg.norm(rays, axis=1)[:, None])


Pair = tuple[str, str]
Instant = Mapping[Pair, Pixels]

WAVES_IN_VIEW = 20.0  # independent elevations at an instant, as neighbouring features are on one wave
HORIZON_ERROR = 0.3  # px: systematic error of the whole line
GROUPS = 8  # of successive instants, for the jackknife
MIN_DOWN = 0.02  # sine of the smallest angle of a sight line below the horizontal, about one degree


@dataclass(frozen=True)
class PlatformFit:
    """Cameras in one frame, and the plane of the sea's mean surface in that frame: up . x + offset = 0."""

    cameras: Mapping[str, Camera]
    up: Array  # (3,): Unit vector
    offset: float  # Metres

    def height(self, name: str) -> float:
        """Return the height of the camera `name` above the mean surface, m."""
        return float(self.up @ self.cameras[name].centre + self.offset)

    def distance(self, matches: Sequence[Mapping[Pair, Pixels]]) -> float:
        """Return the median distance, m, from the first camera to the matched features; 0 without matches.
        `matches` holds, for each instant, matched pixels by pair of cameras."""
        name, camera = next(iter(self.cameras.items()))
        pixels = [a for one in matches for (first, _), (a, _) in one.items() if first == name and len(a)]
        if not pixels:
            return 0.0
        down = -sight_lines(camera, np.concatenate(pixels)) @ camera.R @ self.up
        return self.height(name) / max(float(np.median(down)), MIN_DOWN)


@dataclass(frozen=True)
class _Match:
    """All matched pixels of one pair of cameras, from all instants."""

    pair: Pair
    a: Array  # (n, 2): Pixels of the first camera
    b: Array  # (n, 2): Pixels of the second camera


def fit_platform(
    start: PlatformFit,
    matches: Sequence[Instant],
    horizons: Mapping[str, Array],
    distance: float | None = None,
) -> PlatformFit:
    """Fit the plane of the sea's mean surface to matched pixels and horizon points.
    `matches` holds, for each instant, matched pixels by pair of cameras; `horizons` holds points of the
    horizon (n, 2), px, by camera. If the `distance` between the two cameras, m, is given, the pose of the
    second is fitted too."""
    kept = [one for one in _joined(matches) if len(one.a)]
    kept = [_on_water(start, one) for one in kept]
    fit = start
    if not kept:
        return start
    for _ in range(2):  # the expected sizes come from the previous fit
        sizes = [_sizes(fit, one) for one in kept]
        solution = least_squares(
            _residuals,
            np.zeros(8 if distance is not None else 3),
            loss="soft_l1",
            x_scale=np.array(([1e-3] * 5 if distance is not None else []) + [1e-3, 1e-3, 1e-2]),
            args=(fit, kept, sizes, horizons, distance, len(matches)),
        )
        fit = _stepped(fit, np.asarray(solution.x), distance)
    return fit


def jackknife_std(
    fit: PlatformFit, matches: Sequence[Instant], horizons: Mapping[str, Array], distance: float | None
) -> tuple[float, float]:
    """Return the jackknife standard uncertainties of tilt (degrees) and height (m), over groups of instants.
    A group consists of successive instants, because these show the same waves. With one instant, the
    uncertainty of the height is NaN, and that of the tilt is the error of the horizon (NaN without
    `horizons`). `fit_platform` describes the arguments."""
    # leave out successive instants together, because they show the same waves
    groups = np.array_split(np.arange(len(matches)), min(GROUPS, len(matches)))
    first = next(iter(fit.cameras))
    of_horizon = HORIZON_ERROR / fit.cameras[next(iter(horizons))].fy if horizons else 0.0
    if len(groups) == 1:
        return float(np.degrees(of_horizon)) or float("nan"), float("nan")
    ups, heights = [], []
    for part in groups:
        rest = [one for number, one in enumerate(matches) if number not in part]
        other = fit_platform(fit, rest, horizons, distance)
        ups.append(other.up)
        heights.append(other.height(first))
    factor = (len(groups) - 1) / len(groups)
    up, height = np.array(ups), np.array(heights)
    tilt = np.sqrt(factor * np.sum((up - up.mean(axis=0)) ** 2))
    spread = np.sqrt(factor * np.sum((height - height.mean()) ** 2))
    widening = float(student_t.ppf(0.8413, len(groups) - 1))  # Student's t for one standard deviation
    lever = fit.distance(matches) * of_horizon
    return (
        float(np.degrees(np.hypot(widening * tilt, of_horizon))),
        float(np.hypot(widening * spread, lever)),
    )


def _joined(matches: Sequence[Instant]) -> list[_Match]:
    """Join the matches of all instants by pair of cameras; keep every k-th, up to `MAX_MATCHES` per pair."""
    out = []
    for pair in dict.fromkeys(pair for one in matches for pair in one):
        parts = [one[pair] for one in matches if pair in one]
        a, b = (np.concatenate([np.reshape(part[side], (-1, 2)) for part in parts]) for side in (0, 1))
        every = -(-len(a) // MAX_MATCHES) if len(a) else 1
        out.append(_Match(pair, a[::every], b[::every]))
    return out


def _on_water(fit: PlatformFit, one: _Match) -> _Match:
    """Return the matches near their epipolar lines, below the horizon and not extremely far away."""
    first, second = (fit.cameras[name] for name in one.pair)
    near = np.abs(epipolar_distance(first, second, *one.a.T, *one.b.T)) < MAX_EPIPOLAR_ERROR
    down = -(sight_lines(first, one.a) @ first.R @ fit.up)
    near &= down > MIN_DOWN
    if near.any():
        near &= down > np.median(down[near]) / MAX_DISTANCE_RATIO
    return _Match(one.pair, one.a[near], one.b[near])


def _stepped(fit: PlatformFit, x: Array, distance: float | None) -> PlatformFit:
    """Return the fit after a step x (3,): two tilts of the mean surface, rad, and a change of `offset`, m.
    If `distance`, m, is given, x is (8,). It then begins with a rotation vector (3) of the second camera,
    rad, and its shift (2) perpendicular to the line between the cameras, in units of `distance`."""
    cameras = dict(fit.cameras)
    if distance is not None:
        one, name = list(cameras)[:2]
        first, second = cameras[one], cameras[name]
        turn = Rotation.from_rotvec(x[:3]).as_matrix() @ second.R
        between = second.centre - first.centre
        across = np.linalg.svd(between[None])[2][1:]
        between = between + distance * (x[3:5] @ across)
        centre = first.centre + distance * between / np.linalg.norm(between)
        cameras[name] = replace(second, rotation=turn, translation=-turn @ centre)
    level = np.linalg.svd(fit.up[None])[2][1:]
    up = fit.up + x[-3:-1] @ level
    return PlatformFit(cameras, up / np.linalg.norm(up), fit.offset + float(x[-1]))


def _along_and_across(fit: PlatformFit, one: _Match) -> tuple[Array, Array, Array]:
    """Return distances (n,), px, of matches across and along their epipolar lines, and a derivative (n,).
    Distances along a line start at the pixel of water without waves. The derivative is that of the distance
    along the line, by the elevation of the water, px/m."""
    first, second = (fit.cameras[name] for name in one.pair)
    rays = sight_lines(first, one.a) @ first.R
    down = np.minimum(rays @ fit.up, -MIN_DOWN / 4)
    top = fit.up @ first.centre + fit.offset
    ray_per_metre = rays / down[:, None]
    place = first.centre - top * ray_per_metre
    shift = np.einsum("nij,nj->ni", second.jacobian(*place.T), ray_per_metre)
    per_metre = np.maximum(np.hypot(*shift.T), 1e-6)
    along = np.sum((one.b - np.stack(second.project(*place.T), axis=-1)) * shift, axis=1) / per_metre
    across = epipolar_distance(first, second, *one.a.T, *one.b.T)
    # a match that is not on the water in front of both cameras is off by a radian
    across, along = (np.nan_to_num(part, nan=second.fx) for part in (across, along))
    return across, along, np.nan_to_num(per_metre, nan=1.0)


def _sizes(fit: PlatformFit, one: _Match) -> tuple[float, Array]:
    """Return the standard deviations, px, of matches across epipolar lines (a number) and along them (n,)."""
    across, along, per_metre = _along_and_across(fit, one)
    noise = max(robust_std(across), 0.05)
    waves = max(robust_std(along / per_metre), 1e-3)
    return noise, np.asarray(np.hypot(noise, waves * per_metre))


def _residuals(
    x: Array,
    fit: PlatformFit,
    kept: Sequence[_Match],
    sizes: Sequence[tuple[float, Array]],
    horizons: Mapping[str, Array],
    distance: float | None,
    instants: int,
) -> Array:
    """Return residuals of matches and horizon points after a step x, in standard deviations.
    `sizes` are the results of `_sizes` for the matches `kept`, which come from `instants` instants."""
    now = _stepped(fit, x, distance)
    out = []
    for one, (noise, expected) in zip(kept, sizes, strict=True):
        across, along, _ = _along_and_across(now, one)
        few = np.sqrt(min(1.0, WAVES_IN_VIEW * instants / max(len(along), 1)))
        out += [across / noise, few * along / expected]
    for name, points in horizons.items():
        camera = now.cameras[name]
        off = sight_lines(camera, points) @ camera.R @ now.up + np.sin(dip(now.height(name)))
        out.append(off * camera.fy / (HORIZON_ERROR * np.sqrt(0.5 * len(points))))
    return np.concatenate(out)
