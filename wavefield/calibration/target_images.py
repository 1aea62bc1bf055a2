"""Find the target in images, and calibrate the rig of an experiment from its target images."""

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
from wavefield.one_thread import one_thread
from wavefield.rig import Rig
from wavefield.series import Experiment
from wavefield.series.listing import find_views

TABLES = (".csv", ".txt", ".dat", "")  # suffixes of tables of points that another program found


@dataclass(frozen=True)
class TargetRig:
    """Result of `calibrate_experiment`: the calibrated rig and the target points found in each image."""

    calibration: Calibration  # The rig and its uncertainties
    views: dict[str, dict[str, TargetPoints]]  # Points found, by camera and pose of the target
    images: dict[str, dict[str, Path]]  # Image files, by camera and pose
    notes: tuple[str, ...]  # One sentence for each image in which no target was found


FINDERS = {
    "strings": find_strings,
    "chessboard": find_chessboard,
    "dots": find_dots,
    "charuco": find_charuco,
    "two-level": find_two_level,
}
MIN_SIDE = 32  # px: room for a row of four nodes that are eight pixels apart
MIN_CONTRAST = 4.0 / 255.0  # of the brightest grey: four grey levels of an 8-bit image
MAX_SATURATED = 0.2  # fraction of pixels; above it a failed search is blamed on overexposure


def find_target(image: NDArray[np.generic], target: Target) -> TargetPoints:
    """Find the nodes of a calibration target in one image.

    Parameters
    ----------
    image : ndarray, (row, column), any real dtype
        The image. White strings must have large values.
    target : Target
        Kind and dimensions of the target.

    Returns
    -------
    TargetPoints
        Indices of the nodes found (n, 2), their pixel coordinates (n, 2) and standard uncertainties (n,), px.

    Raises
    ------
    CalibrationError
        If the image is empty, overexposed, or shows no such target or too little of it.
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
    """Return an image as float32, scaled so that its brightest patch has the value 255.
    Raises a CalibrationError if the image is too small, uniform, or not grey, or if a value is not finite."""
    image = np.asarray(image)
    if image.ndim != 2 or min(image.shape) < MIN_SIDE:
        raise CalibrationError(
            f"a target image must be one grey image of {MIN_SIDE} px or more, not {image.shape}"
        )
    grey = image.astype(np.float32)
    if not np.isfinite(grey).all():
        raise CalibrationError("the image holds values that are not numbers; export it from the camera again")
    # the marks of a target are wider than a few pixels: clip hot pixels and sparkles to the brightest mark
    grey = np.minimum(grey, cv2.medianBlur(grey, 5).max())
    low, high = float(grey.min()), float(grey.max())
    if high - low < MIN_CONTRAST * max(abs(high), 1e-12):
        raise CalibrationError(
            "the image is empty: all its pixels have one grey; check light, lens cap and exposure"
        )
    return np.asarray(grey * np.float32(255.0 / high))


def _find_in_file(path: Path, target: Target, size: tuple[int, int] | None = None) -> TargetPoints | str:
    """Return the target points in an image or table, or a sentence for the user if that fails.
    `size` (width, height), px, is used for a table that does not state the size of the image."""
    try:
        if is_table(path):
            return read_points(path, size, unit=target.mesh if target.kind == "points" else None)
        return find_target(read_image(path), target)
    except (CalibrationError, FrameError) as error:
        sentence = str(error)
        return sentence if str(path) in sentence else f"{path}: {sentence}"


def _frame_sizes(experiment: Experiment) -> dict[str, tuple[int, int]]:
    """Return the (width, height) of each camera's frames, px; an empty dict if frames cannot be opened."""
    try:
        return {name: (one.shape[1], one.shape[0]) for name, one in experiment.open_frames().items()}
    except (ExperimentError, FrameError):
        return {}


def placed_at(points: TargetPoints, height: float) -> TargetPoints:
    """Return the points of a target parallel to z = 0, marked as known positions in the rig's frame.
    `height` is the height of the target above z = 0, m."""
    own = np.zeros(len(points)) if points.z is None else points.z
    return replace(points, z=own + height, placed=True)


def is_table(path: Path) -> bool:
    """Tell whether the ending of the file name is one of a table of points, rather than of an image."""
    return path.suffix.lower() in TABLES


@one_thread()
def calibrate_experiment(
    experiment: str | Path | Experiment,
    progress: Callable[[int, int], None] | None = None,
) -> TargetRig:
    """Calibrate the rig of an experiment from its target images.

    Parameters
    ----------
    experiment : path or Experiment
        An experiment with a `calibration:` block.
    progress : callable, optional
        Called with (images done, number of images).

    Returns
    -------
    TargetRig
        The calibration, the points found in each image, and notes on images without a target.

    Raises
    ------
    CalibrationError
        If target images are missing, or `heights` names an unknown pose.

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
    section = experiment.calibration
    if section is None:
        raise CalibrationError(
            f"{experiment.path} has no calibration block, so there is nothing to calibrate; add one that "
            "states what the target is and where its images are (see docs/calibration.md)"
        )
    images = find_views(section, experiment.cameras, experiment.image_folder, experiment.path)
    poses = dict.fromkeys(pose for by_pose in images.values() for pose in by_pose)
    unknown = sorted(set(section.heights) - set(poses))
    if unknown:
        raise CalibrationError(
            f"{experiment.path}: heights names {', '.join(unknown)}; the poses are {', '.join(sorted(poses))}"
        )
    target = Target.from_dict(section.target, experiment.path)
    jobs = [
        (camera, pose, images[camera][pose]) for pose in poses for camera in images if pose in images[camera]
    ]
    views: dict[str, dict[str, TargetPoints]] = {camera: {} for camera in images}
    notes: list[str] = []  # why images show no target
    frame_sizes = _frame_sizes(experiment) if any(is_table(p) for _, _, p in jobs) else {}
    sizes = [frame_sizes.get(camera) for camera, _, _ in jobs]
    # threads suffice: OpenCV and the compiled loops release Python's global lock
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
    )
    source = {"experiment": experiment.name, "target": dict(section.target), "images": named}
    rig = Rig(calibration.rig.cameras, {**calibration.rig.provenance, **source})
    calibration = replace(calibration, rig=rig)
    return TargetRig(calibration, views, images, tuple(notes))
