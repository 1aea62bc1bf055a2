"""Write and open the store of a cube's waves: spectra and other results of `wavefield analyze`."""

import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import xarray as xr
import zarr
from zarr.storage import MemoryStore

from wavefield.atomic_write import Product, atomic, identity_of, read_mark
from wavefield.errors import StoreError

KIND = "wave store"


def write_waves(tree: xr.DataTree, path: str | Path, source: str = "", inputs: Iterable[object] = ()) -> None:
    """Write the groups of a wave analysis as a wave store at `path`, completely or not at all.
    `source` identifies the cube (`source_of`); only an unchanged wave store of the same cube is replaced.
    `inputs` are files and stores that the same command reads and must not overwrite."""
    # Zarr 3 has strings of any length only
    tree = tree.map_over_datasets(
        lambda group: group.assign_coords(
            {name: array.astype(object) for name, array in group.coords.items() if array.dtype.kind == "U"}
        )
    )
    product = Product(KIND, source or identity_of())
    with atomic(path, product, inputs=inputs) as draft, warnings.catch_warnings():
        # readers warn without consolidated metadata, zarr warns with it
        warnings.filterwarnings("ignore", message="Consolidated metadata")
        # written in memory first, because Zarr waits for another thread at each of the many small files
        files: dict[str, Any] = {}
        store = MemoryStore(files)
        tree.to_zarr(store, mode="w", consolidated=False)
        zarr.consolidate_metadata(store)  # once; xarray would repeat it for every group
        for name, content in files.items():
            file = draft / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content.to_bytes())


def open_waves(path: str | Path) -> xr.DataTree:
    """Open a store of waves lazily.

    Parameters
    ----------
    path : path
        Store written by `wavefield analyze`.

    Returns
    -------
    DataTree
        One group per result: ``spectra``, ``komega``, ``coherence``, ... The page of the documentation on the
        wave store lists the attributes and variables of each group.

    Raises
    ------
    StoreError
        If the store does not exist, or was changed or damaged.

    Examples
    --------
    >>> import tempfile
    >>> import wavefield as wf
    >>> group = xr.Dataset({"E_omega": ("omega", [0.1, 0.2])}, {"omega": [6.0, 12.0]})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_waves(xr.DataTree.from_dict({"spectra": group}), Path(folder) / "waves.zarr")
    ...     waves = wf.open_waves(Path(folder) / "waves.zarr").load()
    >>> float(waves["spectra/E_omega"].sel(omega=12.0))
    0.2
    """
    path = Path(str(path).removeprefix("file://"))
    if not path.is_dir():
        raise StoreError(f"{path}: no such wave store; write one with `wavefield analyze CUBE`")
    if read_mark(path) is None:
        raise StoreError(
            f"{path} is not as `wavefield analyze` wrote it: files are missing, damaged or were added; "
            "move it, and write it again with `wavefield analyze CUBE`"
        )
    return xr.open_datatree(path, engine="zarr", chunks={})
