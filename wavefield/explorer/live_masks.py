"""Masks of the frames that arrive: those that are fixed, and images that change with the frames."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wavefield.errors import FrameError, WavefieldError
from wavefield.rig import Rig
from wavefield.series import Experiment, FrameSeries
from wavefield.series.camera_mask import CameraMask
from wavefield.series.listing import number_frames
from wavefield.series.masks import covered_series

Masks = Mapping[str, NDArray[np.bool_]]


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
        first, second = (
            {name: self._covered(name, mask, n) for name, mask in self._fixed.items()}
            for n in (number, number + 1)
        )
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
