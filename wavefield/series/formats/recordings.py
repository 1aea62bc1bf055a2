"""The base class of recordings, and readers for Phantom, Photron, StreamPix and DaVis files."""

import re
import struct
import xml.etree.ElementTree as ET
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, field
from io import FileIO
from pathlib import Path
from typing import Any, BinaryIO

import imagecodecs
import numpy as np
from numpy.typing import NDArray

from wavefield.errors import FrameError
from wavefield.images.davis_image import count_frames, read_buffer

Pixels = NDArray[Any]
Times = NDArray[np.float64]
Starts = range | NDArray[np.int64]  # byte in a file at which each image begins


class Recording(ABC):
    """A file that holds many images (row, column), which can be read in any order."""

    path: Path | str  # The file, for messages
    count: int  # Images in it
    shape: tuple[int, int]  # Rows and columns
    rate: float | None = None  # Images per second; None if the file does not tell
    rotation = 0  # Rotation for display that a video states, degrees; it is not applied
    _times: Times = np.empty(0)

    def read(self, index: int) -> Pixels:
        """Return the image at an index from 0, (row, column); FrameError if it cannot be read."""
        if not 0 <= index < self.count:
            raise FrameError(f"{self.path} has {self.count} images: there is no image {index}")
        return self._read(index)

    @abstractmethod
    def _read(self, index: int) -> Pixels:
        """Return the image, (row, column), at a valid index from 0; FrameError if it cannot be read."""

    def times(self) -> Times:
        """Return the times of the images, (count,), s; empty if the file has none."""
        return self._times

    def close(self) -> None:  # noqa: B027  # not all recordings keep a file open
        """Close the file, if it is open."""


@dataclass
class RawRecording(Recording):
    """A recording with uncompressed pixels, in which each image begins at a known byte of the file."""

    path: Path
    count: int
    shape: tuple[int, int]
    starts: Starts  # Byte at which each image begins
    # Reads an image, (row, column), from a file positioned at its pixels; `EOFError` where it ends before
    take: Callable[[FileIO], Pixels]
    rate: float | None = None
    prefixed: bool = False  # Whether a note precedes the pixels; its first four bytes are its length in bytes
    stamps: Callable[[], Times] | None = None  # Reads the times of the images, (count,), s
    _stream: FileIO | None = field(default=None, repr=False)

    def _read(self, index: int) -> Pixels:
        try:
            if self._stream is None:
                self._stream = FileIO(str(self.path))
            place = int(self.starts[index])
            if self.prefixed:
                self._stream.seek(place)
                place += int.from_bytes(self._stream.read(4), "little")
            self._stream.seek(place)
            return self.take(self._stream)
        except (OSError, OverflowError) as error:  # a damaged header leads anywhere
            raise FrameError(f"{self.path}, image {index} cannot be read: {error}") from None
        except EOFError:
            raise FrameError(f"{self.path} ends within image {index}: is it truncated?") from None

    def times(self) -> Times:
        """Return the times of the images, (count,), s; empty if the file has none."""
        return self.stamps() if self.stamps else np.empty(0)

    def close(self) -> None:
        """Close the file; a further `read` opens it again."""
        if self._stream is not None:
            self._stream.close()
            self._stream = None


def usual_intervals(times: Times) -> Times:
    """Return the intervals between times, s, that are within 50 % of their median (no dropped images)."""
    intervals = np.diff(times)
    middle = float(np.median(intervals)) if len(intervals) else 0.0
    return intervals[np.abs(intervals / middle - 1.0) < 0.5] if middle > 0 else np.empty(0)


def usual_interval(times: Times) -> float:
    """Return the mean interval between images, s, dropped images aside (`usual_intervals`); 0 if unknown."""
    usual = usual_intervals(times)
    return float(usual.mean()) if len(usual) else 0.0


def checked_shape(path: Path, width: int, height: int) -> tuple[int, int]:
    """Return (rows, columns) = (height, width), px; FrameError if one of them is not between 1 and 65536."""
    if not (0 < width <= 65536 and 0 < height <= 65536):
        raise FrameError(f"{path} has images of {width} x {height} px by its header, which is damaged")
    return height, width


