"""The work behind `wavefield follow`: the newest frames measured and assessed, the others counted."""

import logging
import threading
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.explorer import lights
from wavefield.explorer.features import FrameFeatures, frame_features
from wavefield.explorer.lights import PairSummary, StatusLight, StepSummary
from wavefield.explorer.live_measurement import Fields, LiveMeasurement
from wavefield.explorer.watch import FolderWatch, FrameSet
from wavefield.rig import Rig
from wavefield.series import Experiment

log = logging.getLogger("wavefield.follow")
_TILT_STEPS = 200  # over which the tilt is averaged
_PAUSE_S = 0.15  # between polls of the folders


@dataclass(frozen=True)
class FollowedSet:
    """The newest frames and what was measured in them."""

    number: int  # of the first frame
    images: Mapping[str, NDArray[Any]]  # the second frame, by camera
    fields: Fields  # (ny, nx): the measured step; empty without a rig
    lights: tuple[StatusLight, ...]
    delay: float  # from the last byte of the frames until they were measured, s
    measured: int  # steps so far
    skipped: int  # steps so far
    trouble: str  # why nothing is measured, a sentence


class Follower:
    """Follows an experiment in a thread of its own."""

    def __init__(self, experiment: Experiment, rig: Rig | Path | None = None) -> None:
        self.experiment = experiment
        self.latest: FollowedSet | None = None
        self.count = 0  # of the sets that were published
        self.history = lights.LightHistory()
        self.watch = FolderWatch(experiment)
        self._measurer = LiveMeasurement(experiment, rig)
        self._baseline = lights.Baseline()
        self._summaries: deque[StepSummary] = deque(maxlen=_TILT_STEPS)
        self._stop = threading.Event()
        self._first: int | None = None  # number of the first frame that was taken
        self._measured = 0
        self._thread = threading.Thread(target=self._work, daemon=True, name="follow")

    @property
    def nodes(self) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """Nodes along x and y, metres; empty without a rig."""
        learner = self._measurer.learner
        if learner is None:
            return np.empty(0), np.empty(0)
        return learner.geometry.grid.x_nodes, learner.geometry.grid.y_nodes

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """End; a step that is being measured is finished first."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(20)
        if self._measurer.learner is not None:
            self._measurer.learner.wait()

    def _work(self) -> None:
        while not self._stop.is_set():
            try:
                new = self.poll()
            except Exception as error:  # whatever happens with one set of frames, the next ones are measured
                log.warning("a set of frames was passed over", exc_info=True)
                new = False
                if self.latest is not None:
                    words = f"a set of frames was passed over: {error}"
                    self.latest = replace(self.latest, trouble=words)
                    self.count += 1
            if not new:
                self._stop.wait(_PAUSE_S)

    def poll(self) -> bool:
        """List the folders once, and measure the newest frames if they are new."""
        self.watch.poll()
        frames = self.watch.newest_set(after=self.latest.number if self.latest else -1)
        if frames is not None:
            self._take(frames)
        elif self.latest is not None:  # a camera that has stopped shows without a new set
            others = (light for light in self.latest.lights if light.name not in lights.ARRIVALS)
            self.latest = replace(self.latest, lights=(*self._arrivals(), *others))
        if self.latest is not None:
            self.history.add(self.latest.lights)
        return frames is not None

    def _arrivals(self) -> list[StatusLight]:
        watch = self.watch
        return lights.arrival_lights(watch.silent(), watch.written, watch.newest, self.experiment.frame_rate)

    def _take(self, frames: FrameSet) -> None:
        if self._first is None:
            self._first = frames.number
        found = {name: frame_features(both[1]) for name, both in frames.images.items()}
        measurer = self._measurer
        if measurer.learner is None and not measurer.trouble:  # this takes a minute: show the images first
            self._publish(frames, {}, self._assess(found, {}, None), "getting ready to measure")
        fields, summary = measurer.measure(frames)
        pairs = measurer.pairs(frames)
        for values in (found, pairs, {} if summary is None else {"": summary}):
            for name, numbers in values.items():
                self._baseline.add(name, numbers)
        self._measured += 1
        self._publish(frames, fields, self._assess(found, pairs, summary), measurer.trouble)

    def _publish(self, frames: FrameSet, fields: Fields, found: list[StatusLight], trouble: str) -> None:
        assert self._first is not None
        self.latest = FollowedSet(
            number=frames.number,
            images={name: both[1] for name, both in frames.images.items()},
            fields=fields,
            lights=tuple(found),
            delay=time.time() - frames.written,
            measured=self._measured,
            skipped=max(frames.number - self._first + 1 - self._measured, 0),
            trouble=trouble,
        )
        self.count += 1

    def _assess(
        self, frames: Mapping[str, FrameFeatures], pairs: Mapping[str, PairSummary], step: StepSummary | None
    ) -> list[StatusLight]:
        first, out = self._baseline, self._arrivals()
        for name, found in frames.items():
            out += lights.frame_lights(name, found, first.of(FrameFeatures, name))
        for name, pair in pairs.items():
            out.append(lights.pair_light(name, pair, first.of(PairSummary, name)))
        if step is not None:
            self._summaries.append(step)
            out += [*lights.step_lights(step, first.of(StepSummary)), lights.tilt_light(self._summaries)]
        return out
