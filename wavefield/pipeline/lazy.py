"""The lazy cube: `reconstruct` maps the measurement over chunks of steps, one Dask task per chunk."""

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import dask
import dask.array as da
import numpy as np
import xarray as xr

from wavefield.errors import ExperimentError, RigError
from wavefield.grid import Grid
from wavefield.pipeline.chunk import Chunk, make_chunk, measure_chunk
from wavefield.pipeline.learning import both_frames, learn_from, once_per_cube, samples
from wavefield.rig import Rig
from wavefield.rig.field import common_field, pixel_size
from wavefield.rig.formats import load_rig
from wavefield.series import Frame
from wavefield.series.frames import check_content
from wavefield.variables import CUBE_FIELDS, TABLE, annotate
from wavefield.water import stated_water

if TYPE_CHECKING:
    from wavefield.measurement import GridGeometry, Model, Settings

    Known = tuple[GridGeometry, Model | None]

# Longer chunks share the cost of their five extra frames; shorter ones make single steps available earlier
STEPS_PER_TASK = 24


@dataclass(frozen=True)
class ArraySource:
    """Frames of one camera, read one by one from an xarray variable in memory or lazy (a `Source`)."""

    camera: str  # Name of the camera
    variable: xr.Variable  # (time, row, column)
    mask: xr.Variable | None = None  # (row, column) or (time, row, column): True for pixels to leave out

    def __len__(self) -> int:
        return int(self.variable.shape[0])

    def read(self, index: int) -> Frame:
        """Return the frame at an index; if its image is blank or has NaN, it has a fault and no image."""
        return check_content(np.asarray(self.variable[index].values), self.place(index))

    def place(self, index: int) -> str:
        """Return the name of a frame for messages, such as "left frame 3"."""
        return f"{self.camera} frame {index}"

    def covered(self, index: int) -> np.ndarray | None:
        """Return the mask of a frame, (row, column), True where masked; None if the frame has no mask."""
        if self.mask is None:
            return None
        mask = self.mask[index] if self.mask.ndim == 3 else self.mask
        return np.asarray(mask.values, bool)

    def window(self, start: int, stop: int) -> "ArraySource":
        """Return the frames start to stop - 1, as far as they exist, as another source."""
        part = slice(max(start, 0), stop)
        mask = self.mask[part] if self.mask is not None and self.mask.ndim == 3 else self.mask
        return replace(self, variable=self.variable[part], mask=mask)


