"""Find the target in images; from the target images of an experiment to its rig."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.calibration.dots import find_dots
from wavefield.calibration.points import Image, TargetPoints, read_points
from wavefield.calibration.printed import find_charuco, find_chessboard
from wavefield.calibration.solve import Calibration, calibrate
from wavefield.calibration.strings import find_strings
from wavefield.calibration.target import Target
from wavefield.calibration.two_level import find_two_level
from wavefield.errors import CalibrationError, ExperimentError, FrameError
from wavefield.images import read_image
from wavefield.rig import Rig
from wavefield.series import Experiment
from wavefield.series.target_listing import find_views

TABLES = (".csv", ".txt", ".dat", "")  # endings of points found by another program


@dataclass(frozen=True)
class TargetRig:
    """Result of calibrating an experiment."""

    calibration: Calibration  # The rig and how far it can be trusted
    views: dict[str, dict[str, TargetPoints]]  # Points found in the images
    images: dict[str, dict[str, Path]]  # The images
    notes: tuple[str, ...]  # Images without a target


FINDERS = {
    "strings": find_strings,
    "chessboard": find_chessboard,
    "dots": find_dots,
    "charuco": find_charuco,
    "two-level": find_two_level,
}
MIN_SIDE = 32  # px
MIN_CONTRAST = 4.0 / 255.0  # of the brightest grey
MAX_SATURATED = 0.2  # of the image: if nothing is found in more, overexposure is named as the cause


def find_target(image: NDArray[np.generic], target: Target) -> TargetPoints:
    """Find the nodes of a calibration target in one image.

    Parameters
    ----------
    image : ndarray, (row, column), any real dtype
        The image; bright where the strings are white.
    target : Target
        Kind and dimensions of the target.

    Returns
    -------
    TargetPoints
        Indices of the nodes found, their pixel coordinates and standard uncertainties.

    Raises
    ------
    CalibrationError
        If the image is empty or overexposed, or shows no such target, or a mirrored one, or too little of it.
    """
    grey = scaled(image)
    try:
        return FINDERS[target.kind](grey, target)
    except CalibrationError as error:
        saturated = float(np.mean(grey >= grey.max()))
        if saturated > MAX_SATURATED:
            raise CalibrationError(
                f"{error}; {saturated:.0%} of the image is overexposed: photograph it again with less light"
            ) from None
        raise


def scaled(image: NDArray[np.generic]) -> Image:
    """The image as float32 with its brightest patch at 255, refused when it cannot show a target."""
    image = np.asarray(image)
    if image.ndim != 2 or min(image.shape) < MIN_SIDE:
        raise CalibrationError(
            f"a target image must be one grey image of {MIN_SIDE} px or more, not {image.shape}"
        )
    grey = image.astype(np.float32)
    if not np.isfinite(grey).all():
        raise CalibrationError("the image holds values that are not numbers; export it from the camera again")
    # hot pixels and sparkles are no part of a target, whose marks are more than a few pixels wide
    grey = np.minimum(grey, cv2.medianBlur(grey, 5).max())
    low, high = float(grey.min()), float(grey.max())
    if high - low < MIN_CONTRAST * max(abs(high), 1e-12):
        raise CalibrationError(
            "the image is empty: all its pixels have one grey; check light, cap and exposure"
        )
    return np.asarray(grey * np.float32(255.0 / high))


def _find_in_file(path: Path, target: Target, size: tuple[int, int] | None = None) -> TargetPoints | str:
    """Find the target in one image; a sentence where it cannot be found."""
    try:
        if is_table(path):
            return read_points(path, size, unit=target.mesh if target.kind == "points" else None)
        return find_target(read_image(path), target)
    except (CalibrationError, FrameError) as error:
        sentence = str(error)
        return sentence if str(path) in sentence else f"{path}: {sentence}"


def _frame_sizes(experiment: Experiment) -> dict[str, tuple[int, int]]:
    """Width and height of the images of each camera, px; none where there are no images yet."""
    try:
        return {name: (one.shape[1], one.shape[0]) for name, one in experiment.open_frames().items()}
    except (ExperimentError, FrameError):
        return {}


def placed_at(points: TargetPoints, height: float) -> TargetPoints:
    """Points of a target parallel to z = 0 at a known height (metres), its axes along those of the frame."""
    own = np.zeros(len(points)) if points.z is None else points.z
    return replace(points, z=own + height, placed=True)


def is_table(path: Path) -> bool:
    """Whether a file holds points in place of an image."""
    return path.suffix.lower() in TABLES


def calibrate_experiment(
    experiment: str | Path | Experiment,
    progress: Callable[[int, int], None] | None = None,
    solving: Callable[[int, int], None] | None = None,
) -> TargetRig:
    """Find the rig of an experiment from its target images.

    Parameters
    ----------
    experiment : path or Experiment
        With a calibration block.
    progress : callable, optional
        Called with (images done, all images).
    solving : callable, optional
        Called with (camera models fitted, all of them).

    Returns
    -------
    TargetRig

    Raises
    ------
    CalibrationError
        If target images are missing, or in none of them is the target found.

    Examples
    --------
    >>> import wavefield as wf
    >>> found = wf.calibrate("experiment.yaml")  # doctest: +SKIP
    >>> found.calibration.usable, found.notes  # doctest: +SKIP
    (True, ())
    >>> found.calibration.rig.save("rig.yaml")  # doctest: +SKIP
    """
    if not isinstance(experiment, Experiment):
        experiment = Experiment.load(experiment)
    images = find_views(experiment)
    section = experiment.calibration
    assert section is not None
    poses = {pose for by_pose in images.values() for pose in by_pose}
    unknown = sorted(set(section.heights) - poses)
    if unknown:
        raise CalibrationError(
            f"{experiment.path}: heights names {', '.join(unknown)}; the poses are {', '.join(sorted(poses))}"
        )
    target = Target.from_dict(section.target, experiment.path)
    order = dict.fromkeys(pose for by_pose in images.values() for pose in by_pose)
    jobs = [
        (camera, pose, images[camera][pose]) for pose in order for camera in images if pose in images[camera]
    ]
    views: dict[str, dict[str, TargetPoints]] = {camera: {} for camera in images}
    notes: list[str] = []  # images without a target, and why
    frame_sizes = _frame_sizes(experiment) if any(is_table(p) for _, _, p in jobs) else {}
    sizes = [frame_sizes.get(camera) for camera, _, _ in jobs]
    # threads suffice: OpenCV and the compiled loops leave Python's lock
    pool = ThreadPoolExecutor(min(os.cpu_count() or 1, len(jobs)))
    try:
        found = pool.map(_find_in_file, [path for _, _, path in jobs], [target] * len(jobs), sizes)
        for done, ((camera, pose, _), points) in enumerate(zip(jobs, found, strict=True), 1):
            if isinstance(points, str):
                notes.append(points)
            else:
                height = section.heights.get(pose)
                views[camera][pose] = points if height is None else placed_at(points, height)
            if progress:
                progress(done, len(jobs))
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
    named = {
        camera: {pose: os.path.relpath(path, experiment.path.parent) for pose, path in by_pose.items()}
        for camera, by_pose in images.items()
    }
    calibration = calibrate(
        views,
        target,
        flat="flat" if section.flat else "",
        model=section.model,
        target_std=section.target_std,
        camera_distance=section.camera_distance,
        progress=solving,
    )
    source = {"experiment": experiment.name, "target": dict(section.target), "images": named}
    rig = Rig(calibration.rig.cameras, {**calibration.rig.provenance, **source})
    calibration = replace(calibration, rig=rig)
    return TargetRig(calibration, views, images, tuple(notes))
