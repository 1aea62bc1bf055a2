"""The thinned preview of a cube: every fourth node in 16 bits, long in time, written as the run goes.

The group ``preview`` in a cube's store holds one array ``fields`` (variable, y, x, time), one chunk per chunk
of steps, so that no two chunks touch the same file; its ledger ``done`` (time) is written last. It can be
removed at any time: `read_thinned` thins the cube itself, and `wavefield look` writes it again.
"""

import math
import shutil
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.codecs import BloscCodec, Crc32cCodec

from wavefield.atomic_write import writing
from wavefield.errors import StoreError
from wavefield.store.layout import COMPRESSION, MISSING, PACKING, CubeGroup, StoreLayout, in_16_bits
from wavefield.store.read import measured_rate, read_layout
from wavefield.text import one_line
from wavefield.variables import CUBE_FIELDS, TABLE

_NODES = 2000  # of a preview: every fourth of 150 x 200, either way
_VALUES = 32_000_000  # of one variable: 64 MB; longer records are thinned more


@dataclass(frozen=True)
class Thinning:
    """Which part of a cube a preview holds."""

    every: int  # Every so-many-th node along x and y, from the first
    names: tuple[str, ...]  # Variables, in order
    scales: tuple[float, ...]  # Value = scale * stored, in the variable's unit


def preview_path(cube: str | Path) -> Path:
    """Path of the preview of a cube."""
    return Path(cube) / "preview"


