"""The mask of one image of one camera, prepared for matching."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.matching.prepared import Mask

Pixels = NDArray[np.bool_]


@dataclass(frozen=True)
class Covered:
    """Mask of one image of one camera, ready for matching."""

    raw: Mask  # Of the binned image, for matching in time
    flat: Mask | None  # Of the rectified image; None for a camera that does not measure the surface

    def at(self, X: NDArray[Any], Y: NDArray[Any]) -> Pixels:
        """Whether the blocks around positions hold masked pixels."""
        whole = self.raw.levels[0]
        h, w = whole.shape
        with np.errstate(invalid="ignore"):
            inside = (X >= 0) & (X <= w - 1) & (Y >= 0) & (Y <= h - 1)
        column = np.rint(np.where(inside, X, 0)).astype(np.intp)
        row = np.rint(np.where(inside, Y, 0)).astype(np.intp)
        return np.asarray(inside & (whole[row, column] == 0))
