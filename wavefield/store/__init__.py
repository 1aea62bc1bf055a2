"""Stores of cubes and of results made from them, and exports to other formats."""

from pathlib import Path


def beside(store: Path, kind: str, ending: str) -> Path:
    """Default path of something made from a cube: waves.zarr of cube.zarr, run7_waves.zarr of run7.zarr."""
    stem = store.name.removesuffix(".zarr")
    return store.with_name((stem.replace("cube", kind) if "cube" in stem else f"{stem}_{kind}") + ending)
