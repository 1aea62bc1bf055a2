"""Read `.seq` files of NorPix' StreamPix with uncompressed grey images."""

import struct
from pathlib import Path

import numpy as np

from wavefield.errors import FrameError
from wavefield.series.formats.recording import (
    RawRecording,
    Recording,
    Times,
    checked_shape,
    complete_images,
    no_times,
    pixels,
)

_MAGIC = 0xFEED
_GREY = (100, 101)  # monochrome, and raw of a colour mosaic


def open_streampix(path: Path) -> Recording:
    """Open a StreamPix sequence of uncompressed grey images; FrameError if damaged or of another kind."""
    with path.open("rb") as stream:
        head = stream.read(1024)
    if len(head) < 1024 or struct.unpack_from("<I", head)[0] != _MAGIC:
        raise FrameError(f"{path} is not a sequence of StreamPix")
    (version,) = struct.unpack_from("<i", head, 28)
    width, height, depth, _, size, kind, count, _, stride = struct.unpack_from("<9I", head, 548)
    (rate,) = struct.unpack_from("<d", head, 584)
    shape = checked_shape(path, width, height)
    if kind not in _GREY or depth not in (8, 16):
        raise FrameError(
            f"{path} holds images of kind {kind} with {depth} bits: export them uncompressed, in grey"
        )
    take, each = pixels(shape, depth)
    if size != each or stride < each:
        raise FrameError(f"{path} holds compressed images, or its header is damaged: export it uncompressed")
    begin = 8192 if version >= 5 else 1024

    def start(index: int) -> int:
        return begin + index * int(stride)

    def times() -> Times:
        stamp = struct.Struct("<IHH" if version >= 5 else "<IH")
        out = np.empty(complete)
        with path.open("rb") as stream:
            for index in range(complete):
                stream.seek(start(index) + each)
                seconds, *parts = stamp.unpack(stream.read(stamp.size).ljust(stamp.size, b"\0"))
                out[index] = seconds + sum(part / 1e3 ** (k + 1) for k, part in enumerate(parts))
        return out

    complete = complete_images(path, count, start, each)
    stamps = times if stride >= each + 8 else no_times
    return RawRecording(path, complete, shape, start, take, rate if 0 < rate < 1e7 else None, times=stamps)