def complete_images(path: Path, starts: Starts, each: int) -> int:
    """Return how many images of a file are complete; FrameError if none is.
    `starts` are the bytes at which the images begin, and `each` is the number of bytes per image."""
    complete = bisect_right(starts, path.stat().st_size - each, key=int)
    if not complete:
        raise FrameError(f"{path} holds not one complete image: it is empty or truncated")
    return complete


def pixels(
    shape: tuple[int, int], bits: int, *, upside_down: bool = False
) -> tuple[Callable[[FileIO], Pixels], int]:
    """Return a function that reads an image from an open file, and the number of bytes per image.
    `shape` is (rows, columns). Pixels of 8 or 16 `bits` take one or two bytes; others are packed without
    gaps, highest bit first. `upside_down`: the lowest row comes first in the file (not for packed pixels)."""
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


# -- Phantom, as "The Cine File Format" of Vision Research describes it

_CINE_HEADER = struct.Struct("<2sHHHiIiIIIIII")  # CINEFILEHEADER
_CINE_BITMAP = struct.Struct("<IiiHHIIiiII")  # BITMAPINFOHEADER
_CINE_RATE = 0x300  # of FrameRate in SETUP
_CINE_MARK = 140  # of "ST" in SETUP; blocks with a head each follow
_CINE_BLOCK = struct.Struct("<IHH")  # its bytes, what it holds, reserved
_CINE_TIMES = 1002  # TIME64 of every image: fractions of a second, seconds
_CINE_PACKED = {256: 10, 1024: 12}  # biCompression to bits


def open_cine(path: Path) -> Recording:
    """Open a cine file of uncompressed grey or raw images; FrameError if damaged or of another kind."""
    with path.open("rb") as stream:
        head = stream.read(_CINE_HEADER.size)
        if len(head) < _CINE_HEADER.size or head[:2] != b"CI":
            raise FrameError(f"{path} is not a cine file")
        _, _, compression, _, _, _, _, count, at_image, at_setup, at_offsets, *_ = _CINE_HEADER.unpack(head)
        if compression == 1:
            raise FrameError(f"{path} holds JPEG images: save it uncompressed in the camera's program")
        stream.seek(at_image)
        bitmap = stream.read(_CINE_BITMAP.size)
        if len(bitmap) < _CINE_BITMAP.size:
            raise FrameError(f"{path} ends within its header: it is truncated")
        _, width, height, _, depth, code, _, _, _, _, _ = _CINE_BITMAP.unpack(bitmap)
        stream.seek(at_setup + _CINE_RATE)
        rate = struct.unpack("<I", stream.read(4).ljust(4, b"\0"))[0]
        stream.seek(at_offsets)
        if not 0 < count < 2**28:
            raise FrameError(f"{path} holds {count} images by its header, which is damaged")
        offsets = np.frombuffer(stream.read(8 * count), "<i8")
        if not len(offsets):
            raise FrameError(f"{path} ends before its list of images: it is truncated")
        times = _cine_times(stream, at_setup, at_offsets)
    shape = checked_shape(path, width, abs(height))
    if code in _CINE_PACKED:
        take, each = pixels(shape, _CINE_PACKED[code])
    elif code == 0 and depth in (8, 16):
        # as in Windows' bitmaps the lowest row comes first, unless the height is negative
        take, each = pixels(shape, depth, upside_down=height > 0)
    else:
        raise FrameError(f"{path} holds images of {depth} bits of kind {code}: export them as grey TIFF")
    complete = complete_images(path, offsets, each + 8)
    stamps = None if len(times) < complete else lambda: times[:complete]
    rate = float(rate) if rate else None
    return RawRecording(path, complete, shape, offsets, take, rate, prefixed=True, stamps=stamps)


