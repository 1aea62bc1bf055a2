"""The work behind `wavefield follow`: the newest set of frames measured and judged, the others counted."""

import logging
import threading
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from wavefield.errors import WavefieldError
from wavefield.explorer.features import Features, features
from wavefield.explorer.lights import (
    PairMisfit,
    Quantities,
    Start,
    StatusLight,
    arrival_lights,
    frame_lights,
    pair_light,
    quantities,
    step_lights,
    tilt_light,
)
from wavefield.explorer.live_masks import LiveMasks
from wavefield.explorer.watch import FolderWatch, FrameSet
from wavefield.rig import Rig
from wavefield.series import Experiment
from wavefield.series.masks import footprints

if TYPE_CHECKING:
    from wavefield.explorer.learner import Learner

log = logging.getLogger("wavefield.follow")
_AVERAGED = 200  # steps over which the tilt is averaged
_PAUSE = 0.15  # s between looks at the folders


@dataclass(frozen=True)
class FollowedSet:
    """What was made of one set of frames."""

    number: int  # Of its first frame
    images: dict[str, NDArray[Any]]  # The second frame
    fields: dict[str, NDArray[Any]]  # (ny, nx): The measured step; empty without a rig
    lights: tuple[StatusLight, ...]  # The judgement
    delay: float  # From the last byte of the set until it was measured, s
    measured: int  # Steps so far
    skipped: int
    trouble: str  # Why nothing is measured, a sentence


