"""Stores of cubes and of results made from them, and exports to other formats."""

from pathlib import Path


def beside(store: Path, kind: str, ending: str) -> Path:
    """Return the default path of an output made from a cube, next to it.
    With the kind "waves" and the ending ".zarr": waves.zarr for cube.zarr, run7_waves.zarr for run7.zarr.
    """
    stem = store.name.removesuffix(".zarr")
    return store.with_name((stem.replace("cube", kind) if "cube" in stem else f"{stem}_{kind}") + ending)
