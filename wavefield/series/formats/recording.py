"""Recordings: files of many images. Find an image in a file, and read its pixels (bytes or packed bits)."""

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, field
from io import FileIO
from pathlib import Path
from typing import Any, Protocol

import imagecodecs
import numpy as np
from numpy.typing import NDArray

from wavefield.errors import FrameError

Pixels = NDArray[Any]
Times = NDArray[np.float64]


class Recording(Protocol):
    """A file of many images (row, column); any image can be read without its neighbours."""

    count: int  # Images in it
    shape: tuple[int, int]  # Rows and columns
    rate: float | None  # Images per second; None if the file does not tell

    def read(self, index: int) -> Pixels:
        """Return the image at an index from 0, (row, column); FrameError if it cannot be read."""

    def times(self) -> Times:
        """Return the times of the images, (count,), s; empty if the file has none."""

    def close(self) -> None:
        """Close the file."""


def no_times() -> Times:
    """Return an empty array: the `times` of a recording that has none."""
    return np.empty(0)


@dataclass
class RawRecording:
    """A recording with uncompressed pixels, each image at a known place in the file."""

    path: Path  # The file
    count: int  # Images in it
    shape: tuple[int, int]  # Rows and columns
    start: Callable[[int], int]  # Returns the byte at which the image at an index, from 0, begins
    # Reads an image, (row, column), from a file positioned at its pixels; `EOFError` where it ends before
    take: Callable[[FileIO], Pixels]
    rate: float | None = None  # Images per second; None if the file does not tell
    prefixed: bool = False  # Whether a note precedes the pixels; its first four bytes are its length in bytes
    times: Callable[[], Times] = no_times  # Returns the times of the images, (count,), s; empty without
    _stream: FileIO | None = field(default=None, repr=False)

    def read(self, index: int) -> Pixels:
        """Return the image at an index from 0, (row, column); FrameError if it cannot be read."""
        refuse_index(index, self.count, self.path)
        try:
            return self.take(self._at(index))
        except (OSError, OverflowError) as error:  # a damaged header leads anywhere
            raise FrameError(f"{self.path}, image {index} cannot be read: {error}") from None
        except EOFError:
            raise FrameError(f"{self.path} ends within image {index}: is it truncated?") from None

    def _at(self, index: int) -> FileIO:
        """Return the open file, positioned at the pixels of the image at an index."""
        if self._stream is None:
            self._stream = FileIO(str(self.path))
        place = self.start(index)
        if self.prefixed:
            self._stream.seek(place)
            place += int.from_bytes(self._stream.read(4), "little")
        self._stream.seek(place)
        return self._stream

    def close(self) -> None:
        """Close the file; a further `read` opens it again."""
        if self._stream is not None:
            self._stream.close()
            self._stream = None


def usual_intervals(times: Times) -> Times:
    """Return the intervals between times, s, that differ from the median interval by less than half of it.
    These are the intervals without dropped images. The array is empty if the median is not positive."""
    intervals = np.diff(times)
    middle = float(np.median(intervals)) if len(intervals) else 0.0
    return intervals[np.abs(intervals / middle - 1.0) < 0.5] if middle > 0 else np.empty(0)


def usual_interval(times: Times) -> float:
    """Return the mean of `usual_intervals`: the interval between images, s; 0 if there are none."""
    usual = usual_intervals(times)
    return float(usual.mean()) if len(usual) else 0.0


def refuse_index(index: int, count: int, path: Path) -> None:
    """Raise FrameError if a recording of `count` images has no image `index`."""
    if not 0 <= index < count:
        raise FrameError(f"{path} has {count} images: there is no image {index}")


def checked_shape(path: Path, width: int, height: int) -> tuple[int, int]:
    """Return (rows, columns) from a file's header; FrameError if one is not between 1 and 65536."""
    if not (0 < width <= 65536 and 0 < height <= 65536):
        raise FrameError(f"{path} has images of {width} x {height} px by its header, which is damaged")
    return height, width


def complete_images(path: Path, count: int, start: Callable[[int], int], each: int) -> int:
    """Return how many of the `count` images of a file are complete; FrameError if none is.
    `start` gives the byte at which the image at an index begins; `each` is the number of bytes per image."""
    complete = bisect_right(range(count), path.stat().st_size, key=lambda index: start(index) + each)
    if not complete:
        raise FrameError(f"{path} holds not one complete image: it is empty or truncated")
    return complete


def pixels(
    shape: tuple[int, int], bits: int, *, upside_down: bool = False
) -> tuple[Callable[[FileIO], Pixels], int]:
    """Return a function that reads an image from an open file, and the number of bytes per image.
    Pixels of 8 or 16 `bits` take one or two bytes; others are packed without gaps, highest bit first.
    `upside_down` is for files in which the lowest row comes first; it has no effect on packed pixels."""
    count = shape[0] * shape[1]
    size = (count * bits + 7) // 8

    def take(stream: FileIO) -> Pixels:
        raw = np.fromfile(stream, np.uint8, size)
        if raw.size < size:
            raise EOFError
        if bits in (8, 16):
            out = raw.view("u1" if bits == 8 else "<u2").reshape(shape)
            return np.ascontiguousarray(out[::-1] if upside_down else out, out.dtype.newbyteorder("="))
        return np.asarray(imagecodecs.packints_decode(raw.tobytes(), np.uint16, bits))[:count].reshape(shape)

    return take, size
