"""Opening a cube: no damaged or missing file of it is taken for what was measured."""

import json
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import zarr
from zarr.storage import LocalStore

from wavefield.atomic_write import MARK_ATTRIBUTE
from wavefield.errors import StoreError
from wavefield.store.layout import CHUNKED, PACKING, CubeGroup, StoreLayout, chunk_path, named_damage
from wavefield.store.metadata import CHECKSUM, FINISHED, read_metadata
from wavefield.text import one_line
from wavefield.variables import CUBE_FIELDS, TABLE, annotate
from wavefield.water import stated_water

if TYPE_CHECKING:  # not needed by workers, and slow to import
    import xarray as xr

Chunks = dict[str, int] | int | Literal["auto"] | None


class CubeStore(LocalStore):
    """The files of a cube for Zarr, which takes a missing file for missing values: here it is an error,
    unless its steps are still to be measured.
    """

    async def get(self, key: str, *arguments: Any, **keywords: Any) -> Any:
        """Read a file or a part of it, as every store of Zarr does."""
        found = await super().get(key, *arguments, **keywords)
        return found if found is not None and len(found) else self._refuse_absent(key)

    def get_sync(self, key: str, **keywords: Any) -> Any:
        """Read a file or a part of it, as every store of Zarr does."""
        found = super().get_sync(key, **keywords)
        return found if found is not None and len(found) else self._refuse_absent(key)

    async def get_partial_values(self, prototype: Any, key_ranges: Iterable[Any]) -> Any:
        """Read parts of files, as every store of Zarr does."""
        return [await self.get(key, prototype, part) for key, part in key_ranges]

    def _refuse_absent(self, key: str) -> None:
        name, _, place = key.partition("/c/")
        if not place:
            return  # no array of this name
        if not (self.root / "zarr.json").exists():
            raise StoreError(f"{self.root} is no longer there; open the cube again where it is now")
        if _is_expected(self.root, name, place):
            raise StoreError(
                f"{self.root / key} is missing or empty, although it was written; copy the cube again, or "
                f"measure these steps again with `wavefield verify {self.root}` and `wavefield run`"
            )


def _is_expected(root: Path, name: str, place: str) -> bool:
    """Whether a chunk of an array must be there: the ledger calls its steps done, or the run has ended."""
    attributes = read_metadata(root)["attributes"]
    if name not in CHUNKED or attributes.get(FINISHED):
        return True
    # "3/0/0" of "z" is chunk 3, "0/3" of "frame_fault" as well
    number = int(place.split("/")[1 if name == "frame_fault" else 0])
    return name != "frame_status" and is_started(root, number)


def is_started(path: Path, number: int) -> bool:
    """Whether the ledger calls steps of a chunk done; the last four bytes of its file are a checksum."""
    with suppress(OSError):
        return any(chunk_path(path, "frame_status", number).read_bytes()[:-4])
    return False


def find_store(path: str | Path) -> Path:
    """The store that is given, or the one cube in a folder that is given."""
    path = Path(str(path).removeprefix("file://"))
    if not path.is_dir() or (path / "zarr.json").exists() or path.suffix == ".zarr":
        return path
    cubes = cubes_in(path)
    if len(cubes) == 1:
        return cubes[0]
    if cubes:
        raise StoreError(
            f"{path} holds {len(cubes)} cubes: name one of {', '.join(one.name for one in cubes)}"
        )
    raise StoreError(f"{path} is a folder that holds no cube; make one with `wavefield run`")


def cubes_in(folder: Path) -> list[Path]:
    """The cubes in a folder; that of the usual name alone, where it is there."""
    usual = folder / "cube.zarr"
    return [usual] if usual.is_dir() else [one for one in sorted(folder.glob("*.zarr")) if is_cube(one)]


def is_cube(path: Path) -> bool:
    """Whether a store is a cube, by its attributes: waves, smoothed fields and truths are none."""
    try:
        attributes = json.loads((path / "zarr.json").read_text(encoding="utf-8"))["attributes"]
        return "recipe" in attributes and MARK_ATTRIBUTE not in attributes
    except (OSError, ValueError, KeyError, TypeError):
        return False


def open_group(path: Path, mode: Literal["r", "r+"] = "r") -> CubeGroup:
    """Open a store made by `create_store`."""
    read_metadata(path)
    try:
        group = zarr.open_group(CubeStore(path, read_only=mode == "r"), mode=mode, use_consolidated=True)
        read_layout(group)
        return group
    except StoreError:
        raise
    except Exception as error:  # whatever a library makes of damaged bytes
        raise StoreError(f"{path} is damaged ({one_line(error)[:200]}); copy the cube again") from None


