"""Which pixels of a camera are covered: by outlines, by one image, by an image for every frame."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.errors import FrameError
from wavefield.series.readers import FrameEntry, read_entry

Outline = tuple[tuple[float, float], ...]
FRACTION_BITS = 6  # of a corner's coordinates, for OpenCV


@dataclass(frozen=True)
class CameraMask:
    """Pixels of one camera that do not count."""

    shape: tuple[int, int]  # (rows, columns) of its images
    outlines: tuple[Outline, ...] = ()  # (column, row): Closed outlines, px; their inside is covered
    images: tuple[FrameEntry, ...] = ()  # Images of the same size: what is not black is covered
    # One such image for every frame of the series that the mask belongs to; empty if nothing moves
    moving: Sequence[FrameEntry] = field(default=(), repr=False)

    def covered(self, index: int) -> NDArray[np.bool_]:
        """Pixels that are covered in one frame, (row, column)."""
        still = _still(self.shape, self.outlines, self.images)
        if not self.moving:
            return still
        out = still | _covered_by(self.moving[index], self.shape)
        out.flags.writeable = False
        return out

    def window(self, start: int, stop: int) -> "CameraMask":
        """The mask of some of the frames."""
        return replace(self, moving=tuple(self.moving[max(start, 0) : stop]))


@lru_cache(maxsize=16)
def _still(
    shape: tuple[int, int], outlines: tuple[Outline, ...], images: tuple[FrameEntry, ...]
) -> NDArray[np.bool_]:
    covered = np.zeros(shape, np.uint8)
    for outline in outlines:
        corners = np.rint(np.array(outline) * (1 << FRACTION_BITS)).astype(np.int32)
        cv2.fillPoly(covered, [corners], 1, shift=FRACTION_BITS)
    out = covered.astype(bool)
    for entry in images:
        out |= _covered_by(entry, shape)
    out.flags.writeable = False
    return out


@lru_cache(maxsize=1)
def _covered_by(entry: FrameEntry, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Pixels, (row, column), that are not black in an image of a mask."""
    image = read_entry(entry)
    if image.shape != shape:
        raise FrameError(
            f"{entry} is {image.shape[1]} x {image.shape[0]} px, but the camera's images are "
            f"{shape[1]} x {shape[0]}; draw the mask on one of them"
        )
    return np.asarray(image != 0)
