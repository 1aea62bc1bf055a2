"""Stores of results made from a cube: its waves (`wavefield analyze`), and the errors of its camera pairs."""

import shutil
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import zarr
from zarr.storage import MemoryStore

from wavefield.atomic_write import (
    MARK_ATTRIBUTE,
    Product,
    atomic,
    identity_of,
    read_mark,
    write_mark,
    writing,
)
from wavefield.errors import StoreError
from wavefield.store.layout import add_array
from wavefield.variables import Variable, annotate, register, rows_of

WAVES = "wave store"  # kinds of output, for the marks
_PAIRS = "pair statistics"
PAIR_GROUP = "pair_statistics"  # in the store of the cube
_TEXTS = ("quantity", "cameras", "units")  # kept as attributes: Zarr 3 has no fixed-length strings

register(
    Variable(
        "rms", ("error",), "", "rms of an error, without values beyond three times the rms", group=PAIR_GROUP
    ),
    Variable("beyond", ("error",), "1", "fraction of values beyond three times the rms", group=PAIR_GROUP),
    Variable(
        "density",
        ("error", "bin"),
        "1",
        "probability density of an error over its rms",
        group=PAIR_GROUP,
        meaning="in units of 1/rms",
    ),
    Variable("bin", ("bin",), "1", "centre of a bin, over the rms", dtype="float64", group=PAIR_GROUP),
)


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
    product = Product(WAVES, source or identity_of())
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


def write_pair_statistics(path: Path, statistics: xr.Dataset, state: str) -> None:
    """Write or replace statistics of errors between a cube's cameras; `state` is the hash of the cube."""
    attributes = statistics.attrs | {name: statistics[name].values.tolist() for name in _TEXTS}
    with writing(path / PAIR_GROUP):
        shutil.rmtree(path / PAIR_GROUP, ignore_errors=True)
        group = zarr.open_group(path / PAIR_GROUP, mode="w", zarr_format=3, attributes=attributes)
        for row in rows_of(PAIR_GROUP):
            add_array(group, row, statistics[row.name].values.astype(row.dtype), fill_value=np.nan)
        write_mark(path / PAIR_GROUP, Product(_PAIRS, state))


def read_pair_statistics(store: str | Path) -> xr.Dataset | None:
    """Load statistics of the differences between cameras that are stored with a cube.
    None if there are none, or if their file was altered after it was written.
    Each error has ``rms``, ``beyond`` (fraction of values beyond 3 rms), ``density`` (error, bin) and
    coordinates that describe it. The attribute ``cube_state`` is the hash of the cube when the
    statistics were computed."""
    path = Path(store) / PAIR_GROUP
    mark = read_mark(path)
    if mark is None or mark.kind != _PAIRS:
        return None
    out = xr.open_zarr(path, consolidated=False, chunks=None).load()
    out.attrs.pop(MARK_ATTRIBUTE)
    texts = {name: ("error", np.array(out.attrs.pop(name))) for name in _TEXTS}
    return annotate(out.assign_coords(texts).assign_attrs(cube_state=mark.source), PAIR_GROUP)
