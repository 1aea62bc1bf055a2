"""Degrees of freedom of spectra, and the intervals that follow from them."""

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.variables import annotate
from wavefield.waves.estimation import rings
from wavefield.waves.estimation.windows import interval

Array = NDArray[Any]

_NEIGHBOURS = 1.0, 4 / 9, 1 / 36  # squared correlation of lines of a Hann window 0, 1, 2 apart
HANN_LINES = 2 * sum(_NEIGHBOURS) - 1  # lines that count as one


def hann_correlation(lines: int) -> Array:
    """Squared correlation of the lines of a Hann window, (lines, lines), for energy spread evenly."""
    apart = np.abs(np.subtract.outer(np.arange(lines), np.arange(lines)))
    return np.select([apart == n for n in range(len(_NEIGHBOURS))], _NEIGHBOURS, 0.0)


def sum_freedom(power: Array, dof: Array, overlap: Array) -> Array:
    """Degrees of freedom of sums of powers, as their spread lets expect.

    With power (parts, n); dof (parts, n); overlap (parts, parts); returns (n,): (sum P)^2 / sum_ij rho_ij^2
    P_i P_j / sqrt(nu_i nu_j).

    Examples
    --------
    Four parts of ten degrees of freedom each, as strong as each other and independent; then the first alone.

    >>> power = np.array([[1.0, 1.0], [1.0, 0.0], [1.0, 0.0], [1.0, 0.0]])
    >>> sum_freedom(power, np.full((4, 2), 10.0), np.eye(4))
    array([40., 10.])
    """
    size = np.sqrt(np.maximum(np.diag(overlap), 1e-300))
    share = power / np.sqrt(dof)
    variance = np.einsum("in,in->n", share, (overlap / np.outer(size, size)) @ share)
    out = np.divide(power.sum(axis=0) ** 2, variance, out=dof.mean(axis=0), where=variance > 0)
    return np.asarray(out)


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
    """Effective number of independent samples of a record in time, (sum S)^2 / sum S^2, from (omega, ...)."""
    step = float(energy["omega"][1] - energy["omega"][0])
    squares = (energy**2 / cells).sum("omega")
    return duration * step * energy.sum("omega") ** 2 / (2 * np.pi * squares.where(squares > 0))
