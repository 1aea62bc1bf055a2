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


class ZarrImages:
    """An array of images; one that lies in a file of its own, as it is, is read past Zarr."""

    def __init__(self, path: str) -> None:
        self.path, self._array = path, _open(path)
        self.count = int(self._array.shape[0])
        self._folder = _folder_of_plain_files(self._array)

    def read(self, index: int) -> Pixels:
        """Read one image.

        Returns (row, column).
        """
        image = None if self._folder is None else self._in_file_order(self._folder, index)
        try:
            return np.asarray(self._array[index]) if image is None else image
        except Exception as error:
            raise FrameError(f"{self.path}, image {index} cannot be read: {error}") from None

    def _in_file_order(self, folder: Path, index: int) -> Pixels | None:
        """None where there is no such file, or one of another size: Zarr says what that means."""
        array = self._array
        file, size = folder / array.metadata.encode_chunk_key((index, 0, 0)), array.shape[1] * array.shape[2]
        try:
            pixels = np.fromfile(file, array.dtype)
        except OSError:
            return None
        return pixels.reshape(array.shape[1:]) if pixels.size == size else None


def _folder_of_plain_files(array: Any) -> Path | None:
    """Where each image is a file of its own without any compression, or None."""
    store = array.store_path.store
    plain = (
        isinstance(store, LocalStore)
        and array.chunks == (1, *array.shape[1:])
        and array.shards is None
        and not array.compressors
        and not array.filters
        and array.order == "C"
        and array.dtype.kind in "uif"
        and array.dtype.isnative
        and (array.metadata.zarr_format == 2 or array.dtype.itemsize == 1 or _native(array.serializer))
    )
    return Path(str(store.root), array.store_path.path) if plain else None


def _native(serializer: Any) -> bool:
    endian = serializer.endian if isinstance(serializer, BytesCodec) else None
    return getattr(endian, "value", endian) == sys.byteorder


def _open(path: str) -> Any:
    try:
        found = zarr.open(path, mode="r")
    except Exception as error:
        raise FrameError(f"{path} is not a Zarr array: {error}") from None
    if isinstance(found, zarr.Group):  # as xarray writes it
        if "image" not in found:
            raise FrameError(f"{path} holds no array 'image'; name the array itself, as in {path}/NAME")
        found = found["image"]
    if isinstance(found, zarr.Group):
        raise FrameError(f"{path} holds a group where an array should be; name the array itself")
    if len(found.shape) != 3:
        raise FrameError(f"{path} has {len(found.shape)} dimensions, images need three: time, row, column")
    return found
