"""Open a cube's store so that damaged and missing files raise errors instead of reading as missing values."""

import json
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

import numpy as np
import zarr
from zarr.storage import LocalStore

from wavefield.atomic_write import MARK_ATTRIBUTE
from wavefield.errors import StoreError
from wavefield.store.layout import (
    CHUNKED,
    FINISHED,
    CubeGroup,
    StoreLayout,
    chunk_path,
    named_damage,
    read_metadata,
)
from wavefield.text import one_line


class CubeStore(LocalStore):
    """The store from which Zarr reads the files of a cube; reading a file that was lost raises StoreError.
    Zarr alone would return missing values. A file whose steps are still to be measured may be absent."""

    async def get(self, key: str, *arguments: Any, **keywords: Any) -> Any:
        """Return the content of the file `key`, or a part of it (interface of Zarr stores)."""
        found = await super().get(key, *arguments, **keywords)
        return found if found is not None and len(found) else self._refuse_absent(key)

    def get_sync(self, key: str, **keywords: Any) -> Any:
        """Return the content of the file `key`, or a part of it (interface of Zarr stores)."""
        found = super().get_sync(key, **keywords)
        return found if found is not None and len(found) else self._refuse_absent(key)

    async def get_partial_values(self, prototype: Any, key_ranges: Iterable[Any]) -> Any:
        """Return the contents of parts of files (interface of Zarr stores)."""
        return [await self.get(key, prototype, part) for key, part in key_ranges]

    def _refuse_absent(self, key: str) -> None:
        """Raise StoreError if the cube should contain the absent file `key`, a path in the store."""
        name, _, place = key.partition("/c/")
        if not place:
            return  # not a chunk
        if not (self.root / "zarr.json").exists():
            raise StoreError(f"{self.root} no longer exists; open the cube again from its new place")
        if _is_expected(self.root, name, place):
            raise StoreError(
                f"{self.root / key} is missing or empty, although it was written; copy the cube again, or "
                f"measure these steps again with `wavefield verify {self.root}` and `wavefield run`"
            )


def _is_expected(root: Path, name: str, place: str) -> bool:
    """Whether the cube `root` should contain the file `place`, such as "3/0/0", of the array `name`.
    Before the run ends, only the files of the axes and of measured chunks are certain to exist."""
    attributes = read_metadata(root)["attributes"]
    if name not in CHUNKED or attributes.get(FINISHED):
        return True
    # chunk 3 is "3/0/0" in z, and "0/3" in frame_fault
    number = int(place.split("/")[1 if name == "frame_fault" else 0])
    return name != "frame_status" and is_started(root, number)


def is_started(path: Path, number: int) -> bool:
    """Whether a run tried any step of the chunk `number`, from 0, of a cube; failed steps count as tried."""
    # the last four bytes of its file are a checksum
    with suppress(OSError):
        return any(chunk_path(path, "frame_status", number).read_bytes()[:-4])
    return False


def find_store(path: str | Path) -> Path:
    """Return the path of a cube: `path` itself or, if this is a folder of cubes, the only cube in it.
    StoreError if the folder contains no cube or several."""
    path = Path(str(path).removeprefix("file://"))
    if not path.is_dir() or (path / "zarr.json").exists() or path.suffix == ".zarr":
        return path
    cubes = cubes_in(path)
    if len(cubes) == 1:
        return cubes[0]
    if cubes:
        raise StoreError(
            f"{path} contains {len(cubes)} cubes: name one of {', '.join(one.name for one in cubes)}"
        )
    raise StoreError(f"{path} is a folder without a cube; make one with `wavefield run`")


def cubes_in(folder: Path) -> list[Path]:
    """Return the cubes in a folder, sorted; only ``cube.zarr`` if there is a folder of this name."""
    usual = folder / "cube.zarr"
    return [usual] if usual.is_dir() else [one for one in sorted(folder.glob("*.zarr")) if is_cube(one)]


def is_cube(path: Path) -> bool:
    """Whether the store at `path` is a cube, judged by its attributes, rather than another output."""
    try:
        attributes = json.loads((path / "zarr.json").read_text(encoding="utf-8"))["attributes"]
        return "recipe" in attributes and MARK_ATTRIBUTE not in attributes
    except (OSError, ValueError, KeyError, TypeError):
        return False


def open_group(path: Path, mode: Literal["r", "r+"] = "r") -> CubeGroup:
    """Return the open Zarr group of the cube at `path`; StoreError if it is not a cube or is damaged."""
    read_metadata(path)
    try:
        group = zarr.open_group(CubeStore(path, read_only=mode == "r"), mode=mode, use_consolidated=True)
        read_layout(group)
        return group
    except StoreError:
        raise
    except Exception as error:  # libraries raise errors of many kinds on damaged bytes
        raise StoreError(f"{path} is damaged ({one_line(error)[:200]}); copy the cube again") from None


def read_array(group: CubeGroup, path: Path, name: str) -> np.ndarray:
    """Return all values of an array of the cube at `path`, as stored; StoreError if they are damaged."""
    with named_damage(path / name):
        return np.asarray(group[name][...])


def read_layout(group: Any) -> StoreLayout:
    """Return the sizes of an open cube: number of steps, steps per chunk, cameras, first frame number."""
    return StoreLayout(
        steps=group["frame_status"].shape[0],
        chunk_steps=int(group.attrs["steps_per_block"]),
        cameras=tuple(group.attrs["cameras"]),
        first_frame=int(group["frame"][0]),
    )
