"""The xarray engine "wavefield" for experiment files: ``xr.open_datatree(path, engine="wavefield")``.

It also opens the stores of cubes and of smoothed fields, by ``xr.open_dataset``.
"""

import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from xarray.backends import BackendArray, BackendEntrypoint
from xarray.core import indexing

from wavefield.atomic_write import has_mark, read_mark
from wavefield.errors import StoreError
from wavefield.series.clocks import frame_departures
from wavefield.series.experiment import Experiment
from wavefield.series.frames import FrameSeries
from wavefield.store.cube import open_cube
from wavefield.variables import TABLE

CHUNK_BYTES = 100_000_000  # size of a Dask chunk of images


class FrameWarning(UserWarning):
    """Warns that a missing or bad frame is replaced by zeros, or that masks are not applied to frames."""


class FrameArray(BackendArray):
    """The images of one camera as a lazy array (time, row, column); zeros and a warning for bad frames."""

    def __init__(self, series: FrameSeries) -> None:
        self.series = series
        self.shape = (len(series), *series.shape)
        self.dtype = np.dtype(series.dtype)

    def __getitem__(self, key: indexing.ExplicitIndexer) -> np.ndarray:
        support = indexing.IndexingSupport.OUTER_1VECTOR
        out: np.ndarray = indexing.explicit_indexing_adapter(key, self.shape, support, self._read)
        return out

    def _read(self, key: tuple[int | slice | np.ndarray, ...]) -> np.ndarray:
        """Return the values at `key`: an index, slice or array of indices for time, row and column."""
        time, inside = key[0], key[1:]
        if isinstance(time, int | np.integer):
            return np.asarray(self._frame(int(time))[inside])
        indices = np.arange(len(self.series))[time]
        if indices.size == 0:
            return np.zeros((0, *self.shape[1:]), self.dtype)[(slice(None), *inside)]
        return np.stack([self._frame(int(i))[inside] for i in indices])

    def _frame(self, index: int) -> np.ndarray:
        """Return the image at an index; zeros and a FrameWarning if it is missing or bad."""
        frame = self.series.read(index)
        if frame.image is not None:
            return frame.image
        warnings.warn(f"{frame.message}; zeros take its place", FrameWarning, stacklevel=2)
        return np.zeros(self.shape[1:], self.dtype)


class ExperimentBackend(BackendEntrypoint):
    """Opens the images of an experiment as a DataTree, and a cube or smoothed fields as a Dataset, lazily."""

    description = "cubes, and image series of the cameras of an experiment file"
    open_dataset_parameters = ("filename_or_obj", "drop_variables", "group")

    def guess_can_open(self, filename_or_obj: object) -> bool:
        """Whether a path leads to an experiment file, that is, to a YAML file with the key ``cameras``."""
        try:
            path = Path(str(filename_or_obj))
            return path.suffix in (".yaml", ".yml") and path.is_file() and "cameras:" in path.read_text()
        except (ValueError, OSError):
            return False

    def open_dataset(
        self,
        filename_or_obj: object,
        *,
        drop_variables: str | Iterable[str] | None = None,
        group: str | None = None,
    ) -> xr.Dataset:
        """Open a cube, smoothed fields, or the images of one camera of an experiment file (``group="cam1"``).
        StoreError if a store is damaged, or is neither a cube nor smoothed fields."""
        path = Path(str(filename_or_obj).removeprefix("file://"))
        if path.is_file():
            cameras = self.open_datatree(path)
            if group is None or group not in cameras.children:
                names = ", ".join(cameras.children)
                raise ValueError(
                    f"{path}: pass one of its cameras as group ({names}), or use xarray.open_datatree"
                )
            found = cameras[group].to_dataset()
        else:
            found = _smoothed(path) if has_mark(path) else _cube(path)
        return found.drop_vars([drop_variables] if isinstance(drop_variables, str) else drop_variables or [])

    def open_datatree(self, filename_or_obj: object, **_: Any) -> xr.DataTree:
        """Open all cameras of an experiment file as a DataTree, each with ``image(time, row, column)``.
        The groups are ``/cam1``, ``/cam2``, ...; times are in the root. ExperimentError if the file or images
        are wrong; warns if the experiment has masks, because they are not applied."""
        experiment = Experiment.load(str(filename_or_obj))
        series = experiment.open_frames()
        if experiment.mask:
            warnings.warn(
                f"{experiment.path}: what `mask` covers is not marked in frames opened like this; put it "
                "next to a camera's image as `mask`, or measure with `wavefield run`",
                FrameWarning,
                stacklevel=2,
            )
        departures = frame_departures({name: series[name] for name in experiment.measuring_cameras})
        nodes = {"/": _root(experiment, next(iter(series.values())))}
        return xr.DataTree.from_dict(nodes | {f"/{n}": _camera(s, departures) for n, s in series.items()})


def _cube(path: Path) -> xr.Dataset:
    """Return the cube at `path` as `open_cube` does, but without Dask chunks.
    If a user passes ``chunks={}`` to xarray, Dask chunks have as many steps as the chunks on disk."""
    cube = open_cube(path, None)
    for variable in cube.variables.values():
        if "time" in variable.dims:
            steps = {"time": int(cube.attrs["steps_per_block"])}
            variable.encoding["preferred_chunks"] = {**dict(zip(variable.dims, variable.shape)), **steps}
    return cube


def _smoothed(path: Path) -> xr.Dataset:
    """Return the fields that `wavefield smooth` wrote to `path`, lazily; StoreError for anything else.
    All files are checked first, because Zarr would return missing values for a file that was lost."""
    mark = read_mark(path)
    if mark is None or mark.kind != "smoothed fields":
        what = "is not as it was written: make it again" if mark is None else f"is a {mark.kind}"
        raise StoreError(f"{path} {what}; this engine opens cubes and what `wavefield smooth` wrote")
    found: xr.Dataset = xr.open_zarr(path, chunks=None)
    return found


def _camera(series: FrameSeries, departures: np.ndarray | None) -> xr.Dataset:
    """Return a Dataset of one camera: ``image`` (time, row, column), and whether it is ``present`` (time).
    `departures`, (n,), the delays of the frames in frame intervals, become a coordinate, unless None."""
    array = FrameArray(series)
    image = xr.Variable(
        ("time", "row", "column"),
        indexing.LazilyIndexedArray(array),
        TABLE["frames/image"].of(series.camera, "1"),
    )
    per_frame = int(np.prod(series.shape)) * array.dtype.itemsize
    frames = max(CHUNK_BYTES // per_frame, 1)
    image.encoding["preferred_chunks"] = {"time": frames, "row": series.shape[0], "column": series.shape[1]}
    present = np.ones(len(series), bool)
    present[series.missing - series.first] = False
    late = TABLE["frames/departure"]
    return xr.Dataset(
        {"image": image, "present": ("time", present, TABLE["frames/present"].of(series.camera, "1"))},
        {"camera": ((), series.camera, TABLE["frames/camera"].attrs)}
        | ({} if departures is None else {"departure": (late.dims, departures, late.attrs)}),
    )


def _root(experiment: Experiment, series: FrameSeries) -> xr.Dataset:
    """Return a Dataset with the coordinates ``time``, s, and ``frame`` (number), which all cameras share."""
    number = series.first + np.arange(len(series))
    return xr.Dataset(
        coords={
            "time": ("time", experiment.frame_times(series), TABLE["frames/time"].attrs),
            "frame": ("time", number, TABLE["frames/frame"].attrs),
        },
        attrs={"experiment": experiment.name, "frame_rate": experiment.frame_rate}
        | experiment.water.attributes(),
    )
