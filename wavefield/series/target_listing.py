"""Which images show the calibration target, and in which pose."""

import glob
import os
import re
from collections.abc import Sequence
from pathlib import Path

from wavefield.errors import CalibrationError
from wavefield.series.experiment import Experiment


def find_views(experiment: Experiment) -> dict[str, dict[str, Path]]:
    """Target images of an experiment, by camera and by pose; that on z = 0 is called ``flat``."""
    section = experiment.calibration
    if section is None:
        raise CalibrationError(
            f"{experiment.path} has no calibration block; add one that states what the target is and where "
            "its images are (see docs/calibration.md), or name a rig that another program made"
        )
    tilted = [section.tilted] if isinstance(section.tilted, str) else section.tilted
    out: dict[str, dict[str, Path]] = {}
    for camera in experiment.cameras:
        poses: dict[str, Path] = {}
        for pattern in tilted:
            poses |= _poses(experiment, pattern, camera)
        if not poses:
            raise _no_images(experiment, camera, tilted)
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
        raise _no_images(experiment, "any camera", [section.flat])
    return out


def _no_images(experiment: Experiment, camera: str, patterns: Sequence[str]) -> CalibrationError:
    return CalibrationError(
        f"{experiment.path}: no target image of {camera}: nothing in {experiment.image_folder} is called "
        f"{' or '.join(patterns)}; correct the calibration block"
    )


def _poses(experiment: Experiment, pattern: str, camera: str) -> dict[str, Path]:
    """Images that fit a pattern, by pose: the part that its wildcards match, the same in all cameras."""
    folder = experiment.image_folder
    named = pattern.replace("{camera}", glob.escape(camera))
    groups = {"*": "(.*?)", "?": "(.)"}
    parts = re.split(r"(\*+|\?)", named)
    expression = re.compile(
        "".join(groups[part[0]] if part[:1] in groups else re.escape(part) for part in parts)
    )
    stem = Path(pattern.replace("{camera}", "")).stem
    out = {}
    for file in sorted(glob.glob(str(folder / named))):
        match = expression.fullmatch(os.path.relpath(file, folder)) or expression.fullmatch(file)
        pose = stem
        for piece in match.groups() if match else ():
            pose = re.sub(r"\*+|\?", piece, pose, count=1)
        out[pose.strip("_- ") or Path(file).stem] = Path(file)
    return out
