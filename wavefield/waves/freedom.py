"""Degrees of freedom of spectra, and the intervals that follow from them."""

import numpy as np
import xarray as xr

from wavefield.variables import annotate
from wavefield.waves import rings
from wavefield.waves.windows import interval


def independent_cells(energy: xr.DataArray, cells: xr.DataArray, table: rings.Rings) -> xr.DataArray:
    """Independent cells of a sum over rings, (...), from each ring's energy and own cells, (..., k)."""
    share = energy / energy.sum("k")
    # neighbouring rings share cells: correlated as for even energy, with the variance that each has
    share = share * (xr.DataArray(1 / np.diag(table.overlap), dims="k") / cells) ** 0.5
    overlap = xr.DataArray(table.overlap, dims=("k", "k2"))
    norm = xr.dot(
        share, overlap, share.rename(k="k2").drop_vars(["k2", "cycles"], errors="ignore"), dim=["k", "k2"]
    )
    out: xr.DataArray = 1 / norm
    return out


def with_interval(energy: xr.DataArray, dof: xr.DataArray) -> xr.Dataset:
    """Put a spectrum, its degrees of freedom and its interval together."""
    dof = dof.clip(min=1)
    low, high = (
        xr.apply_ufunc(lambda d, i=i: interval(d)[i], dof, dask="parallelized", output_dtypes=[float])
        for i in (0, 1)
    )
    return annotate(xr.Dataset({"E": energy, "dof": dof, "low": low, "high": high}))


def samples_in_time(energy: xr.DataArray, duration: float, cells: xr.DataArray | float = 1.0) -> xr.DataArray:
    """Effective number of independent samples of a record in time, (sum S)^2 / sum S^2.

    Parameters
    ----------
    energy : DataArray, (omega, ...)
        Spectrum, one-sided.
    duration : float
        Length of the record, s (`effective_duration` for an estimate from windowed segments).
    cells : DataArray, (omega, ...), optional
        Independent samples in space at each frequency.

    Returns
    -------
    DataArray
        T (int S domega)^2 / (2 pi int S^2 / cells domega): a narrow band repeats itself, so this is far less
        than the number of steps.
    """
    step = float(energy["omega"][1] - energy["omega"][0])
    squares = (energy**2 / cells).sum("omega")
    return duration * step * energy.sum("omega") ** 2 / (2 * np.pi * squares.where(squares > 0))
