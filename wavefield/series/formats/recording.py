"""One image after another in a file: where they start, how their pixels are packed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import numpy as np
from numba import int64, types, uint8, uint16, void
from numpy.typing import NDArray

from wavefield.compiled import compiled
from wavefield.errors import FrameError

Pixels = NDArray[Any]


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
    bytes_each : int
        Of the pixels of an image.
    decode : callable
        From those bytes to the image, (row, column).
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
    bytes_each: int
    decode: Callable[[bytes], Pixels]
    rate: float | None = None
    first: int = 0
    prefixed: bool = False
    _stream: BinaryIO | None = field(default=None, repr=False)

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
            data = self._bytes(index)
        except (OSError, OverflowError) as error:  # a damaged header leads anywhere
            raise FrameError(f"{self.path}, image {index} cannot be read: {error}") from None
        if len(data) < self.bytes_each:
            raise FrameError(f"{self.path} ends within image {index}: is it truncated?")
        return self.decode(data)

    def _bytes(self, index: int) -> bytes:
        if self._stream is None:
            self._stream = self.path.open("rb")
        place = self.start(index)
        if self.prefixed:
            self._stream.seek(place)
            place += int.from_bytes(self._stream.read(4), "little")
        self._stream.seek(place)
        return self._stream.read(self.bytes_each)

    def close(self) -> None:
        """Close the file; a further `read` opens it again."""
        if self._stream is not None:
            self._stream.close()
            self._stream = None


def plain(shape: tuple[int, int], dtype: str, *, upside_down: bool = False) -> Callable[[bytes], Pixels]:
    """Decoder of whole bytes.

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

    def decode(data: bytes) -> Pixels:
        image = np.frombuffer(data, dtype).reshape(shape)
        image = image[::-1] if upside_down else image
        return np.ascontiguousarray(image.astype(image.dtype.newbyteorder("="), copy=False))

    return decode


def packed(shape: tuple[int, int], bits: int) -> Callable[[bytes], Pixels]:
    """Decoder of pixels of 10 or 12 bits one after another, the highest bit first.

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
    >>> packed((1, 2), 12)(bytes([0x12, 0x34, 0x56])).tolist()
    [[291, 1110]]
    """

    def decode(data: bytes) -> Pixels:
        out = np.empty(shape, np.uint16)
        _unpack(np.frombuffer(data, np.uint8), bits, out.reshape(-1))
        return out

    return decode


@compiled([void(types.Array(uint8, 1, "C", readonly=True), int64, uint16[::1])], error_model="numpy")
def _unpack(raw: Pixels, bits: int, out: Pixels) -> None:
    """Pixels of 10 or 12 bits, the highest bit first, four or two at a time, the last ones bit by bit."""
    group, width = (4, 5) if bits == 10 else (2, 3)
    whole = len(out) // group
    for k in range(whole):
        i, o = width * k, group * k
        if bits == 12:
            a, b, c = np.uint16(raw[i]), np.uint16(raw[i + 1]), np.uint16(raw[i + 2])
            out[o], out[o + 1] = (a << 4) | (b >> 4), ((b & 15) << 8) | c
        else:
            a, b, c = np.uint16(raw[i]), np.uint16(raw[i + 1]), np.uint16(raw[i + 2])
            d, e = np.uint16(raw[i + 3]), np.uint16(raw[i + 4])
            out[o], out[o + 1] = (a << 2) | (b >> 6), ((b & 63) << 4) | (c >> 4)
            out[o + 2], out[o + 3] = ((c & 15) << 6) | (d >> 2), ((d & 3) << 8) | e
    for o in range(group * whole, len(out)):
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
