"""E(k) and E(omega): the two spectra that are quoted, from a field, a cube or E(k, omega)."""

from typing import cast

import xarray as xr

from wavefield.variables import OMEGA_UNITS, TABLE, annotate, product
from wavefield.waves.estimation.degrees_of_freedom import samples_in_time, with_interval
from wavefield.waves.estimation.inputs import takes
from wavefield.waves.estimation.windows import effective_duration
from wavefield.waves.spectra.field_spectra import a_komega, frequency_spectrum


@takes(a_komega)
def E_omega(field: xr.DataArray | xr.Dataset) -> xr.Dataset:
    """Spectrum E(omega) of a field, with its 95 % interval.

    Parameters
    ----------
    field : DataArray or Dataset
        Any variable of a cube over (time, y, x), s and m, or the result of `komega`.

    Returns
    -------
    Dataset
        ``E`` (omega), the mean spectrum over the nodes weighted by the squared window; ``dof``, ``low``,
        ``high`` and ``valid`` (omega).

    Raises
    ------
    CubeError
        If it is given something else, or the record is too short.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> axes = {"time": np.arange(256) * 0.05, "y": np.arange(24) * 0.05, "x": np.arange(32) * 0.05}
    >>> w = xr.DataArray(rng.standard_normal((256, 24, 32)), axes, ("time", "y", "x"))
    >>> E_omega(w).E.dims
    ('omega',)
    """
    return frequency_spectrum(cast(xr.Dataset, field))


@takes(a_komega)
def E_k(field: xr.DataArray | xr.Dataset) -> xr.Dataset:
    """Spectrum E(k) of a field, with its 95 % interval.

    Parameters
    ----------
    field : DataArray or Dataset
        Any variable of a cube over (time, y, x), s and m, or the result of `komega`.

    Returns
    -------
    Dataset
        ``E`` (k), its sum times the step of k is the variance; ``dof``, ``low`` and ``high`` (k).

    Raises
    ------
    CubeError
        If it is given something else, or the record is too short.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> axes = {"time": np.arange(256) * 0.05, "y": np.arange(24) * 0.05, "x": np.arange(32) * 0.05}
    >>> w = xr.DataArray(rng.standard_normal((256, 24, 32)), axes, ("time", "y", "x"))
    >>> E_k(w).E.dims
    ('k',)
    """
    step = float(field["omega"][1] - field["omega"][0])
    duration = effective_duration(field.attrs["segments"], field.attrs["segment"] * field.attrs["dt"])
    cells = field["dof"] / field.attrs["degrees_of_freedom"]
    theory = 2 * samples_in_time(field["E"], duration, cells).clip(min=1)
    out = with_interval(field["E"].sum("omega") * step, field["dof_k"].fillna(theory))
    out = annotate(out)
    what = str(field["E"].attrs.get("long_name", "")).partition(" of ")[2] or "the field"
    units = product((field["E"].attrs.get("units", "1"), 1), (OMEGA_UNITS, 1))
    out["E"].attrs = TABLE["frequency/E"].of(what, units)
    return out
