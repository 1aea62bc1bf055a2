"""One image after another in a file: where they start, how whole pixels are read."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from io import BytesIO, FileIO
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from wavefield.errors import FrameError

Pixels = NDArray[Any]
Stream = FileIO | BytesIO

_PIECE = 1 << 18  # bytes of an image upside down that are read at a time


class Recording(Protocol):
    """A file of many images, of which any one can be read without its neighbours.

    With shape (int, int).
    """

    count: int
    shape: tuple[int, int]
    rate: float | None
    first: int

    def read(self, index: int) -> Pixels:
        """Read one image, (row, column), counted from 0; a `FrameError` where it is not whole."""

    def close(self) -> None:
        """Close the file."""


@dataclass
class RawRecording:
    """A recording whose images lie at known places in the file, their pixels uncompressed."""

    path: Path  # The file
    count: int  # Images in it
    shape: tuple[int, int]  # (int, int): Rows and columns
    start: Callable[[int], int]  # From the number of an image, from 0, to the byte where its pixels start
    # Reads an image, (row, column), from a file that stands at its pixels; `EOFError` where it ends before
    take: Callable[[Stream], Pixels]
    rate: float | None = None  # Images per second, where the file says
    first: int = 0  # Number that the camera gave the first image
    # Whether each image begins with a note to it, whose length in bytes are its first four
    prefixed: bool = False
    # Gives when each image was taken, s since 1970, (count,); None where the file does not say
    times: Callable[[], NDArray[np.float64]] | None = None
    _stream: FileIO | None = field(default=None, repr=False)

    def read(self, index: int) -> Pixels:
        """Read one image, without its neighbours.

        Returns (row, column).
        """
        if not 0 <= index < self.count:
            raise FrameError(f"{self.path} has {self.count} images: there is no image {index}")
        try:
            return self.take(self._at(index))
        except (OSError, OverflowError) as error:  # a damaged header leads anywhere
            raise FrameError(f"{self.path}, image {index} cannot be read: {error}") from None
        except EOFError:
            raise FrameError(f"{self.path} ends within image {index}: is it truncated?") from None

    def _at(self, index: int) -> FileIO:
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


def plain(shape: tuple[int, int], dtype: str, *, upside_down: bool = False) -> Callable[[Stream], Pixels]:
    """Reader of whole bytes: straight into the image.

    With shape (int, int).
    """

    def take(stream: Stream) -> Pixels:
        out = np.empty(shape, dtype)
        if upside_down:
            piece = np.empty((max(1, _PIECE // out[0].nbytes), shape[1]), dtype)
            for last in range(shape[0], 0, -len(piece)):
                part = piece[: min(len(piece), last)]
                fill(part, stream)
                out[last - len(part) : last] = part[::-1]
        else:
            fill(out, stream)
        return out.astype(out.dtype.newbyteorder("="), copy=False)

    return take


def fill(out: Pixels, stream: Stream) -> None:
    """Read bytes until an array is full."""
    rest = memoryview(out.reshape(-1).view(np.uint8))  # type: ignore[arg-type]  # which is a buffer
    while rest:
        count = stream.readinto(rest)
        if not count:
            raise EOFError
        rest = rest[count:]


def checked_shape(path: Path, width: int, height: int) -> tuple[int, int]:
    """Rows and columns, refused where they cannot be those of an image.

    With width, height, px; returns (int, int).
    """
    if not (0 < width <= 65536 and 0 < height <= 65536):
        raise FrameError(f"{path} says its images are {width} x {height} px: its header is damaged")
    return height, width


def fitting(path: Path, count: int, starts: Sequence[int] | Callable[[int], int], each: int) -> int:
    """How many of the images announced are there: a recording that was cut short keeps those before."""
    size = path.stat().st_size
    at = starts if callable(starts) else starts.__getitem__
    low, high = 0, count
    while low < high:  # the first image that is not whole
        middle = (low + high) // 2
        low, high = (middle + 1, high) if at(middle) + each <= size else (low, middle)
    if not low:
        raise FrameError(f"{path} holds not one whole image: it is empty or truncated")
    return low
