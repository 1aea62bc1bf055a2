"""The target images beside a cube, and what is found in them."""

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.errors import CalibrationError, FrameError, WavefieldError
from wavefield.images import read_image
from wavefield.series import Experiment

_KEPT = 6  # images that are held in memory


@dataclass(frozen=True)
class FoundTarget:
    """A target image and what is found in it."""

    image: NDArray[Any] | None  # (row, column): As read; None if it cannot be
    pixel: NDArray[np.float64]  # (n, 2): Columns and rows of the nodes, px
    words: str  # How many, or why there are none


class TargetImages:
    """Looks for the target in images of an experiment when they are asked for."""

    def __init__(self, experiment: Experiment) -> None:
        from wavefield.series.target_listing import find_views

        self._experiment = experiment
        self._found: dict[Path, FoundTarget] = {}
        self._views: dict[str, dict[str, Path]] = {}
        if experiment.calibration is not None:
            with suppress(WavefieldError):  # target images that are gone say nothing against the cube
                self._views = find_views(experiment)

    def poses(self, camera: str) -> list[str]:
        """Names of the poses of which a camera has an image."""
        there = self._views.get(camera, {})
        return [pose for pose, path in there.items() if path.suffix.lower() not in (".csv", ".txt")]

    def found(self, camera: str, pose: str) -> FoundTarget:
        """An image of a camera and the nodes in it; a second or two when it is asked for first."""
        path = self._views[camera][pose]
        if path not in self._found:
            while len(self._found) >= _KEPT:
                self._found.pop(next(iter(self._found)))
            self._found[path] = self._find(path)
        return self._found[path]

    def _find(self, path: Path) -> FoundTarget:
        from wavefield.calibration import Target, find_target

        section, none = self._experiment.calibration, np.zeros((0, 2))
        assert section is not None
        try:
            image = read_image(path)
        except FrameError as error:
            return FoundTarget(None, none, str(error))
        try:
            points = find_target(image, Target.from_dict(section.target))
        except CalibrationError as error:
            return FoundTarget(image, none, str(error))
        return FoundTarget(image, points.pixel, f"{len(points.pixel)} nodes found in {path.name}")
