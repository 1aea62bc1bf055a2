"""One image after another in a file: where they start, how their pixels are packed."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from io import BytesIO, FileIO
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numba import int64, uint8, uint16, uint32, uint64, void
from numpy.typing import NDArray

from wavefield.compiled import compiled
from wavefield.errors import FrameError

Pixels = NDArray[Any]
Stream = FileIO | BytesIO

_TOGETHER = 4  # pixels of 10 or 12 bits that begin and end with a byte
_PIECE = 1 << 18  # bytes of an image that are taken apart at a time


class Recording(Protocol):
    """A file of many images, of which any one can be read without its neighbours.

    Attributes
    ----------
    count : int
        Images in it.
    shape : (int, int)
        Rows and columns.
    rate : float or None
        Images per second, where the file says.
    first : int
        Number that the camera gave the first image.
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
    """A recording whose images lie at known places in the file, their pixels uncompressed.

    Parameters
    ----------
    path : Path
        The file.
    count : int
        Images in it.
    shape : (int, int)
        Rows and columns.
    start : callable
        From the number of an image, from 0, to the byte where its pixels start.
    take : callable
        Reads an image, (row, column), from a file that stands at its pixels; `EOFError` where it ends before.
    rate : float, optional
        Images per second, where the file says.
    first : int
        Number that the camera gave the first image.
    prefixed : bool
        Whether each image begins with a note to it, whose length in bytes are its first four.
    """

    path: Path
    count: int
    shape: tuple[int, int]
    start: Callable[[int], int]
    take: Callable[[Stream], Pixels]
    rate: float | None = None
    first: int = 0
    prefixed: bool = False
    _stream: FileIO | None = field(default=None, repr=False)

    def read(self, index: int) -> Pixels:
        """Read one image, without its neighbours.

        Parameters
        ----------
        index : int
            Which, from 0.

        Returns
        -------
        ndarray, (row, column)

        Raises
        ------
        FrameError
            If the file ends before, or there is no such image.
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

    Parameters
    ----------
    shape : (int, int)
        Rows and columns.
    dtype : str
        Of a pixel in the file, as numpy writes it.
    upside_down : bool
        Whether the lowest row comes first.

    Returns
    -------
    callable
    """

    def take(stream: Stream) -> Pixels:
        out = np.empty(shape, dtype)
        if upside_down:
            piece = np.empty((max(1, _PIECE // out[0].nbytes), shape[1]), dtype)
            for last in range(shape[0], 0, -len(piece)):
                part = piece[: min(len(piece), last)]
                _fill(part, stream)
                out[last - len(part) : last] = part[::-1]
        else:
            _fill(out, stream)
        return out.astype(out.dtype.newbyteorder("="), copy=False)

    return take


def _fill(out: Pixels, stream: Stream) -> None:
    rest = memoryview(out.reshape(-1).view(np.uint8))  # type: ignore[arg-type]  # which is a buffer
    while rest:
        count = stream.readinto(rest)
        if not count:
            raise EOFError
        rest = rest[count:]


def packed(shape: tuple[int, int], bits: int) -> Callable[[Stream], Pixels]:
    """Reader of pixels of 10 or 12 bits one after another, the highest bit first.

    They are taken apart piece by piece, while each is still in the processor's cache.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns.
    bits : {10, 12}
        Of a pixel.

    Returns
    -------
    callable
        To images of uint16.

    Examples
    --------
    >>> from io import BytesIO
    >>> packed((1, 2), 12)(BytesIO(bytes([0x12, 0x34, 0x56]))).tolist()
    [[291, 1110]]
    """

    def take(stream: Stream) -> Pixels:
        out = np.empty(shape, np.uint16)
        flat, piece = out.reshape(-1), np.empty(_PIECE * bits // 16, np.uint8)
        for first in range(0, flat.size, _PIECE // 2):
            part = flat[first : first + _PIECE // 2]
            raw = piece[: packed_bytes((1, part.size), bits)]
            _fill(raw, stream)
            _unpack(raw, bits, part)
        return out

    return take


def _unpack(raw: Pixels, bits: int, flat: Pixels) -> None:
    whole = flat.size // _TOGETHER * _TOGETHER if sys.byteorder == "little" else 0
    if bits == 12:
        _unpack_pairs(raw, flat[:whole].view(np.uint32))
    else:
        _unpack_fours(raw, flat[:whole].view(np.uint64))
    _unpack_rest(raw, bits, whole, flat)


@compiled([void(uint8[::1], uint32[::1])], error_model="numpy")
def _unpack_pairs(raw: Pixels, out: Pixels) -> None:
    """Pixels of 12 bits, two from three bytes: in words of one width it becomes vector code."""
    for k in range(np.uintp(len(out))):
        i = np.uintp(3) * np.uintp(k)
        a, b, c = np.uint32(raw[i]), np.uint32(raw[i + np.uintp(1)]), np.uint32(raw[i + np.uintp(2)])
        first = (a << np.uint32(4)) | (b >> np.uint32(4))
        out[k] = first | ((b & np.uint32(15)) << np.uint32(24)) | (c << np.uint32(16))


@compiled([void(uint8[::1], uint64[::1])], error_model="numpy")
def _unpack_fours(raw: Pixels, out: Pixels) -> None:
    """Pixels of 10 bits, four from five bytes: gathered into words, then taken apart in vector code."""
    gathered, ten = np.empty(256, np.uint64), np.uint64(1023)
    one = np.uintp(1)
    for start in range(np.uintp(0), np.uintp(len(out)), np.uintp(256)):
        count = min(np.uintp(len(out)) - start, np.uintp(256))
        for k in range(count):
            i = np.uintp(5) * (start + k)
            word = np.uint64(raw[i])
            for _ in range(4):
                i += one
                word = (word << np.uint64(8)) | np.uint64(raw[i])
            gathered[k] = word
        for k in range(count):
            word = gathered[k]
            first = (word >> np.uint64(30)) | (((word >> np.uint64(20)) & ten) << np.uint64(16))
            out[start + k] = (
                first | (((word >> np.uint64(10)) & ten) << np.uint64(32)) | ((word & ten) << np.uint64(48))
            )


@compiled([void(uint8[::1], int64, int64, uint16[::1])], error_model="numpy")
def _unpack_rest(raw: Pixels, bits: int, first: int, out: Pixels) -> None:
    """Pixels from ``first`` on, bit by bit."""
    for o in range(first, len(out)):
        value = 0
        for bit in range(o * bits, (o + 1) * bits):
            value = 2 * value + ((raw[bit >> 3] >> (7 - (bit & 7))) & 1)
        out[o] = value


def packed_bytes(shape: tuple[int, int], bits: int) -> int:
    """Bytes of an image of packed pixels.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns.
    bits : int
        Of a pixel.

    Returns
    -------
    int
    """
    return -(-shape[0] * shape[1] * bits // 8)


def checked_shape(path: Path, width: int, height: int) -> tuple[int, int]:
    """Rows and columns, refused where they cannot be those of an image.

    Parameters
    ----------
    path : Path
        The file.
    width, height : int
        As the file says, px.

    Returns
    -------
    (int, int)

    Raises
    ------
    FrameError
        If they are none or enormous.
    """
    if not (0 < width <= 65536 and 0 < height <= 65536):
        raise FrameError(f"{path} says its images are {width} x {height} px: its header is damaged")
    return height, width


def fitting(path: Path, count: int, starts: Sequence[int] | Callable[[int], int], each: int) -> int:
    """How many of the images announced are there: a recording that was cut short keeps those before.

    Parameters
    ----------
    path : Path
        The file.
    count : int
        Images announced.
    starts : sequence of int, or callable
        Where each starts.
    each : int
        Bytes of an image.

    Returns
    -------
    int

    Raises
    ------
    FrameError
        If not even one is there.
    """
    size = path.stat().st_size
    at = starts if callable(starts) else starts.__getitem__
    low, high = 0, count
    while low < high:  # the first image that is not whole
        middle = (low + high) // 2
        low, high = (middle + 1, high) if at(middle) + each <= size else (low, middle)
    if not low:
        raise FrameError(f"{path} holds not one whole image: it is empty or truncated")
    return low
