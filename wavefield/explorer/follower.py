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

from wavefield.errors import WavefieldError
from wavefield.explorer.features import FrameFeatures, frame_features
from wavefield.explorer.learner import Learner
from wavefield.explorer.lights import (
    ARRIVALS,
    Baseline,
    LightHistory,
    PairSummary,
    StatusLight,
    StepSummary,
    arrival_lights,
    frame_lights,
    pair_light,
    step_lights,
    summarize_step,
    tilt_light,
)
from wavefield.explorer.live_masks import LiveMasks
from wavefield.explorer.watch import FolderWatch, FrameSet
from wavefield.rig import Rig
from wavefield.series import Experiment
from wavefield.series.frames import subtracted
from wavefield.series.masks import footprints
from wavefield.series.mean_images import read_backgrounds, refuse_other_images
from wavefield.variables import AROUND

log = logging.getLogger("wavefield.follow")
_TILT_STEPS = 200  # over which the tilt is averaged
_PAUSE_S = 0.15  # between polls of the folders
Fields = dict[str, NDArray[Any]]


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
        self.history = LightHistory()
        self.watch = FolderWatch(experiment)
        self._measurer = LiveMeasurement(experiment, rig)
        self._baseline = Baseline()
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
            if self.latest is not None:
                self.history.add(self.latest.lights)
            return True
        if self.latest is not None:  # a camera that has stopped shows without a new set
            others = tuple(light for light in self.latest.lights if light.name not in ARRIVALS)
            self.latest = replace(self.latest, lights=(*self._arrivals(), *others))
            self.history.add(self.latest.lights)
        return False

    def _arrivals(self) -> list[StatusLight]:
        watch = self.watch
        return arrival_lights(watch.silent(), watch.written, watch.newest, self.experiment.frame_rate)

    def _take(self, frames: FrameSet) -> None:
        if self._first is None:
            self._first = frames.number
        found = {name: frame_features(both[1]) for name, both in frames.images.items()}
        measurer = self._measurer
        if (
            measurer.learner is None and not measurer.trouble
        ):  # preparing takes a minute: show the images first
            self._publish(frames, {}, self._assess(found, {}, None), "getting ready to measure")
        fields, summary = measurer.measure(frames)
        pairs = measurer.pairs(frames)
        for values in (found, pairs, {} if summary is None else {"": summary}):
            for name, numbers in values.items():
                self._baseline.add(name, numbers)
        self._measured += 1
        self._publish(frames, fields, self._assess(found, pairs, summary), measurer.trouble)

    def _publish(self, frames: FrameSet, fields: Fields, lights: list[StatusLight], trouble: str) -> None:
        assert self._first is not None
        self.latest = FollowedSet(
            number=frames.number,
            images={name: both[1] for name, both in frames.images.items()},
            fields=fields,
            lights=tuple(lights),
            delay=time.time() - frames.written,
            measured=self._measured,
            skipped=max(frames.number - self._first + 1 - self._measured, 0),
            trouble=trouble,
        )
        self.count += 1

    def _assess(
        self, frames: Mapping[str, FrameFeatures], pairs: Mapping[str, PairSummary], step: StepSummary | None
    ) -> list[StatusLight]:
        first = self._baseline
        lights = self._arrivals()
        for name, found in frames.items():
            lights += frame_lights(name, found, first.of(FrameFeatures, name))
        lights += [pair_light(name, found, first.of(PairSummary, name)) for name, found in pairs.items()]
        if step is not None:
            self._summaries.append(step)
            lights += [*step_lights(step, first.of(StepSummary)), tilt_light(self._summaries)]
        return lights


