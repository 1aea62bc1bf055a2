"""Find, measure and rate the newest frames while cameras record, for the page of `wavefield follow`."""

import logging
import os
import threading
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.errors import FrameError, RigError, WavefieldError
from wavefield.explorer import lights
from wavefield.explorer.lights import FrameFeatures, PairSummary, StatusLight, StepSummary
from wavefield.measurement import GridGeometry, Model, learn, measure
from wavefield.measurement.elevation import match_pair
from wavefield.measurement.images import prepare, ready, usable
from wavefield.rig import Rig
from wavefield.series import Experiment, FrameSeries
from wavefield.series.backgrounds import read_backgrounds, refuse_other_images
from wavefield.series.frames import subtracted
from wavefield.series.listing import number_frames
from wavefield.series.masks import covered_series, footprints
from wavefield.series.readers import FrameEntry, read_entry
from wavefield.variables import AROUND

log = logging.getLogger("wavefield.follow")
_PAUSE_PER_ESTIMATE = 10.0  # pause between two estimates of the model over the time that one takes
POLL_S = 0.2  # between looks for new frames, and between looks of a page for new results
Fields = dict[str, NDArray[Any]]
Frames = Mapping[str, NDArray[Any] | None]
Masks = Mapping[str, NDArray[np.bool_]]


@dataclass(frozen=True)
class FrameSet:
    """Two successive frames of every camera that still records."""

    number: int  # number of the first frame
    images: dict[str, tuple[NDArray[Any], NDArray[Any]]]  # both frames, by camera
    written: float  # when the last of these frames was written, s since the epoch


class FolderWatch:
    """Watches the image folders of an experiment for new frames."""

    def __init__(self, experiment: Experiment) -> None:
        self.experiment = experiment
        self.newest: dict[str, int] = {}  # number of the newest frame of each camera
        self.written: dict[str, float] = {}  # when that was written, s since the epoch
        self.trouble: dict[str, str] = {}  # why the folder of a camera cannot be listed
        self._polled = time.monotonic()
        self._noticed = dict.fromkeys(experiment.cameras, self._polled)  # when the newest frame was found
        self._frames: dict[str, dict[int, FrameEntry]] = {}

    def poll(self) -> None:
        """List the image folders once, and update number and time of each camera's newest frame.
        If a folder cannot be listed, `trouble` gets the reason."""
        self._polled = time.monotonic()
        for name, section in self.experiment.cameras.items():
            try:
                listed = number_frames(section.images, self.experiment.image_folder, name)
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
        """Return, by camera, the time in s from when its newest frame was found to the last `poll`.
        For a camera without frames, the time begins when this object was made."""
        return {name: self._polled - when for name, when in self._noticed.items()}

    def newest_set(self, after: int = -1) -> FrameSet | None:
        """Return the newest two successive frames that all recording cameras have, or None.
        The number of the first frame is above `after`. A camera whose newest frame is over 1 s older than the
        newest one of another camera counts as stopped."""
        latest = max(self.written.values(), default=0.0)
        longest = lights.LIMITS["delay"][1]  # a camera further behind the others counts as stopped
        sending = [name for name, when in self.written.items() if latest - when <= longest]
        if not sending:
            return None
        top = min(self.newest[name] for name in sending) - 1
        for number in range(top, max(top - 2, after), -1):  # a camera may still be writing its newest frame
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
        except FrameError:  # the camera is still writing it
            return None


def _written(entry: FrameEntry) -> float:
    try:
        return os.stat(Path(entry.path)).st_mtime
    except OSError:
        return time.time()


