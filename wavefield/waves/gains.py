"""Gains (transfer functions) of the measurement, and their correction in spectra.

Averages and differences over time steps have gains that depend on omega dt, and on `frames`, the code
`path_frames` of velocities. Matching windows average over space; their amplitude gain is a Dataset over
(direction, k) with ``gain_z``, ``gain_u``, ``gain_v``, ``gain_w``, NaN where it is unknown. The measurement
predicts it and stores it in the cube; users can give their own.
"""

from pathlib import Path
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from wavefield.errors import StoreError
from wavefield.variables import INSTANTANEOUS, PATH_WEIGHTS
from wavefield.waves.sums import MIN_AMPLITUDE

Array = NDArray[Any]

MIN_SIGNAL_TO_NOISE = 3.0  # of a cell, ring or band: a noise wrong by a tenth changes the waves by 3 %


def path_factor(omega: Any, dt: float, frames: int) -> Any:
    """Return the amplitude gain of velocities with code `frames` (see `frames_of`) over that for two frames.
    For paths, it is w_0 + 2 w_1 cos(omega dt) + 2 w_2 cos(2 omega dt), with weights w of `PATH_WEIGHTS`."""
    if frames == INSTANTANEOUS:
        with np.errstate(divide="ignore"):
            return 1 / np.sinc(np.asarray(omega) * dt / (2 * np.pi))
    central, *others = PATH_WEIGHTS[frames]
    out: Any = np.full_like(omega, central, dtype=float)
    for n, weight in enumerate(others, 1):
        out = out + 2 * weight * np.cos(n * omega * dt)
    return out


def noise_of_displacement(omega: Any, dt: float, frames: int) -> Any:
    """Return the noise spectrum of w dt divided by the noise spectrum of the elevation integrated from w."""
    return (omega * dt if frames == INSTANTANEOUS else 2 * np.sin(omega * dt / 2)) ** 2


def elevation_from_w(omega: Any, dt: float, frames: int = 2) -> Any:
    """Return the factor, s2, that converts the power spectrum of w to that of the elevation. It is (dt / 2)^2
    / (p sin(omega dt / 2))^2 with the gain p of `path_factor`, since w dt is a difference."""
    with np.errstate(divide="ignore"):
        return (dt / 2) ** 2 / (np.sin(omega * dt / 2) * path_factor(omega, dt, frames)) ** 2


CELLS_OF_WEIGHT = 2.0  # chosen: standard deviation, in cells of k, over which weights are smoothed
PREDICTED = "linear theory"  # first words of the attribute `origin` of a predicted gain


def read_gain(source: str | Path | xr.Dataset) -> xr.Dataset:
    """Return the gain `source`, read from disk if it is a path; StoreError if gain_z or gain_w is missing."""
    if isinstance(source, xr.Dataset):
        gain = source
    else:
        try:
            gain = xr.open_zarr(Path(source), chunks=None, consolidated=False).load()
        except (OSError, ValueError, KeyError) as error:
            raise StoreError(f"{source} cannot be read as a gain: {error}") from None
    for name in ("gain_z", "gain_w"):
        if name not in gain or set(gain[name].dims) != {"direction", "k"}:
            raise StoreError(f"the gain has no {name!r} over direction and k: a run stores one in its cube")
    return gain


def gain_of(
    cube: xr.Dataset, requested: str | Path | xr.Dataset | Literal[False] | None = None
) -> xr.Dataset | None:
    """Return the gain `requested` by the user, else the gain stored in the cube. Return None if `requested`
    is False, no gain is stored, or the stored gain is NaN or below 0.5 at the smallest k."""
    if requested is False:
        return None
    if requested is not None:
        return read_gain(requested)
    names = [f"gain_{name}" for name in "zuvw" if f"gain_{name}" in cube]
    if not {"gain_z", "gain_w"} <= set(names):
        return None
    own = cube[names].compute()
    if not all(float(own[name].isel(k=0).mean()) > MIN_AMPLITUDE for name in names):  # NaN of a light sheet
        return None
    return own.assign_attrs(origin=f"{PREDICTED}, from what the run learned of its record")


def is_predicted(gain: xr.Dataset) -> bool:
    """Return True if the measurement predicted the gain, and False if the user gave it."""
    return str(gain.attrs.get("origin", "")).startswith(PREDICTED)


def correction(gain: xr.Dataset, name: str, k: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return the factor (k,) that corrects the power of field `name` for its gain, and a mask (k,). Where the
    amplitude gain is below 0.5, the factor is 1 and the mask false; without a gain, 1 and true."""
    if f"gain_{name}" not in gain:
        return np.ones_like(k), np.ones(k.shape, bool)
    power = ring_gain(gain, name, name, k)
    valid = power > MIN_AMPLITUDE**2
    return np.where(valid, 1.0 / np.where(valid, power, 1.0), 1.0), valid


def with_directions(gain: xr.Dataset, plane_w: xr.DataArray) -> xr.Dataset:
    """Return `gain` with ``weight`` (direction, k): at each k, the fraction of the energy in each direction.
    The weights come from the spectrum `plane_w` of w over (ky, kx), since gains depend on direction."""
    ky, kx = np.meshgrid(plane_w["ky"].values, plane_w["kx"].values, indexing="ij")
    sectors, step = gain.sizes["direction"], float(gain["k"][1] - gain["k"][0])
    cell = min(float(np.diff(plane_w[name][:2])[0]) for name in ("ky", "kx"))
    turn = np.rint(np.arctan2(ky, kx) * sectors / np.pi).astype(int) % sectors
    ring = np.minimum(np.rint(np.hypot(ky, kx) / step).astype(int), gain.sizes["k"] - 1)
    energy = np.zeros((sectors, gain.sizes["k"]))
    np.add.at(energy, (turn, ring), plane_w.values)
    energy = gaussian_filter1d(energy, CELLS_OF_WEIGHT * cell / step, axis=1)
    waves = energy / np.maximum(gain["gain_w"].transpose("direction", "k").values ** 2, MIN_AMPLITUDE**2)
    weight = waves / np.maximum(waves.sum(axis=0), np.finfo(float).tiny)
    return gain.assign(weight=(("direction", "k"), weight))


def ring_gain(gain: xr.Dataset, one: str, other: str, k: Array) -> Array:
    """Return the gain (k,) of the power or cross spectrum of two fields, averaged over directions. Fields are
    `one` and `other`, such as "z" and "w". The gain is 0 above the largest k at which it is known."""
    product = gain[f"gain_{one}"] * gain[f"gain_{other}"] * gain.get("weight", 1.0 / gain.sizes["direction"])
    product = product.sum("direction", skipna=False)
    known = np.isfinite(product.values)
    # constant below the lowest known k: windows hardly affect waves longer than the rectangle
    values = np.interp(k, product["k"].values[known], product.values[known], right=0.0)
    return np.where(k > product["k"].values[known].max(initial=0.0), 0.0, values)
