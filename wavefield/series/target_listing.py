"""Find the images of the calibration target and their poses, from patterns in the experiment file."""

import glob
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path

from wavefield.errors import CalibrationError
from wavefield.series.experiment import Experiment


def find_views(experiment: Experiment) -> dict[str, dict[str, Path]]:
    """Return the paths of the images of the calibration target: for each camera, a path by pose.
    A pose of the target is named by the part of the file name that varies; the pose on z = 0 is ``flat``.
    CalibrationError if the experiment has no calibration block, or if a camera has no target image."""
    section = experiment.calibration
    if section is None:
        raise CalibrationError(
            f"{experiment.path} has no calibration block, so there is nothing to calibrate; add one that "
            "states what the target is and where its images are (see docs/calibration.md)"
        )
    tilted = [section.tilted] if isinstance(section.tilted, str) else section.tilted
    out: dict[str, dict[str, Path]] = {}
    for camera in experiment.cameras:
        poses: dict[str, Path] = {}
        for pattern in tilted:
            _add_poses(poses, _images(experiment, pattern, camera), experiment)
        if not poses:
            raise _no_images(experiment, camera, tilted)
        if section.flat:
            flat = [path for _, path in _images(experiment, section.flat, camera)]
            if len(flat) > 1:
                raise CalibrationError(
                    f"{experiment.path}: flat: {section.flat} names {len(flat)} images of {camera}; name one"
                )
            poses = {pose: path for pose, path in poses.items() if path not in flat}
            poses |= dict.fromkeys(["flat"], flat[0]) if flat else {}
        out[camera] = poses
    if section.flat and not any("flat" in poses for poses in out.values()):
        raise _no_images(experiment, "any camera", [section.flat])
    return out


def _no_images(experiment: Experiment, camera: str, patterns: Sequence[str]) -> CalibrationError:
    """Return the error to raise if no image of a camera matches the patterns."""
    return CalibrationError(
        f"{experiment.path}: no target image of {camera}: nothing in {experiment.image_folder} is called "
        f"{' or '.join(patterns)}; correct the calibration block"
    )


def _add_poses(poses: dict[str, Path], images: Iterable[tuple[str, Path]], experiment: Experiment) -> None:
    """Add pairs (pose, path) to the `poses` of a camera, in place.
    CalibrationError if two files have the same pose."""
    for pose, path in images:
        other = poses.setdefault(pose, path)
        if other != path:
            raise CalibrationError(
                f"{experiment.path}: both {other} and {path} would be pose {pose!r}; rename one of them, or "
                "narrow `tilted`"
            )


def _images(experiment: Experiment, pattern: str, camera: str) -> Iterator[tuple[str, Path]]:
    """Yield the pose and the path of each image of a camera that matches a pattern.
    The pose is the text that the wildcards match, with the text around them, so it is the same in all
    cameras. A leading minus sign is kept, because a target may be moved from -3 mm to 3 mm."""
    folder = experiment.image_folder
    named = pattern.replace("{camera}", glob.escape(camera))
    one_each = re.sub(r"\[.[^]]*\]", "?", pattern)  # a set such as [0-9] matches one character
    groups = {"*": "(.*?)", "?": "(.)"}
    parts = re.split(r"(\*+|\?)", one_each.replace("{camera}", camera))
    expression = re.compile(
        "".join(groups[part[0]] if part[:1] in groups else re.escape(part) for part in parts)
    )
    *folders, name = one_each.replace("{camera}", "").split("/")
    # folders with wildcards are part of the pose as well
    template = [re.sub(r"\*+", "*", part) for part in (*folders, Path(name).stem) if re.search(r"[*?]", part)]
    words = [word.strip("_- ") for word in template] or [Path(name).stem.strip("_- ")]
    for file in sorted(glob.glob(str(Path(glob.escape(str(folder))) / named))):
        match = expression.fullmatch(os.path.relpath(file, folder)) or expression.fullmatch(file)
        pose = "_".join(words)
        if match:
            texts = re.split(r"[*?]", pose)
            pose = "".join(chain.from_iterable(zip(texts, (*match.groups()[: len(texts) - 1], ""))))
        yield pose.lstrip("_ ").rstrip("_- ") or Path(file).stem, Path(file)
