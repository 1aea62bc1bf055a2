"""Create the store of a cube: a Zarr v3 group with all arrays, empty at first and filled chunk by chunk.

Every stored chunk ends with a checksum by a codec of Zarr, so that any Zarr reader notices damage.
"""

import json
import warnings
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import zarr
from zarr.codecs import BloscCodec, Crc32cCodec

from wavefield.atomic_write import atomic, writing
from wavefield.errors import StoreError
from wavefield.store.recipe import Recipe
from wavefield.text import one_line
from wavefield.variables import CUBE_FIELDS, TABLE, Variable, find
from wavefield.water import WATER

# arrays with one file per chunk of steps; the ledger is written last
CHUNKED: tuple[str, ...] = (*CUBE_FIELDS, "frame_fault", "frame_status")

# value = scale * stored; -32768 marks missing values and values that do not fit into 16 bits
PACKING = {
    "z": 1e-5,
    "z_t": 1e-4,
    "u": 1e-4,
    "v": 1e-4,
    "w": 1e-4,
    "eps_y": 1e-5,
    "eps_piv": 1e-3,
    "z_std": 1e-6,
    "u_std": 1e-5,
    "v_std": 1e-5,
    "w_std": 1e-5,
}
MISSING = -32768
# compared with zstd: a quarter of the time for writing and reading, and 4 % larger files
COMPRESSION: dict[str, Any] = {"cname": "lz4", "clevel": 1}
INNER_CHUNK_STEPS = 8  # a reader decodes at most so many steps to get one
FILES_OF_ALL_CHUNKS = {"array.write_empty_chunks": True}  # so that a missing file has been lost

# attributes that describe the experiment and may change after the measurement
DESCRIPTION = ("experiment_file", "image_folder", "description", *WATER)

CubeGroup: TypeAlias = Any  # an open cube: `zarr.Group` types arrays and groups alike


@dataclass(frozen=True)
class StoreLayout:
    """Sizes of a cube's store: number of steps, steps per chunk, cameras; and its first frame number."""

    steps: int  # Steps of the whole run; the record has one frame more
    chunk_steps: int  # Steps per chunk (shard)
    cameras: tuple[str, ...]  # Cameras whose bad frames are recorded in `frame_fault`
    first_frame: int  # Number of the first frame

    def chunks(self) -> list[tuple[int, int]]:
        """Return the range of steps (start, stop) of each chunk, in order; `stop` is excluded."""
        return [(i, min(i + self.chunk_steps, self.steps)) for i in range(0, self.steps, self.chunk_steps)]


def title(experiment: str) -> str:
    """Return the title of a cube (attribute of the CF conventions) from the experiment's name."""
    return f"water surface and its velocity, {experiment}"


def create_store(
    path: Path,
    recipe: Recipe,
    x: np.ndarray,
    y: np.ndarray,
    layout: StoreLayout,
    attributes: Mapping[str, Any],
    once: Mapping[str, np.ndarray | np.floating] | None = None,
) -> None:
    """Make an empty cube at `path`, complete or not at all; StoreError if something is already there.
    `x` (nx,) and `y` (ny,) are the positions of the nodes, m. `attributes` are added to those from the
    `recipe` (all inputs). `once` has the values of variables known before the run, such as ``gain_z``."""
    frames = layout.first_frame + np.arange(layout.steps + 1)
    axes: dict[str, Any] = {
        "time": (frames[:-1] + 0.5) / recipe.frame_rate,
        "y": y,
        "x": x,
        "frame": frames,
        "path_frames": np.uint8(recipe.record.get("path_frames", 4)),
    }
    own: dict[str, Any] = {
        "Conventions": "CF-1.11",
        "title": title(recipe.experiment),
        "experiment": recipe.experiment,
        "frame_rate": recipe.frame_rate,
        "cameras": list(layout.cameras),
        "steps_per_block": layout.chunk_steps,
        "recipe": recipe.to_json(),
        "recipe_hash": recipe.hash,
        "wavefield_version": recipe.software.get("wavefield", ""),
    }
    with atomic(path) as draft, zarr.config.set(FILES_OF_ALL_CHUNKS):
        group = zarr.open_group(draft, mode="w", zarr_format=3, attributes={**own, **attributes})
        for name, values in axes.items():
            add_array(group, TABLE[name], values)
        _add_chunked(group, layout, (y.size, x.size), recipe.packing == "int16")
        for name, values in (once or {}).items():
            row = find(name, "gain")
            assert row is not None
            add_array(group, row, values, dtype=values.dtype, name=name, fill_value=np.nan)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # consolidated metadata, to open the store faster
            zarr.consolidate_metadata(draft)
        write_metadata(draft, json.loads((draft / "zarr.json").read_bytes()))