@dataclass
class Follower:
    """Follows an experiment in a thread of its own."""

    experiment: Experiment  # The experiment
    rig: Any = None  # In place of the one that the experiment names
    seen: FollowedSet | None = None
    count: int = 0
    _learner: "Learner | None" = None
    _trouble: str = ""
    _sizes: dict[str, tuple[int, int]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.watch = FolderWatch(self.experiment)
        self._start = Start()
        self._steps: deque[Quantities] = deque(maxlen=_AVERAGED)
        self._stop = threading.Event()
        self._first: int | None = None
        self._measured = 0
        self._masks: LiveMasks | None = None
        self._thread = threading.Thread(target=self._work, daemon=True, name="follow")

    @property
    def nodes(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Nodes along x and y, metres; empty without a rig."""
        if self._learner is None:
            return np.empty(0), np.empty(0)
        grid = self._learner.geometry.grid
        return grid.x_nodes, grid.y_nodes

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """End; a set that is being measured is finished first."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(20)
        if self._learner is not None:
            self._learner.wait()

    def _work(self) -> None:
        while not self._stop.is_set():
            try:
                new = self.look()
            except Exception as error:  # the watch goes on, whatever one set of frames does to it
                log.warning("a set of frames was passed over", exc_info=True)
                new, words = False, f"a set of frames was passed over: {error}"
                if self.seen is not None:
                    self.seen = replace(self.seen, trouble=words)
                    self.count += 1
            if not new:
                self._stop.wait(_PAUSE)

    def look(self) -> bool:
        """Look once; measure what is new."""
        self.watch.look()
        found = self.watch.newest_set(after=self.seen.number if self.seen else -1)
        if found is None:
            if self.seen is not None:  # a camera that has gone silent shows without a new set
                arrivals = self._arrivals()
                others = tuple(one for one in self.seen.lights if one.name != "synchronisation")
                self.seen = replace(self.seen, lights=(*arrivals, *others))
            return False
        self._take(found)
        return True

    def _arrivals(self) -> list[StatusLight]:
        return arrival_lights(self.watch.last, self.watch.newest, time.time())

    def _take(self, found: FrameSet) -> None:
        if self._first is None:
            self._first = found.number
        now = {name: features(both[1]) for name, both in found.images.items()}
        if self._learner is None and not self._trouble:  # the first time this takes a minute
            self._publish(found, {}, self._assess(now, {}, None), "getting ready to measure")
        fields, summary = self._measure(found)
        pairs = self._pair_consistencies(found)
        self._start.take(now, pairs, summary)
        self._measured += 1
        self._publish(found, fields, self._assess(now, pairs, summary), self._trouble)

    def _publish(
        self, found: FrameSet, fields: dict[str, NDArray[Any]], lights: list[StatusLight], trouble: str
    ) -> None:
        assert self._first is not None
        self.seen = FollowedSet(
            number=found.number,
            images={name: both[1] for name, both in found.images.items()},
            fields=fields,
            lights=tuple(lights),
            delay=time.time() - found.written,
            measured=self._measured,
            skipped=max(found.number - self._first + 1 - self._measured, 0),
            trouble=trouble,
        )
        self.count += 1

    def _assess(
        self, now: Mapping[str, Features], pairs: Mapping[str, PairMisfit], summary: Quantities | None
    ) -> list[StatusLight]:
        lights = self._arrivals()
        for name, found in now.items():
            lights += frame_lights(name, found, self._start.of(name))
        lights += [pair_light(pair, found, self._start.of_pair(pair)) for pair, found in pairs.items()]
        if summary is None:
            return lights
        self._steps.append(summary)
        return [*lights, *step_lights(summary, self._start.step), tilt_light(self._steps)]

    # -- measuring -------------------------------------------------------------------------------------

    def _measure(self, found: FrameSet) -> tuple[dict[str, NDArray[Any]], Quantities | None]:
        """Measure a step, as far as there is a rig; the geometry is computed with the first frames."""
        from wavefield.measurement import measure
        from wavefield.variables import AROUND

        sizes = {name: (both[0].shape[1], both[0].shape[0]) for name, both in found.images.items()}
        if self._learner is None or (self._trouble and sizes != self._sizes):
            self._set_up(sizes)
        if self._learner is None:
            return {}, None
        cameras, beside = self._learner.geometry.cameras, [None] * AROUND
        pairs = {name: found.images.get(name, (None, None)) for name in cameras}
        first, second = self._masks.of(found.number) if self._masks else ({}, {})
        try:
            self._learner.take(({n: p[0] for n, p in pairs.items()}, {n: p[1] for n, p in pairs.items()}),
                            (first, second))  # fmt: skip
            geometry = self._learner.geometry
            frames = {name: [*beside, *both, *beside] for name, both in pairs.items()}
            masks = {n: [first[n]] * (AROUND + 1) + [second[n]] * (AROUND + 1) for n in first}
            block = measure(frames, geometry, self.experiment.frame_rate, self._learner.model, masks)
        except (WavefieldError, ValueError) as error:
            self._trouble = str(error)
            return {}, None
        self._trouble = self._masks.absent if self._masks else ""
        fields = {name: values[0] for name, values in block.items() if np.ndim(values) == 3}
        return fields, quantities(fields, geometry.x, geometry.y, geometry.z_range)

    def _pair_consistencies(self, found: FrameSet) -> dict[str, PairMisfit]:
        """How each pair of cameras agrees on the second frame; nothing without a rig."""
        from wavefield.measurement import pair_surface
        from wavefield.measurement.frame import ready, usable

        if self._learner is None:
            return {}
        geometry = self._learner.geometry
        good = {
            name: pair_surface.prepare(ready(both[1], geometry.sights[name].binning), name, geometry)
            for name, both in found.images.items()
            if name in geometry.surface_cameras and usable(both[1], geometry.rig[name].size)
        }
        out = {}
        for a, b in geometry.pairs:
            if a in good and b in good:
                match = pair_surface.match_pair(good[a], good[b], (a, b), geometry)
                seen = (geometry.views[a].visible_blocks > 0.5) & (geometry.views[b].visible_blocks > 0.5)
                eps = match.eps_y[match.matched] / geometry.pixel
                rms = float(np.sqrt(np.mean(np.square(eps)))) if eps.size else float("nan")
                out[f"{a}-{b}"] = PairMisfit(rms, float(match.valid.sum() / max(seen.sum(), 1)))
        return out

    def _set_up(self, sizes: dict[str, tuple[int, int]]) -> None:
        from wavefield.execution.workflow import Workflow
        from wavefield.explorer.learner import Learner
        from wavefield.measurement import GridGeometry
        from wavefield.pipeline.prepare import make_settings

        self._sizes = sizes
        try:
            rig = self.rig if isinstance(self.rig, Rig) else self.experiment.load_rig(self.rig)
            used = replace(rig, cameras={name: rig[name] for name in self.experiment.measuring_cameras})
            for name, size in sizes.items():
                if name in used.cameras and used[name].size != size:
                    requested = "{} x {}".format(*used[name].size)
                    self._trouble = (
                        f"nothing is measured: the rig was made for images of {name} of {requested} px, but "
                        f"these have {size[0]} x {size[1]}; use the rig of these images"
                    )
                    return
            settings = make_settings(self.experiment, Workflow())
            covered = footprints(self.experiment.mask)
            geometry = GridGeometry(used, self.experiment.choose_grid(used), settings, covered)
            self._masks = LiveMasks(self.experiment, used, -geometry.z_range[0])
            self._learner = Learner(geometry)
            self._trouble = ""
        except WavefieldError as error:
            self._trouble = f"nothing is measured: {error}"
