"""The smoothed fields of a cube, written beside it."""

import os
import warnings
from collections.abc import Callable
from pathlib import Path

import zarr

from wavefield.atomic_write import Product, atomic, check_writable
from wavefield.store.read import open_cube
from wavefield.store.recipe import source_of, state_of
from wavefield.store.store_paths import beside
from wavefield.variables import CUBE_DIMS
from wavefield.waves.smooth import smooth


def write_smoothed(
    store: Path, output: Path | None = None, progress: Callable[[int, int], None] | None = None
) -> Path:
    """Write the smoothed fields of a cube to a Zarr store, whole or not at all; returns its path."""
    output = output or beside(store, "smooth", ".zarr")
    cube = open_cube(store)
    product = Product("smoothed fields", source_of(cube))
    check_writable(output, product, inputs=[store])
    found = smooth(cube).chunk(time=cube.chunks["time"][0]).drop_encoding()
    found = found.drop_vars([name for name in found.coords if name not in CUBE_DIMS])
    found.attrs |= {"title": f"smoothed fields of {store.name}", "cube": state_of(cube)}
    steps, at_a_time = found.sizes["time"], found.chunks["time"][0] * (os.cpu_count() or 1)
    with atomic(output, product, inputs=[store]) as draft:
        for start in range(0, steps, at_a_time):
            part = found.isel(time=slice(start, start + at_a_time))
            part.to_zarr(
                draft, mode=None if start else "w", append_dim="time" if start else None, consolidated=False
            )
            if progress:
                progress(min(start + at_a_time, steps), steps)
        with warnings.catch_warnings():  # readers warn without it, zarr warns with it
            warnings.filterwarnings("ignore", message="Consolidated metadata")
            zarr.consolidate_metadata(draft)
    return output
