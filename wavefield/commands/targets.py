"""From the calibration block of an experiment to a rig: finds the images, the targets in them, and solves."""

import glob
import os
import re
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

from wavefield.calibration import Calibration, Target, TargetPoints, calibrate, find_target
from wavefield.calibration.pointfile import read_points
from wavefield.errors import CalibrationError, FrameError
from wavefield.images import read_image
from wavefield.series import Experiment

_TABLES = (".csv", ".txt")


@dataclass(frozen=True)
class TargetRig:
    """What came of calibrating an experiment.

    Parameters
    ----------
    calibration : Calibration
        The rig and how far it can be trusted.
    views : dict of camera to dict of pose to TargetPoints
        What was found in the images.
    images : dict of camera to dict of pose to Path
        The images.
    notes : tuple of str
        Images without a target.
    mesh : float
        Of the target, m.
    """

    calibration: Calibration
    views: dict[str, dict[str, TargetPoints]]
    images: dict[str, dict[str, Path]]
    notes: tuple[str, ...]
    mesh: float


def find_views(experiment: Experiment) -> dict[str, dict[str, Path]]:
    """Find the target images of an experiment.

    Parameters
    ----------
    experiment : Experiment
        With a calibration block.

    Returns
    -------
    dict of camera to dict of pose to Path
        The flat pose is called "flat"; tilted ones after their file, without what names the camera.

    Raises
    ------
    CalibrationError
        If there is no calibration block, or a pattern in it names no image of a camera.
    """
    section = experiment.calibration
    if section is None:
        raise CalibrationError(
            f"{experiment.path} has no calibration block; add one that says what the target is and where "
            f"its images "
            "are (see docs/calibration.md), or name a rig that another program made"
        )
    tilted = [section.tilted] if isinstance(section.tilted, str) else list(section.tilted)
    out: dict[str, dict[str, Path]] = {}
    for camera in experiment.cameras:
        poses: dict[str, Path] = {}
        for pattern in tilted:
            poses |= _poses(experiment, pattern, camera)
        if not poses:
            raise _nothing(experiment, camera, tilted)
        if section.flat:
            flat = list(_poses(experiment, section.flat, camera).values())
            if len(flat) > 1:
                raise CalibrationError(
                    f"{experiment.path}: flat: {section.flat} names {len(flat)} images of {camera}; name one"
                )
            poses = {pose: path for pose, path in poses.items() if path not in flat}
            poses |= dict.fromkeys(["flat"], flat[0]) if flat else {}
        out[camera] = poses
    if section.flat and not any("flat" in poses for poses in out.values()):
        raise _nothing(experiment, "any camera", [section.flat])
    return out


def _nothing(experiment: Experiment, camera: str, patterns: Sequence[str]) -> CalibrationError:
    folder = experiment.image_folder
    return CalibrationError(
        f"{experiment.path}: no target image of {camera}: nothing in {folder} is called "
        f"{' or '.join(patterns)}; correct the calibration block"
    )


def _poses(experiment: Experiment, pattern: str, camera: str) -> dict[str, Path]:
    folder = experiment.image_folder
    named = pattern.replace("{camera}", glob.escape(camera))
    # what the wildcards stand for names the pose, so that one pose has one name in all cameras
    parts = re.split(r"(\*+|\?)", named)
    groups = [
        ("(.)" if part == "?" else "(.*?)") if part and part[0] in "*?" else re.escape(part) for part in parts
    ]
    expression = re.compile("".join(groups))
    stem = Path(pattern.replace("{camera}", "")).stem
    out = {}
    for found in sorted(glob.glob(str(folder / named))):
        match = expression.fullmatch(os.path.relpath(found, folder)) or expression.fullmatch(found)
        pose = stem
        for piece in match.groups() if match else ():
            pose = re.sub(r"\*+|\?", piece, pose, count=1)
        out[pose.strip("_- ") or Path(found).stem] = Path(found)
    return out


def _look(path: Path, target: Target, size: tuple[int, int] | None) -> TargetPoints | str:
    """Find the target in one image; a sentence where it cannot be found."""
    try:
        if path.suffix.lower() in _TABLES:
            return read_points(path, size)
        return find_target(read_image(path), target)
    except (CalibrationError, FrameError) as error:
        words = str(error)
        return words if str(path) in words else f"{path}: {words}"


def calibrate_experiment(
    experiment: Experiment, progress: Callable[[int, int], None] | None = None
) -> TargetRig:
    """Find the rig of an experiment from its target images.

    Parameters
    ----------
    experiment : Experiment
        With a calibration block.
    progress : callable, optional
        Told (images done, all images).

    Returns
    -------
    TargetRig

    Raises
    ------
    CalibrationError
        If target images are not there.
    """
    images = find_views(experiment)
    section = experiment.calibration
    assert section is not None
    target = Target.from_dict(section.target)
    jobs = [(camera, pose, path) for camera, poses in images.items() for pose, path in poses.items()]
    views: dict[str, dict[str, TargetPoints]] = {camera: {} for camera in images}
    notes = []
    workers = min(os.cpu_count() or 1, len(jobs), 8)
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        found = pool.map(_look, [path for _, _, path in jobs], [target] * len(jobs), [None] * len(jobs))
        for done, ((camera, pose, _), points) in enumerate(zip(jobs, found, strict=True), 1):
            if isinstance(points, str):
                notes.append(points)
            else:
                views[camera][pose] = points
            if progress:
                progress(done, len(jobs))
    named = {
        camera: {pose: os.path.relpath(path, experiment.path.parent) for pose, path in poses.items()}
        for camera, poses in images.items()
    }
    calibration = calibrate(
        views,
        target,
        flat="flat" if section.flat else "",
        model=section.model or "auto",
        target_std=section.target_std,
        camera_distance=section.camera_distance,
        provenance={"experiment": experiment.name, "target": dict(section.target), "images": named},
    )
    return TargetRig(calibration, views, images, tuple(notes), target.mesh)


def draw_found(result: TargetRig, path: Path) -> None:
    """Draw what was found in one image of each camera: the flat pose where there is one.

    Parameters
    ----------
    result : TargetRig
        As from `calibrate_experiment`.
    path : Path
        PNG file to write; nothing is written if no target was found, or if the points came as tables.
    """
    from wavefield import figures

    poses = {
        camera: "flat" if "flat" in found else max(found, key=lambda pose: len(found[pose]))
        for camera, found in result.views.items()
        if found and all(path.suffix.lower() not in _TABLES for path in result.images[camera].values())
    }
    if not poses:
        return
    figure = figures.target_points(
        {camera: read_image(result.images[camera][pose]) for camera, pose in poses.items()},
        {camera: result.views[camera][pose] for camera, pose in poses.items()},
        result.calibration.rig if len(result.calibration.rig) and set(poses.values()) == {"flat"} else None,
        result.mesh,
    )
    figure.savefig(path, dpi=110)
