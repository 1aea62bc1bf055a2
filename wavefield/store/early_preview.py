"""Early steps: some steps of a whole record, measured before the others for `wavefield look`.

``early`` (variable, y, x, number) beside ``fields`` of ``cube_preview.zarr`` holds every so-many-th step in
16 bits, one file each. They never enter the cube, and are removed when it is complete.
"""

import os
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.codecs import BloscCodec, Crc32cCodec

from wavefield.atomic_write import writing
from wavefield.store.cube_group import CubeGroup
from wavefield.store.layout import COMPRESSION, MISSING, PACKING
from wavefield.store.preview import Thinning, open_preview, preview_path, thin_chunk, thinning

_SPACING_M = 0.02  # of the nodes, at most, unless the cube's own are farther apart
_EVERY = "early_every"  # attribute of the preview: every so-many-th step from the first


def early_thinning(group: CubeGroup) -> Thinning:
    """How early steps are thinned: about every 2 cm, all nodes of the preview among them."""
    thin, x = thinning(group), np.asarray(group["x"][:])
    spacing = float(np.ptp(x)) / max(x.size - 1, 1)
    fits = [d for d in range(1, thin.every + 1) if thin.every % d == 0 and d * spacing <= 1.001 * _SPACING_M]
    return replace(thin, every=max(fits, default=1))


def create_early(cube: Path, preview: CubeGroup, group: CubeGroup, every: int) -> None:
    """Make room in a preview for every so-many-th step of its cube."""
    steps, ny, nx = group["z"].shape
    thin = early_thinning(group)
    shape = len(thin.names), -(-ny // thin.every), -(-nx // thin.every)
    with writing(preview_path(cube)):
        zarr.create_array(
            preview_path(cube),
            name="early",
            shape=(*shape, -(-steps // every)),
            chunks=(*shape, 1),
            dtype="int16",
            fill_value=MISSING,
            compressors=[BloscCodec(**COMPRESSION, shuffle="shuffle"), Crc32cCodec()],
            dimension_names=("variable", "y", "x", "number"),
            overwrite=True,
        )
        preview.attrs[_EVERY] = every  # last: without it, there are none


def early_every(preview: CubeGroup | None) -> int:
    """Every how many steps an early one is; 0 without any."""
    return int(preview.attrs.get(_EVERY, 0)) if preview is not None and "early" in preview else 0


def write_early(cube: Path, group: CubeGroup, step: int, fields: Mapping[str, NDArray[Any]]) -> None:
    """Write one early step, fields (1, ny, nx), where the preview has room for it."""
    preview = open_preview(cube, group, "r+")
    every = early_every(preview)
    if preview is not None and every:
        thin = early_thinning(group)
        thin = replace(thin, scales=tuple(PACKING.get(name, 1.0) for name in thin.names))
        with writing(preview_path(cube)):
            preview["early"][..., step // every] = thin_chunk(fields, thin)[..., 0]


def early_steps(cube: Path, preview: CubeGroup | None) -> list[int]:
    """The early steps that are there."""
    every = early_every(preview)
    try:
        names = os.listdir(preview_path(cube) / "early/c/0/0/0") if every else []
    except FileNotFoundError:  # none yet
        names = []
    return sorted(every * int(name) for name in names if name.isdigit())


def read_early(preview: CubeGroup, step: int) -> NDArray[np.int16] | None:
    """An early step as it is stored, (variable, y, x); None where it is damaged or was removed."""
    try:
        return np.asarray(preview["early"][..., step // early_every(preview)])
    except Exception:  # whatever a library makes of damaged bytes: the run measures all of it
        return None


def drop_early(cube: Path, group: CubeGroup) -> None:
    """Remove the early steps of a complete cube."""
    preview = open_preview(cube, group, "r+")
    if preview is not None and _EVERY in preview.attrs:
        del preview.attrs[_EVERY]
        shutil.rmtree(preview_path(cube) / "early", ignore_errors=True)
