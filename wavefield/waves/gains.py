"""Gains of averages, differences and matching windows in a spectrum, and their correction.

Gains of averages and differences are of power; b = omega dt / 2. The gain of the matching windows is
predicted by the run from its recipe, or given: a Dataset over (direction, k) with ``gain_z``,
``gain_u``, ``gain_v``, ``gain_w``, of amplitude, NaN where it is not known. Save one with ``gain.to_zarr``.
"""

from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from wavefield.errors import StoreError
from wavefield.variables import INSTANTANEOUS, PATH_WEIGHTS, annotate
from wavefield.water import dispersion
from wavefield.waves.welch import k_coords

Array = NDArray[Any]
Values = TypeVar("Values", float, Array, xr.DataArray)

MIN_SIGNAL_TO_NOISE = (
    3.0  # of a cell, ring or band: noise that is off by a tenth then changes the waves by 3 %
)
MIN_AMPLITUDE = 0.5  # of a wave as measured: a correction is at most twofold


def path_factor(omega: Values, dt: float, frames: int) -> Values:
    """Gain of a velocity from a path through several frames over that of one displacement; omega in rad/s.
    It is w_0 + 2 w_1 cos(omega dt) + 2 w_2 cos(2 omega dt) with w from `PATH_WEIGHTS`; for instantaneous
    velocities b / sin b, b = omega dt / 2.
    """
    factor: Values
    if frames == INSTANTANEOUS:
        reciprocal: Any = np.sinc(np.asarray(omega) * dt / (2 * np.pi))
        with np.errstate(divide="ignore"):
            factor = 1 / reciprocal
        return factor
    central, *others = PATH_WEIGHTS[frames]
    out: Any = np.full_like(omega, central, dtype=float)
    for n, weight in enumerate(others, 1):
        out = out + 2 * weight * np.cos(n * omega * dt)
    factor = out
    return factor


def noise_of_displacement(omega: Values, dt: float, frames: int) -> Values:
    """Noise of the displacements over that of the elevation integrated from them, 4 sin^2 b.
    Of instantaneous velocities times dt it is (2 b)^2.
    """
    twice: Any = omega * dt if frames == INSTANTANEOUS else 2 * np.sin(omega * dt / 2)
    factor: Values = twice**2
    return factor


def to_frame_time(k: Array, omega: Array, dt: float, frames: int) -> Array:
    """Factor from z at mid-time to z at the step's first frame; ``frames`` is the cube's `path_frames`.
    Measured z are interpolated from six frames, in a frame moving with the mean flow, in which a free wave
    turns by sigma(k) dt = 2 b per frame: the gain of the polynomial through six frames at its middle,
    (150 cos b - 25 cos 3b + 3 cos 5b) / 128, is undone up to a factor 2.
    """
    start = np.exp(-0.5j * omega * dt)
    if frames <= 2:  # fields of another program
        return np.asarray(start)
    b = dispersion(np.asarray(k, float)) * dt / 2
    amplitude = np.abs(150 * np.cos(b) - 25 * np.cos(3 * b) + 3 * np.cos(5 * b)) / 128
    return np.asarray(start / np.maximum(amplitude, MIN_AMPLITUDE))


def elevation_from_w(omega: Values, dt: float, frames: int = 2) -> Values:
    """Factor from the spectrum of w to that of the elevation; infinite at omega = 0.

    Parameters
    ----------
    omega : array_like
        Angular frequency, rad/s.
    dt : float
        Time between frames, s.
    frames : int
        The cube's `path_frames`: 2 of a displacement, 4, 6 or 7 along a path, 1 of an instantaneous velocity.

    Returns
    -------
    array_like
        s2.

    Notes
    -----
    (dt / 2)^2 / (sin b path_factor)^2 with b = omega dt / 2. For displacements between two frames, whose path
    factor is 1, w dt is the difference of two elevations with the gain 2 i sin b; dividing by omega^2 would
    be wrong by sinc^2 b. For instantaneous velocities the factor becomes 1 / omega^2.
    """
    with np.errstate(divide="ignore"):
        path: Any = path_factor(omega, dt, frames)
        factor: Values = (dt / 2) ** 2 / (np.sin(omega * dt / 2) * path) ** 2
    return factor


DIRECTIONS = 8  # of crests, over half a turn: along x, along y and between
CELLS_OF_WEIGHT = 2.0  # standard deviation over which directions are averaged along k
PREDICTED = "linear theory"  # origin of a gain that is predicted


def label(gains: dict[str, Array], k: Array, origin: str) -> xr.Dataset:
    """Turn arrays (DIRECTIONS, k) of amplitude gains into a gain."""
    out = {f"gain_{name}": (("direction", "k"), values) for name, values in gains.items()}
    coords = {"direction": np.arange(DIRECTIONS) * np.pi / DIRECTIONS} | k_coords(k)
    attrs = {"title": "gain of the matching windows", "origin": origin}
    return annotate(xr.Dataset(out, coords, attrs), "gain")


def read_gain(source: str | Path | xr.Dataset) -> xr.Dataset:
    """Read a gain that was saved with ``to_zarr``.

    Parameters
    ----------
    source : path or Dataset
        The store, or the gain itself.

    Returns
    -------
    Dataset
        ``gain_z``, ``gain_w`` and, where present, ``gain_u``, ``gain_v`` (direction, k), of amplitude.

    Raises
    ------
    StoreError
        If it cannot be read or holds no gain of z and w.
    """
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
    """Gain for which spectra of a cube are corrected: the requested one, else that stored; none if False."""
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
    """Whether a gain was predicted by a run, rather than measured or given."""
    return str(gain.attrs.get("origin", "")).startswith(PREDICTED)


def correction(gain: xr.Dataset, name: str, k: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Factor that corrects the power of a field for a gain, and where that can be done; k in rad/m."""
    if f"gain_{name}" not in gain:
        return np.ones_like(k), np.ones(k.shape, bool)
    power = ring_gain(gain, name, name, k)
    valid = power > MIN_AMPLITUDE**2
    return np.where(valid, 1.0 / np.where(valid, power, 1.0), 1.0), valid


def with_directions(gain: xr.Dataset, plane_w: xr.DataArray) -> xr.Dataset:
    """The gain with ``weight`` (direction, k): the fraction of the waves of a ring in each direction.
    From the spectrum of w over (ky, kx); cameras near the horizon lose waves along the line of sight.
    """
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
    """Gain of a power or cross spectrum over rings (k in rad/m); without weights all directions count
    equally.
    """
    product = gain[f"gain_{one}"] * gain[f"gain_{other}"] * gain.get("weight", 1.0 / gain.sizes["direction"])
    product = product.sum("direction", skipna=False)
    known = np.isfinite(product.values)
    # below the lowest ring as in it: windows do not affect waves longer than the rectangle
    values = np.interp(k, product["k"].values[known], product.values[known], right=0.0)
    return np.where(k > product["k"].values[known].max(initial=0.0), 0.0, values)
