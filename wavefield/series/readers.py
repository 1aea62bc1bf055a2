"""Read single frames from image files, multi-page TIFF, recordings, videos, or Zarr arrays."""

import os
from collections import OrderedDict
from pathlib import Path
from threading import Lock
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from wavefield.errors import FrameError
from wavefield.file_access import refuse_pipe
from wavefield.images import grey, read_image
from wavefield.images.tiff import ENDINGS as TIFF_ENDINGS
from wavefield.images.tiff import TiffImages
from wavefield.series.formats import Recording, open_recording, recording_path
from wavefield.series.formats.arrays import ZarrImages, is_remote

MAX_OPEN_FILES = 8  # per process; files with many frames stay open between reads

Kind = Literal["file", "images"]
_Images: TypeAlias = Recording | TiffImages  # open files or stores of many images


class FrameEntry(NamedTuple):
    """Where the image of one frame is stored: a file, and the index of the image in this file."""

    kind: Kind  # "file": a file of one image; "images": a file or store of many
    path: str  # Path or address of the file or store
    image: int = 0  # Index of the image in it, from 0

    def __str__(self) -> str:
        return f"{self.path}, image {self.image}" if self.kind == "images" else self.path


def read_entry(entry: FrameEntry) -> np.ndarray:
    """Return the grey image of one frame, (row, column); FrameError if it cannot be read."""
    if entry.kind == "file":
        return read_image(entry.path)
    # open files keep a position, which threads must not share
    refuse_pipe(entry.path, FrameError)
    with _lock:
        return grey(_kept_open(entry.path).read(entry.image))


def count_images(name: str | Path) -> tuple[Kind, int]:
    """Return ("file", 1) for a file of one image, else ("images", number of images in the file or store)."""
    refuse_pipe(name, FrameError)
    path = Path(name)
    single = recording_path(path) is None and path.suffix.lower() not in (*TIFF_ENDINGS, ".zarr")
    if single and not path.is_dir() and not is_remote(str(name)):
        if not path.is_file():
            raise FrameError(f"{path}: no such image")
        return "file", 1
    images = _open(str(name))
    images.close()
    tiff_of_one = images.count == 1 and isinstance(images, TiffImages)
    return ("file", 1) if tiff_of_one else ("images", images.count)


def _open(path: str) -> _Images:
    """Open a file or store of many images; FrameError if it is missing or damaged."""
    if is_remote(path):
        return ZarrImages(path)
    if recording_path(Path(path)) is not None:
        return open_recording(path)
    return TiffImages(path, path) if path.lower().endswith(TIFF_ENDINGS) else ZarrImages(path)


_lock = Lock()
_open_files: OrderedDict[tuple[str, int], _Images] = OrderedDict()


def close_files() -> None:
    """Close all files that this process keeps open between reads of frames."""
    with _lock:
        while _open_files:
            _open_files.popitem()[1].close()


def _kept_open(path: str) -> _Images:
    """Return the open file at a path; the eight files used last stay open for later calls."""
    try:
        key = path, os.stat(path).st_mtime_ns  # a file that was copied again is opened again
    except OSError:
        key = path, 0
    if key not in _open_files:
        _open_files[key] = _open(path)
        if len(_open_files) > MAX_OPEN_FILES:
            _open_files.popitem(last=False)[1].close()
    _open_files.move_to_end(key)
    return _open_files[key]
