"""Measuring single steps as they arrive, with the masks of their frames and what is learned of them."""

import logging
import threading
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.errors import FrameError, RigError, WavefieldError
from wavefield.explorer.lights import PairSummary, StepSummary, summarize_step
from wavefield.explorer.watch import FrameSet
from wavefield.measurement import GridGeometry, Model, learn, measure, pair_surface
from wavefield.measurement.frame import ready, usable
from wavefield.rig import Rig
from wavefield.series import Experiment, FrameSeries
from wavefield.series.camera_mask import CameraMask
from wavefield.series.frames import subtracted
from wavefield.series.listing import number_frames
from wavefield.series.masks import covered_series, footprints
from wavefield.series.mean_images import read_backgrounds, refuse_other_images
from wavefield.variables import AROUND

log = logging.getLogger("wavefield.follow")
_STEPS = 2  # the newest ones, that are learned from
_MIN_PAUSE_S = 5.0  # from one learning to the next
_PAUSE_PER_DURATION = 3.0  # of the learning, so that the measurement has the machine to itself
Fields = dict[str, NDArray[Any]]
Frames = Mapping[str, NDArray[Any] | None]
Masks = Mapping[str, NDArray[np.bool_]]


class LiveMeasurement:
    """Measures single steps as they arrive, once it has a rig for them."""

    def __init__(self, experiment: Experiment, rig: Rig | Path | None) -> None:
        self._experiment, self._rig = experiment, rig
        self._backgrounds = read_backgrounds(
            experiment.background, experiment.measuring_cameras, experiment.resolve, experiment.path
        )
        self._sizes: dict[str, tuple[int, int]] = {}  # width and height of the images of the last geometry
        self._masks: LiveMasks | None = None
        self.learner: Learner | None = None
        self.trouble = ""  # why nothing is measured

    def measure(self, frames: FrameSet) -> tuple[Fields, StepSummary | None]:
        """Fields (ny, nx) of a step and their summary; nothing without a rig, which `trouble` explains."""
        firsts = {name: both[0] for name, both in frames.images.items()}
        sizes = {name: (image.shape[1], image.shape[0]) for name, image in firsts.items()}
        if self.learner is None or (self.trouble and sizes != self._sizes):
            self._sizes = sizes
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
        return fields, summarize_step(fields, geometry.x, geometry.y, geometry.z_range, rate)

    def pairs(self, frames: FrameSet) -> dict[str, PairSummary]:
        """Consistency of each pair of cameras on the second frame; nothing without a rig."""
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
            self._masks = LiveMasks(experiment, rig, -geometry.z_range[0])
            self.learner = Learner(geometry, experiment.frame_rate)
            self.trouble = ""
        except WavefieldError as error:
            self.trouble = f"nothing is measured: {error}"


class Learner:
    """What is learned of a record as it is now; `model` is None before the first frames."""

    def __init__(self, geometry: GridGeometry, frame_rate: float) -> None:
        self.geometry, self._frame_rate = geometry, frame_rate
        self.model: Model | None = None
        self._steps: deque[tuple[tuple[Frames, Frames], tuple[Masks, Masks]]] = deque(maxlen=_STEPS)
        self._next_s = 0.0
        self._thread: threading.Thread | None = None

    def add(self, frames: tuple[Frames, Frames], masks: tuple[Masks, Masks]) -> None:
        """Learn from both frames of a step: the first time at once, later in a thread of its own."""
        self._steps.append((frames, masks))
        if self.model is None:
            self._learn()
        elif time.monotonic() >= self._next_s and not (self._thread and self._thread.is_alive()):
            self._thread = threading.Thread(target=self._learn, daemon=True, name="learn")
            self._thread.start()

    def _learn(self) -> None:
        begun = time.monotonic()
        steps = list(self._steps)
        try:
            frames, masks = ([one[i] for one in steps] for i in (0, 1))
            record = learn(frames, self.geometry, masks, frame_rate=self._frame_rate)
            if record is not None:
                self.model = Model(self.geometry, record)
        except (WavefieldError, ValueError) as error:  # the model stays
            log.warning("nothing was learned from these frames: %s", error)
        except RuntimeError as error:
            if not str(error).startswith("cannot schedule"):  # the program ends, and its pools before it
                raise
        pause = max(_MIN_PAUSE_S, _PAUSE_PER_DURATION * (time.monotonic() - begun))
        self._next_s = time.monotonic() + pause

    def wait(self) -> None:
        """Wait until the learning that goes on has ended."""
        if self._thread is not None:
            self._thread.join(20)


class LiveMasks:
    """The masks of an experiment while its cameras write."""

    def __init__(self, experiment: Experiment, rig: Rig, trough: float) -> None:
        self._folder = experiment.path.parent
        sections = experiment.mask
        self._moving = {
            name: shape.frames for name in rig for shape in sections.get(name, ()) if shape.frames
        }
        fixed = {name: [s for s in shapes if not s.frames] for name, shapes in sections.items()}
        blank = {name: FrameSeries(name, 0, [], rig[name].size[::-1], "uint8") for name in rig}
        series = covered_series(fixed, blank, rig, self._folder, trough)
        self._fixed = {
            name: one.mask or CameraMask(one.shape)
            for name, one in series.items()
            if one.mask is not None or name in self._moving
        }
        self.absent = ""  # a sentence on the mask that is absent, after `of`

    def of(self, number: int) -> tuple[Masks, Masks]:
        """What is masked (row, column) in a frame and in the next one, by camera."""
        self.absent = ""
        n1, n2 = number, number + 1
        first, second = ({c: self._covered(c, m, n) for c, m in self._fixed.items()} for n in (n1, n2))
        return first, second

    def _covered(self, name: str, mask: CameraMask, number: int) -> NDArray[np.bool_]:
        if name in self._moving:
            try:
                entry = number_frames(self._moving[name], self._folder, f"the mask of {name}").get(number)
                if entry is not None:
                    return replace(mask, moving=(entry,)).covered(0)
                self.absent = (
                    f"no image of the mask of {name} for frame {number} yet: what moves is measured, too"
                )
            except (WavefieldError, FrameError) as error:
                self.absent = f"what moves in the view of {name} is measured, too: {error}"
        return mask.covered(0)
