"""What the tests of the measurement share."""

from dataclasses import dataclass

import numpy as np

from wavefield.grid import Grid
from wavefield.rig import Rig

PIXEL = 1.8e-3  # metres: the unit of the paper's errors
RATE = 20.0


@dataclass(frozen=True)
class Series:
    rig: Rig
    grid: Grid
    frames: dict[str, list[np.ndarray]]
    truth: list[dict[str, np.ndarray]]  # at mid-time of step n: between frames n + 1 and n + 2
    inside: np.ndarray  # nodes 4 cm inside the edge

    def without(self, *lost: tuple[str, int]) -> dict[str, list[np.ndarray | None]]:
        return {
            name: [None if (name, k) in lost else image for k, image in enumerate(images)]
            for name, images in self.frames.items()
        }