class LiveMeasurement:
    """Measures fields from two successive frames at a time during a recording, if a rig can be loaded.
    `rig` is a Rig or the path of a rig file; None means the file that the experiment names."""

    def __init__(self, experiment: Experiment, rig: Rig | Path | None) -> None:
        self._experiment, self._rig = experiment, rig
        self._backgrounds = read_backgrounds(
            experiment.background, experiment.measuring_cameras, experiment.resolve, experiment.path
        )
        self._sizes: dict[str, tuple[int, int]] = {}  # width and height of the images of the last geometry
        self._masks: Masks = {}
        self.learner: Learner | None = None
        self.trouble = ""  # why nothing is measured

    def measure(self, frames: FrameSet) -> tuple[Fields, StepSummary | None]:
        """Return the fields (ny, nx), by variable, measured from two successive frames, and their summary.
        Without a rig, or after an error, return {} and None; the reason is then in `trouble`."""
        firsts = {name: both[0] for name, both in frames.images.items()}
        sizes = {name: (image.shape[1], image.shape[0]) for name, image in firsts.items()}
        if self.learner is None or (self.trouble and sizes != self._sizes):
            self._sizes = sizes
            self._prepare(firsts)
        if self.learner is None:
            return {}, None
        try:
            bare = {n: [self._bare(n, image) for image in both] for n, both in frames.images.items()}
            pairs = {name: bare.get(name, [None, None]) for name in self.learner.geometry.cameras}
            instants = {n: p[0] for n, p in pairs.items()}, {n: p[1] for n, p in pairs.items()}
            self.learner.add(instants, (self._masks, self._masks))
            geometry = self.learner.geometry
            around = [None] * AROUND
            images = {name: [*around, *both, *around] for name, both in pairs.items()}
            masks = {n: [mask] * (2 * AROUND + 2) for n, mask in self._masks.items()}
            rate, model = self._experiment.frame_rate, self.learner.model
            block = measure(images, geometry, rate, model, masks)
        except (WavefieldError, ValueError) as error:
            self.trouble = str(error)
            return {}, None
        self.trouble = ""
        fields = {name: values[0] for name, values in block.items() if np.ndim(values) == 3}
        return fields, lights.summarize_step(fields, geometry.z_range)

    def pairs(self, frames: FrameSet) -> dict[str, PairSummary]:
        """Return, by pair of cameras "a-b", how well their second frames agree; {} without a rig."""
        if self.learner is None:
            return {}
        geometry = self.learner.geometry
        flat = {
            name: prepare(ready(self._bare(name, both[1]), geometry.sights[name].binning), name, geometry)
            for name, both in frames.images.items()
            if name in geometry.surface_cameras and usable(both[1], geometry.rig[name].size)
        }
        out = {}
        for a, b in geometry.pairs:
            if a in flat and b in flat:
                match = match_pair(flat[a], flat[b], (a, b), geometry)
                visible = (geometry.views[a].visible_blocks > 0.5) & (geometry.views[b].visible_blocks > 0.5)
                eps_y = match.eps_y[match.matched] / geometry.pixel
                rms = float(np.sqrt(np.mean(np.square(eps_y)))) if eps_y.size else float("nan")
                out[f"{a}-{b}"] = PairSummary(rms, float(match.valid.sum() / max(visible.sum(), 1)))
        return out

    def _bare(self, name: str, image: NDArray[Any]) -> NDArray[Any]:
        """Return an image (row, column) of the camera `name` minus the camera's background image."""
        background = self._backgrounds.get(name)
        return image if background is None else subtracted(image, background)

    def _prepare(self, images: Mapping[str, NDArray[Any]]) -> None:
        """Load the rig, and set `learner` (geometry and wave model) and masks for the sizes of `images`.
        `images` holds one image (row, column) per camera. If this fails, `trouble` gets the reason."""
        from wavefield.execution.workflow import Workflow
        from wavefield.pipeline.prepare import make_settings

        experiment = self._experiment
        try:
            for name in self._backgrounds.keys() & images.keys():
                shape, dtype = images[name].shape, str(images[name].dtype)
                refuse_other_images(self._backgrounds[name], name, shape, dtype, experiment.path)
            rig = self._rig if isinstance(self._rig, Rig) else experiment.load_rig(self._rig)
            rig = replace(rig, cameras={name: rig[name] for name in experiment.measuring_cameras})
            for name, (width, height) in self._sizes.items():
                if name in rig.cameras and rig[name].size != (width, height):
                    expected = "{} x {}".format(*rig[name].size)
                    raise RigError(
                        f"the rig was made for images of {name} of {expected} px, but these have {width} x "
                        f"{height}; use the rig of these images"
                    )
            settings, covered = make_settings(experiment, Workflow()), footprints(experiment.mask)
            geometry = GridGeometry(rig, experiment.choose_grid(rig), settings, covered)
            blank = {name: FrameSeries(name, 0, [], rig[name].size[::-1], "uint8") for name in rig}
            series = covered_series(experiment.mask, blank, rig, experiment.path.parent)
            masks = {name: one.covered(0) for name, one in series.items()}
            self._masks = {name: mask for name, mask in masks.items() if mask is not None}
            self.learner = Learner(geometry, experiment.frame_rate)
            self.trouble = ""
        except WavefieldError as error:
            self.trouble = f"nothing is measured: {error}"


