"""Arrays of which every block has a small file of its own: the ledger."""

from pathlib import Path
from typing import Any

import numpy as np

from wavefield.store.layout import Layout
from wavefield.store.verify import chunk_path


def read_blocks(path: Path, group: Any, name: str, layout: Layout) -> np.ndarray:
    """Read the whole of an array of the ledger, file by file: many times as fast as through Zarr.

    Parameters
    ----------
    path : path
        The store.
    group : zarr.Group
        As from `wavefield.store.read.open_group`.
    name : {"frame_status", "frame_fault"}
        The array.
    layout : Layout
        Sizes of the store.

    Returns
    -------
    ndarray of uint8, (steps,) or (cameras, frames)
        0 where nothing is stored.

    Raises
    ------
    ValueError
        If a file is not as long as it should be.
    """
    array = group[name]
    if array.compressors:  # stores of earlier versions
        return np.asarray(array[:])
    out = np.zeros(array.shape, array.dtype)
    chunks, dtype = array.chunks, array.dtype  # Zarr works these out at every look
    folder = str(chunk_path(path, name, 0).parent)  # many files: plain words are quicker than paths
    for start in range(0, array.shape[-1], layout.block):
        try:
            with open(f"{folder}/{start // layout.block}", "rb", buffering=0) as stream:
                stored = stream.read()
        except FileNotFoundError:
            continue
        values = np.frombuffer(stored, dtype).reshape(chunks)
        part = out[..., start : start + layout.block]
        part[...] = values[..., : part.shape[-1]]
    return out
