"""Target images as they are taken: what is found in them, how well they fix the rig, what to take next."""

import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.calibration.points import TargetPoints
from wavefield.errors import CalibrationError, FrameError, WavefieldError
from wavefield.series import Experiment
from wavefield.series.experiment_parts import CalibrationSection

_PAUSE = 1.0  # s
_VIEWS = 3  # of each camera, before anything is solved for
_MODEL = "paper"  # of the cameras: the choice among all takes too long between two pictures


class TargetWatch:
    """Looks for the target in the newest image of each camera, in a thread of its own."""

    def __init__(self, experiment: Experiment) -> None:
        self._experiment = experiment
        self._checked: dict[tuple[str, str], tuple[str, float]] = {}
        self._words: dict[str, str] = {}
        self._views: dict[str, dict[str, TargetPoints]] = {}  # points by camera and pose
        self.found: dict[str, tuple[NDArray[Any], NDArray[Any]]] = {}
        self.rig_words = ""
        self._thread = threading.Thread(target=self._work, daemon=True, name="targets")

    def start(self) -> None:
        """Begin, if the experiment names target images."""
        if self._experiment.calibration is not None:
            self._thread.start()

    @property
    def words(self) -> str:
        """What was found, a sentence per camera."""
        lines = [f"Target, {name}: {words}" for name, words in sorted(self._words.items())]
        return "<br>".join([*lines, self.rig_words] if self.rig_words else lines)

    def _work(self) -> None:
        pause = threading.Event()
        while True:
            self.look()
            pause.wait(_PAUSE)

    def look(self) -> None:
        """Look at target images that are new."""
        from wavefield.series.target_listing import find_views

        try:
            views = find_views(self._experiment)
        except WavefieldError as error:
            self._words = {"all cameras": str(error).replace("<", "&lt;")}
            return
        self._words.pop("all cameras", None)
        new = False
        for camera, poses in views.items():
            images = [
                (pose, path) for pose, path in poses.items() if path.suffix.lower() not in (".csv", ".txt")
            ]
            images.sort(key=lambda one: one[1].stat().st_mtime)
            for pose, path in images:
                mark = str(path), path.stat().st_mtime
                if self._checked.get((camera, pose)) != mark:
                    self._checked[camera, pose] = mark
                    new |= self._find(camera, pose, path, len(poses))
        if new:
            self._assess()

    def _find(self, camera: str, pose: str, path: Path, poses: int) -> bool:
        from wavefield.calibration import Target, find_target
        from wavefield.images import read_image

        assert self._experiment.calibration is not None
        try:
            image = read_image(path)
            points = find_target(image, Target.from_dict(self._experiment.calibration.target))
        except (CalibrationError, FrameError) as error:
            self._words[camera] = str(error).replace("<", "&lt;")
            return False
        self._words[camera] = f"{len(points.pixel)} nodes found in {path.name}; {poses} poses so far"
        self.found[camera] = image, points.pixel
        self._views.setdefault(camera, {})[pose] = points
        return True

    def _assess(self) -> None:
        section = self._experiment.calibration
        assert section is not None
        if min((len(self._views.get(name, ())) for name in self._experiment.cameras), default=0) < _VIEWS:
            self.rig_words = f"Rig: {_VIEWS} views of each camera are needed to solve for it."
        else:
            self.rig_words = so_far(self._views, section).replace("<", "&lt;")


def so_far(views: Mapping[str, Mapping[str, TargetPoints]], section: CalibrationSection) -> str:
    """Say how well views of a target fix the rig, and what to photograph next."""
    from wavefield.calibration import Target, calibrate
    from wavefield.calibration.images import placed_at
    from wavefield.calibration.next_view import next_view

    placed = {
        camera: {
            pose: placed_at(points, section.heights[pose]) if pose in section.heights else points
            for pose, points in poses.items()
        }
        for camera, poses in views.items()
    }
    found = calibrate(
        placed,
        Target.from_dict(section.target),
        flat="flat" if section.flat else "",
        model=section.model or _MODEL,
        target_std=section.target_std,
    )
    if found.derived is None:
        return f"Rig: {'; '.join(found.problems)}"
    pixels = ", ".join(f"{name} to {std:.2g} px" for name, std in found.derived.reprojection.items())
    z = "" if np.isnan(found.derived.z_std) else f", z to {1e3 * found.derived.z_std:.2g} mm"
    then = next_view(found)
    helps = then is not None and then.helps
    more = f"Next: {then.words}" if then and helps else "Another view would hardly tell more: calibrate"
    return f"Rig, as the views so far fix it: {pixels}{z}. {more}."
