"""Cameras above moving water: poses, level and height in one fit, with uncertainties from its instants."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import t as student_t

from wavefield.calibration.horizon import dip, sight_lines
from wavefield.calibration.relative_pose import MAX_DEPTH_RATIO, MAX_EPIPOLAR_ERROR, Pixels
from wavefield.rig import Camera
from wavefield.rig.epipolar import epipolar_distance
from wavefield.rig.lens import Array
from wavefield.robust import robust_std

Pair = tuple[str, str]
Instant = Mapping[Pair, Pixels]

WAVES_IN_VIEW = 20.0  # independent elevations per instant: neighbouring features are on one wave
HORIZON_ERROR = 0.3  # px: of the line as a whole
PROBE = 0.1  # m: by which the plane is raised to find the parallax of an elevation
GROUPS = 8  # of instants next to each other, left out in turn
OUTLIER = 4.0  # robust standard deviations of the elevations
CELLS = 6  # along each side of an image, in which the water of groups is compared
MIN_INDEPENDENT = 1.5  # groups: fewer show the same waves, as one instant does
MAX_MATCHES = 1500  # of a pair in the fit
LOWEST = 0.02  # sine of the smallest angle of a sight line below the horizontal
HUGE = 1e3  # px: where there is no water


@dataclass(frozen=True)
class PlatformFit:
    """Cameras in one frame and the plane of the mean surface, up . x + offset = 0."""

    cameras: Mapping[str, Camera]
    up: Array  # (3,), unit vector
    offset: float  # m

    def height(self, name: str) -> float:
        """Of a camera above the mean surface, m."""
        return float(self.up @ self.cameras[name].centre + self.offset)

    def distance(self, matches: Sequence[Mapping[Pair, Pixels]]) -> float:
        """Of the water of the matches from the first camera, m."""
        name = next(iter(self.cameras))
        rays = [
            sight_lines(self.cameras[name], np.reshape(pixels[0], (-1, 2))) @ self.cameras[name].R @ self.up
            for one in matches
            for pair, pixels in one.items()
            if pair[0] == name
        ]
        return self.height(name) / max(float(np.median(-np.concatenate(rays))), LOWEST) if rays else 0.0


@dataclass(frozen=True)
class _Match:
    """Matches of one pair, px, and the instants they are of."""

    pair: Pair
    a: Array  # (n, 2)
    b: Array
    instant: NDArray[np.intp]


def fit_platform(
    start: PlatformFit,
    matches: Sequence[Instant],
    horizons: Mapping[str, Array],
    distance: float | None = None,
) -> PlatformFit:
    """Least squares of the level, the height and, if its distance is stated, the second camera's pose.
    Residuals over their expected size: epipolar distances, waves along the epipolar lines, the horizon.
    """
    kept = [one for one in _joined(matches) if len(one.a)]
    kept = [_on_water(start, one) for one in kept]
    fit = start
    if not kept:
        return start
    for _ in range(2):  # the sizes of waves and of mismatches are those of the fit before
        sizes = [_sizes(fit, one) for one in kept]
        solution = least_squares(
            _residuals,
            np.zeros(8 if distance is not None else 3),
            loss="soft_l1",
            x_scale=np.array(([1e-3] * 5 if distance is not None else []) + [1e-3, 1e-3, 1e-2]),
            args=(fit, kept, sizes, horizons, distance, len(matches)),
        )
        fit = _changed(fit, np.asarray(solution.x), distance)
    return fit


def leave_out(
    fit: PlatformFit, matches: Sequence[Instant], horizons: Mapping[str, Array], distance: float | None
) -> tuple[float, float]:
    """Standard uncertainties of the tilt, degrees, and of the height, m, from groups of instants (jackknife).
    NaN where too few groups show different waves; the tilt then has the uncertainty of the horizon, if any.
    """
    # instants next to each other are left out together: they show the same waves
    groups = [
        part for part in np.array_split(np.arange(len(matches)), min(GROUPS, len(matches))) if len(part)
    ]
    first = next(iter(fit.cameras))
    name, points = next((item for item in horizons.items()), (first, None))
    of_horizon = HORIZON_ERROR / fit.cameras[name].fy if points is not None else 0.0
    count, alike = len(groups), _alike(fit, matches, groups)
    if count < MIN_INDEPENDENT * alike:
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
    of_few = float(student_t.ppf(0.8413, len(groups) - 1))  # the spread of few groups is uncertain itself
    # groups that show the same waves: the variance of the mean of n is F/n of one's (F is `alike`), and the
    # spread within the record is too small by (n - F)/(n - 1)
    of_few *= float(np.sqrt(alike * (count - 1) / (count - alike)))
    lever = fit.distance(matches) * of_horizon
    return (
        float(np.degrees(np.hypot(of_few * tilt, of_horizon))),
        float(np.hypot(of_few * spread, lever)),
    )


def _alike(fit: PlatformFit, matches: Sequence[Instant], groups: Sequence[NDArray[np.intp]]) -> float:
    """How many groups of instants show the same waves, F of `leave_out`, by elevations in cells."""
    count = len(groups)
    products, squares = np.zeros(count), np.zeros(count)
    number = np.concatenate([np.full(len(part), n) for n, part in enumerate(groups)])
    for one in _joined(matches):
        one = _on_water(fit, one)
        _, along, per_metre = _along_and_across(fit, one)
        limit = OUTLIER * robust_std(along / per_metre)
        elevation = np.clip(along / per_metre, -limit, limit)
        cell = np.clip(one.a / fit.cameras[one.pair[0]].size * CELLS, 0, CELLS - 1).astype(int)
        place = (number[one.instant] * CELLS + cell[:, 1]) * CELLS + cell[:, 0]
        features, total = (
            np.bincount(place, weight, count * CELLS**2).reshape(count, -1)
            for weight in (np.ones(len(elevation)), elevation)
        )
        mean = total / np.where(features > 0, features, np.nan)
        for lag in range(1, count):
            first, second = mean[:-lag], mean[lag:]
            products[lag] += float(np.nansum(first * second))
            squares[lag] += float(np.nansum(0.5 * (first**2 + second**2)))
    # F = 1 + 2 sum (1 - k/n) r_k, with the correlation r_k of elevations k groups apart
    r = products[1:] / np.maximum(squares[1:], 1e-12)
    return max(1.0 + 2.0 * float(r @ (1.0 - np.arange(1, count) / count)), 1.0)


def _joined(matches: Sequence[Instant]) -> list[_Match]:
    """All matches of each pair, thinned evenly where there are very many."""
    out = []
    for pair in dict.fromkeys(pair for one in matches for pair in one):
        parts = [(number, one[pair]) for number, one in enumerate(matches) if pair in one]
        a, b = (np.concatenate([np.reshape(p[side], (-1, 2)) for _, p in parts]) for side in (0, 1))
        instant = np.concatenate([np.full(len(p[0]), number) for number, p in parts])
        every = -(-len(a) // MAX_MATCHES) if len(a) else 1
        out.append(_Match(pair, a[::every], b[::every], instant[::every]))
    return out


def _on_water(fit: PlatformFit, one: _Match) -> _Match:
    """Matches near their epipolar lines and near enough to the cameras: no sky, no far water."""
    first, second = (fit.cameras[name] for name in one.pair)
    near = np.abs(epipolar_distance(first, second, *one.a.T, *one.b.T)) < MAX_EPIPOLAR_ERROR
    down = -(sight_lines(first, one.a) @ first.R @ fit.up)
    near &= down > LOWEST
    if near.any():
        near &= down > np.median(down[near]) / MAX_DEPTH_RATIO
    return _Match(one.pair, one.a[near], one.b[near], one.instant[near])


def _changed(fit: PlatformFit, x: Array, distance: float | None) -> PlatformFit:
    """The fit with the second camera turned and moved, the plane tilted and raised."""
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
    """Of each match, px: the distance from its epipolar line, that along it from the plane's, and the
    parallax per metre of elevation."""
    first, second = (fit.cameras[name] for name in one.pair)
    rays = sight_lines(first, one.a) @ first.R
    down = np.minimum(rays @ fit.up, -LOWEST / 4)
    top = fit.up @ first.centre + fit.offset
    places = [
        np.stack(second.project(*(first.centre + (-(top - z) / down)[:, None] * rays).T), axis=-1)
        for z in (0.0, PROBE)
    ]
    shift = (places[1] - places[0]) / PROBE
    per_metre = np.maximum(np.hypot(*shift.T), 1e-6)
    along = np.sum((one.b - places[0]) * shift, axis=1) / per_metre
    across = epipolar_distance(first, second, *one.a.T, *one.b.T)
    return np.nan_to_num(across, nan=HUGE), np.nan_to_num(along, nan=HUGE), np.nan_to_num(per_metre, nan=1.0)


def _sizes(fit: PlatformFit, one: _Match) -> tuple[float, Array]:
    """Expected sizes, px, of the distances from the lines and (n,) of those along them."""
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
    now = _changed(fit, x, distance)
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
