"""Store the statistics of each camera pair's errors (`pipeline.assess.pair_statistics`) in a cube."""

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
    """Write statistics of camera pairs into the cube at `path`, in place of earlier ones.
    `statistics` is a Dataset as `read_pair_statistics` returns it, and `state` identifies the steps of the
    cube that are measured (`state_of`)."""
    attributes = statistics.attrs | {name: statistics[name].values.tolist() for name in _TEXTS}
    with writing(path / GROUP):
        shutil.rmtree(path / GROUP, ignore_errors=True)
        group = zarr.open_group(path / GROUP, mode="w", zarr_format=3, attributes=attributes)
        for row in rows_of(GROUP):
            add_array(group, row, statistics[row.name].values.astype(row.dtype), fill_value=np.nan)
        write_mark(path / GROUP, Product(KIND, state))


def read_pair_statistics(store: str | Path) -> xr.Dataset | None:
    """Load the error statistics of a cube's camera pairs; None if there are none or they were changed.
    The variables are ``rms`` and ``beyond`` (error), and ``density`` (error, bin); the coordinates
    ``quantity``, ``cameras`` and ``units`` describe each error. The attribute ``cube_state`` identifies the
    steps of the cube that were measured when the statistics were made (`state_of`)."""
    path = Path(store) / GROUP
    mark = read_mark(path)
    if mark is None or mark.kind != KIND:
        return None
    out = xr.open_zarr(path, consolidated=False, chunks=None).load()
    out.attrs.pop(MARK_ATTRIBUTE)
    texts = {name: ("error", np.array(out.attrs.pop(name))) for name in _TEXTS}
    return annotate(out.assign_coords(texts).assign_attrs(cube_state=mark.source), GROUP)
