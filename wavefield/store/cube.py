"""Open a cube as a lazy xarray Dataset with the accessor ``cube.wavefield``; read errors name the file."""

from pathlib import Path
from typing import Any, Literal

import numpy as np
import xarray as xr
from xarray.backends import BackendArray
from xarray.core import indexing

from wavefield.errors import StoreError
from wavefield.rig.camera import Camera
from wavefield.rig.rig import Rig
from wavefield.store.layout import CHECKSUM, FINISHED, PACKING, named_damage
from wavefield.store.read import CubeStore, find_store, open_group, read_layout
from wavefield.store.recipe import recipe_of
from wavefield.text import one_line
from wavefield.variables import CUBE_FIELDS, TABLE, Quality, annotate
from wavefield.water import stated_water

Chunks = dict[str, int] | int | Literal["auto"] | None


def open_cube(path: str | Path, chunks: Chunks = "auto") -> xr.Dataset:
    """Open a cube, lazily.

    Parameters
    ----------
    path : path
        Store written by `run`, or a folder that holds one.
    chunks : optional
        As in `xarray.open_zarr`; by default one Dask chunk for each stored chunk of steps.

    Returns
    -------
    Dataset
        The variables of `wavefield.variables`. Steps that are not yet measured are NaN, and so are steps at
        frames that the run found lost, doubled or late (``frame_status`` 4). The names of the cameras and the
        ratio of measured to true wave amplitude (``gain_z``, ...) are coordinates. Every field has as
        attributes ``path_frames`` (how velocities follow from frames) and the depth and surface tension of
        the water, if they were given, so that ``cube.w`` keeps them.
        The accessor ``cube.wavefield`` reads the recipe, the rig, the gain and the flags of `quality`.

    Raises
    ------
    StoreError
        If the store does not exist, is not a cube, or has damaged metadata. A file that is missing or damaged
        raises the same error when it is read.

    Examples
    --------
    A cube of ten steps in chunks of four.

    >>> import wavefield as wf
    >>> cube = wf.open_cube("cube.zarr")
    >>> cube.z.dims, cube.z.shape, cube.z.chunks[0]
    (('time', 'y', 'x'), (10, 3, 4), (4, 4, 2))
    """
    from wavefield.waves import accessor as waves_accessor  # noqa: F401  # registers `cube.waves`

    stored = open_stored(path, chunks)
    stored = stored.set_coords([f"gain_{name}" for name in "zuvw" if f"gain_{name}" in stored])
    cube = stored[list(dict.fromkeys((*CUBE_FIELDS, *stored.data_vars)))].assign_coords(stored.coords)
    cube = cube.assign_coords(camera=("camera", np.array(stored.attrs["cameras"]), TABLE["camera"].attrs))
    cube.encoding.pop("coordinates", None)
    for name in PACKING:
        if cube[name].dtype == "float64":  # xarray unpacks 16-bit values to float64
            cube[name] = cube[name].astype("float32")
    # attributes, because a single variable keeps them, and plots do not put them into titles
    stated = {"path_frames": int(cube["path_frames"]), **stated_water(cube.attrs)}
    for name in CUBE_FIELDS:
        cube[name].attrs |= stated
    return annotate(cube)


def open_stored(path: str | Path, chunks: Chunks = "auto") -> xr.Dataset:
    """Open all variables of a cube's store lazily, without the coordinates that `open_cube` adds."""
    path = find_store(path)
    layout = read_layout(open_group(path))
    if chunks == "auto":
        chunks = {"time": layout.chunk_steps}
    try:
        found: xr.Dataset = xr.open_zarr(CubeStore(path, read_only=True), chunks=None)
    except StoreError:
        raise
    except Exception as error:  # libraries raise errors of many kinds on damaged bytes
        raise StoreError(f"{path} is damaged ({one_line(error)[:200]}); copy the cube again") from None
    lazy = {
        name: xr.Variable(
            one.dims, indexing.LazilyIndexedArray(_NamedArray(path / str(name), one)), one.attrs, one.encoding
        )
        for name, one in found.variables.items()
        if name not in found.xindexes
    }
    out = found.assign({name: lazy[name] for name in found.data_vars})
    out = out.assign_coords({name: lazy[name] for name in lazy if name in found.coords})
    for name in (CHECKSUM, FINISHED):  # attributes of the store, not of the measurement
        out.attrs.pop(name, None)
    out.encoding["source"] = str(path)
    if chunks is None:
        return out
    changed = (path / "zarr.json").stat().st_mtime_ns
    return out.chunk(chunks, token=f"{path.absolute()} {changed}")


class _NamedArray(BackendArray):
    """A variable of a cube as a lazy array; if it cannot be read, StoreError names the path of the array."""

    def __init__(self, path: Path, variable: xr.Variable) -> None:
        self.path, self.variable = path, variable
        self.shape, self.dtype = variable.shape, variable.dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> np.ndarray:
        support = indexing.IndexingSupport.OUTER
        out: np.ndarray = indexing.explicit_indexing_adapter(key, self.shape, support, self._read)
        return out

    def _read(self, key: tuple[Any, ...]) -> np.ndarray:
        """Return the values at `key`: an integer, slice or array for each dimension."""
        with named_damage(self.path):
            return np.asarray(self.variable[key].values)


@xr.register_dataset_accessor("wavefield")
class CubeAccessor:
    """Properties of a cube, from `open_cube` or `reconstruct`, other than its fields: ``cube.wavefield``.

    Examples
    --------
    >>> quality = np.array([[[int(Quality.FILLED | Quality.MASKED), int(Quality.MEASURED)]]], np.uint16)
    >>> cube = xr.Dataset({"quality": (("time", "y", "x"), quality)})
    >>> cube.wavefield.flagged("masked").values.tolist()
    [[[True, False]]]
    """

    def __init__(self, cube: xr.Dataset) -> None:
        self._cube = cube

    def flagged(self, name: str) -> xr.DataArray:
        """Return where the variable ``quality`` has the flag `name`: a DataArray of bool, (time, y, x).
        `name` is one of its ``flag_meanings``, such as "masked"; ValueError if there is no such flag."""
        flags = {flag.name.lower(): flag for flag in Quality if flag.name}
        if name not in flags:
            raise ValueError(f"quality has no flag {name!r}; it has {', '.join(flags)}")
        found: xr.DataArray = (self._cube["quality"] & int(flags[name])) != 0
        return found.rename(name)

    @property
    def gain(self) -> xr.Dataset:
        """Gain, measured over true wave amplitude: ``gain_z``, ..., each (direction, k = wavenumber)."""
        names = [f"gain_{name}" for name in "zuvw" if f"gain_{name}" in self._cube]
        return self._cube[names].reset_coords(names)

    @property
    def recipe(self) -> dict[str, Any]:
        """All inputs of the cube (images, rig, grid, settings, ...), as in `Recipe`; empty if not stored."""
        return recipe_of(self._cube.attrs)

    @property
    def rig(self) -> Rig:
        """The calibrated cameras of the measurement; a rig without cameras if they are not stored."""
        cameras = self.recipe.get("rig", {})
        return Rig({name: Camera.from_dict(camera) for name, camera in cameras.items()})
