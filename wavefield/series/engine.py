"""The xarray engine: ``xr.open_datatree("experiment.yaml", engine="wavefield")``, or a cube's store."""

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

CHUNK_BYTES = 100_000_000  # read at once
MAX_CHUNK_FRAMES = 64


class FrameWarning(UserWarning):
    """A frame is missing or bad; zeros take its place."""


class FrameArray(BackendArray):
    """The images of one camera as a lazy array (time, row, column)."""

    def __init__(self, series: FrameSeries) -> None:
        self.series = series
        self.shape = (len(series), *series.shape)
        self.dtype = np.dtype(series.dtype)

    def __getitem__(self, key: indexing.ExplicitIndexer) -> np.ndarray:
        support = indexing.IndexingSupport.OUTER_1VECTOR
        out: np.ndarray = indexing.explicit_indexing_adapter(key, self.shape, support, self._read)
        return out

    def _read(self, key: tuple[int | slice | np.ndarray, ...]) -> np.ndarray:
        time, inside = key[0], key[1:]
        if isinstance(time, int | np.integer):
            return np.asarray(self._frame(int(time))[inside])
        indices = np.arange(len(self.series))[time]
        if indices.size == 0:
            return np.zeros((0, *self.shape[1:]), self.dtype)[(slice(None), *inside)]
        return np.stack([self._frame(int(i))[inside] for i in indices])

    def _frame(self, index: int) -> np.ndarray:
        frame = self.series.read(index)
        if frame.image is not None:
            return frame.image
        warnings.warn(f"{frame.message}; zeros take its place", FrameWarning, stacklevel=2)
        return np.zeros(self.shape[1:], self.dtype)


class ExperimentBackend(BackendEntrypoint):
    """Opens the images of an experiment file, or a cube, lazily."""

    description = "cubes, and image series of the cameras of an experiment file"
    open_dataset_parameters = ("filename_or_obj", "drop_variables", "group", "folder")
    supports_groups = True

    def guess_can_open(self, filename_or_obj: object) -> bool:
        """Whether this is an experiment file."""
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
        folder: str | None = None,
    ) -> xr.Dataset:
        """Open one camera (``group="cam1"``), all as variables of their names, a cube, or smoothed fields."""
        path = Path(str(filename_or_obj).removeprefix("file://"))
        if path.is_dir() or path.suffix == ".zarr":
            found = _smoothed(path) if has_mark(path) else _cube(path)
            return found.drop_vars(_listed(drop_variables))
        groups = self.open_groups_as_dict(filename_or_obj, folder=folder)
        root = groups.pop("/")
        name = (group or "").strip("/")
        if not name:
            out = xr.merge([_named(camera, path.strip("/")) for path, camera in groups.items()])
        elif f"/{name}" in groups:
            out = groups[f"/{name}"]
        else:
            cameras = ", ".join(path.strip("/") for path in groups)
            raise ValueError(f"{filename_or_obj} has no camera {name!r}; it has {cameras}")
        return out.assign_coords(root.coords).assign_attrs(root.attrs).drop_vars(_listed(drop_variables))

    def open_groups_as_dict(
        self,
        filename_or_obj: object,
        *,
        drop_variables: str | Iterable[str] | None = None,
        folder: str | None = None,
    ) -> dict[str, xr.Dataset]:
        """Open the root (time) and one group per camera."""
        experiment = Experiment.load(str(filename_or_obj), folder)
        series = experiment.open_frames()
        if experiment.mask:
            warnings.warn(
                f"{experiment.path}: what `mask` covers is not marked in frames opened like this; put it "
                "next to a camera's image as `mask`, or measure with `wavefield run`",
                FrameWarning,
                stacklevel=2,
            )
        drop = _listed(drop_variables)
        coordinates = _coordinates(experiment, next(iter(series.values())))
        groups = {"/": xr.Dataset(coords=coordinates, attrs=_attributes(experiment))}
        measuring = {name: series[name] for name in experiment.measuring_cameras}
        departures = frame_departures(measuring)
        groups |= {f"/{name}": _camera(s, departures) for name, s in series.items()}
        return {path: group.drop_vars(drop, errors="ignore") for path, group in groups.items()}

    def open_datatree(
        self,
        filename_or_obj: object,
        *,
        drop_variables: str | Iterable[str] | None = None,
        folder: str | None = None,
    ) -> xr.DataTree:
        """Open all cameras as a tree: ``/cam1``, ``/cam2``, ..., each with ``image(time, row, column)``."""
        groups = self.open_groups_as_dict(filename_or_obj, drop_variables=drop_variables, folder=folder)
        return xr.DataTree.from_dict(groups)


def _cube(path: Path) -> xr.Dataset:
    """A cube as `open_cube` gives it; ``chunks={}`` of xarray takes the chunks of the store."""
    cube = open_cube(path, None)
    for variable in cube.variables.values():
        if "time" in variable.dims:
            steps = {"time": int(cube.attrs["steps_per_block"])}
            variable.encoding["preferred_chunks"] = {**dict(zip(variable.dims, variable.shape)), **steps}
    return cube


def _smoothed(path: Path) -> xr.Dataset:
    """Smoothed fields, all as they were written: Zarr would take a lost file for missing values."""
    mark = read_mark(path)
    if mark is None or mark.kind != "smoothed fields":
        what = "is not as it was written: make it again" if mark is None else f"is a {mark.kind}"
        raise StoreError(f"{path} {what}; this engine opens cubes and what `wavefield smooth` wrote")
    found: xr.Dataset = xr.open_zarr(path, chunks=None)
    return found


def _listed(names: str | Iterable[str] | None) -> list[str]:
    return [names] if isinstance(names, str) else list(names or [])


def _named(camera: xr.Dataset, name: str) -> xr.Dataset:
    own = {part: f"{name}_{part}" for part in ("row", "column", "present")}
    return camera.drop_vars("camera").rename({"image": name} | own)


def _camera(series: FrameSeries, departures: np.ndarray | None) -> xr.Dataset:
    array = FrameArray(series)
    image = xr.Variable(
        ("time", "row", "column"),
        indexing.LazilyIndexedArray(array),
        TABLE["frames/image"].of(series.camera, "1"),
    )
    per_frame = int(np.prod(series.shape)) * array.dtype.itemsize
    frames = int(np.clip(CHUNK_BYTES // per_frame, 1, MAX_CHUNK_FRAMES))
    image.encoding["preferred_chunks"] = {"time": frames, "row": series.shape[0], "column": series.shape[1]}
    present = np.ones(len(series), bool)
    present[series.missing - series.first] = False
    late = TABLE["frames/departure"]
    return xr.Dataset(
        {"image": image, "present": ("time", present, TABLE["frames/present"].of(series.camera, "1"))},
        {"camera": ((), series.camera, TABLE["frames/camera"].attrs)}
        | ({} if departures is None else {"departure": (late.dims, departures, late.attrs)}),
    )


def _coordinates(experiment: Experiment, series: FrameSeries) -> dict[str, Any]:
    number = series.first + np.arange(len(series))
    return {
        "time": ("time", experiment.frame_times(series), TABLE["frames/time"].attrs),
        "frame": ("time", number, TABLE["frames/frame"].attrs),
    }


def _attributes(experiment: Experiment) -> dict[str, Any]:
    start = {"experiment": experiment.name, "frame_rate": experiment.frame_rate}
    return start | experiment.water.attributes()