class Learner:
    """Keeps the statistical model of waves and noise for measuring, updated with the newest frames.
    `model` is None until the first estimate succeeds."""

    def __init__(self, geometry: GridGeometry, frame_rate: float) -> None:
        self.geometry, self._frame_rate = geometry, frame_rate
        self.model: Model | None = None
        self._steps: deque[tuple[tuple[Frames, Frames], tuple[Masks, Masks]]] = deque(
            maxlen=2
        )  # the newest ones
        self._next_s = 0.0

    def add(self, frames: tuple[Frames, Frames], masks: tuple[Masks, Masks]) -> None:
        """Add the two frames of a step and their masks, by camera, and learn the record again if that is due.
        It is due after a pause ten times as long as the last update took."""
        self._steps.append((frames, masks))
        begun = time.monotonic()
        if self.model is not None and begun < self._next_s:
            return
        both, covered = ([step[k] for step in self._steps] for k in (0, 1))
        try:
            record = learn(both, self.geometry, covered, frame_rate=self._frame_rate)
            if record is not None:
                self.model = Model(self.geometry, record)
        except (WavefieldError, ValueError) as error:  # the model stays
            log.warning("the wave model was not updated from these frames: %s", error)
        now = time.monotonic()
        self._next_s = now + _PAUSE_PER_ESTIMATE * (now - begun)


@dataclass(frozen=True)
class FollowedSet:
    """The newest frames of a recording, the fields measured from them, and the status lights."""

    number: int  # number of the first frame
    images: Mapping[str, NDArray[Any]]  # the second frame, by camera
    fields: Fields  # the measured step, (ny, nx) by variable; empty if it was not measured
    lights: tuple[StatusLight, ...]
    delay: float  # time from the last frame's file to this result, s
    measured: int  # pairs of frames handled so far, also without a rig
    skipped: int  # pairs of frames left out so far, because others were being handled
    trouble: str  # a sentence on why nothing is measured; empty otherwise


class Follower:
    """Finds, measures and rates the newest frames in its own thread; pages read the result, `latest`."""

    def __init__(self, experiment: Experiment, rig: Rig | Path | None = None) -> None:
        self.experiment = experiment
        self.latest: FollowedSet | None = None
        self.count = 0  # number of sets published
        self.watch = FolderWatch(experiment)
        self._measurer = LiveMeasurement(experiment, rig)
        self._baseline = lights.Baseline()
        self._stop = threading.Event()
        self._first: int | None = None  # number of the first frame that was measured
        self._measured = 0
        self._thread = threading.Thread(target=self._work, daemon=True, name="follow")

    @property
    def nodes(self) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """Positions of the grid's nodes along x (nx,) and y (ny,), m; both empty before a rig is loaded."""
        learner = self._measurer.learner
        if learner is None:
            return np.empty(0), np.empty(0)
        return learner.geometry.grid.x_nodes, learner.geometry.grid.y_nodes

    def start(self) -> None:
        """Start the thread that watches the image folders."""
        self._thread.start()

    def stop(self) -> None:
        """Stop the thread after the step that is being measured; wait 20 s at most."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(20)

    def _work(self) -> None:
        while not self._stop.is_set():
            try:
                new = self.poll()
            except Exception as error:  # whatever happens with one set of frames, the next ones are measured
                log.warning("a set of frames was skipped", exc_info=True)
                new = False
                if self.latest is not None:
                    words = f"a set of frames was skipped: {error}"
                    self.latest = replace(self.latest, trouble=words)
                    self.count += 1
            if not new:
                self._stop.wait(POLL_S)

    def poll(self) -> bool:
        """List the image folders once. If there are new frames, measure the newest and publish the result.
        Return whether there were new frames."""
        self.watch.poll()
        frames = self.watch.newest_set(after=self.latest.number if self.latest else -1)
        if frames is not None:
            self._take(frames)
        elif self.latest is not None:  # the lights show a stopped camera although no new frames arrive
            others = (light for light in self.latest.lights if light.name not in lights.ARRIVALS)
            self.latest = replace(self.latest, lights=(*self._arrivals(), *others))
        return frames is not None

    def _arrivals(self) -> list[StatusLight]:
        watch = self.watch
        return lights.arrival_lights(watch.silent(), watch.written, watch.newest, self.experiment.frame_rate)

    def _take(self, frames: FrameSet) -> None:
        if self._first is None:
            self._first = frames.number
        found = {name: lights.frame_features(both[1]) for name, both in frames.images.items()}
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
            out += lights.frame_lights(name, found, first.medians(FrameFeatures, name))
        for name, pair in pairs.items():
            out.append(lights.pair_light(name, pair, first.medians(PairSummary, name)))
        if step is not None:
            out += lights.step_lights(step, first.medians(StepSummary))
        return out