def read_array(group: CubeGroup, path: Path, name: str) -> np.ndarray:
    """All values of an array, as stored; damaged bytes are a `StoreError` that names it."""
    with named_damage(path / name):
        return np.asarray(group[name][...])


def read_layout(group: Any) -> StoreLayout:
    """Sizes of an open store."""
    return StoreLayout(
        steps=group["frame_status"].shape[0],
        chunk_steps=int(group.attrs["steps_per_block"]),
        cameras=tuple(group.attrs["cameras"]),
        first_frame=int(group["frame"][0]),
    )


def open_cube(path: str | Path, chunks: Chunks = "auto") -> "xr.Dataset":
    """Open a cube, lazily.

    Parameters
    ----------
    path : path
        Store written by `run`, or a folder that holds one.
    chunks : optional
        As in `xarray.open_zarr`; by default one Dask chunk per chunk.

    Returns
    -------
    Dataset
        The variables of `wavefield.variables`, attributes with the recipe. Steps not yet measured, and those
        over frames that the run found lost, doubled or late (``frame_status`` 4), are NaN. The values are
        those that ``xarray.open_zarr(path)`` gives. The names of the cameras and the response to waves
        (``gain_z``, ...) are coordinates. Every field has ``path_frames`` and the stated depth of the water
        as attributes, so that ``cube.w`` keeps them. The recipe, the rig, the response and the flags of
        `quality` are read with ``cube.wavefield``.

    Raises
    ------
    StoreError
        If it is not there, is not a cube, or its metadata are damaged. A file that is missing or damaged
        raises the same error when it is read.

    Examples
    --------
    A cube of ten steps in chunks of four.

    >>> import wavefield as wf
    >>> cube = wf.open_cube("cube.zarr")
    >>> cube.z.dims, cube.z.shape, cube.z.chunks[0]
    (('time', 'y', 'x'), (10, 3, 4), (4, 4, 2))
    """
    from wavefield.store import accessor  # noqa: F401  # registers `cube.wavefield`
    from wavefield.waves import accessor as waves_accessor  # noqa: F401  # registers `cube.waves`

    stored = open_stored(path, chunks)
    stored = stored.reset_coords("path_frames")  # a coordinate in cubes of version 1.0
    stored = stored.set_coords([f"gain_{name}" for name in "zuvw" if f"gain_{name}" in stored])
    order = dict.fromkeys((*CUBE_FIELDS, *stored.data_vars))
    cube = stored[list(order)].assign_coords(stored.coords)
    cube = cube.assign_coords(camera=("camera", np.array(stored.attrs["cameras"]), TABLE["camera"].attrs))
    cube.encoding.pop("coordinates", None)
    for name in PACKING:
        if cube[name].dtype == "float64":  # as 16-bit values are unpacked
            cube[name] = cube[name].astype("float32")
    # a variable that is taken out of the cube keeps them, and plots do not name them in their titles
    stated = {"path_frames": int(cube["path_frames"]), **stated_water(cube.attrs)}
    for name in CUBE_FIELDS:
        cube[name].attrs |= stated
    return annotate(cube)


def open_stored(path: str | Path, chunks: Chunks = "auto") -> "xr.Dataset":
    """Open all that a cube's store holds, as it is stored; parameters and errors as of `open_cube`."""
    import xarray as xr

    from wavefield.store.lazy_variable import named_variable

    path = find_store(path)
    layout = read_layout(open_group(path))
    if chunks == "auto":
        chunks = {"time": layout.chunk_steps}
    try:
        found: xr.Dataset = xr.open_zarr(CubeStore(path, read_only=True), chunks=None)
    except StoreError:
        raise
    except Exception as error:  # whatever a library makes of damaged bytes
        raise StoreError(f"{path} is damaged ({one_line(error)[:200]}); copy the cube again") from None
    lazy = {
        name: named_variable(path / str(name), one)
        for name, one in found.variables.items()
        if name not in found.xindexes
    }
    out = found.assign({name: lazy[name] for name in found.data_vars})
    out = out.assign_coords({name: lazy[name] for name in lazy if name in found.coords})
    for name in (CHECKSUM, FINISHED):  # of the store, not of the measurement
        out.attrs.pop(name, None)
    out.encoding["source"] = str(path)
    if chunks is None:
        return out
    changed = (path / "zarr.json").stat().st_mtime_ns
    return out.chunk(chunks, token=f"{path.absolute()} {changed}")
