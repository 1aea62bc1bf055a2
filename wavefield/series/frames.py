"""The frames of one camera: their files, numbers and masks, and how they are read."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.errors import FrameError
from wavefield.images import fill_masked
from wavefield.series.readers import FrameEntry, read_entry
from wavefield.variables import FrameFault

Outline = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class CameraMask:
    """The masked pixels of a camera: those inside outlines, and those that are not black in mask images."""

    shape: tuple[int, int]  # (rows, columns) of its images
    outlines: tuple[Outline, ...] = ()  # Closed outlines of corners (column, row), px; their inside is masked
    images: tuple[FrameEntry, ...] = ()  # Images of this shape, masked where not black


@lru_cache(maxsize=16)
def covered_pixels(mask: CameraMask) -> NDArray[np.bool_]:
    """Return a mask (row, column), read-only, true at masked pixels; FrameError if a mask image is bad."""
    drawn = np.zeros(mask.shape, np.uint8)
    for outline in mask.outlines:
        cv2.fillPoly(drawn, [np.rint(outline).astype(np.int32)], 1)
    out = drawn.astype(bool)
    for entry in mask.images:
        image = read_entry(entry)
        if image.shape != mask.shape:
            raise FrameError(
                f"{entry} is {image.shape[1]} x {image.shape[0]} px, but the camera's images are "
                f"{mask.shape[1]} x {mask.shape[0]}; draw the mask on one of them"
            )
        out |= image != 0
    out.flags.writeable = False
    return out


INTERLACED_RATIO = 1.05  # images of one moment: 0.73 to 1.0; interlaced: 1.02 to 1.13, median 1.10


class Frame(NamedTuple):
    """One image, or the reason why it is missing.

    Parameters
    ----------
    image : ndarray, (row, column), or None
        Grey levels, of the type of the file; None for a missing or bad frame.
    fault : FrameFault
        What is wrong with the frame; NONE if it is sound.
    message : str
        What is wrong, in a sentence that names the frame; empty if it is sound.
    """

    image: np.ndarray | None
    fault: FrameFault
    message: str


@dataclass(frozen=True)
class FrameSeries:
    """The frames of one camera over a range of frame numbers; index 0 is the first number of the range.

    Parameters
    ----------
    camera : str
        Name of the camera.
    first : int
        Frame number of index 0.
    entries : sequence of FrameEntry or None
        Files of the frames, in order of their numbers; None where one is missing.
    shape : tuple of int
        (rows, columns) that every frame must have.
    dtype : str
        Type that every frame must have.
    mask : CameraMask, optional
        Masked pixels, the same in all frames.
    beyond : tuple of int
        How many frames this camera has before and after the record, which is limited by the other cameras or
        by ``frames`` in the experiment file.
    times : ndarray, (n,), optional
        Time of each frame by the camera's own clock, s; NaN where it is missing.
    background : ndarray, (row, column), optional
        Image that is subtracted from every frame; negative differences become 0.
    """

    camera: str
    first: int
    entries: Sequence[FrameEntry | None] = field(repr=False)
    shape: tuple[int, int]
    dtype: str
    mask: CameraMask | None = None
    beyond: tuple[int, int] = (0, 0)
    times: NDArray[np.float64] | None = field(default=None, repr=False, compare=False)
    background: NDArray[Any] | None = field(default=None, repr=False, compare=False)

    def __len__(self) -> int:
        return len(self.entries)

    @property
    def missing(self) -> np.ndarray:
        """Numbers of the frames that have no file, as an array of integers."""
        return self.first + np.flatnonzero([entry is None for entry in self.entries])

    def place(self, index: int) -> str:
        """Return the camera, frame number and file of the frame at an index as text, for a message."""
        entry = self.entries[index]
        return f"{self.camera} frame {self.first + index}" + (f" ({entry})" if entry else "")

    def read(self, index: int) -> Frame:
        """Return the frame at an index from 0, minus the background; a bad frame has a fault and no image."""
        entry = self.entries[index]
        place = self.place(index)
        if entry is None:
            return Frame(None, FrameFault.MISSING, f"{place} is missing")
        try:
            image = read_entry(entry)
        except FrameError as error:
            if entry.path in str(error):
                place = f"{self.camera} frame {self.first + index}"
            return Frame(None, FrameFault.UNREADABLE, f"{place}: {error}")
        if image.shape != self.shape or image.dtype != self.dtype:
            size = f"{image.shape[1]} x {image.shape[0]} {image.dtype}"
            usual = f"{self.shape[1]} x {self.shape[0]} {self.dtype}"
            return Frame(None, FrameFault.WRONG_SIZE, f"{place} is {size}, the others are {usual}")
        frame = check_content(image, place)
        if frame.image is None or self.background is None:
            return frame
        return frame._replace(image=subtracted(frame.image, self.background))

    def covered(self, index: int) -> NDArray[np.bool_] | None:
        """Return the camera's mask (row, column), true at masked pixels, at any index; None without one."""
        return None if self.mask is None else covered_pixels(self.mask)

    def read_uncovered(self, index: int) -> np.ndarray | None:
        """Return the image at an index, with masked pixels set to a median grey; None for a bad frame."""
        image, covered = self.read(index).image, self.covered(index)
        return image if image is None or covered is None else fill_masked(image, covered)

    def window(self, start: int, stop: int) -> "FrameSeries":
        """Return the frames at indices `start` to `stop` - 1 as a series without times, for a worker."""
        start = max(start, 0)
        entries = list(self.entries[start:stop])
        return replace(self, first=self.first + start, entries=entries, times=None)


def is_interlaced(series: FrameSeries) -> bool:
    """Whether odd and even rows were exposed at two moments; up to five of a camera's images are examined.
    Let D_k be the rms difference between rows k apart. D_1 D_4 / D_2^2 is 0.7 to 1 in an image of one moment,
    and about 1.1 if particles moved between two moments. A colour mosaic raises this ratio for columns too;
    such images do not count as interlaced."""
    found = []
    for index in np.unique(np.linspace(0, len(series) - 1, 5).astype(int)):
        image = series.read(int(index)).image
        if image is None or min(image.shape) <= 8:
            continue
        for values in (image.astype(np.float32), image.T.astype(np.float32)):
            d1, d2, d4 = (np.mean((values[k:] - values[:-k]) ** 2) for k in (1, 2, 4))
            found.append(np.sqrt(d1 * d4) / d2 if d2 > 0 else 0.0)
    rows, columns = (np.median(found[k::2] or 0.0) for k in (0, 1))
    return bool(rows > INTERLACED_RATIO > columns)


def subtracted(image: NDArray[Any], background: NDArray[Any]) -> NDArray[Any]:
    """Return an image minus a background of the same type, (row, column); negative differences become 0."""
    return np.asarray(image - np.minimum(image, background))


def check_content(image: np.ndarray, place: str) -> Frame:
    """Return a `Frame` with the image, or a fault if it is blank or not finite; `place` names the frame."""
    if image.dtype.kind == "f" and not np.isfinite(image).all():
        bad = int(image.size - np.isfinite(image).sum())
        return Frame(None, FrameFault.UNREADABLE, f"{place} has {bad} pixels that are not finite numbers")
    # a sample of the pixels shows contrast in nearly every image, and is faster
    sample = image[::17, ::17]
    if sample.min() == sample.max() and image.min() == image.max():
        return Frame(None, FrameFault.BLANK, f"{place} is blank (all pixels are {image.flat[0]})")
    return Frame(image, FrameFault.NONE, "")