def reconstruct(
    frames: xr.DataTree | Mapping[str, xr.DataArray],
    rig: Rig | str | Path,
    grid: Grid | Mapping[str, Any] | None = None,
    settings: "Settings | None" = None,
    *,
    steps_per_block: int = STEPS_PER_TASK,
    record: Mapping[str, object] | None = None,
) -> xr.Dataset:
    """Turn image series into a lazy cube of elevation and velocity.

    Images are read when values are requested. The first request also learns bead widths, wave spectra and
    noise from sample steps of the whole series. A step is the interval between two consecutive frames; steps
    are computed in chunks, so a request for one step computes its whole chunk. To look at single steps,
    choose a small ``steps_per_block``.

    Parameters
    ----------
    frames : DataTree or mapping of str to DataArray
        Images (time, row, column) of each camera, by its name. The coordinate ``time``, in seconds, must be
        evenly spaced and the same for all cameras. A tree, such as
        ``xr.open_datatree("experiment.yaml", engine="wavefield")`` returns, has one group per camera with a
        variable ``image``, and may have a ``mask``, (row, column) or (time, row, column), True for pixels to
        leave out. A coordinate ``departure`` (time) tells how late each image was taken, in frame intervals.
    rig : Rig or path
        The cameras, or their file: ``rig.yaml``, or the rig file of another program (`load_rig`).
    grid : Grid or mapping, optional
        Grid points of the cube, in metres, also as a mapping such as
        ``dict(x=(-1, 1), y=(-1, 1), step=0.01)``; by default the largest rectangle that all cameras see.
    settings : wavefield.measurement.Settings, optional
        Settings of the measurement; by default those of ``Settings()``.
    steps_per_block : int
        Number of steps per chunk. The values do not depend on it.
    record : mapping, optional
        What was learned for an earlier cube, ``cube.wavefield.recipe["record"]``. With it, a part of the
        frames of that cube gives the same values as all frames. By default it is learned from ``frames``.

    Returns
    -------
    Dataset
        The cube: Dask arrays z (m), u, v, w (m/s), their standard uncertainties and further variables over
        (time, y, x). ``time`` is the time at mid-step, in seconds.

    Raises
    ------
    ExperimentError
        If a camera of the rig has no images, the times are not evenly spaced, or ``record`` was learned for
        other cameras.
    RigError
        If the rig file cannot be read, is for images of another size, or the cameras see no common area.

    Examples
    --------
    The images are black; they are not read, because no values are requested.

    >>> from wavefield.tank import Scene
    >>> rig = Scene.load("demo").build_rig()
    >>> times = {"time": np.arange(5) / 20}
    >>> images = {n: da.zeros((5, *rig[n].size[::-1]), np.uint8, chunks=(1, -1, -1)) for n in rig}
    >>> frames = {n: xr.DataArray(one, times, ("time", "row", "column")) for n, one in images.items()}
    >>> cube = reconstruct(frames, rig, Grid(x=(-0.5, 0.5), y=(-0.4, 0.4), step=0.02))
    >>> cube.z.dims, cube.z.shape
    (('time', 'y', 'x'), (4, 41, 51))
    >>> round(float(cube.time[0]), 3)
    0.025
    """
    from wavefield.measurement import GridGeometry, Settings, sample_steps
    from wavefield.measurement.model import tabulated
    from wavefield.store import cube as _cube  # noqa: F401  # registers `cube.wavefield`
    from wavefield.waves import accessor as waves_accessor  # noqa: F401  # registers `cube.waves`

    settings = Settings() if settings is None else settings
    arrays, masks = _images(frames)
    attributes = {str(name): value for name, value in getattr(frames, "attrs", {}).items()}
    if not isinstance(rig, Rig):
        sizes = {name: (array.shape[-1], array.shape[-2]) for name, array in arrays.items()}
        rig = load_rig(rig, sizes, list(arrays))
    grid = _grid_of(grid, rig, settings)
    geometry = GridGeometry(rig, grid, settings)
    absent = [name for name in geometry.cameras if name not in arrays]
    if absent:
        raise ExperimentError(
            f"the frames lack {', '.join(absent)} (there are {', '.join(arrays)}); pass the whole tree, "
            "not one camera"
        )
    arrays = {name: arrays[name] for name in geometry.cameras}
    times, frame_rate = _times(arrays, rig, attributes)
    if record is not None:
        _check_record(record, geometry)

    sources = {name: ArraySource(name, array.variable, masks.get(name)) for name, array in arrays.items()}
    first = next(iter(arrays.values()))
    departures = np.asarray(first["departure"]) if "departure" in first.coords else None
    steps = len(times) - 1
    edges = [(i, min(i + steps_per_block, steps)) for i in range(0, steps, steps_per_block)]
    token = uuid.uuid4().hex
    known = dask.delayed(_Learner(geometry, frame_rate, record), pure=False, traverse=False)(
        samples(sources, sample_steps(steps)), dask_key_name=f"learn-{token}"
    )
    tasks = [
        dask.delayed(_measure, pure=False, traverse=True)(
            make_chunk(sources, *edge, departures), known, frame_rate, dask_key_name=f"measure-{token}-{k}"
        )
        for k, edge in enumerate(edges)
    ]
    measured = da.concatenate([da.from_delayed(t, (b - a,), object) for t, (a, b) in zip(tasks, edges)])
    variables = {
        name: (TABLE[name].dims, _variable(measured, name, grid.shape))
        for name in (*CUBE_FIELDS, "frame_status")
    }
    once: Any = dask.delayed(_from_record, pure=False)(known)
    table, dims = tabulated(geometry, None), TABLE["gain/gain_z"].dims  # shapes and axes of all gains
    shape = tuple(table[name].size for name in dims)
    gain = {n: (dims, da.from_delayed(once[n], shape, np.float64)) for n in table if n not in dims}
    level = da.from_delayed(once["z_level_std"], (), np.float64)
    coords = {"time": 0.5 * (times[:-1] + times[1:]), "y": grid.y_nodes, "x": grid.x_nodes}
    coords |= {name: table[name] for name in dims}
    coords["path_frames"] = da.from_delayed(once["path_frames"], (), np.uint8)
    out = xr.Dataset(variables | gain | {"z_level_std": ((), level)}, coords=coords)
    used = replace(rig, cameras={name: rig[name] for name in geometry.cameras})
    out.attrs = {"frame_rate": frame_rate, "pixel_size": pixel_size(used, grid)} | {
        name: attributes[name]
        for name in ("experiment", "water_depth", "surface_tension_over_density")
        if name in attributes
    }
    out = out.set_coords(list(gain)).assign_coords(stated_water(out.attrs))
    return annotate(out, "gain")


def _grid_of(given: Grid | Mapping[str, Any] | None, rig: Rig, settings: "Settings") -> Grid:
    """Return ``given`` as a Grid; for None, the largest rectangle that all cameras see."""
    if given is None:
        half_sheet = settings.sheet_thickness and 0.5 * settings.sheet_thickness
        return common_field(rig.cameras.values(), height=settings.z_range or half_sheet)
    if isinstance(given, Grid):
        return given
    try:
        return Grid(**given)
    except (TypeError, IndexError) as error:
        raise ExperimentError(
            f"grid: give x and y (first and last node) and step in metres, not {dict(given)!r}"
        ) from error


def _measure(chunk: Chunk, known: "Known", frame_rate: float) -> np.ndarray:
    """Measure a chunk of n steps, and return an object array (n,) whose first element is a dict of results.
    The dict has all variables by name, (n, ny, nx) or (n,); the other elements are None. ``known`` holds the
    geometry and the estimator."""
    geometry, model = known
    measured = measure_chunk(chunk, geometry, frame_rate, model)
    out = np.empty(chunk.steps, object)
    out[0] = {**measured.fields, "frame_status": measured.frame_status}
    return out


