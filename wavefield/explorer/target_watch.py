"""Target images as they are taken: what is found in them, how well they fix the rig, what to take next."""

import threading
from collections.abc import Mapping
from html import escape
from pathlib import Path

import numpy as np

from wavefield.calibration import Target, TargetPoints, calibrate
from wavefield.calibration.next_view import next_view
from wavefield.calibration.target_images import placed_at
from wavefield.errors import WavefieldError
from wavefield.explorer.target_images import FoundTarget, find_in_image, target_images
from wavefield.series import Experiment
from wavefield.series.experiment_parts import CalibrationSection

_PAUSE_S = 1.0  # between polls
MIN_VIEWS = 3  # of each camera, before the rig is solved for
_MODEL = "paper"  # of the cameras: the choice among all takes too long between two pictures


class TargetWatch:
    """Finds the target in new images of each camera, in a thread of its own."""

    def __init__(self, experiment: Experiment) -> None:
        self._experiment = experiment
        self._checked: dict[tuple[str, str], tuple[Path, float]] = {}  # path and time, by camera and pose
        self._views: dict[str, dict[str, TargetPoints]] = {}  # by camera and pose
        self._lines: dict[str, str] = {}  # of the words, by camera
        self._rig_words = ""
        self.found: dict[str, FoundTarget] = {}  # the newest, by camera

    def start(self) -> None:
        """Begin, if the experiment names target images."""
        if self._experiment.calibration is not None:
            threading.Thread(target=self._work, daemon=True, name="targets").start()

    @property
    def words(self) -> str:
        """What was found, a line of HTML per camera."""
        lines = [f"Target, {name}: {words}" for name, words in sorted(self._lines.items())]
        if self._rig_words:
            lines.append(self._rig_words)
        return "<br>".join(escape(line, quote=False) for line in lines)

    def _work(self) -> None:
        pause = threading.Event()
        while True:
            self.poll()
            pause.wait(_PAUSE_S)

    def poll(self) -> None:
        """Evaluate the target images that are new."""
        section = self._experiment.calibration
        assert section is not None
        try:
            images = target_images(self._experiment)
        except WavefieldError as error:
            self._lines = {"all cameras": str(error)}
            return
        self._lines.pop("all cameras", None)
        new = False
        for camera, poses in images.items():
            for pose, path in sorted(poses.items(), key=lambda one: one[1].stat().st_mtime):
                mark = path, path.stat().st_mtime
                if self._checked.get((camera, pose)) == mark:
                    continue
                self._checked[camera, pose] = mark
                found = find_in_image(path, section)
                self._lines[camera] = found.words
                if found.points is not None:
                    self._lines[camera] += f"; {len(poses)} poses so far"
                    self.found[camera] = found
                    self._views.setdefault(camera, {})[pose] = found.points
                    new = True
        if new and min(len(self._views.get(name, ())) for name in self._experiment.cameras) < MIN_VIEWS:
            self._rig_words = f"Rig: {MIN_VIEWS} views of each camera are needed to solve for it."
        elif new:
            self._rig_words = so_far(self._views, section)


def so_far(views: Mapping[str, Mapping[str, TargetPoints]], section: CalibrationSection) -> str:
    """How well views of a target fix the rig, and which to photograph next, in words."""
    placed = {
        camera: {
            pose: placed_at(points, section.heights[pose]) if pose in section.heights else points
            for pose, points in poses.items()
        }
        for camera, poses in views.items()
    }
    result = calibrate(
        placed, Target.from_dict(section.target), flat="flat" if section.flat else "",
        model=section.model or _MODEL, target_std=section.target_std,
    )  # fmt: skip
    if result.predicted is None:
        return f"Rig: {'; '.join(result.problems)}"
    pixels = ", ".join(f"{name} to {std:.2g} px" for name, std in result.predicted.reprojection.items())
    z = "" if np.isnan(result.predicted.z_std) else f", z to {1e3 * result.predicted.z_std:.2g} mm"
    then = next_view(result)
    helps = then is not None and then.helps
    advice = f"Next: {then.words}" if then and helps else "Another view would hardly improve it: calibrate"
    return f"Rig, from the views so far: {pixels}{z}. {advice}."
