"""Cubes that no run wrote, in the form of a run's store: Datasets of `wavefield.cube`, cropped, filtered."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import xarray as xr

from wavefield.errors import CubeError, StoreError
from wavefield.store.layout import StoreLayout, create_store
from wavefield.store.read import open_cube
from wavefield.store.recipe import Recipe
from wavefield.store.write_cube import write_chunk
from wavefield.variables import CUBE_FIELDS, TABLE, FrameStatus, Quality, validate
from wavefield.waves.estimation.wave_record import check_axes
from wavefield.waves.estimation.welch import frames_of

FIELDS = ("z", "z_t", "u", "v", "w")
CHUNK_STEPS = 64


@contextmanager
def stored_cube(cube: str | Path | xr.Dataset) -> Iterator[Path]:
    """The store of a cube; for one that no run wrote, a store of its fields as long as it is used."""
    path, dataset = store_or_fields(cube)
    if dataset is None:
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="wavefield-") as folder:
        store = Path(folder) / f"{path.stem or 'cube'}.zarr"
        store_fields(dataset, store)
        yield store


def store_or_fields(cube: str | Path | xr.Dataset) -> tuple[Path, xr.Dataset | None]:
    """Where a cube comes from, and its fields if that is no store of a run that holds them as they are."""
    if isinstance(cube, xr.Dataset):
        source = Path(str(cube.encoding.get("source", "")))
        return source, None if _is_run(source) and _as_stored(cube, source) else cube
    path = Path(str(cube).removeprefix("file://"))
    if _is_run(path) or not (path / "zarr.json").is_file() | (path / ".zgroup").is_file():
        return path, None  # whatever is wrong with it is reported when it is opened
    try:
        return path, xr.open_zarr(path, consolidated=False)
    except Exception as error:  # of any library that reads a damaged or foreign store
        raise StoreError(f"{path} cannot be read as a cube: {error}") from None


def _is_run(path: Path) -> bool:
    """Whether a folder is the store of a run, however damaged."""
    return (path / "frame_status").is_dir() and (path / "checksum").is_dir()


def _as_stored(cube: xr.Dataset, path: Path) -> bool:
    """Whether the fields of a Dataset are those of a store, unchanged: the same lazy arrays."""
    own = open_cube(path)
    arrays = [(cube[name], own[name]) for name in FIELDS if name in cube]
    return len(arrays) == len(FIELDS) and all(
        one.chunks is not None and one.data.name == other.data.name for one, other in arrays
    )


def store_fields(cube: xr.Dataset, path: Path) -> None:
    """Write z, z_t, u, v, w of a Dataset in the form of a run's store; what it lacks besides is NaN."""
    missing = [name for name in FIELDS if name not in cube]
    if missing:
        raise CubeError(f"the cube has no {', '.join(missing)}: pages of a cube need {', '.join(FIELDS)}")
    more = [n for n in CUBE_FIELDS if n in cube and n != "quality" and n not in FIELDS]
    fields = validate(cube, *FIELDS, *more)
    dt, _, dx = check_axes(fields)
    steps, ny, nx = (fields.sizes[name] for name in ("time", "y", "x"))
    y, x = fields["y"].values, fields["x"].values
    first = max(round(float(fields["time"][0]) / dt - 0.5), 0)
    layout = StoreLayout(steps, min(CHUNK_STEPS, steps), (), first)
    grid = {"x": (float(x[0]), float(x[-1])), "y": (float(y[0]), float(y[-1])), "step": dx}
    name = str(cube.attrs.get("experiment", "")) or "cube"
    recipe = Recipe(
        name, {}, (first, first + steps), 1 / dt, grid, {}, {}, record={"path_frames": frames_of(cube)}
    )
    kept = ("water_depth", "surface_tension_over_density", "velocity", "description", "pixel_size")
    create_store(path, recipe, x, y, layout, {n: cube.attrs[n] for n in kept if n in cube.attrs})
    absent = np.full((layout.chunk_steps, ny, nx), np.nan, np.float32)
    for start, stop in layout.chunks():
        part = fields.isel(time=slice(start, stop)).compute()
        values = {
            n: part[n].values.astype(np.float32) if n in part else absent[: stop - start] for n in CUBE_FIELDS
        }
        there = np.isfinite(values["z"])
        quality = np.where(there, int(Quality.MEASURED), int(Quality.OUTSIDE))
        values["quality"] = quality.astype(TABLE["quality"].dtype)
        write_chunk(path, start, values, np.full(stop - start, int(FrameStatus.DONE), np.uint8), {})