def _variable(measured: da.Array, name: str, shape: tuple[int, int]) -> da.Array:
    """Return the variable ``name`` of the cube as a lazy array; ``shape`` is (ny, nx).
    ``measured`` (steps,) holds the results of `_measure`, one chunk of steps after the other."""
    row = TABLE[name]
    nodes = shape if len(row.dims) == 3 else ()
    out: da.Array = da.map_blocks(
        lambda block: block[0][name],
        measured,
        chunks=(measured.chunks[0], *((n,) for n in nodes)),
        new_axis=list(range(1, 1 + len(nodes))),
        meta=np.empty((0,) * (1 + len(nodes)), row.dtype),
        name=f"{name}-{measured.name}",
    )
    return out


def _check_record(record: Mapping[str, object], geometry: "GridGeometry") -> None:
    """Raise ExperimentError if ``record``, learned for an earlier cube, lacks a camera of ``geometry``."""
    for part, cameras in (("beads", geometry.cameras), ("displacement", geometry.velocity_cameras)):
        learned = record.get(part)
        absent = [name for name in cameras if not isinstance(learned, Mapping) or name not in learned]
        if absent:
            raise ExperimentError(
                f"the record was learned without {', '.join(absent)}: give the record of a cube of these "
                "cameras and settings, or leave `record` out"
            )


@dataclass
class _Learner:
    """A callable that takes sample steps (`samples`), and returns the geometry and the estimator of the cube.
    At the first call it learns search ranges, bead widths, spectra and noise; later calls return the same."""

    geometry: "GridGeometry"
    frame_rate: float
    record: Mapping[str, object] | None  # What was learned for an earlier cube; None to learn it now
    known: "Known | None" = None  # The geometry, and the model or None if nothing could be learned

    def __call__(self, pairs: Sequence[Mapping[str, Any]]) -> "Known":
        from wavefield.measurement import Model
        from wavefield.measurement.model import LearnedRecord
        from wavefield.measurement.search_range import search_widened

        if self.known is None:
            geometry, learned = self.geometry, self.record
            if learned is None:  # otherwise the settings contain the search ranges of the earlier cube
                geometry = search_widened(map(both_frames, pairs), geometry)
                learned = learn_from(pairs, geometry, self.frame_rate)
            model = Model(geometry, LearnedRecord.from_dict(learned)) if learned else None
            self.known = geometry, model
        return self.known


def _from_record(known: "Known") -> dict[str, np.ndarray]:
    """Return by name the variables of the cube without time, such as the response to waves.
    ``known`` holds the geometry and the estimator."""
    geometry, model = known
    record = model.record if model else None
    frames = np.asarray(record.path_frames if record else 4, np.uint8)
    return once_per_cube(geometry, record) | {"path_frames": frames}


def _images(
    frames: xr.DataTree | Mapping[str, xr.DataArray],
) -> tuple[dict[str, xr.DataArray], dict[str, xr.Variable]]:
    """Return the images (time, row, column) by camera, and the masks by camera for cameras with a mask."""
    if isinstance(frames, xr.DataTree):
        nodes = {name: node.to_dataset() for name, node in frames.children.items()}
        images = {name: node["image"] for name, node in nodes.items() if "image" in node}
        return images, {name: node["mask"].variable for name, node in nodes.items() if "mask" in node}
    return {str(name): array for name, array in frames.items()}, {}


def _times(
    arrays: Mapping[str, xr.DataArray], rig: Rig, attributes: Mapping[str, Any]
) -> tuple[np.ndarray, float]:
    """Return the times of the frames (n,), s, and the frame rate, Hz, which ``attributes`` may contain.
    Raises an error if images of cameras have different or uneven times, or another size than in the rig."""
    name, first = next(iter(arrays.items()))
    for other, array in arrays.items():
        if array.dims[0] != "time" or array.ndim != 3:
            raise ExperimentError(
                f"images of {other} have dimensions {array.dims}; needed: time, row, column"
            )
        if "time" not in array.coords or not np.array_equal(array["time"], first["time"]):
            raise ExperimentError(f"{other} and {name} need the same `time` coordinate, in seconds")
        w, h = rig[other].size
        if array.shape[1:] != (h, w):
            raise RigError(
                f"the rig was made for images of {other} of {w} x {h} px, but these have "
                f"{array.shape[2]} x {array.shape[1]}"
            )
    times = np.asarray(first["time"].values, float)
    if times.size < 2:
        raise ExperimentError(f"there are {times.size} frames; a step needs two")
    intervals = np.diff(times)
    frame_rate = float(attributes.get("frame_rate") or round(1.0 / np.median(intervals), 9))
    if np.abs(intervals * frame_rate - 1.0).max() > 1e-3:
        raise ExperimentError(
            f"the times of the frames are not evenly spaced at {frame_rate:g} Hz; "
            "select them without a stride"
        )
    return times, frame_rate
