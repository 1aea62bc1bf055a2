"""The group of a cube's store that holds the errors of every pair of cameras on its own."""

from pathlib import Path

import numpy as np
import xarray as xr
import zarr

from wavefield.atomic_write import writing
from wavefield.errors import StoreError
from wavefield.store.layout import add_array, gather_metadata
from wavefield.store.metadata import keep_metadata
from wavefield.store.read import open_group
from wavefield.variables import Variable, annotate, register, rows_of

GROUP = "pair_statistics"
_TEXTS = ("quantity", "cameras", "units")  # text coordinates, kept as attributes: Zarr 3 has no fixed strings

register(
    Variable("rms", ("error",), "", "rms of an error, without what exceeds three times it", group=GROUP),
    Variable("rms_all", ("error",), "", "rms of an error", group=GROUP),
    Variable("beyond", ("error",), "1", "fraction that exceeds three times the rms", group=GROUP),
    Variable(
        "density",
        ("error", "bin"),
        "1",
        "probability density of an error over its rms",
        group=GROUP,
        meaning="times the rms; bins are multiples of the rms",
    ),
    Variable("bin", ("bin",), "1", "centre of a bin, over the rms", dtype="float64", group=GROUP),
)


def write_pair_statistics(path: Path, statistics: xr.Dataset, ledger_checksum: int) -> None:
    """Put the statistics into a cube; they belong to a ledger of this checksum, which is written last."""
    attributes = statistics.attrs | {name: statistics[name].values.tolist() for name in _TEXTS}
    with writing(path / GROUP):
        group = zarr.open_group(path / GROUP, mode="a", zarr_format=3)
        group.attrs.put({})
        for row in rows_of(GROUP):
            values = statistics[row.name].values.astype(row.dtype)
            add_array(group, row, values, fill_value=np.nan, overwrite=True)
        group.attrs.put(attributes | {"ledger_checksum": ledger_checksum})
        gather_metadata(path)
        keep_metadata(path)


def read_pair_statistics(store: str | Path) -> xr.Dataset | None:
    """The statistics (error, bin) in a cube, loaded; None if there are none.
    Coordinates of error: quantity, cameras, units.
    """
    path = Path(store)
    open_group(path)  # compares all small files with their copies
    gathered = zarr.open_group(path, mode="r").metadata.consolidated_metadata
    if gathered is None or GROUP not in gathered.metadata or not (path / GROUP).is_dir():
        return None  # none, or a run was killed while it wrote them
    try:
        out = xr.open_zarr(path / GROUP, consolidated=False, chunks=None).load()
    except Exception as error:  # whatever a library makes of damaged bytes
        raise StoreError(
            f"{path / GROUP} cannot be read ({error}); `wavefield run EXPERIMENT` writes it again"
        ) from None
    if "ledger_checksum" not in out.attrs:  # being written
        return None
    texts = {name: ("error", np.array(out.attrs.pop(name))) for name in _TEXTS}
    return annotate(out.assign_coords(texts), GROUP)
