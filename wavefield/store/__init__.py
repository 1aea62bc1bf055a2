"""Stores of cubes and of results made from them, and exports to other formats."""

from pathlib import Path


def beside(store: Path, kind: str, ending: str) -> Path:
    """Return the default path of an output that is made from a cube: a file or store next to the cube.
    The name is the cube's with `kind` in place of "cube", or appended to it, and with `ending`:
    ``waves.zarr`` from ``cube.zarr``, ``run7_waves.zarr`` from ``run7.zarr``."""
    stem = store.name.removesuffix(".zarr")
    return store.with_name((stem.replace("cube", kind) if "cube" in stem else f"{stem}_{kind}") + ending)
