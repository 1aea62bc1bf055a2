"""Reading one frame from a file, a multi-page TIFF, a recording, a video, Zarr, or an object store."""

import os
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol, TypeVar, cast

import cv2
import numpy as np

from wavefield.errors import FrameError
from wavefield.file_access import accessing
from wavefield.images import grey, read_image
from wavefield.images.tiff import TiffImages
from wavefield.series.formats import file_of, open_recording
from wavefield.series.remote import is_remote, read_remote

if TYPE_CHECKING:
    from wavefield.series.formats.zarr_array import ZarrImages

os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # damage in a video is reported here
VIDEO_ENDINGS = (".avi", ".mp4", ".mov", ".mkv")
MAX_OPEN_FILES = 8  # per process; files with many frames stay open between reads

Kind = Literal["file", "page", "video", "zarr", "recording", "remote"]


class _Closable(Protocol):
    def close(self) -> None: ...


Opened = TypeVar("Opened", bound=_Closable)


class FrameEntry(NamedTuple):
    """File and number of one frame."""

    kind: Kind
    path: str
    image: int = 0

    def __str__(self) -> str:
        return self.path if self.kind in ("file", "remote") else f"{self.path}, image {self.image}"


def read_entry(entry: FrameEntry) -> np.ndarray:
    """Read one frame, (row, column)."""
    if entry.kind == "file":
        return read_image(entry.path)
    if entry.kind == "remote":
        return read_remote(entry.path)
    with accessing(entry.path, FrameError), _lock:  # open files keep a position, which threads must not share
        if entry.kind == "page":
            return grey(_open(entry.path, _open_tiff).read(entry.image))
        if entry.kind == "video":
            return _open(entry.path, _Video).read(entry.image)
        if entry.kind == "recording":
            return _open(entry.path, open_recording).read(entry.image)
        return _open(entry.path, _open_array).read(entry.image)


def count_images(name: str | Path) -> tuple[Kind, int]:
    """Kind and number of images of a single file or store."""
    ending = Path(name).suffix.lower()
    if is_remote(str(name)):
        return ("zarr", _open_array(str(name)).count) if ending == ".zarr" else ("remote", 1)
    with accessing(name, FrameError):
        return _count_images(Path(name), ending)


def video_rate(path: Path) -> float | None:
    """Rate of the playback that a video states, images per second; None if it is none or states none."""
    if path.suffix.lower() not in VIDEO_ENDINGS:
        return None
    try:
        video = _Video(str(path))
    except FrameError:  # reported when the images are opened
        return None
    video.close()
    return video.rate


def _count_images(path: Path, ending: str) -> tuple[Kind, int]:
    if file_of(path) is not None:
        recording = open_recording(path)
        recording.close()
        return "recording", recording.count
    if ending in VIDEO_ENDINGS:
        return "video", _Video(str(path)).count
    if ending == ".zarr" or path.is_dir():
        return "zarr", _open_array(str(path)).count
    if ending in (".tif", ".tiff"):
        images = _open_tiff(str(path))
        images.close()
        count = images.count
        return ("page", count) if count > 1 else ("file", 1)
    if not path.is_file():
        raise FrameError(f"{path}: no such image")
    return "file", 1


_lock = Lock()
_open_files: OrderedDict[tuple[str, int], _Closable] = OrderedDict()


def close_files() -> None:
    """Close all files that stay open for further reading."""
    with _lock:
        while _open_files:
            _open_files.popitem()[1].close()


def _open(path: str, opener: Callable[[str], Opened]) -> Opened:
    """The open file of a path; the one that was not used for the longest time is closed."""
    try:
        key = path, os.stat(path).st_mtime_ns  # a file that was copied again is opened again
    except OSError:
        key = path, 0
    if key not in _open_files:
        _open_files[key] = opener(path)
        if len(_open_files) > MAX_OPEN_FILES:
            _open_files.popitem(last=False)[1].close()
    _open_files.move_to_end(key)
    return cast(Opened, _open_files[key])


def _open_tiff(path: str) -> TiffImages:
    return TiffImages(path, path)


def _open_array(path: str) -> "ZarrImages":
    from wavefield.series.formats.zarr_array import ZarrImages  # Zarr takes long to import

    return ZarrImages(path)


class _Video:
    """A video, read forwards where possible."""

    def __init__(self, path: str) -> None:
        self.path = path
        if not Path(path).is_file():
            raise FrameError(f"{path}: no such video")
        self._capture = cv2.VideoCapture(path)
        if not self._capture.isOpened():
            raise FrameError(f"{path} cannot be read as a video; convert it to PNG or TIFF frames")
        self.count = int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))
        rate = float(self._capture.get(cv2.CAP_PROP_FPS))
        self.rate = rate if 0 < rate < 1e7 else None  # of the playback, images per second
        self._next = 0

    def read(self, index: int) -> np.ndarray:
        if index != self._next:
            self._capture.set(cv2.CAP_PROP_POS_FRAMES, index)
        ok, image = self._capture.read()
        if not ok:
            self._next = -1
            raise FrameError(f"{self.path}, image {index}: cannot be decoded")
        self._next = index + 1
        return grey(image[..., ::-1] if image.ndim == 3 else image)

    def close(self) -> None:
        self._capture.release()
