"""What the tests of the measurement share."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wavefield.grid import Grid
from wavefield.rig import Rig

PIXEL = 1.8e-3  # metres: the unit of the paper's errors
RATE = 20.0


def around(
    frames: Mapping[str, Sequence[np.ndarray | None]], first: int = 0, steps: int = 1
) -> dict[str, list[np.ndarray | None]]:
    """Frames of some steps as `measure` takes them; step n lies between frames n + 1 and n + 2 of six."""
    ends = range(first - 1, first + steps + 4)
    return {
        name: [images[k] if 0 <= k < len(images) else None for k in ends] for name, images in frames.items()
    }


@dataclass(frozen=True)
class Series:
    rig: Rig
    grid: Grid
    frames: dict[str, list[np.ndarray]]
    truth: list[dict[str, np.ndarray]]  # at mid-time of step n: between frames n + 1 and n + 2
    inside: np.ndarray  # nodes 4 cm inside the edge

    def block(self, first: int = 0, steps: int = 1) -> dict[str, list[np.ndarray | None]]:
        """Frames as `measure` takes them for some steps: those that are not there are None."""
        return around(self.frames, first, steps)

    def without(self, *lost: tuple[str, int]) -> dict[str, list[np.ndarray | None]]:
        """All frames but some, as `measure` takes them."""
        rest = {
            name: [None if (name, k) in lost else image for k, image in enumerate(images)]
            for name, images in self.frames.items()
        }
        return around(rest, steps=3)
