"""Watching the folders of an experiment while its cameras write; nothing is ever written there."""

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from wavefield.errors import FrameError, WavefieldError
from wavefield.series import Experiment
from wavefield.series.listing import newest_frames
from wavefield.series.readers import FrameEntry, read_entry

_BACK = 3  # frames to go back where the newest cannot be read yet
_KEPT = 1000  # frames that are known: no camera that still sends is as many behind the others


@dataclass(frozen=True)
class FrameSet:
    """The newest frames that every camera has written whole."""

    number: int  # Number of the first frame of the step
    # (first, second): Both frames of a step; one camera's are absent where it sends none any more
    images: dict[str, tuple[NDArray[Any], NDArray[Any]]]
    written: float  # When the last of them was written, s since the epoch


class FolderWatch:
    """The frames of an experiment as they come."""

    def __init__(self, experiment: Experiment) -> None:
        self.experiment = experiment
        self.newest: dict[str, int] = {}
        self.last: dict[str, float] = {}
        self.trouble: dict[str, str] = {}
        self._frames: dict[str, dict[int, FrameEntry]] = {}

    def look(self) -> None:
        """List the folders."""
        for name, section in self.experiment.cameras.items():
            try:
                found = newest_frames(section.images, self.experiment.image_folder, name, _KEPT)
            except WavefieldError as error:
                self.trouble[name] = str(error)
                continue
            self.trouble.pop(name, None)
            self._frames[name] = {number + section.offset: entry for number, entry in found.items()}
            number = max(self._frames[name])
            if number != self.newest.get(name):
                self.newest[name] = number
                self.last[name] = _written(self._frames[name][number])

    def cameras_sending(self, within: float = 1.0) -> list[str]:
        """Cameras whose newest frame is hardly older than that of the others."""
        latest = max(self.last.values(), default=0.0)
        return [name for name, when in self.last.items() if latest - when <= within]

    def newest_set(self, after: int = -1) -> FrameSet | None:
        """The newest step of which all cameras that still send have both frames."""
        sending = self.cameras_sending()
        if not sending:
            return None
        top = min(self.newest[name] for name in sending) - 1
        for number in range(top, max(top - _BACK, after), -1):
            images = {name: both for name in sending if (both := self._read(name, number)) is not None}
            if len(images) == len(sending):
                written = max(_written(self._frames[name][number + 1]) for name in sending)
                return FrameSet(number, images, written)
        return None

    def _read(self, name: str, number: int) -> tuple[NDArray[Any], NDArray[Any]] | None:
        frames: Mapping[int, FrameEntry] = self._frames[name]
        if number not in frames or number + 1 not in frames:
            return None
        try:
            return read_entry(frames[number]), read_entry(frames[number + 1])
        except FrameError:  # not written to its end yet
            return None


def _written(entry: FrameEntry) -> float:
    try:
        return os.stat(Path(entry.path)).st_mtime
    except OSError:
        return time.time()