class LiveMeasurement:
    """Measures single steps as they arrive, once it has a rig for them."""

    def __init__(self, experiment: Experiment, rig: Rig | Path | None) -> None:
        self._experiment, self._rig = experiment, rig
        self._backgrounds = read_backgrounds(
            experiment.background, experiment.measuring_cameras, experiment.resolve, experiment.path
        )
        self._sizes: dict[str, tuple[int, int]] = {}  # of the images that the geometry was tried for
        self._masks: LiveMasks | None = None
        self.learner: Learner | None = None
        self.trouble = ""  # why nothing is measured

    def measure(self, frames: FrameSet) -> tuple[Fields, StepSummary | None]:
        """Fields (ny, nx) of a step and their summary; nothing without a rig, which `trouble` explains."""
        from wavefield.measurement import measure

        firsts = {name: both[0] for name, both in frames.images.items()}
        if self.learner is None or (self.trouble and _sizes(firsts) != self._sizes):
            self._prepare(firsts)
        if self.learner is None:
            return {}, None
        first, second = self._masks.of(frames.number) if self._masks else ({}, {})
        try:
            bare = {n: [self._bare(n, image) for image in both] for n, both in frames.images.items()}
            pairs = {name: bare.get(name, [None, None]) for name in self.learner.geometry.cameras}
            instants = {n: p[0] for n, p in pairs.items()}, {n: p[1] for n, p in pairs.items()}
            self.learner.add(instants, (first, second))
            geometry = self.learner.geometry
            around = [None] * AROUND
            images = {name: [*around, *both, *around] for name, both in pairs.items()}
            masks = {n: [first[n]] * (AROUND + 1) + [second[n]] * (AROUND + 1) for n in first}
            rate, model = self._experiment.frame_rate, self.learner.model
            block = measure(images, geometry, rate, model, masks)
        except (WavefieldError, ValueError) as error:
            self.trouble = str(error)
            return {}, None
        self.trouble = self._masks.absent if self._masks else ""
        fields = {name: values[0] for name, values in block.items() if np.ndim(values) == 3}
        return fields, summarize_step(fields, geometry.x, geometry.y, geometry.z_range)

    def pairs(self, frames: FrameSet) -> dict[str, PairSummary]:
        """Consistency of each pair of cameras on the second frame; nothing without a rig."""
        from wavefield.measurement import pair_surface
        from wavefield.measurement.frame import ready, usable

        if self.learner is None:
            return {}
        geometry = self.learner.geometry
        flat = {
            name: pair_surface.prepare(
                ready(self._bare(name, both[1]), geometry.sights[name].binning), name, geometry
            )
            for name, both in frames.images.items()
            if name in geometry.surface_cameras and usable(both[1], geometry.rig[name].size)
        }
        out = {}
        for a, b in geometry.pairs:
            if a in flat and b in flat:
                match = pair_surface.match_pair(flat[a], flat[b], (a, b), geometry)
                visible = (geometry.views[a].visible_blocks > 0.5) & (geometry.views[b].visible_blocks > 0.5)
                eps_y = match.eps_y[match.matched] / geometry.pixel
                rms = float(np.sqrt(np.mean(np.square(eps_y)))) if eps_y.size else float("nan")
                out[f"{a}-{b}"] = PairSummary(rms, float(match.valid.sum() / max(visible.sum(), 1)))
        return out

    def _bare(self, name: str, image: NDArray[Any]) -> NDArray[Any]:
        """An image of a camera less its background, as a run reads it."""
        background = self._backgrounds.get(name)
        return image if background is None else subtracted(image, background)

    def _prepare(self, images: Mapping[str, NDArray[Any]]) -> None:
        """Compute the geometry for images like these."""
        from wavefield.execution.workflow import Workflow
        from wavefield.measurement import GridGeometry
        from wavefield.pipeline.prepare import make_settings

        self._sizes = sizes = _sizes(images)
        experiment = self._experiment
        try:
            for name in self._backgrounds.keys() & images.keys():
                shape, dtype = images[name].shape, str(images[name].dtype)
                refuse_other_images(self._backgrounds[name], name, shape, dtype, experiment.path)
            rig = self._rig if isinstance(self._rig, Rig) else experiment.load_rig(self._rig)
            rig = replace(rig, cameras={name: rig[name] for name in experiment.measuring_cameras})
            for name, (width, height) in sizes.items():
                if name in rig.cameras and rig[name].size != (width, height):
                    expected = "{} x {}".format(*rig[name].size)
                    self.trouble = (
                        f"nothing is measured: the rig was made for images of {name} of {expected} px, but "
                        f"these have {width} x {height}; use the rig of these images"
                    )
                    return
            settings, covered = make_settings(experiment, Workflow()), footprints(experiment.mask)
            geometry = GridGeometry(rig, experiment.choose_grid(rig), settings, covered)
            self._masks = LiveMasks(experiment, rig, -geometry.z_range[0])
            self.learner = Learner(geometry)
            self.trouble = ""
        except WavefieldError as error:
            self.trouble = f"nothing is measured: {error}"


def _sizes(images: Mapping[str, NDArray[Any]]) -> dict[str, tuple[int, int]]:
    """Columns and rows of images, by camera."""
    return {name: (image.shape[1], image.shape[0]) for name, image in images.items()}
