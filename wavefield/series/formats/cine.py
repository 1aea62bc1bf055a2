"""Read `.cine` files of Vision Research's Phantom, as "The Cine File Format" describes them."""

import struct
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from wavefield.errors import FrameError
from wavefield.series.formats.recording import (
    RawRecording,
    Recording,
    checked_shape,
    complete_images,
    no_times,
    pixels,
)

_HEADER = struct.Struct("<2sHHHiIiIIIIII")  # CINEFILEHEADER
_BITMAP = struct.Struct("<IiiHHIIiiII")  # BITMAPINFOHEADER
_RATE = 0x300  # of FrameRate in SETUP
_MARK = 140  # of "ST" in SETUP; blocks with a head each follow
_BLOCK = struct.Struct("<IHH")  # its bytes, what it holds, reserved
_TIMES = 1002  # TIME64 of every image: fractions of a second, seconds
_PACKED = {256: 10, 1024: 12}  # biCompression to bits


def open_cine(path: Path) -> Recording:
    """Open a cine file of grey or raw images, uncompressed; FrameError if it is damaged or another kind."""
    with path.open("rb") as stream:
        head = stream.read(_HEADER.size)
        if len(head) < _HEADER.size or head[:2] != b"CI":
            raise FrameError(f"{path} is not a cine file")
        _, _, compression, _, _, _, _, count, at_image, at_setup, at_offsets, *_ = _HEADER.unpack(head)
        if compression == 1:
            raise FrameError(f"{path} holds JPEG images: save it uncompressed in the camera's program")
        stream.seek(at_image)
        bitmap = stream.read(_BITMAP.size)
        if len(bitmap) < _BITMAP.size:
            raise FrameError(f"{path} ends within its header: it is truncated")
        _, width, height, _, depth, code, _, _, _, _, _ = _BITMAP.unpack(bitmap)
        stream.seek(at_setup + _RATE)
        rate = struct.unpack("<I", stream.read(4).ljust(4, b"\0"))[0]
        stream.seek(at_offsets)
        if not 0 < count < 2**28:
            raise FrameError(f"{path} holds {count} images by its header, which is damaged")
        offsets = np.frombuffer(stream.read(8 * count), "<i8")
        if not len(offsets):
            raise FrameError(f"{path} ends before its list of images: it is truncated")
        times = _times(stream, at_setup, at_offsets)
    shape = checked_shape(path, width, abs(height))
    if code in _PACKED:
        take, each = pixels(shape, _PACKED[code])
    elif code == 0 and depth in (8, 16):
        # as in Windows' bitmaps the lowest row comes first, unless the height is negative
        take, each = pixels(shape, depth, upside_down=height > 0)
    else:
        raise FrameError(f"{path} holds images of {depth} bits of kind {code}: export them as grey TIFF")

    def start(index: int) -> int:
        return int(offsets[index])

    complete = complete_images(path, len(offsets), start, each + 8)
    stamps = no_times if len(times) < complete else lambda: times[:complete]
    rate = float(rate) if rate else None
    return RawRecording(path, complete, shape, start, take, rate, prefixed=True, times=stamps)


def _times(stream: BinaryIO, at_setup: int, at_offsets: int) -> NDArray[np.float64]:
    """Return the times of the images of an open cine file, (n,), s; empty if the file has none.
    `at_setup` and `at_offsets` are the bytes at which the block SETUP and the list of images begin."""
    stream.seek(at_setup + _MARK)
    mark = stream.read(4)
    place = at_setup + int.from_bytes(mark[2:], "little")
    while mark[:2] == b"ST" and place + _BLOCK.size <= at_offsets:
        stream.seek(place)
        size, kind, _ = _BLOCK.unpack(stream.read(_BLOCK.size))
        if kind == _TIMES:
            pairs = np.frombuffer(stream.read(max(size - _BLOCK.size, 0) // 8 * 8), "<u4").reshape(-1, 2)
            return pairs[:, 1] + pairs[:, 0] / 2.0**32
        if size < _BLOCK.size:
            break
        place += size
    return np.empty(0)
