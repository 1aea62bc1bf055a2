"""E(ky, kx) of z and w at chosen frequencies."""

from collections.abc import Sequence
from functools import partial

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.variables import FIELD_TEXTS, FIELD_UNITS
from wavefield.waves.estimation.welch import Welch
from wavefield.waves.products import Product, register
from wavefield.waves.spectra.field_spectra import density, plane_density


def _density(name: str, sums: dict[str, NDArray[np.floating]], welch: Welch) -> xr.DataArray:
    power = sums.pop(f"map {name}")  # large, and of no further use
    values = xr.Variable(("omega", "ky", "kx"), density(power, welch))
    return plane_density(values, FIELD_TEXTS[name], FIELD_UNITS[name], welch)["E"]


def _sum_of_lines(w: xr.DataArray) -> xr.DataArray:
    """Of the density (omega, ky, kx), over (ky, kx): small enough for workers."""
    return w.sum("omega")


def map_lines(welch: Welch, frequencies: Sequence[float]) -> list[int]:
    """Lines of the spectrum next to some frequencies, Hz."""
    lines = welch.omega / (2 * np.pi)
    return sorted({int(np.abs(lines - f).argmin()) for f in frequencies if f < lines[-2]} - {0})


def maps(z: xr.DataArray, w: xr.DataArray, lines: list[int]) -> xr.Dataset:
    """Densities (omega, ky, kx) at some lines, (omega_map, ky, kx)."""
    chosen = {f"E_kxky_{name}": density.isel(omega=lines) for name, density in (("z", z), ("w", w))}
    return xr.Dataset(
        {
            name: values.drop_vars("frequency").rename(omega="omega_map").drop_attrs()
            for name, values in chosen.items()
        }
    )


register(
    *(
        Product(f"density_{name}", ("ring_sums", "welch"), partial(_density, name), planes=(name,))
        for name in ("z", "w")
    ),
    Product("plane_w", ("density_w",), _sum_of_lines),
    Product("map_lines", ("welch", "map_frequencies"), map_lines),
    Product("maps", ("density_z", "density_w", "map_lines"), maps, group="spectra"),
)
