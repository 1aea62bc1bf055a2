"""What is masked in the frames that come: what stands still, and images that move with the frames."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.errors import FrameError, WavefieldError
from wavefield.rig import Rig
from wavefield.series import Experiment, FrameSeries
from wavefield.series.camera_mask import CameraMask
from wavefield.series.listing import number_frames
from wavefield.series.masks import covered_series

Pixels = Mapping[str, NDArray[np.bool_]]


class LiveMasks:
    """The masks of an experiment while its cameras write."""

    def __init__(self, experiment: Experiment, rig: Rig, reach: float) -> None:
        self._folder = experiment.path.parent
        shapes = experiment.mask
        self._moving = {
            name: pattern for name in rig for pattern in (s.frames for s in shapes.get(name, ()) if s.frames)
        }
        still = {name: [s for s in parts if not s.frames] for name, parts in shapes.items()}
        blank = {name: FrameSeries(name, 0, [], rig[name].size[::-1], "uint8") for name in rig}
        series = covered_series(still, blank, rig, self._folder, reach)
        self._still: dict[str, CameraMask] = {
            name: one.mask or CameraMask(one.shape)
            for name, one in series.items()
            if one.mask is not None or name in self._moving
        }
        self.absent = ""

    def of(self, number: int) -> tuple[dict[str, Any], dict[str, Any]]:
        """What is covered in a frame and in the next one.

        Returns first, second (row, column): Per camera.
        """
        self.absent = ""
        return self._at(number), self._at(number + 1)

    def _at(self, number: int) -> dict[str, Any]:
        return {name: self._covered(name, mask, number) for name, mask in self._still.items()}

    def _covered(self, name: str, mask: CameraMask, number: int) -> NDArray[np.bool_]:
        if name not in self._moving:
            return mask.covered(0)
        try:
            entry = number_frames(self._moving[name], self._folder, f"the mask of {name}").get(number)
            if entry is not None:
                return replace(mask, moving=(entry,)).covered(0)
            self.absent = (
                f"no image of the mask of {name} for frame {number} yet: what moves is measured, too"
            )
        except (WavefieldError, FrameError) as error:
            self.absent = f"what moves before {name} is measured, too: {error}"
        return mask.covered(0)
