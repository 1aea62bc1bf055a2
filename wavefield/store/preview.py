"""A thinned copy of a cube for fast plots: every nth node in 16 bits, written during the run.

The group ``preview`` in a cube's store has one array ``fields`` (variable, y, x, time), with one file per
chunk. It may be deleted at any time: `read_thinned` then reads the cube itself.
"""

import math
import shutil
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.codecs import BloscCodec, Crc32cCodec

from wavefield.atomic_write import writing
from wavefield.store.layout import COMPRESSION, MISSING, PACKING, CubeGroup, in_16_bits, named_damage
from wavefield.store.read import read_layout
from wavefield.variables import CUBE_FIELDS

_GROUP = "preview"
_NODES = 2000  # nodes of a preview; of 150 x 200 nodes, every fourth along x and y
_VALUES = 32_000_000  # values of one variable (64 MB); longer records are thinned more


@dataclass(frozen=True)
class Thinning:
    """Which nodes and variables of a cube its preview (a thinned copy for plots) contains."""

    every: int  # Distance between its nodes, in nodes of the cube, along x and y; 1 keeps all
    names: tuple[str, ...]  # Variables, in order
    scales: tuple[float, ...]  # Value = scale * stored, in the variable's unit
    shape: tuple[int, ...]  # (variable, y, x, time)

    @property
    def attributes(self) -> dict[str, Any]:
        """Attributes of the preview's group: the spacing of its nodes, and its variables."""
        return {"every": self.every, "variables": list(self.names)}


def thinning(group: CubeGroup) -> Thinning:
    """Return which nodes (about 2000 at most) and variables of an open cube its preview contains."""
    names = tuple(name for name in CUBE_FIELDS if name in group)
    steps, ny, nx = group[names[0]].shape
    most = min(_NODES, max(1, _VALUES // max(steps, 1)))
    every = math.ceil(math.sqrt(ny * nx / most))
    scales = tuple(PACKING.get(name, 1.0) for name in names)
    return Thinning(every, names, scales, (len(names), math.ceil(ny / every), math.ceil(nx / every), steps))


def create_preview(group: CubeGroup) -> None:
    """Make an empty preview (a thinned copy for plots) in an open cube, in place of an old preview."""
    layout, thin, path = read_layout(group), thinning(group), group.store_path.store.root / _GROUP
    with writing(path):
        shutil.rmtree(path, ignore_errors=True)
        preview = zarr.open_group(path, mode="w", zarr_format=3, attributes=thin.attributes)
        preview.create_array(
            "fields",
            shape=thin.shape,
            chunks=(*thin.shape[:-1], layout.chunk_steps),
            dtype="int16",
            fill_value=MISSING,
            compressors=(BloscCodec(**COMPRESSION, shuffle="shuffle"), Crc32cCodec()),
            dimension_names=("variable", "y", "x", "time"),
        )


def _open(group: CubeGroup, thin: Thinning, mode: Literal["r", "r+"]) -> Any:
    """Return the array ``fields`` of a cube's preview, (variable, y, x, time), open in Zarr's `mode`.
    None if it is absent or damaged, or if its variables or shape differ from `thin`."""
    with suppress(Exception):  # absent or damaged: the cube has it all
        root = group.store_path.store.root
        preview: Any = zarr.open_group(root / _GROUP, mode=mode, use_consolidated=False)
        fits = thin.attributes.items() <= dict(preview.attrs).items()
        return preview["fields"] if fits and preview["fields"].shape == thin.shape else None
    return None


def _chunk(group: CubeGroup, start: int) -> Path:
    """Return the path of the preview's file for the chunk of steps that begins with step `start`."""
    number = start // read_layout(group).chunk_steps
    return Path(group.store_path.store.root / _GROUP / f"fields/c/0/0/0/{number}")


def _thinned(fields: Mapping[str, NDArray[Any]], thin: Thinning) -> NDArray[np.int16]:
    """Return `fields`, each (n, ny, nx), at the nodes of a preview, packed as int16: (variable, y, x, n)."""
    nodes = [fields[name][:, :: thin.every, :: thin.every].astype(np.float32) for name in thin.names]
    out = [in_16_bits(values, scale) for values, scale in zip(nodes, thin.scales)]
    return np.ascontiguousarray(np.moveaxis(np.array(out), 1, -1))


def write_preview(group: CubeGroup, start: int, fields: Mapping[str, NDArray[Any]]) -> None:
    """Write the chunk that begins with step `start` into the preview of a cube; do nothing if there is none.
    `fields` has the values of each variable in the chunk, (n, ny, nx), at all nodes of the cube."""
    thin = thinning(group)
    preview = _open(group, thin, "r+")
    if preview is not None:
        _chunk(group, start).unlink(missing_ok=True)  # Zarr would first read this file, which may be damaged
        thinned = _thinned(fields, thin)
        preview[..., start : start + thinned.shape[-1]] = thinned


def read_thinned(group: CubeGroup, thin: Thinning, start: int, stop: int) -> NDArray[np.int16]:
    """Return the fields of the chunk of steps `start` to `stop` - 1 at the nodes in `thin`, packed as int16.
    The array, (variable, y, x, n), is read from the preview, or else from the cube itself."""
    preview = _open(group, thin, "r")
    with suppress(Exception):  # as above
        if _chunk(group, start).is_file():
            return np.ascontiguousarray(preview[..., start:stop])
    return _thinned({name: read_steps(group, name, start, stop) for name in thin.names}, thin)


def read_steps(group: CubeGroup, name: str, start: int, stop: int) -> NDArray[Any]:
    """Return the steps `start` to `stop` - 1 of a variable of an open cube, (n, ny, nx).
    Values stored in 16 bits are unpacked to float32. StoreError if the steps are damaged."""
    array = group[name]
    with named_damage(group.store_path.store.root / name):
        values = np.asarray(array[start:stop])
    scale = array.attrs.get("scale_factor")
    if scale is None:
        return values
    out = values.astype(np.float32) * np.float32(scale)
    if values.dtype == np.int16:
        out[values == MISSING] = np.nan
    return out
