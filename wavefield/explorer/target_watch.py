"""Target images as they are taken: what is found in the newest of each camera."""

import threading
from typing import Any

from numpy.typing import NDArray

from wavefield.errors import CalibrationError, FrameError, WavefieldError
from wavefield.series import Experiment

_PAUSE = 1.0  # s


class TargetWatch:
    """Looks for the target in the newest image of each camera, in a thread of its own.

    Parameters
    ----------
    experiment : Experiment
        With a calibration block; without one there is nothing to do.

    Attributes
    ----------
    found : dict of camera to (image, points)
        The newest target image, and the nodes found in it, (n, 2), px.
    """

    def __init__(self, experiment: Experiment) -> None:
        self._experiment = experiment
        self._looked: dict[str, tuple[str, float]] = {}
        self._words: dict[str, str] = {}
        self.found: dict[str, tuple[NDArray[Any], NDArray[Any]]] = {}
        self._thread = threading.Thread(target=self._work, daemon=True, name="targets")

    def start(self) -> None:
        """Begin, if the experiment names target images."""
        if self._experiment.calibration is not None:
            self._thread.start()

    @property
    def words(self) -> str:
        """What was found, a sentence per camera."""
        return "<br>".join(f"Target, {name}: {words}" for name, words in sorted(self._words.items()))

    def _work(self) -> None:
        pause = threading.Event()
        while True:
            self.look()
            pause.wait(_PAUSE)

    def look(self) -> None:
        """Look at target images that are new."""
        from wavefield.series.targets import find_views

        try:
            views = find_views(self._experiment)
        except WavefieldError as error:
            self._words = {"all cameras": str(error).replace("<", "&lt;")}
            return
        self._words.pop("all cameras", None)
        for camera, poses in views.items():
            images = [path for path in poses.values() if path.suffix.lower() not in (".csv", ".txt")]
            if not images:
                continue
            newest = max(images, key=lambda path: path.stat().st_mtime)
            mark = str(newest), newest.stat().st_mtime
            if self._looked.get(camera) != mark:
                self._looked[camera] = mark
                self._find(camera, newest, len(poses))

    def _find(self, camera: str, path: Any, poses: int) -> None:
        from wavefield.calibration import Target, find_target
        from wavefield.images import read_image

        assert self._experiment.calibration is not None
        try:
            image = read_image(path)
            points = find_target(image, Target.from_dict(self._experiment.calibration.target))
            nodes = points.pixel
            words = f"{len(nodes)} nodes found in {path.name}; {poses} poses so far"
            self.found[camera] = image, nodes
        except (CalibrationError, FrameError) as error:
            words = str(error).replace("<", "&lt;")
        self._words[camera] = words
