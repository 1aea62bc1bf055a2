"""Ratio of the nonlinear term to the vertical velocity, by wavenumber and by frequency."""

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import stats

from wavefield.variables import annotate
from wavefield.waves.products import Product, register

CHANCE = 0.05  # outside the interval


def mean_current_group(mean_and_std: tuple[NDArray[np.float64], NDArray[np.float64]]) -> xr.Dataset:
    """The record's mean velocity (2,) and its standard uncertainty, m/s, as the wave store names them."""
    out, (mean, std) = {}, mean_and_std
    for i, axis in enumerate(("x", "y")):
        out[f"mean_current_{axis}"] = ((), float(mean[i]))
        out[f"mean_current_{axis}_std"] = ((), float(std[i]))
    return annotate(xr.Dataset(out), "kinematics")


def from_spectra(spectra: xr.Dataset) -> xr.Dataset:
    """Ratio of nonlinear to linear, sqrt(E_nl / E_w), over k and over omega with 95 % intervals."""
    out = {}
    for axis, stem in (("k", "E_k"), ("omega", "E")):
        w, nl = spectra[f"{stem}_w"], spectra[f"{stem}_nl"]
        power = nl / w.where(w > 0)
        dof_w, dof_nl = spectra[f"dof_{stem}_w"].values, spectra[f"dof_{stem}_nl"].values
        upper = stats.f.ppf(1 - CHANCE / 2, dof_nl, dof_w), stats.f.ppf(1 - CHANCE / 2, dof_w, dof_nl)
        name = f"nonlinear_ratio_{axis}"
        out[name] = power**0.5
        out[f"low_{name}"] = (power / upper[0]) ** 0.5
        out[f"high_{name}"] = (power * upper[1]) ** 0.5
    return annotate(xr.Dataset(out), "kinematics")


register(
    Product("record_current", ("mean_current",), mean_current_group, group="kinematics"),
    Product("nonlinear_ratio", ("spectra",), from_spectra, group="kinematics"),
)
