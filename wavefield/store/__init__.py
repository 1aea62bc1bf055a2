"""Stores of cubes and of results made from them, and exports to other formats.

A step is the interval between two consecutive frames. A chunk is a range of steps that one task measures; it
has one file in every array. The ledger is the pair of arrays ``frame_status`` (status of each step) and
``frame_fault`` (fault of each frame and camera). The recipe is everything that determines a cube's values.
"""

from pathlib import Path


def beside(store: Path, kind: str, ending: str) -> Path:
    """Return the default path of an output made from the cube `store`, in the same folder.
    In the name of the cube, `kind` takes the place of "cube" (``waves.zarr`` for ``cube.zarr``), or else is
    appended (``run7_waves.zarr`` for ``run7.zarr``). The file name ends with `ending`."""
    stem = store.name.removesuffix(".zarr")
    return store.with_name((stem.replace("cube", kind) if "cube" in stem else f"{stem}_{kind}") + ending)
