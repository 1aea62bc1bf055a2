"""Reading one frame from a file, a multi-page TIFF, a recording, a video, Zarr, or an object store."""

import os
import re
from collections import OrderedDict
from pathlib import Path
from threading import Lock
from typing import Literal, NamedTuple, Protocol

import numpy as np

from wavefield.errors import FrameError
from wavefield.file_access import accessing
from wavefield.images import decode_image, grey, read_image
from wavefield.images.tiff import ENDINGS as TIFF_ENDINGS
from wavefield.images.tiff import TiffImages
from wavefield.series.formats import file_of, open_recording
from wavefield.series.formats.arrays import ZarrImages
from wavefield.text import one_line

MAX_OPEN_FILES = 8  # per process; files with many frames stay open between reads
_ADDRESS = re.compile(r"[a-z][a-z0-9+.-]+://")

Kind = Literal["file", "images", "remote"]


class _Images(Protocol):
    """A file or store of many images."""

    count: int

    def read(self, index: int) -> np.ndarray: ...
    def close(self) -> None: ...


class FrameEntry(NamedTuple):
    """File and number of one frame."""

    kind: Kind  # "images": of a file or store with many
    path: str
    image: int = 0

    def __str__(self) -> str:
        path = without_password(self.path)
        return f"{path}, image {self.image}" if self.kind == "images" else path


def read_entry(entry: FrameEntry) -> np.ndarray:
    """Read one frame, (row, column)."""
    if entry.kind == "file":
        return read_image(entry.path)
    if entry.kind == "remote":
        return _read_remote(entry.path)
    with accessing(entry.path, FrameError), _lock:  # open files keep a position, which threads must not share
        return grey(_kept_open(entry.path).read(entry.image))


def count_images(name: str | Path) -> tuple[Kind, int]:
    """Kind and number of images of a single file or store."""
    if is_remote(str(name)) and not str(name).endswith(".zarr"):
        return "remote", 1
    with accessing(name, FrameError):
        path = Path(name)
        single = file_of(path) is None and path.suffix.lower() not in (*TIFF_ENDINGS, ".zarr")
        if single and not path.is_dir():
            if not path.is_file():
                raise FrameError(f"{path}: no such image")
            return "file", 1
        images = _open(str(name))
        images.close()
        tiff_of_one = images.count == 1 and isinstance(images, TiffImages)
        return ("file", 1) if tiff_of_one else ("images", images.count)


def _open(path: str) -> _Images:
    """Open a file or store of many images."""
    if file_of(Path(path)) is not None and not is_remote(path):
        return open_recording(path)
    if path.lower().endswith(TIFF_ENDINGS):
        return TiffImages(path, path)
    return ZarrImages(path)


_lock = Lock()
_open_files: OrderedDict[tuple[str, int], _Images] = OrderedDict()


def close_files() -> None:
    """Close all files that stay open for further reading."""
    with _lock:
        while _open_files:
            _open_files.popitem()[1].close()


def _kept_open(path: str) -> _Images:
    """The open file of a path; the one that was not used for the longest time is closed."""
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


# -- object stores (s3, gs, https ...), reached through fsspec; nothing is copied to this machine ------------


def is_remote(name: str) -> bool:
    """Whether a name is an address rather than a path.

    Examples
    --------
    >>> is_remote("s3://bucket/cam1.zarr"), is_remote("C://images/cam1"), is_remote("cam1/img_0.tif")
    (True, False, False)
    """
    return bool(_ADDRESS.match(name))


def without_password(address: str) -> str:
    """An address without what gives access to it: user and password before the host, the query after it.

    Examples
    --------
    >>> without_password("https://me:secret@host/cam1/{frame}.tif?token=abc")
    'https://host/cam1/{frame}.tif'
    """
    if not is_remote(address):
        return address
    return re.sub(r"(://)[^/@]*@", r"\1", re.sub(r"\?[^/]*=.*$", "", address))


def list_remote(folder: str) -> list[str]:
    """Names of the files in a folder of an object store, in one listing."""
    from fsspec.core import url_to_fs

    try:
        files, inside = url_to_fs(folder)
        listed = files.ls(inside, detail=False)
    except Exception as error:  # each kind of store has errors of its own
        raise FrameError(_unreachable(folder, error)) from None
    return [str(name).rstrip("/").rsplit("/", 1)[-1] for name in listed]


def _read_remote(address: str) -> np.ndarray:
    """Read one image, (row, column), from an object store."""
    from fsspec.core import url_to_fs

    try:
        files, inside = url_to_fs(address)
        data: bytes = files.cat_file(inside)
    except Exception as error:
        raise FrameError(_unreachable(address, error)) from None
    return decode_image(data, without_password(address))


def _unreachable(address: str, error: Exception) -> str:
    shown = without_password(address)
    if isinstance(error, FileNotFoundError):
        return f"{shown}: there is nothing"
    words = one_line(error).rstrip(".").replace(address, shown)
    for secret in re.findall(r"://([^/@]*)@", address) + re.findall(r"\?([^/]*=.*)$", address):
        words = words.replace(secret, "...")
    return f"{shown} cannot be reached ({type(error).__name__}: {words})"
