"""Gain of the matching windows: measured on a simulated experiment, or predicted from a recipe.

A gain is a Dataset over (direction, k): ``gain_z``, ``gain_u``, ``gain_v``, ``gain_w``, of amplitude, NaN
where it is not known. Save one with ``gain.to_zarr``.
"""

from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from wavefield.errors import CubeError, StoreError
from wavefield.variables import CUBE_DIMS, annotate, validate
from wavefield.water import dispersion, water_of
from wavefield.waves.estimation import rings, segments
from wavefield.waves.estimation.record import Record
from wavefield.waves.estimation.transfer_functions import path_factor
from wavefield.waves.estimation.welch import Welch, frames_of, k_coords

Array = NDArray[Any]

DIRECTIONS = 8  # of crests, over half a turn: along x, along y and between
HALF_BAND = 0.12  # of omega, around the dispersion relation
MIN_HALF_BAND_LINES = 3
MIN_POWER_GAIN = 0.25  # half the amplitude of a wave: less is not corrected
CELLS_OF_WEIGHT = 2.0  # standard deviation over which directions are averaged along k
MIN_COHERENCE = 0.3  # squared, with the truth: below it the gain is not known
PREDICTED = "linear theory"  # origin of a gain that is predicted
# field: measured variable, variable of the truth
_TRUTH = {"z": ("z_t", "z_t"), "u": ("u", "dx"), "v": ("v", "dy"), "w": ("w", "dz")}


def _pair(measured: Array, exact: Array) -> dict[str, Array]:
    return {"measured": segments.transform_space(measured), "true": segments.transform_space(exact)}


def _sums(
    near: Array, path: Array, first: dict[str, Array], second: dict[str, Array], begin: int
) -> dict[str, Array]:
    """Powers and products per cell over the band around the dispersion relation, at both signs of omega."""
    out = {name: np.zeros(near.shape[0]) for name in ("true", "measured", "cross", "quadrature")}
    for slab in segments.slabs(near.shape[0]):
        mine, true = (
            segments.transform_time(first[name][slab], second[name][slab]) for name in ("measured", "true")
        )
        mine /= path  # the effect of paths in time is not that of windows
        band = near[slab]
        cross = (true.conj() * mine * band).sum(axis=1)
        out["true"][slab] = (np.abs(true) ** 2 * band).sum(axis=1)
        out["measured"][slab] = (np.abs(mine) ** 2 * band).sum(axis=1)
        out["cross"][slab], out["quadrature"][slab] = cross.real, cross.imag
    return out


def label(gains: dict[str, Array], k: Array, origin: str) -> xr.Dataset:
    """Turn arrays (DIRECTIONS, k) of amplitude gains into a gain."""
    out = {f"gain_{name}": (("direction", "k"), values) for name, values in gains.items()}
    coords = {"direction": np.arange(DIRECTIONS) * np.pi / DIRECTIONS} | k_coords(k)
    attrs = {"title": "gain of the matching windows", "origin": origin}
    return annotate(xr.Dataset(out, coords, attrs), "gain")


