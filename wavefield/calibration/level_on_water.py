"""Bring z = 0 to the mean surface of moving water, and find the pose of a second camera, from images.

Levelling turns and shifts the frame of the rig. The vertical comes from the horizon if the images show it,
and else from the mean surface of many instants. Matches are pixels of the same features in two cameras.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wavefield.calibration.observations import MIN_MATCHES
from wavefield.calibration.platform import PlatformFit, find_horizon, fit_platform, jackknife_std
from wavefield.calibration.relative_pose import (
    MAX_EPIPOLAR_ERROR,
    Pixels,
    match_features,
    place_second,
    points_of,
)
from wavefield.errors import RigError
from wavefield.rig import Rig
from wavefield.rig.lens import Array
from wavefield.rig.stereo import epipolar_distance
from wavefield.rig.water_level import MAX_DEVIATIONS, level
from wavefield.sampling import evenly_spaced
from wavefield.series import Experiment, masks
from wavefield.text import spell_uncertain

TILT_STD = 1.0  # degrees, of the mean surface, if the instants are too few to determine it


@dataclass(frozen=True)
class Levelled:
    """Result of levelling: a rig with z = 0 on the mean surface of the water, and uncertainties."""

    rig: Rig  # z = 0 on the mean surface, z up
    tilt: float  # Angle by which the z axis was turned, degrees
    tilt_std: float  # Standard uncertainty of the tilt; NaN for one instant without a horizon
    height: float  # Height of the first camera above the mean surface, metres
    height_std: float  # Excludes the error of the given distance; NaN for one instant
    rms: float  # Rms elevation of the points about the mean surface, metres
    epipolar_error: float  # Median distance of the matches from their epipolar lines, px
    points: int  # Number of points used
    instants: int  # Number of instants used
    horizon: str  # Whether the horizon or the mean surface gave the level, in words

    @property
    def sentence(self) -> str:
        """Sentence for the user: tilt, height, and the distance by which sight lines miss each other."""
        height = spell_uncertain(self.height, self.height_std, "m")
        turned = spell_uncertain(self.tilt, self.tilt_std, "degrees")
        return (
            f"{self.points} points of {self.instants} instant{'s' * (self.instants > 1)}: sight lines miss "
            f"each other by {self.epipolar_error:.2f} px (median); {self.horizon}; the frame was turned by "
            f"{turned}; {next(iter(self.rig))} is {height} above "
            f"the mean surface; the water is within {100 * self.rms:.2g} cm (rms) of it"
            f"{self._unknown}"
        )

    @property
    def _unknown(self) -> str:
        """Clause on an unknown uncertainty of the height, or of tilt and height; empty if both are known."""
        if np.isfinite(self.height_std):
            return ""
        which = "height" if np.isfinite(self.tilt_std) else "tilt and the height"
        return f"; one instant gives no uncertainty of the {which}: take instants over many wave periods"


def level_on_water(
    rig: Rig,
    matches: Sequence[Mapping[tuple[str, str], Pixels]],
    horizons: Mapping[str, Array] | None = None,
    distance: float | None = None,
) -> Levelled:
    """Bring z = 0 to the mean surface of moving water, by matched features and, if given, the horizon.
    `matches` holds, for each instant, matched pixels by pair of cameras; `horizons` holds points of the
    horizon (n, 2), px, by camera. If the `distance` between the two cameras, m, is given, the pose of the
    second is fitted too, and the origin is on the water below their midpoint."""
    none = np.empty((0, 3))
    surfaces = [
        np.concatenate([none, *(points_of(rig[a], rig[b], pixels) for (a, b), pixels in by_pair.items())])
        for by_pair in matches
    ]
    points = np.concatenate([none, *surfaces])
    if len(points) < MIN_MATCHES:
        matched = sum(len(a) for by_pair in matches for a, _ in by_pair.values())
        raise RigError(
            f"sight lines of only {len(points)} of {matched} matching features meet within "
            f"{MAX_EPIPOLAR_ERROR:g} px, {MIN_MATCHES} at least are needed: is the rig that of these images, "
            "each camera its own (or state --distance to recompute the second one's pose), do images show "
            "texture, and were they taken at the same moment?"
        )
    levelled, plane = level(rig, *points.T)
    name = next(iter(rig))
    axes = rig[name].R.T @ levelled[name].R
    start = PlatformFit(
        rig.cameras, axes[:, 2], float(levelled[name].centre[2] - axes[:, 2] @ rig[name].centre)
    )
    fit, (tilt_std, height_std), sentence = _best_fit(start, matches, horizons or {}, distance)
    if distance is None:
        along, origin = axes[:, 0], rig[name].centre - axes @ levelled[name].centre
    else:  # the rig had no poses: put the origin below the cameras, x to the right and y away from them
        along = rig[name].R[0]
        origin = np.mean([camera.centre for camera in fit.cameras.values()], axis=0)
    origin = origin - (fit.up @ origin + fit.offset) * fit.up
    x = along - (along @ fit.up) * fit.up
    x /= np.linalg.norm(x)
    tilt = _angle(fit.up, np.array([0.0, 0.0, 1.0]))
    note = {
        "camera_height_m": fit.height(name),
        "camera_height_std_m": height_std,
        "tilt_deg": tilt,
        "tilt_std_deg": tilt_std,
        "waves_rms_m": plane.rms,
        "points": len(points),
        "by": sentence,
    }
    placed = Rig(fit.cameras, rig.provenance)
    done = placed.moved(np.stack([x, np.cross(fit.up, x), fit.up], axis=1), origin, levelled=note)
    return Levelled(
        done,
        tilt,
        tilt_std,
        fit.height(name),
        height_std,
        plane.rms,
        _epipolar_error(done, matches),
        len(points),
        len(matches),
        sentence,
    )


def _best_fit(
    start: PlatformFit,
    matches: Sequence[Mapping[tuple[str, str], Pixels]],
    horizons: Mapping[str, Array],
    distance: float | None,
) -> tuple[PlatformFit, tuple[float, float], str]:
    """Fit the mean surface to matched pixels, and also to the horizon if it agrees with the mean surface.
    Returns the fit, the standard uncertainties of tilt (degrees) and height (m), and a sentence that names
    the source of the vertical. `horizons` holds points (n, 2), px, by camera; `distance` (m or None)
    separates two cameras."""
    free = fit_platform(start, matches, {}, distance)
    std = jackknife_std(free, matches, {}, distance)
    if not horizons:
        return free, std, "no horizon was found, so the mean surface is the level"
    fit = fit_platform(free, matches, horizons, distance)
    apart = _angle(fit.up, free.up)
    if apart > max(MAX_DEVIATIONS * np.nan_to_num(std[0], nan=TILT_STD), TILT_STD):
        sentence = (
            f"an edge like a horizon in {', '.join(horizons)} is {apart:.1f} degrees off the mean surface "
            "and was not used: the mean surface is the level"
        )
        return free, std, sentence
    std = jackknife_std(fit, matches, horizons, distance)
    return fit, std, f"the horizon in {', '.join(horizons)} gives the vertical"


def _epipolar_error(rig: Rig, matches: Sequence[Mapping[tuple[str, str], Pixels]]) -> float:
    """Return the median distance, px, of matched pixels from their epipolar lines, without outliers.
    `matches` holds, for each instant, matched pixels by pair of cameras."""
    distances = [
        epipolar_distance(rig[a], rig[b], *p.T, *q.T)
        for by_pair in matches
        for (a, b), (p, q) in by_pair.items()
    ]
    errors = np.abs(np.concatenate(distances))
    errors = errors[errors < MAX_EPIPOLAR_ERROR]
    return float(np.median(errors)) if errors.size else float("nan")


def _angle(a: Array, b: Array) -> float:
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def level_experiment(
    experiment: str | Path | Experiment,
    rig: str | Path | None = None,
    distance: float | None = None,
    frames: int = 20,
    progress: Callable[[int, int], None] | None = None,
) -> Levelled:
    """Bring z = 0 to the mean surface of moving water, from the images of an experiment.

    Parameters
    ----------
    experiment : path or Experiment
        An experiment whose cameras see natural texture from similar directions.
    rig : path, optional
        A rig to use instead of the experiment's. Its frame is arbitrary, for example that of a camera.
    distance : float, optional
        Distance between the two cameras, metres. If it is given, the pose of the second camera relative to
        the first comes from matched features; its pose in the rig is ignored.
    frames : int
        Number of instants to use, spread over the record.
    progress : callable, optional
        Called with (instants done, number of instants).

    Returns
    -------
    Levelled
        The rig with z = 0 on the mean surface, and its tilt and height with standard uncertainties.

    Raises
    ------
    RigError
        If too few features match, if no distance is given but cameras are at the same position, or if it is
        given for a rig that does not have two cameras.

    Examples
    --------
    >>> import wavefield as wf
    >>> found = wf.level("experiment.yaml")  # doctest: +SKIP
    >>> found.instants  # doctest: +SKIP
    20
    >>> found.rig.save("rig.yaml")  # doctest: +SKIP
    """
    if not isinstance(experiment, Experiment):
        experiment = Experiment.load(experiment)
    series = experiment.open_frames()
    loaded = experiment.load_rig(rig, series)
    in_images = {name: shapes for name, shapes in experiment.mask.items() if name != masks.WATER}
    series = masks.covered_series(in_images, series, loaded, experiment.path.parent)
    first, *others = loaded
    if distance is not None and len(others) != 1:
        raise RigError(f"a distance places the second of two cameras; this rig has {len(loaded)}")
    if distance is None and any(np.allclose(loaded[first].centre, loaded[n].centre) for n in others):
        raise RigError(
            "the rig does not contain the positions of its cameras: state the distance between them "
            "(`--distance`)"
        )
    instants = evenly_spaced(len(series[first]), frames)
    matches: list[dict[tuple[str, str], Pixels]] = []
    total: dict[str, Array] = {}  # sums of all images: the mean shows the horizon, but not the waves
    for done, instant in enumerate(instants, 1):
        images = {
            name: image for name in loaded if (image := series[name].read_uncovered(instant)) is not None
        }
        for name, image in images.items():
            total[name] = total.get(name, 0.0) + np.asarray(image, float)
        pairs = [(first, n) for n in others if first in images and n in images]
        matches.append({(a, b): match_features(images[a], images[b]) for a, b in pairs})
        if progress:
            progress(done, len(instants))
    if distance is not None:
        pair = first, others[0]
        found = [by_pair[pair] for by_pair in matches if pair in by_pair]
        a, b = (np.concatenate([m[side] for m in found] or [np.empty((0, 2))]) for side in (0, 1))
        second = place_second(loaded[first], loaded[others[0]], (a, b), distance)
        note = {"distance_m": distance, "matches": len(a)}
        loaded = Rig({first: loaded[first], others[0]: second}, {**loaded.provenance, "placed": note})
    lines = {name: find_horizon(image / len(instants), loaded[name]) for name, image in total.items()}
    horizons = {name: line for name, line in lines.items() if line is not None}
    return level_on_water(loaded, matches, horizons, distance)
