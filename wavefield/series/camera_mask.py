"""Which pixels of a camera are covered: by outlines, by one image, by an image for every frame."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.errors import FrameError
from wavefield.series.readers import Entry, read_entry

Outline = tuple[tuple[float, float], ...]
_SHIFT = 6  # bits behind the point of a corner's coordinates, for OpenCV


@dataclass(frozen=True)
class CameraMask:
    """Pixels of one camera that do not count.

    Parameters
    ----------
    shape : tuple of int
        (rows, columns) of its images.
    outlines : tuple of ((column, row), ...)
        Closed outlines, px; what lies inside is covered.
    images : tuple of Entry
        Images of the same size: what is not black is covered.
    moving : sequence of Entry, optional
        One such image for every frame of the series that the mask belongs to; empty if nothing moves.
    """

    shape: tuple[int, int]
    outlines: tuple[Outline, ...] = ()
    images: tuple[Entry, ...] = ()
    moving: Sequence[Entry] = field(default=(), repr=False)

    def covered(self, index: int) -> NDArray[np.bool_]:
        """What is covered in one frame.

        Parameters
        ----------
        index : int
            Index of the frame in its series.

        Returns
        -------
        ndarray of bool, (row, column)
            True where covered; read-only. The same array for every frame if nothing moves.

        Raises
        ------
        FrameError
            If an image of the mask cannot be read, or has another size.
        """
        still = _still(self.shape, self.outlines, self.images)
        return _with_image(still, self.moving[index]) if self.moving else still

    def window(self, start: int, stop: int) -> "CameraMask":
        """The mask of some of the frames.

        Parameters
        ----------
        start, stop : int
            Indices, from 0.

        Returns
        -------
        CameraMask
        """
        return replace(self, moving=tuple(self.moving[max(start, 0) : stop]))


@lru_cache(maxsize=16)
def _still(
    shape: tuple[int, int], outlines: tuple[Outline, ...], images: tuple[Entry, ...]
) -> NDArray[np.bool_]:
    covered = np.zeros(shape, np.uint8)
    for outline in outlines:
        corners = np.rint(np.array(outline) * (1 << _SHIFT)).astype(np.int32)
        cv2.fillPoly(covered, [corners], 1, shift=_SHIFT)
    out = covered.astype(bool)
    for entry in images:
        out = out | (read_mask(entry, shape) != 0)
    out.flags.writeable = False
    return out


@lru_cache(maxsize=1)
def _last(entry: Entry, shape: tuple[int, int]) -> NDArray[np.bool_]:
    return np.asarray(read_mask(entry, shape) != 0)


def _with_image(still: NDArray[np.bool_], entry: Entry) -> NDArray[np.bool_]:
    out = still | _last(entry, still.shape)
    out.flags.writeable = False
    return out


def read_mask(entry: Entry, shape: tuple[int, int]) -> NDArray[np.generic]:
    """Read an image of a mask.

    Parameters
    ----------
    entry : Entry
        Where it is.
    shape : tuple of int
        (rows, columns) that it must have.

    Returns
    -------
    ndarray, (row, column)
        Grey levels; what is not 0 is covered.

    Raises
    ------
    FrameError
        If it cannot be read, or has another size.
    """
    image = read_entry(entry)
    if image.shape != shape:
        raise FrameError(
            f"{entry} is {image.shape[1]} x {image.shape[0]} px, but the camera's images are "
            f"{shape[1]} x {shape[0]}; draw the mask on one of them"
        )
    return image
