"""Images in Zarr: an array of three dimensions, time, row, column."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from zarr.codecs import BytesCodec
from zarr.storage import LocalStore

from wavefield.errors import FrameError
from wavefield.series.formats.recording import Pixels

_METADATA = ("zarr.json", ".zarray", ".zgroup", ".zmetadata")  # of a Zarr array or group


class ZarrImages:
    """An array of images; one in a file of its own without compression is read past Zarr."""

    def __init__(self, path: str) -> None:
        self.path, self._array = path, _open(path)
        self.count = int(self._array.shape[0])
        self._folder = _folder_of_plain_files(self._array)

    def read(self, index: int) -> Pixels:
        """Read one image, (row, column)."""
        image = None if self._folder is None else self._in_file_order(self._folder, index)
        try:
            return np.asarray(self._array[index]) if image is None else image
        except Exception as error:
            raise FrameError(f"{self.path}, image {index} cannot be read: {error}") from None

    def close(self) -> None:
        """Nothing stays open."""

    def _in_file_order(self, folder: Path, index: int) -> Pixels | None:
        """An image from its file; None without a file of the right size, which Zarr then reports."""
        array = self._array
        file = folder / array.metadata.encode_chunk_key((index, 0, 0))
        size = array.shape[1] * array.shape[2]
        try:
            pixels = np.fromfile(file, array.dtype)
        except OSError:
            return None
        return pixels.reshape(array.shape[1:]) if pixels.size == size else None


def _folder_of_plain_files(array: zarr.Array[Any]) -> Path | None:
    """Folder in which each image is a file of its own without compression, or None."""
    store = array.store_path.store
    if not isinstance(store, LocalStore):
        return None
    plain = (
        array.chunks == (1, *array.shape[1:])
        and array.shards is None
        and not array.compressors
        and not array.filters
        and array.order == "C"
        and array.dtype.kind in "uif"
        and array.dtype.isnative
        and (array.metadata.zarr_format == 2 or array.dtype.itemsize == 1 or _native(array.serializer))
    )
    return Path(str(store.root), array.store_path.path) if plain else None


def _native(serializer: object) -> bool:
    endian = serializer.endian if isinstance(serializer, BytesCodec) else None
    return getattr(endian, "value", endian) == sys.byteorder


def _open(path: str) -> Any:
    folder = Path(path)
    if folder.is_dir() and not any((folder / name).exists() for name in _METADATA):
        raise FrameError(f"{path} is a folder and no Zarr array; name its images, as in {path}/{{frame}}.tif")
    try:
        opened = zarr.open(path, mode="r")
    except Exception as error:
        raise FrameError(f"{path} is not a Zarr array: {error}") from None
    if isinstance(opened, zarr.Group):  # as xarray writes it
        if "image" not in opened:
            raise FrameError(f"{path} holds no array 'image'; name the array itself, as in {path}/NAME")
        opened = opened["image"]
    if isinstance(opened, zarr.Group):
        raise FrameError(f"{path} holds a group where an array should be; name the array itself")
    if len(opened.shape) != 3:
        raise FrameError(f"{path} has {len(opened.shape)} dimensions, images need three: time, row, column")
    return opened