def _add_chunked(group: zarr.Group, layout: StoreLayout, nodes: tuple[int, int], packing: bool) -> None:
    """Add the empty fields, (time, y, x), and the status arrays of steps and frames to the group of a cube.
    `nodes` is (ny, nx). With `packing`, fields are stored in 16 bits."""
    n, steps = layout.steps, layout.chunk_steps
    inner = max(k for k in range(1, INNER_CHUNK_STEPS + 1) if steps % k == 0)
    for name in CUBE_FIELDS:
        row = TABLE[name]
        packed = packing and name in PACKING
        dtype = "int16" if packed else row.dtype
        fill: Any = MISSING if packed else np.nan if dtype == "float32" else 0
        encoding = {"scale_factor": PACKING[name], "add_offset": 0.0, "_FillValue": MISSING} if packed else {}
        add_array(
            group,
            row,
            shape=(n, *nodes),
            chunks=(inner, *nodes),
            shards=(steps, *nodes),
            dtype=dtype,
            fill_value=fill,
            compressors=(BloscCodec(**COMPRESSION, shuffle="shuffle"), Crc32cCodec()),
            attributes=row.attrs | encoding,
        )
    cameras = len(layout.cameras)
    ledger: dict[str, Any] = {
        "frame_status": {"shape": (n,), "chunks": (steps,)},
        "frame_fault": {"shape": (cameras, n + 1), "chunks": (cameras, steps)},
    }
    for name, sizes in ledger.items():  # not compressed, because `is_started` reads the bytes of the file
        add_array(group, TABLE[name], **sizes, fill_value=0, compressors=Crc32cCodec())


def add_array(
    group: zarr.Group, row: Variable, values: np.ndarray | np.generic | None = None, **options: Any
) -> None:
    """Create the array of a variable in a group: with `values` in a single chunk, or empty if None.
    Name, type, dimensions and attributes are those of `row`; `options`, keywords of Zarr, replace them."""
    how: dict[str, Any] = {
        "name": row.name,
        "dtype": row.dtype,
        "dimension_names": row.dims,
        "attributes": row.attrs,
    }
    if values is not None:
        how |= {"shape": values.shape, "chunks": values.shape, "compressors": Crc32cCodec()}
    array = group.create_array(**(how | options))
    if values is not None:
        array[...] = values


def in_16_bits(values: np.ndarray, scale: float) -> np.ndarray:
    """Return `values` / `scale`, rounded, as int16, in the shape of `values`.
    Values that are not finite, or whose quotient is beyond +-32767, become `MISSING` (-32768)."""
    with np.errstate(invalid="ignore"):
        scaled = np.rint(values / scale)
        return np.where(np.abs(scaled) <= 32767, scaled, MISSING).astype(np.int16)


_CHUNK_FILES = {"frame_fault": "c/0/{}", "frame_status": "c/{}"}  # fields have c/{}/0/0


@contextmanager
def named_damage(array: Path) -> Iterator[None]:
    """Context manager: turn an error from reading damaged bytes into a StoreError that names the array."""
    try:
        yield
    except StoreError:
        raise
    except Exception as error:
        raise StoreError(
            f"{array} is damaged ({one_line(error)[:200]}): `wavefield verify {array.parent}` finds the "
            "damaged steps, and `wavefield run` measures them again"
        ) from None


def chunk_path(path: Path, name: str, number: int) -> Path:
    """Return the path of the file with the chunk `number`, from 0, of the array `name` in the cube `path`."""
    return path / name / _CHUNK_FILES.get(name, "c/{}/0/0").format(number)


# -- metadata: zarr.json, with a checksum that shows changes and damage

CHECKSUM = "metadata_checksum"  # attribute: CRC-32 of the rest of zarr.json
FINISHED = "finished"  # attribute: true once the run has ended


def read_metadata(path: Path) -> dict[str, Any]:
    """Return the content of a cube's ``zarr.json``.
    StoreError if the file is missing, damaged, changed since wavefield wrote it, or not that of a cube."""
    file = path / "zarr.json"
    if not path.exists():
        raise StoreError(f"{path}: no such store; make one with `wavefield run`")
    if not file.exists():
        raise StoreError(
            f"{path} is not a cube, or a damaged copy: it has no zarr.json; "
            "copy the cube again, or choose another name"
        )
    try:
        data: dict[str, Any] = json.loads(file.read_bytes())
        attributes = data["attributes"]
    except Exception as error:  # damaged bytes raise errors of many kinds
        raise StoreError(f"{file} cannot be read ({one_line(error)[:200]}); copy the cube again") from None
    if not isinstance(attributes, dict) or "recipe" not in attributes:
        raise StoreError(f"{path} is not a cube of `wavefield run`; choose another name")
    if attributes.get(CHECKSUM) != _checksum(data):
        raise StoreError(f"{file} was changed since it was written, or is damaged; copy the cube again")
    return data


def update_metadata(path: Path, attributes: Mapping[str, object]) -> None:
    """Set attributes of the cube at `path`; an attribute with the value None is removed."""
    data = read_metadata(path)
    merged = {**data["attributes"], **attributes}
    data["attributes"] = {name: value for name, value in merged.items() if value is not None}
    with writing(path):
        write_metadata(path, data)


def write_metadata(path: Path, data: dict[str, Any]) -> None:
    """Write `data` as ``zarr.json``, completely or not at all, after adding a checksum to `data`."""
    data["attributes"][CHECKSUM] = _checksum(data)
    with atomic(path / "zarr.json", replace=True) as draft:
        draft.write_text(json.dumps(data, indent=1), encoding="utf-8")


def _checksum(data: Mapping[str, Any]) -> int:
    """Return the CRC-32 of the content of ``zarr.json``, without the attribute that holds a checksum."""
    attributes = {name: value for name, value in data["attributes"].items() if name != CHECKSUM}
    return zlib.crc32(json.dumps({**data, "attributes": attributes}, sort_keys=True).encode())
