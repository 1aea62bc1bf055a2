"""The images of the calibration target of an experiment, and the nodes that are found in them."""

from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.calibration import TargetPoints
from wavefield.errors import CalibrationError, FrameError, WavefieldError
from wavefield.images import read_image
from wavefield.series import Experiment
from wavefield.series.experiment_parts import CalibrationSection
from wavefield.series.target_listing import find_views

_CACHED_IMAGES = 6


@dataclass(frozen=True)
class FoundTarget:
    """A target image and the nodes in it."""

    image: NDArray[Any] | None  # (row, column): as read; None if it cannot be read
    points: TargetPoints | None  # None if there is no target
    words: str  # how many, or why there are none

    @property
    def pixel(self) -> NDArray[np.float64]:
        """Columns and rows of the nodes, (n, 2), px."""
        return np.zeros((0, 2)) if self.points is None else self.points.pixel


def find_in_image(path: Path, section: CalibrationSection) -> FoundTarget:
    """Find the target of an experiment in an image; an error becomes words."""
    from wavefield.calibration import Target, find_target

    image = None
    try:
        image = read_image(path)
        points = find_target(image, Target.from_dict(section.target))
    except (CalibrationError, FrameError) as error:
        return FoundTarget(image, None, str(error))
    return FoundTarget(image, points, f"{len(points.pixel)} nodes found in {path.name}")


def target_images(experiment: Experiment) -> dict[str, dict[str, Path]]:
    """Target images of an experiment by camera and pose."""
    from wavefield.calibration.target_images import is_table

    return {
        camera: {pose: path for pose, path in poses.items() if not is_table(path)}
        for camera, poses in find_views(experiment).items()
    }


class TargetImages:
    """Finds the target in the images of an experiment when they are shown."""

    def __init__(self, experiment: Experiment) -> None:
        self._images: dict[str, dict[str, Path]] = {}
        section = experiment.calibration
        if section is not None:
            with suppress(WavefieldError):  # a cube is shown without its target images, too
                self._images = target_images(experiment)
            self._find = lru_cache(_CACHED_IMAGES)(lambda path: find_in_image(path, section))

    def poses(self, camera: str) -> list[str]:
        """Names of the poses of which a camera has an image."""
        return list(self._images.get(camera, ()))

    def found(self, camera: str, pose: str) -> FoundTarget:
        """An image of a camera and the nodes in it; takes a second or two the first time."""
        return self._find(self._images[camera][pose])