def window_gain(
    measured: xr.Dataset,
    exact: xr.Dataset,
    *,
    depth: float | None = None,
    segment: int | None = None,
    record: Record | None = None,
) -> xr.Dataset:
    """Measure the gain of the measured over the true waves, near the dispersion relation.

    Parameters
    ----------
    measured : Dataset
        Cube measured from simulated images: z_t, w and, if present, u, v over (time, y, x), m/s.
    exact : Dataset
        Its truth at the same steps and nodes (``truth/truth.zarr``): z_t, m/s, and dz, dx, dy, m.
    depth : float, optional
        Depth of the water, m; the attribute ``water_depth`` of the cube, or deep, if not given.
    segment : int, optional
        Steps of a Welch segment; chosen from the record if not given.
    record : Record, optional
        Rectangle and runs; found from the cube if not given.

    Returns
    -------
    Dataset
        ``gain_z``, ``gain_w`` and, where both have them, ``gain_u``, ``gain_v`` (direction, k): amplitude
        gains, 1 where nothing is lost; ``coherence_z`` ... (k): squared coherence with the truth. A gain is
        NaN from where that falls below 0.3. Computed at once.

    Raises
    ------
    CubeError
        If a variable is missing, the truth is of other steps or nodes, or the record is too short.

    Notes
    -----
    H = Re <F_true* F_measured> / <|F_true|^2> over the band near the dispersion relation and the cells of a
    ring within a sector of directions. It holds for the cameras, the windows and the texture that were
    simulated.
    """
    for dataset, needed, what in ((measured, ("z_t", "w"), "cube"), (exact, ("z_t", "dz"), "truth")):
        for name in needed:
            if name not in dataset:
                raise CubeError(f"the {what} has no {name!r}: the gain of the windows needs it")
    for name in CUBE_DIMS:
        same = measured.sizes[name] == exact.sizes[name]
        if not same or not np.allclose(measured[name].values, exact[name].values, rtol=0, atol=1e-6):
            raise CubeError(f"cube and truth differ in {name!r}: they must hold the same steps and nodes")
    pairs = {n: (a, b) for n, (a, b) in _TRUTH.items() if a in measured and b in exact}
    measured = validate(measured, *sorted({a for a, _ in pairs.values()})).assign_attrs(measured.attrs)
    exact = validate(exact, *sorted({b for _, b in pairs.values()}))
    welch = Welch.of(measured, segment, record)
    record, table = welch.record, welch.table
    water = water_of(measured.attrs, depth)

    ny, nx = record.shape
    ky = rings.wavenumbers(ny, record.dy)[:, None]
    kx = np.abs(rings.wavenumbers(nx, record.dx)[: nx // 2 + 1])
    k = np.hypot(ky, kx).ravel()
    omega = np.abs(2 * np.pi * np.fft.fftfreq(welch.segment, record.dt))
    ridge = dispersion(k, *water)[:, None]
    near = np.abs(omega - ridge) < np.maximum(HALF_BAND * ridge, MIN_HALF_BAND_LINES * omega[1])
    ring = np.minimum((k / table.dk).astype(int), table.k.size - 1)
    turn = np.arctan2(ky, kx).ravel() * DIRECTIONS / np.pi
    place = (np.rint(turn).astype(int) % DIRECTIONS) * table.k.size + ring

    signed = 2 * np.pi * np.fft.fftfreq(welch.segment, record.dt)
    path = path_factor(signed, record.dt, welch.frames) / path_factor(signed, record.dt, frames_of(exact))
    gains, coherences = {}, {}
    for name, (mine, true) in pairs.items():
        scale = 1.0 if name == "z" else record.dt

        def make(blocks: list[Array], first: int, scale: float = scale) -> dict[str, Array]:
            return _pair(blocks[0], blocks[1] / blocks[1].dtype.type(scale))

        arrays = [measured[mine], exact[true]]
        sums = segments.sum_segments(arrays, record, welch.half, make, partial(_sums, near, path)).compute()
        shape = (DIRECTIONS, table.k.size)
        power, own, cross, quadrature = (
            np.bincount(place, sums[n], DIRECTIONS * table.k.size).reshape(shape)
            for n in ("true", "measured", "cross", "quadrature")
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            # the longest waves have no cell in some sectors: those take their ring's
            gain = np.where(power > 0, cross / power, cross.sum(axis=0) / power.sum(axis=0))
            both = cross.sum(axis=0) ** 2 + quadrature.sum(axis=0) ** 2
            coherence = both / (power.sum(axis=0) * own.sum(axis=0))
        lost = np.cumsum((coherence < MIN_COHERENCE) & (np.arange(table.k.size) > 1)) > 0
        gains[name], coherences[name] = np.where(lost, np.nan, gain), coherence
    out = label(gains, table.k, "measured on a simulated experiment")
    for name, values in coherences.items():
        out[f"coherence_{name}"] = ("k", values)
    return annotate(out.assign_attrs(segment=welch.segment, water_depth=water[0]), "gain")


def read_gain(source: str | Path | xr.Dataset) -> xr.Dataset:
    """Read a gain that was saved with ``to_zarr``.

    Parameters
    ----------
    source : path or Dataset
        The store, or the gain itself.

    Returns
    -------
    Dataset
        As `window_gain` gives it.

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
            raise StoreError(
                f"the gain has no {name!r} over direction and k: make one with wavefield.waves.window_gain"
            )
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
    if not all(
        float(own[name].isel(k=0).mean()) > np.sqrt(MIN_POWER_GAIN) for name in names
    ):  # NaN of a light sheet
        return None
    return own.assign_attrs(origin=f"{PREDICTED}, from what the run learned of its record")


def is_predicted(gain: xr.Dataset) -> bool:
    """Whether a gain is predicted from what a run learned, not measured or given."""
    return str(gain.attrs.get("origin", "")).startswith(PREDICTED)


def correction(gain: xr.Dataset, name: str, k: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Factor that corrects the power of a field for a gain, and where that can be done; k in rad/m."""
    if f"gain_{name}" not in gain:
        return np.ones_like(k), np.ones(k.shape, bool)
    power = ring_gain(gain, name, name, k)
    valid = power > MIN_POWER_GAIN
    return np.where(valid, 1.0 / np.where(valid, power, 1.0), 1.0), valid


def with_directions(gain: xr.Dataset, plane_w: xr.DataArray) -> xr.Dataset:
    """The gain with ``weight`` (direction, k): the part of a ring's waves in each direction.
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
    waves = energy / np.maximum(gain["gain_w"].transpose("direction", "k").values ** 2, MIN_POWER_GAIN)
    weight = waves / np.maximum(waves.sum(axis=0), np.finfo(float).tiny)
    return gain.assign(weight=(("direction", "k"), weight))


def ring_gain(gain: xr.Dataset, one: str, other: str, k: Array) -> Array:
    """Gain of a power or cross spectrum over rings (k in rad/m); directions count evenly without weights."""
    product = gain[f"gain_{one}"] * gain[f"gain_{other}"] * gain.get("weight", 1.0 / gain.sizes["direction"])
    product = product.sum("direction", skipna=False)
    known = np.isfinite(product.values)
    # below the lowest ring as in it: windows do not affect waves longer than the rectangle
    values = np.interp(k, product["k"].values[known], product.values[known], right=0.0)
    return np.where(k > product["k"].values[known].max(initial=0.0), 0.0, values)
