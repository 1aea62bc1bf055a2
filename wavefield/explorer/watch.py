"""Watching the folders of an experiment while its cameras write; nothing is ever written there."""

import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from wavefield.errors import FrameError, WavefieldError
from wavefield.series import Experiment
from wavefield.series.listing import newest_frames
from wavefield.series.readers import FrameEntry, read_entry

_STEPS_BACK = 3  # tried if the newest frames cannot be read yet
_LISTED_FRAMES = 1000  # the newest ones: no camera that still sends is so many behind the others
_MAX_DELAY_S = 1.0  # behind the newest frame of the others, of a camera that still sends


@dataclass(frozen=True)
class FrameSet:
    """The newest two frames of every camera that still sends."""

    number: int  # of the first frame
    images: dict[str, tuple[NDArray[Any], NDArray[Any]]]  # both frames, by camera
    written: float  # when the last of them was written, s since the epoch


class FolderWatch:
    """The frames of an experiment as they arrive."""

    def __init__(self, experiment: Experiment) -> None:
        self.experiment = experiment
        self.newest: dict[str, int] = {}  # number of the newest frame of each camera
        self.written: dict[str, float] = {}  # when that was written, s since the epoch
        self.trouble: dict[str, str] = {}
        self._polled = time.monotonic()
        self._noticed = dict.fromkeys(experiment.cameras, self._polled)  # when the newest frame was
        self._frames: dict[str, dict[int, FrameEntry]] = {}

    def poll(self) -> None:
        """List the folders."""
        self._polled = time.monotonic()
        for name, section in self.experiment.cameras.items():
            try:
                listed = newest_frames(section.images, self.experiment.image_folder, name, _LISTED_FRAMES)
            except WavefieldError as error:
                self.trouble[name] = str(error)
                continue
            self.trouble.pop(name, None)
            self._frames[name] = {number + section.offset: entry for number, entry in listed.items()}
            number = max(self._frames[name])
            if number != self.newest.get(name):
                self.newest[name] = number
                self.written[name] = _written(self._frames[name][number])
                self._noticed[name] = self._polled

    def silent(self) -> dict[str, float]:
        """For how long no new frame of each camera had come at the last poll, s, by this clock."""
        return {name: self._polled - when for name, when in self._noticed.items()}

    def newest_set(self, after: int = -1) -> FrameSet | None:
        """The newest step after a number of which all cameras that still send have both frames."""
        latest = max(self.written.values(), default=0.0)
        sending = [name for name, when in self.written.items() if latest - when <= _MAX_DELAY_S]
        if not sending:
            return None
        top = min(self.newest[name] for name in sending) - 1
        for number in range(top, max(top - _STEPS_BACK, after), -1):
            images = {name: both for name in sending if (both := self._read(name, number)) is not None}
            if len(images) == len(sending):
                written = max(_written(self._frames[name][number + 1]) for name in sending)
                return FrameSet(number, images, written)
        return None

    def _read(self, name: str, number: int) -> tuple[NDArray[Any], NDArray[Any]] | None:
        frames = self._frames[name]
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
