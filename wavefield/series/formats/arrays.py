"""Read images in HDF5, netCDF 4 and Zarr: arrays with the dimensions time, row, column."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wavefield.errors import FrameError
from wavefield.series.formats.recordings import Pixels, Recording, Times, usual_interval
from wavefield.text import one_line

if TYPE_CHECKING:
    import h5py  # 12 MB in every worker, for the few who have such images

_ENDINGS = (".h5", ".hdf5", ".nc")
_ADDRESS = re.compile(r"[a-z][a-z0-9+.-]+://")
_SECRET = re.compile(r"://[^/]*@|\?.*=")  # a user before the host, or a query after the path
SECONDS = {
    **dict.fromkeys(("s", "sec", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "microsecond", "microseconds"), 1e-6),
    **dict.fromkeys(("ns", "nanosecond", "nanoseconds"), 1e-9),
}


class _Dataset(Recording):
    """An HDF5 dataset (image, row, column) as a `Recording`; the frame rate is stored or from times."""

    def __init__(self, path: Path, file: h5py.File, data: h5py.Dataset) -> None:
        self.path, self._file, self._data = path, file, data
        self.count, self.shape = int(data.shape[0]), (int(data.shape[1]), int(data.shape[2]))
        self._times = _times(data)
        rate = data.attrs.get("frame_rate", file.attrs.get("frame_rate"))
        usual = usual_interval(self._times)
        self.rate = float(f"{1 / usual:.6g}") if usual else None
        if rate is not None:
            self.rate = float(np.ravel(rate)[0])

    def _read(self, index: int) -> Pixels:
        try:
            image = np.asarray(self._data[index])
        except (OSError, RuntimeError) as error:
            raise FrameError(f"{self.path}, image {index} cannot be read: {error}") from None
        return image.astype(image.dtype.newbyteorder("="), copy=False)

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _times(data: h5py.Dataset) -> Times:
    """Return the times of images, (count,), s; empty if the file has none with a known unit.
    They are the coordinate of the first dimension (netCDF), or else the dataset `time` of the same group."""
    scales = [scale for scale in data.dims[0].values() if scale.ndim == 1]
    in_folder = data.parent.get("time")
    for stored in (*scales, in_folder):
        units = "" if stored is None else str(np.ravel(stored.attrs.get("units", ""))[:1].astype(str)[0])
        unit = SECONDS.get(units.split(" ")[0])
        if unit is not None and stored.shape == data.shape[:1]:
            return unit * np.asarray(stored, np.float64)
    return np.empty(0)


def open_hdf5(path: Path) -> Recording:
    """Open a stack of images in HDF5: `path` is the file, or file/dataset if it holds several stacks."""
    import h5py

    name = next(part for part in (path, *path.parents) if part.suffix.lower() in _ENDINGS)
    inside = path.relative_to(name).as_posix()
    try:
        file = h5py.File(name, "r")
    except OSError as error:
        raise FrameError(f"{name} cannot be read as HDF5: {error}") from None
    try:
        return _Dataset(path, file, _chosen(file, name, "" if inside == "." else inside))
    except BaseException:
        file.close()
        raise


def _chosen(file: h5py.File, path: Path, inside: str) -> h5py.Dataset:
    """Return the dataset named `inside` of an HDF5 file, or its only stack of images if `inside` is ""."""
    import h5py

    series: list[str] = []

    def visit(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset) and item.ndim == 3 and item.dtype.kind in "uif" and item.shape[0]:
            series.append(name)

    file.visititems(visit)
    named = [name for name in series if inside in ("", name)]
    if len(named) != 1:
        what = f"images called {inside!r}" if inside else "single dataset of three dimensions"
        there = ", ".join(f"{path.name}/{name}" for name in series[:5])
        raise FrameError(
            f"{path} holds no {what} (time, row, column): name one, as {there or 'none is there'}"
        )
    return file[named[0]]


class ZarrImages(Recording):
    """The images in a Zarr array (image, row, column), or in the array ``image`` of a group.
    `path` is a path or a URL. FrameError if there is no such array."""

    def __init__(self, path: str) -> None:
        import zarr  # takes long, for the few who have such images

        try:
            opened: Any = zarr.open(path, mode="r")
        except Exception as error:
            raise FrameError(
                f"{path} is not a Zarr array ({one_line(error)}); of a folder of images name the images, as "
                f"in {path}/{{frame}}.tif"
            ) from None
        if isinstance(opened, zarr.Group):  # as xarray writes it
            opened = opened.get("image")
        if not isinstance(opened, zarr.Array):
            raise FrameError(f"{path} holds no array 'image'; name the array itself, as in {path}/NAME")
        if opened.ndim != 3:
            raise FrameError(f"{path} has {opened.ndim} dimensions, images need three: time, row, column")
        self.path, self._array = path, opened
        self.count, self.shape = int(opened.shape[0]), (int(opened.shape[1]), int(opened.shape[2]))

    def _read(self, index: int) -> Pixels:
        try:
            return np.asarray(self._array[index])
        except Exception as error:
            raise FrameError(f"{self.path}, image {index}: {one_line(error)}") from None


def is_remote(name: str) -> bool:
    """Whether a name is a URL, such as s3://..., rather than a path."""
    return bool(_ADDRESS.match(name))


def refuse_password(address: str) -> None:
    """Raise ValueError if a URL contains a password or token; the message does not repeat the URL."""
    if is_remote(address) and _SECRET.search(address):
        raise ValueError(
            "the address contains a password or token: leave it to the environment (fsspec's configuration)"
        )
