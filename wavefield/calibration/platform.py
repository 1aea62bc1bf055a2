"""Pose and motion of a platform above the sea, from horizon, sea surface and image shifts."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import t as student_t

from wavefield.atomic_write import write_text
from wavefield.calibration.horizon import MAX_MISFIT, dip, find_horizon, sight_lines
from wavefield.calibration.relative_pose import MAX_DEPTH_RATIO, MAX_EPIPOLAR_ERROR, Pixels
from wavefield.errors import RigError
from wavefield.images import write_image
from wavefield.rig import Camera, Rig
from wavefield.rig.lens import Array, rotation_about
from wavefield.rig.stereo import epipolar_distance
from wavefield.robust import robust_std
from wavefield.series import Experiment, masks
from wavefield.series.frames import FrameSeries

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
        """Height of a camera above the mean surface, m."""
        return float(self.up @ self.cameras[name].centre + self.offset)

    def distance(self, matches: Sequence[Mapping[Pair, Pixels]]) -> float:
        """Distance of the matched water from the first camera, m."""
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
    """Matched pixels of one pair of cameras, with the number of their instant."""

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
    """Number of groups of instants that show the same waves (F of `leave_out`), from elevations in cells."""
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
    """All matches of each pair; evenly thinned if there are very many."""
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
    """For each match, px: distance from its epipolar line, distance along it from the plane, and the
    parallax per metre of elevation.
    """
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
    """Expected standard deviations, px, of the distances across and (n,) along the epipolar lines."""
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


REFRACTION_STD = 0.07  # of the dip: what air that is warmer or colder than the water bends light by
MIN_HORIZONS = 3  # images, for how much a camera sways
FAR = 1e5  # m: what is drawn of the sky, and of water further away
KEPT = ("name", "frame_rate", "surface", "velocity", "grid", "settings", "water")  # of the experiment file
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class PlatformMotion:
    """How a platform moved, and the experiment whose frames are turned level."""

    experiment: Path
    rig: Rig  # that of all turned frames
    tilt: Array  # (frames, 2): of the rig about x (pitch) and y (roll), degrees; NaN without a horizon
    # Of one frame, degrees, from what its cameras differ by (NaN of one camera) and the refraction of the air
    tilt_std: float

    @property
    def sentence(self) -> str:
        """The result as sentences for the user."""
        seen = np.isfinite(self.tilt[:, 0])
        pitch, roll = np.std(self.tilt[seen], axis=0)
        height = float(np.mean([camera.centre[2] for camera in self.rig.cameras.values()]))
        tan = np.tan(np.radians(self.tilt_std))
        return (
            f"{seen.sum()} of {len(seen)} frames show the horizon and were turned level: pitch {pitch:.2f} "
            f"and roll {roll:.2f} degrees (rms), each known to {self.tilt_std:.3f} degrees, that is "
            f"{100 * tan * 3 * height:.1g} cm of z at {3 * height:.0f} m, which z_std does not contain"
        )


def level_frames(
    experiment: str | Path | Experiment,
    folder: str | Path,
    rig: str | Path | Rig | None = None,
    progress: Progress | None = None,
) -> PlatformMotion:
    """Write the frames of a platform that rolls and pitches as a platform at rest would have taken them.

    The horizon in each frame gives roll and pitch. Every image is drawn anew, through the mean surface, for
    cameras that do not move; a wave of elevation z at distance d is displaced by a few parts in a thousand
    of z at tilts of some degrees. Frames without a horizon are left out. Heave, sway and yaw stay.

    Parameters
    ----------
    experiment : path or Experiment
        Of cameras that all show the horizon.
    folder : path
        Made, and empty if it is there: ``experiment.yaml``, ``rig.yaml``, ``<camera>/img_<frame>.tif``.
    rig : path or Rig, optional
        In place of the one that the experiment names; z = 0 is the mean surface, to some degrees.
    progress : callable, optional
        Called with (frames done, all frames).

    Returns
    -------
    PlatformMotion

    Raises
    ------
    RigError
        If no frame shows the horizon, or the folder is not empty.

    Examples
    --------
    >>> import wavefield as wf
    >>> moved = wf.level_frames("experiment.yaml", "level", "rig.yaml")  # doctest: +SKIP
    >>> moved.tilt.shape  # doctest: +SKIP
    (40, 2)
    """
    folder = Path(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise RigError(f"{folder} is not empty; give another folder")
    if not isinstance(experiment, Experiment):
        experiment = Experiment.load(experiment)
    series = experiment.open_frames()
    loaded = rig if isinstance(rig, Rig) else experiment.load_rig(rig, series)
    in_images = {name: shapes for name, shapes in experiment.mask.items() if name != masks.WATER}
    series = masks.covered_series(in_images, series, loaded, experiment.path.parent, 0.0)
    count = min(len(one) for one in series.values())
    tilt, apart = np.full((count, 2), np.nan), []
    for index in range(count):
        found = _level_frame(series, index, loaded, folder)
        if found is not None:
            tilt[index], by_camera = found
            apart.append(np.ptp(by_camera, axis=0) if len(by_camera) > 1 else np.full(2, np.nan))
        if progress:
            progress(index + 1, count)
    if not apart:
        raise RigError(
            "no frame shows the horizon in all cameras: only frames that do can be turned level one by one"
        )
    loaded.save(folder / "rig.yaml")
    note = yaml.safe_load(experiment.path.read_text(encoding="utf-8"))
    note = {key: note[key] for key in KEPT if key in note}
    images = {name: {"images": f"{name}/img_{{frame:05d}}.tif"} for name in loaded}
    path = folder / "experiment.yaml"
    text = yaml.safe_dump({**note, "cameras": images, "rig": "rig.yaml"}, sort_keys=False)
    write_text(path, text)
    # the mean of two cameras has half of what they differ by
    of_images = 0.5 * np.sqrt(np.mean(np.square(apart)))
    of_air = REFRACTION_STD * max(dip(camera.centre[2]) for camera in loaded.cameras.values())
    std = float(np.degrees(np.hypot(of_images, of_air)))
    return PlatformMotion(path, loaded, np.degrees(tilt), std)


def sway(images: Sequence[NDArray[Any]], camera: Camera) -> float:
    """Rms of the roll and pitch of a camera, degrees, from its horizon in images; NaN in fewer than three."""
    lines = [find_horizon([image], camera) for image in images]
    rays = [sight_lines(camera, line) @ camera.R for line in lines if line is not None]
    if len(rays) < MIN_HORIZONS:
        return float("nan")
    tilts = [_tilt(one, np.zeros(len(one))) for one in rays]
    return float(np.degrees(np.sqrt(np.var(tilts, axis=0).max())))


def _level_frame(
    series: Mapping[str, FrameSeries], index: int, rig: Rig, folder: Path
) -> tuple[Array, Array] | None:
    """Tilt (2,) of a frame, and of each camera (cameras, 2), rad; writes the levelled images."""
    images = {name: series[name].read_uncovered(index) for name in rig}
    rays = {}
    for name, image in images.items():
        points = None if image is None else find_horizon([image], rig[name])
        if points is None:
            return None
        rays[name] = sight_lines(rig[name], points) @ rig[name].R
    dips = {name: dip(rig[name].centre[2]) for name in rig}
    own = np.array([_tilt(rays[name], np.full(len(rays[name]), dips[name])) for name in rays])
    count = [len(one) for one in rays.values()]
    tilt = _tilt(np.concatenate([*rays.values()]), np.repeat([*dips.values()], count))
    focal = min(camera.fy for camera in rig.cameras.values())
    if np.abs(own - tilt).max() * focal > 3.0 * MAX_MISFIT:
        return None  # the cameras show different edges
    turn = _level_turn(tilt)
    middle = np.mean([camera.centre for camera in rig.cameras.values()], axis=0)
    for name, image in images.items():
        camera = rig[name]
        centre = middle + turn @ (camera.centre - middle)
        rotation = camera.R @ turn.T
        moved = replace(camera, rotation=rotation, translation=-rotation @ centre)
        path = folder / name / f"img_{series[name].first + index:05d}.tif"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_image(path, redrawn(np.asarray(image), moved, camera))
    return tilt, own


def _tilt(rays: Array, dips: Array) -> Array:
    """Tilt about x and y, rad, of a frame, from unit rays (n, 3) to the horizon with dips (n,), rad."""
    tilt, weight = np.zeros(2), np.ones(len(rays))
    for _ in range(8):
        up = _level_turn(tilt)[2]
        miss = rays @ up + np.sin(dips)
        # d up / d tilt at small angles
        design = np.column_stack([rays[:, 1], -rays[:, 0]])
        root = np.sqrt(weight)
        tilt = tilt - np.linalg.lstsq(root[:, None] * design, root * miss, rcond=None)[0]
        spread = 1.5 * float(np.median(np.abs(miss))) + 1e-12
        weight = np.minimum(1.0, 2.0 * spread / np.maximum(np.abs(miss), 1e-12))
    return tilt


def _level_turn(tilt: Array) -> Array:
    """Rotation (3, 3) from a frame tilted about x and y to the level one, without yaw."""
    return rotation_about([*tilt, 0.0])


def redrawn(image: NDArray[Any], taken: Camera, drawn: Camera) -> NDArray[Any]:
    """An image (row, column) of one camera as another, near it, would have taken it of z = 0 and the sky."""
    width, height = drawn.size
    a, b = drawn.tangents(np.arange(float(width)), np.arange(float(height))[:, None])
    ray = np.stack([a, b, np.ones_like(a)], -1) @ drawn.R
    with np.errstate(divide="ignore"):
        far = np.where(ray[..., 2] < 0.0, np.minimum(-drawn.centre[2] / ray[..., 2], FAR), FAR)
    x, y, z = np.moveaxis(drawn.centre + far[..., None] * ray, -1, 0)
    X, Y = (np.nan_to_num(v, nan=-1e4).astype(np.float32) for v in taken.project(x, y, z))
    grey = float(np.median(image))
    out = cv2.remap(
        image.astype(np.float32), X, Y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT, borderValue=grey
    )
    if image.dtype.kind == "f":
        return np.asarray(out, image.dtype)
    top = np.iinfo(image.dtype).max
    return np.asarray(np.clip(np.rint(out), 0, top), image.dtype)
