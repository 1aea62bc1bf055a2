"""Ratio of the nonlinear term to the vertical velocity, by wavenumber and by frequency."""

from typing import Any

import dask
import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import stats

from wavefield.variables import annotate
from wavefield.waves.estimation.inputs import a_cube, takes
from wavefield.waves.estimation.mean_current import delayed_current
from wavefield.waves.estimation.wave_record import Record
from wavefield.waves.estimation.welch import Welch
from wavefield.waves.products import Product, register
from wavefield.waves.spectra.cross_spectra import by_field, door, lazy_cross_spectra

CHANCE = 0.05  # outside the interval


def mean_current_group(mean_and_std: tuple[NDArray[np.float64], NDArray[np.float64]]) -> xr.Dataset:
    """The record's mean velocity (2,) and its standard uncertainty, m/s, as the wave store names them."""
    out, (mean, std) = {}, mean_and_std
    for i, axis in enumerate(("x", "y")):
        out[f"mean_current_{axis}"] = ((), float(mean[i]))
        out[f"mean_current_{axis}_std"] = ((), float(std[i]))
    return annotate(xr.Dataset(out), "kinematics")


@takes(a_cube)
def nonlinear_ratio(
    cube: xr.Dataset, *, segment: int | None = None, record: Record | None = None
) -> xr.Dataset:
    """Ratio of the nonlinear term to the vertical velocity, by wavenumber and by frequency.

    Parameters
    ----------
    cube : Dataset
        z, z_t, u, v, w over (time, y, x), m and m/s. Computed at once.
    segment : int, optional
        Steps of a Welch segment; chosen from the record if not given.
    record : Record, optional
        Rectangle and runs; found from the cube if not given.

    Returns
    -------
    Dataset
        ``nonlinear_ratio_k`` (k) and ``nonlinear_ratio_omega`` (omega), with the ends of their 95 %
        intervals as factors, ``low_`` and ``high_``; ``mean_current_x``, ``mean_current_y``, m/s, and their
        ``_std``.

    Raises
    ------
    CubeError
        If a variable is missing, the record is shorter than a segment or no full rectangle is left.

    Notes
    -----
    sqrt(E_nl / E_w), the term being (u - U) . grad z with U the mean of u, v over the record: U . grad z is
    linear. The intervals are those of the ratio of two chi-squared spectra.

    Examples
    --------
    A plane tilted by 0.1 that water crosses at a tenth of its rate of rise.

    >>> rise = 1e-3 * np.random.default_rng(0).standard_normal((128, 20, 24))
    >>> axes = {"time": np.arange(128) * 0.05, "y": np.arange(20) * 0.04, "x": np.arange(24) * 0.04}
    >>> fields = {"z_t": rise, "u": 0.1 * rise, "v": 0 * rise, "w": 1.01 * rise}
    >>> fields["z"] = 0 * rise + 0.1 * axes["x"]
    >>> units = {"z": {"units": "m"}} | {name: {"units": "m s-1"} for name in ("z_t", "u", "v", "w")}
    >>> at = ("time", "y", "x")
    >>> cube = xr.Dataset({name: (at, field, units[name]) for name, field in fields.items()}, axes)
    >>> print(f"{float(nonlinear_ratio(cube, segment=32).nonlinear_ratio_k[5]):.4f}")
    0.0099
    """
    fields = door(cube, ("w", "nl"))
    welch = Welch.of(fields, segment, record)
    ring = lazy_cross_spectra(fields, ("w", "nl"), (), welch).compute()
    (mean,) = dask.compute(delayed_current(fields, welch.record))
    return from_spectra(by_field(ring, names=("w", "nl"))).assign(mean_current_group(mean).data_vars)


def from_spectra(spectra: xr.Dataset) -> xr.Dataset:
    """Ratio of nonlinear to linear, sqrt(E_nl / E_w), over k and over omega with 95 % intervals."""
    out: dict[str, Any] = {}
    for axis, stem in (("k", "E_k"), ("omega", "E")):
        w, nl = spectra[f"{stem}_w"], spectra[f"{stem}_nl"]
        power = nl / w.where(w > 0)
        dof_w, dof_nl = spectra[f"dof_{stem}_w"].values, spectra[f"dof_{stem}_nl"].values
        upper = stats.f.ppf(1 - CHANCE / 2, dof_nl, dof_w), stats.f.ppf(1 - CHANCE / 2, dof_w, dof_nl)
        name = f"nonlinear_ratio_{axis}"
        out[name] = power**0.5
        out[f"low_{name}"] = (axis, upper[0] ** -0.5)
        out[f"high_{name}"] = (axis, upper[1] ** 0.5)
    return annotate(xr.Dataset(out), "kinematics")


register(
    Product("record_current", ("mean_current",), mean_current_group, group="kinematics"),
    Product("nonlinear_ratio", ("spectra",), from_spectra, group="kinematics"),
)
