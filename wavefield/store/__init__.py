"""Stores of cubes and of results made from them, and exports to other formats."""

from pathlib import Path


def beside(store: Path, kind: str, ending: str) -> Path:
    """Return the default path of an output made from a cube: ``waves.zarr`` from ``cube.zarr``.
    The name is the cube's with `kind` in place of "cube", or appended (``run7_waves.zarr``), and `ending`."""
    stem = store.name.removesuffix(".zarr")
    return store.with_name((stem.replace("cube", kind) if "cube" in stem else f"{stem}_{kind}") + ending)
