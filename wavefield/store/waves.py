"""The store of a cube's waves."""

import warnings
from pathlib import Path
from typing import Any

import xarray as xr
import zarr
from zarr.storage import MemoryStore

from wavefield.whole_files import whole


def write_waves(tree: xr.DataTree, path: str | Path) -> None:
    """Write spectra and what goes with them; the store appears whole or not at all.

    Parameters
    ----------
    tree : DataTree
        As from `wavefield.waves.analyze`.
    path : path
        Zarr store; one that is there is replaced.

    Raises
    ------
    StoreError
        If it cannot be written.
    """
    # Zarr 3 knows strings of any length only
    tree = tree.map_over_datasets(
        lambda group: group.assign_coords(
            {name: array.astype(object) for name, array in group.coords.items() if array.dtype.kind == "U"}
        )
    )
    with whole(path) as draft, warnings.catch_warnings():
        # readers warn without consolidated metadata, zarr warns with it
        warnings.filterwarnings("ignore", message="Consolidated metadata")
        # many small arrays: made in memory, as zarr hands every file to another thread and waits for it
        files: dict[str, Any] = {}
        store = MemoryStore(files)
        tree.to_zarr(store, mode="w", consolidated=False)
        zarr.consolidate_metadata(store)  # once: xarray does it anew for every group
        for name, content in files.items():
            file = draft / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content.to_bytes())
