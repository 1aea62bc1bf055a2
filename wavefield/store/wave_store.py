"""The store of a cube's waves."""

import json
import warnings
import zlib
from pathlib import Path
from typing import Any

import xarray as xr
import zarr
from zarr.storage import MemoryStore

from wavefield.atomic_write import CHECKSUMS, OwnFile, atomic, file_names, zarr_store
from wavefield.errors import StoreError
from wavefield.text import one_line

WAVES = OwnFile("a wave store", zarr_store("waves of ", "wavefield_version", "segment"), folder=True)


def write_waves(tree: xr.DataTree, path: str | Path) -> None:
    """Write the groups of an analysis; the store appears complete or not at all."""
    # Zarr 3 has strings of any length only
    tree = tree.map_over_datasets(
        lambda group: group.assign_coords(
            {name: array.astype(object) for name, array in group.coords.items() if array.dtype.kind == "U"}
        )
    )
    with atomic(path, WAVES) as draft, warnings.catch_warnings():
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
        sums = {name: zlib.crc32(content.to_bytes()) for name, content in files.items()}
        (draft / CHECKSUMS).write_text(json.dumps(sums) + "\n")


def open_waves(path: str | Path) -> xr.DataTree:
    """Open a store of waves, lazily.

    Parameters
    ----------
    path : path
        Store written by `wavefield analyze`.

    Returns
    -------
    DataTree
        One group per product: ``spectra``, ``komega``, ``coherence``, ...; attributes and variables are in
        the page on the wave store.

    Raises
    ------
    StoreError
        If it is not there or is damaged: the message names the file.

    Examples
    --------
    >>> import tempfile
    >>> import wavefield as wf
    >>> group = xr.Dataset({"E_w": ("omega", [0.1, 0.2])}, {"omega": [6.0, 12.0]})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_waves(xr.DataTree.from_dict({"spectra": group}), Path(folder) / "waves.zarr")
    ...     waves = wf.open_waves(Path(folder) / "waves.zarr").load()
    >>> float(waves["spectra/E_w"].sel(omega=12.0))
    0.2
    """
    path = Path(str(path).removeprefix("file://"))
    if not path.is_dir():
        raise StoreError(f"{path}: no such wave store; write one with `wavefield analyze CUBE`")
    try:
        _check(path)
        return xr.open_datatree(path, engine="zarr", chunks={})
    except StoreError:
        raise
    except Exception as error:  # whatever a library makes of damaged bytes
        raise StoreError(
            f"{path} cannot be read as a wave store ({one_line(error)[:200]}); write it again "
            "with `wavefield analyze CUBE`"
        ) from None


def _check(path: Path) -> None:
    """Compare all files of a wave store with their checksums; those from before there were any pass."""
    if not (path / CHECKSUMS).is_file():
        return
    kept = json.loads((path / CHECKSUMS).read_text(encoding="utf-8"))
    for name in {*kept, *(name for name in file_names(path) if "/c/" in name)}:
        file = path / name
        if not file.is_file() or zlib.crc32(file.read_bytes()) != kept.get(name):
            what = "not as it was written" if file.exists() else "missing"
            raise StoreError(f"{file} is {what}; write the wave store again with `wavefield analyze CUBE`")