def thinning(group: CubeGroup) -> Thinning:
    """How a cube is thinned: every fourth node of an usual one, all of a small one."""
    names = tuple(name for name in CUBE_FIELDS if name in group)
    steps, ny, nx = group[names[0]].shape
    most = min(_NODES, max(1, _VALUES // max(steps, 1)))
    rate = float(group.attrs["frame_rate"]) / measured_rate(group)  # a corrected clock leaves what is stored
    scales = tuple(PACKING.get(name, 1.0) * (rate if TABLE[name].units == "m s-1" else 1.0) for name in names)
    return Thinning(math.ceil(math.sqrt(ny * nx / most)), names, scales)


def create_preview(cube: Path, group: CubeGroup) -> None:
    """Make an empty preview of a cube, in place of an old one."""
    path, layout, thin = preview_path(cube), read_layout(group), thinning(group)
    shape = _shape(group, thin)
    attributes: dict[str, Any] = {
        "every": thin.every,
        "variables": list(thin.names),
        "scales": list(thin.scales),
        "missing": MISSING,
    }
    with writing(path):
        shutil.rmtree(path, ignore_errors=True)
        preview = zarr.open_group(path, mode="w", zarr_format=3, attributes=attributes)
        preview.create_array(
            "fields",
            shape=(len(thin.names), *shape, layout.steps),
            chunks=(len(thin.names), *shape, layout.chunk_steps),
            dtype="int16",
            fill_value=MISSING,
            compressors=(BloscCodec(**COMPRESSION, shuffle="shuffle"), Crc32cCodec()),
            dimension_names=("variable", "y", "x", "time"),
        )
        preview.create_array(
            "done",
            shape=(layout.steps,),
            chunks=(layout.chunk_steps,),
            dtype="uint8",
            fill_value=0,
            compressors=Crc32cCodec(),
            dimension_names=("time",),
        )


def _shape(group: CubeGroup, thin: Thinning) -> tuple[int, int]:
    _, ny, nx = group[thin.names[0]].shape
    return -(-ny // thin.every), -(-nx // thin.every)


def open_preview(cube: Path, group: CubeGroup, mode: Literal["r", "r+"] = "r") -> CubeGroup | None:
    """The preview of a cube; None where there is none that can be used."""
    try:
        preview = zarr.open_group(preview_path(cube), mode=mode, use_consolidated=False)
        thin = thinning(group)
        fits = preview.attrs.get("variables") == list(thin.names) and preview.attrs.get("every") == thin.every
        return preview if fits else None
    except Exception:  # absent or damaged: the cube has it all
        return None


def thin_chunk(fields: Mapping[str, NDArray[Any]], thin: Thinning) -> NDArray[np.int16]:
    """Every so-many-th node of a chunk, fields (n, ny, nx), in 16 bits: round(value / scale),
    (variable, y, x, n).
    """
    out = [
        in_16_bits(np.asarray(fields[name])[:, :: thin.every, :: thin.every].astype(np.float32), scale)
        for name, scale in zip(thin.names, thin.scales)
    ]
    return np.ascontiguousarray(np.moveaxis(np.array(out), 1, -1))


def write_preview(cube: Path, group: CubeGroup, start: int, fields: Mapping[str, NDArray[Any]]) -> None:
    """Write one chunk, fields (n, ny, nx), of the preview, if the cube has one."""
    preview = open_preview(cube, group, "r+")
    if preview is not None:
        thin = thinning(group)
        thin = replace(thin, scales=tuple(PACKING.get(name, 1.0) for name in thin.names))
        store_thinned(cube, preview, start, thin_chunk(fields, thin))


def store_thinned(cube: Path, preview: CubeGroup, start: int, thinned: NDArray[np.int16]) -> None:
    """Put a thinned chunk (variable, y, x, n) into the preview, its ledger last."""
    stop = start + thinned.shape[-1]
    with writing(preview_path(cube)):
        preview["fields"][..., start:stop] = thinned
        preview["done"][start:stop] = np.uint8(1)


def stored_thinned(preview: CubeGroup, start: int, stop: int) -> NDArray[np.int16] | None:
    """A chunk as the preview holds it, (variable, y, x, n); None where it is damaged."""
    with suppress(Exception):  # whatever a codec makes of damaged bytes: the cube has it all
        return np.ascontiguousarray(preview["fields"][..., start:stop])
    return None


def chunks_stored(preview: CubeGroup | None, layout: StoreLayout) -> NDArray[np.bool_]:
    """Which chunks the preview's ledger calls done; none without it, and where it cannot be read."""
    with suppress(Exception):  # as above
        if preview is not None:
            return chunks_done(np.asarray(preview["done"][:]), layout)
    return np.zeros(len(layout.chunks()), bool)


def read_thinned(group: CubeGroup, thin: Thinning, start: int, stop: int) -> NDArray[np.int16]:
    """Thin a chunk of the cube itself to (variable, y, x, n)."""
    fields = {name: read_steps(group, name, start, stop) for name in thin.names}
    return thin_chunk(fields, thin)


def read_steps(
    group: CubeGroup,
    name: str,
    start: int,
    stop: int,
    rows: slice = slice(None),
    columns: slice = slice(None),
) -> NDArray[Any]:
    """Steps of one variable of a cube, unpacked, (n, ny, nx): float32, NaN where nothing was measured."""
    array = group[name]
    try:
        values = np.asarray(array[start:stop, rows, columns])
    except StoreError:
        raise
    except Exception as error:
        raise StoreError(
            f"{name} of steps {start} to {stop - 1} cannot be read ({one_line(error)[:200]}); "
            "`wavefield verify` finds the damaged steps, and `wavefield run` measures them again"
        ) from None
    scale = array.attrs.get("scale_factor")
    if scale is None:
        return values
    out = values.astype(np.float32) * np.float32(scale)
    if values.dtype == np.int16:
        out[values == MISSING] = np.nan
    return out


def chunks_done(ledger: NDArray[Any], layout: StoreLayout) -> NDArray[np.bool_]:
    """Which chunks have no step left.

    With ledger (steps,); returns (chunks,).

    Examples
    --------
    >>> chunks_done(np.array([1, 1, 1, 0], np.uint8), StoreLayout(4, 2, (), 0)).tolist()
    [True, False]
    """
    return np.array([bool(ledger[a:b].all()) for a, b in layout.chunks()])
