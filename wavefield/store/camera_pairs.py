"""Errors of each pair of cameras (`pair_statistics` of `pipeline.assess`), stored in a group of the cube."""

import shutil
from pathlib import Path

import numpy as np
import xarray as xr
import zarr

from wavefield.atomic_write import MARK_ATTRIBUTE, Product, read_mark, write_mark, writing
from wavefield.store.layout import add_array
from wavefield.variables import Variable, annotate, register, rows_of

GROUP, KIND = "pair_statistics", "pair statistics"
_TEXTS = ("quantity", "cameras", "units")  # kept as attributes: Zarr 3 has no fixed-length strings

register(
    Variable(
        "rms", ("error",), "", "rms of an error, without values beyond three times the rms", group=GROUP
    ),
    Variable("beyond", ("error",), "1", "fraction of values beyond three times the rms", group=GROUP),
    Variable(
        "density",
        ("error", "bin"),
        "1",
        "probability density of an error over its rms",
        group=GROUP,
        meaning="in units of 1/rms",
    ),
    Variable("bin", ("bin",), "1", "centre of a bin, over the rms", dtype="float64", group=GROUP),
)


def write_pair_statistics(path: Path, statistics: xr.Dataset, state: str) -> None:
    """Write the statistics that `read_pair_statistics` returns into a cube, in place of earlier ones.
    `state` identifies the measured steps of the cube (`state_of`)."""
    attributes = statistics.attrs | {name: statistics[name].values.tolist() for name in _TEXTS}
    with writing(path / GROUP):
        shutil.rmtree(path / GROUP, ignore_errors=True)
        group = zarr.open_group(path / GROUP, mode="w", zarr_format=3, attributes=attributes)
        for row in rows_of(GROUP):
            add_array(group, row, statistics[row.name].values.astype(row.dtype), fill_value=np.nan)
        write_mark(path / GROUP, Product(KIND, state))


def read_pair_statistics(store: str | Path) -> xr.Dataset | None:
    """Load the error statistics of a cube's camera pairs; None if there are none or they were changed.
    The variables ``rms``, ``beyond`` and ``density`` are (error) or (error, bin); ``quantity``, ``cameras``
    and ``units`` describe each error. The attribute ``cube_state`` identifies the steps that were measured at
    that time (`state_of`)."""
    path = Path(store) / GROUP
    mark = read_mark(path)
    if mark is None or mark.kind != KIND:
        return None
    out = xr.open_zarr(path, consolidated=False, chunks=None).load()
    out.attrs.pop(MARK_ATTRIBUTE)
    texts = {name: ("error", np.array(out.attrs.pop(name))) for name in _TEXTS}
    return annotate(out.assign_coords(texts).assign_attrs(cube_state=mark.source), GROUP)