def _cine_times(stream: BinaryIO, at_setup: int, at_offsets: int) -> NDArray[np.float64]:
    """Return the times of a cine file's images, (n,), s; empty if the file has none.
    `at_setup` and `at_offsets` are the byte positions of the block SETUP and of the list of images."""
    stream.seek(at_setup + _CINE_MARK)
    mark = stream.read(4)
    place = at_setup + int.from_bytes(mark[2:], "little")
    while mark[:2] == b"ST" and place + _CINE_BLOCK.size <= at_offsets:
        stream.seek(place)
        size, kind, _ = _CINE_BLOCK.unpack(stream.read(_CINE_BLOCK.size))
        if kind == _CINE_TIMES:
            pairs = np.frombuffer(stream.read(max(size - _CINE_BLOCK.size, 0) // 8 * 8), "<u4").reshape(-1, 2)
            return pairs[:, 1] + pairs[:, 0] / 2.0**32
        if size < _CINE_BLOCK.size:
            break
        place += size
    return np.empty(0)


# -- Photron: pixels in `.mraw`, their format in `.cihx` (XML) or `.cih` (text)

_CIH_NEEDED = ("Total Frame", "Image Width", "Image Height", "Color Bit")
_CIHX_PLACES = {
    "Total Frame": "frameInfo/totalFrame",
    "Image Width": "imageDataInfo/resolution/width",
    "Image Height": "imageDataInfo/resolution/height",
    "Color Bit": "imageDataInfo/colorInfo/bit",
    "Record Rate(fps)": "recordInfo/recordRate",
}


def open_photron(path: Path) -> Recording:
    """Open a recording of a Photron camera by the path of its .mraw, .cihx or .cih file."""
    note = _with_ending(path, ".cihx", ".cih", ".CIHX", ".CIH")
    if note is None:
        raise FrameError(f"{path} has no .cihx or .cih next to it, which states how large its images are")
    raw = _with_ending(path, ".mraw", ".MRAW")
    if raw is None:
        raise FrameError(f"{path} has no .mraw next to it: save the recording as MRAW")
    stated = _read_cihx(note) if note.suffix.lower() == ".cihx" else _read_cih(note)
    missing = [name for name in _CIH_NEEDED if name not in stated]
    if missing:
        raise FrameError(f"{note} does not state {', '.join(missing)}: it is damaged")
    try:
        count, width, height, bits = (int(stated[name]) for name in _CIH_NEEDED)
        rate = float(stated.get("Record Rate(fps)") or 0) or None
    except ValueError:
        raise FrameError(f"{note} states sizes or a rate that are not numbers: it is damaged") from None
    shape = checked_shape(note, width, height)
    if bits not in (8, 10, 12, 16):
        raise FrameError(f"{note}: images of {bits} bits a pixel are not read; save them in grey")
    take, each = pixels(shape, bits)
    starts = range(0, count * each, each)
    return RawRecording(raw, complete_images(raw, starts, each), shape, starts, take, rate)


def _with_ending(path: Path, *endings: str) -> Path | None:
    """Return `path` with the first of the `endings` for which this file exists; None if none exists."""
    return next((file for file in map(path.with_suffix, endings) if file.is_file()), None)


def _read_cih(path: Path) -> dict[str, str]:
    """Return the entries of a .cih file (lines ``name : value``) as a dict."""
    out = {}
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        name, colon, value = line.partition(":")
        if colon:
            out[name.strip()] = value.strip()
    return out


def _read_cihx(path: Path) -> dict[str, str]:
    """Return the entries of a .cihx file, as text, under the names that they have in a .cih file."""
    data = path.read_bytes()
    xml = re.search(rb"<cih>.*</cih>", data, re.DOTALL)
    if not xml:
        raise FrameError(f"{path} holds no <cih>: it is damaged or truncated")
    try:
        root = ET.fromstring(xml[0])
    except ET.ParseError as error:
        raise FrameError(f"{path} is damaged: {error}") from None
    return {name: text for name, place in _CIHX_PLACES.items() if (text := root.findtext(place))}


# -- StreamPix of NorPix

_SEQ_MAGIC = 0xFEED
_SEQ_GREY = (100, 101)  # monochrome, and raw of a colour mosaic


def open_streampix(path: Path) -> Recording:
    """Open a StreamPix sequence of uncompressed grey images; FrameError if damaged or of another kind."""
    with path.open("rb") as stream:
        head = stream.read(1024)
    if len(head) < 1024 or struct.unpack_from("<I", head)[0] != _SEQ_MAGIC:
        raise FrameError(f"{path} is not a sequence of StreamPix")
    (version,) = struct.unpack_from("<i", head, 28)
    width, height, depth, _, size, kind, count, _, stride = struct.unpack_from("<9I", head, 548)
    (rate,) = struct.unpack_from("<d", head, 584)
    shape = checked_shape(path, width, height)
    if kind not in _SEQ_GREY or depth not in (8, 16):
        raise FrameError(
            f"{path} holds images of kind {kind} with {depth} bits: export them uncompressed, in grey"
        )
    take, each = pixels(shape, depth)
    if size != each or stride < each:
        raise FrameError(f"{path} holds compressed images, or its header is damaged: export it uncompressed")
    begin = 8192 if version >= 5 else 1024
    starts = range(begin, begin + count * stride, stride)
    complete = complete_images(path, starts, each)

    def times() -> Times:
        stamp = struct.Struct("<IHH" if version >= 5 else "<IH")
        out = np.empty(complete)
        with path.open("rb") as stream:
            for index in range(complete):
                stream.seek(starts[index] + each)
                seconds, *parts = stamp.unpack(stream.read(stamp.size).ljust(stamp.size, b"\0"))
                out[index] = seconds + sum(part / 1e3 ** (k + 1) for k, part in enumerate(parts))
        return out

    stamps = times if stride >= each + 8 else None
    return RawRecording(path, complete, shape, starts, take, rate if 0 < rate < 1e7 else None, stamps=stamps)


# -- DaVis of LaVision: a `.set` file, and `.im7` buffers in the folder of the same name


class _DavisSet(Recording):
    """A DaVis set as a `Recording`: from each of its .im7 files, the image with the index `frame`, from 0."""

    def __init__(self, path: Path, buffers: list[Path], frame: int) -> None:
        self.path, self._buffers, self._frame = path, buffers, frame
        first = read_buffer(buffers[0], frame)
        self.count, self.shape = len(buffers), (first.shape[0], first.shape[1])

    def _read(self, index: int) -> Pixels:
        return read_buffer(self._buffers[index], self._frame)


def open_davis(path: Path) -> Recording:
    """Open a DaVis set, ``run.set``, or ``run.set/1`` for the second image of each buffer (.im7 file)."""
    name = path if path.suffix.lower() == ".set" else path.parent
    folder = name.with_suffix("")
    buffers = _buffers_in_order(list(folder.glob("*.im7")))
    if not buffers:
        raise FrameError(f"{name} has no .im7 in the folder {folder.name} next to it: copy both")
    count = count_frames(buffers[0])
    if path == name and count > 1:
        raise FrameError(f"{name} has {count} images in each buffer: name one, as {name.name}/0")
    inside = "0" if path == name else path.name
    if not inside.isdecimal() or int(inside) >= count:
        raise FrameError(f"{name} has images 0 to {count - 1} in each buffer, none called {inside!r}")
    return _DavisSet(path, buffers, int(inside))


def _buffers_in_order(buffers: list[Path]) -> list[Path]:
    """Return the paths of .im7 files sorted by the number at the end of their names, or else by name.
    For a missing number, the path that its file should have is inserted, so that reading it fails."""
    ends = [re.search(r"(?<!\d)\d{1,6}$", path.stem) for path in buffers]
    numbered = {int(end[0]): path for end, path in zip(ends, buffers) if end}
    if not buffers or len(numbered) < len(buffers):
        return sorted(buffers)
    first, last = min(numbered), max(numbered)
    stem, folder = numbered[first].stem.rstrip("0123456789"), buffers[0].parent
    width = len(numbered[first].stem) - len(stem)
    return [numbered.get(n, folder / f"{stem}{n:0{width}d}.im7") for n in range(first, last + 1)]
