"""Gains of averages, differences and matching windows in a spectrum, and their correction.

Gains of averages and differences are of power; b = omega dt / 2. The gain of the matching windows is measured
on a simulated experiment or predicted from a recipe: a Dataset over (direction, k) with ``gain_z``,
``gain_u``, ``gain_v``, ``gain_w``, of amplitude, NaN where it is not known. Save one with ``gain.to_zarr``.
"""

from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter1d

from wavefield.errors import CubeError, StoreError
from wavefield.variables import CUBE_DIMS, INSTANTANEOUS, PATH_WEIGHTS, annotate, validate
from wavefield.water import dispersion, water_of
from wavefield.waves import rings
from wavefield.waves.products import Product, register
from wavefield.waves.record import Record
from wavefield.waves.welch import (
    Welch,
    frames_of,
    k_coords,
    slabs,
    sum_segments,
    transform_space,
    transform_time,
)

Array = NDArray[Any]
Values = TypeVar("Values", float, Array, xr.DataArray)

MIN_GAIN = 0.1  # below it a correction would only amplify noise
MIN_SIGNAL_TO_NOISE = 3.0
MIN_AMPLITUDE = 0.5  # of a wave after interpolation in time: the correction is at most twofold
# by frames: weights of cos b, cos 3b and cos 5b in the polynomial through the frames at its middle
MEAN_WEIGHTS = {2: (1,), 4: (9, -1), 6: (150, -25, 3)}


def gain_frame_mean(omega: Values, dt: float, frames: int = 2) -> Values:
    """Gain of the polynomial through two, four or six frames at its middle.

    Parameters
    ----------
    omega : array_like
        Angular frequency, rad/s.
    dt : float
        Time between frames, s.
    frames : int
        2, 4 or 6; of two it is their mean.

    Returns
    -------
    array_like
        Gain of power, 0 to 1.

    Notes
    -----
    cos^2 b of two frames, ((9 cos b - cos 3b) / 8)^2 of four,
    ((150 cos b - 25 cos 3b + 3 cos 5b) / 128)^2 of six.

    Examples
    --------
    >>> [round(float(gain_frame_mean(2 * np.pi * 5, 0.05, frames)), 2) for frames in (2, 6)]
    [0.5, 0.9]
    """
    weights = MEAN_WEIGHTS[frames]
    b = omega * dt / 2
    total: Any = sum(weight * np.cos((2 * n + 1) * b) for n, weight in enumerate(weights))
    gain: Values = (total / sum(weights)) ** 2
    return gain


def path_factor(omega: Values, dt: float, frames: int) -> Values:
    """Amplitude of a velocity along a path over that of one displacement; omega in rad/s.
    w_0 + 2 w_1 cos omega dt + 2 w_2 cos 2 omega dt with `PATH_WEIGHTS` w; b / sin b of instantaneous ones.
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


def to_frame_time(omega: Array, dt: float, frames: int, z_frames: int = 4) -> Array:
    """Factor T so that z + T z_t is the elevation at a step's first frame, in numpy's signs exp(+i omega t).
    T is in seconds, omega in rad/s.
    """
    # with d differences over dt the mean of the two frames is z + (dt / 16) (d(k+1) - d(k-1)) of four frames,
    # z + (dt / 256) [22 (d(k+1) - d(k-1)) - 3 (d(k+2) - d(k-2))] of six
    if z_frames == 6:
        mean = dt / 128 * 1j * (22 * np.sin(omega * dt) - 3 * np.sin(2 * omega * dt))
    else:
        mean = dt / 8 * 1j * np.sin(omega * dt)
    return np.asarray((mean - dt / 2) / path_factor(omega, dt, frames))


def from_moving_frame(k: Array, omega: Array, dt: float) -> Array:
    """Factor from z at mid-time in a frame that moves with the mean flow to z at the step's first frame.
    In it a free wave turns by sigma(k) dt per frame; the gain of six frames is corrected, up to twofold.
    """
    amplitude = np.sqrt(gain_frame_mean(dispersion(np.asarray(k, float)), dt, 6))
    return np.asarray(np.exp(-0.5j * omega * dt) / np.maximum(amplitude, MIN_AMPLITUDE))


def gain_displacement(omega: Values, dt: float, frames: int = 2) -> Values:
    """Gain of a velocity taken from the displacement over dt, (sin b / b)^2, or along a path.

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
        Gain of power, 0 to 1.
    """
    sinc: Any = np.sinc(omega * dt / (2 * np.pi))
    gain: Values = (sinc * path_factor(omega, dt, frames)) ** 2
    return gain


def elevation_from_w(omega: Values, dt: float, frames: int = 2) -> Values:
    """Factor from the spectrum of w to that of the elevation, (dt / 2)^2 / sin^2 b; infinite at omega = 0.

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
    Exact for finite displacements: w dt is the difference of two elevations, whose gain is 2 i sin b.
    Dividing by omega^2 instead is wrong by sinc^2 b.
    """
    with np.errstate(divide="ignore"):
        path: Any = path_factor(omega, dt, frames)
        factor: Values = (dt / 2) ** 2 / (np.sin(omega * dt / 2) * path) ** 2
    return factor


def gain_box(kx: ArrayLike, ky: ArrayLike, width: float) -> Array:
    """Gain of the mean over a square box, (sin(kx a/2) / (kx a/2))^2 times the same in y.

    Parameters
    ----------
    kx, ky : array_like
        Wavenumbers, rad/m.
    width : float
        Side a of the box, m.

    Returns
    -------
    array_like
        Gain of power, 0 to 1.

    Examples
    --------
    A 4 cm box at 10 cm wavelength:

    >>> round(float(gain_box(2 * np.pi / 0.1, 0.0, 0.04)), 2)
    0.57
    """
    along_x, along_y = (np.sinc(np.asarray(k) * width / (2 * np.pi)) for k in (kx, ky))
    return np.asarray((along_x * along_y) ** 2)


def undo(energy: xr.DataArray, gain: xr.DataArray, noise: xr.DataArray | float = 0.0) -> xr.Dataset:
    """Divide a spectrum by a power gain where that can be trusted.

    Parameters
    ----------
    energy : DataArray
        A spectrum as measured, noise included.
    gain : DataArray
        Power gain over some of its dimensions, from a calibration on simulated images or one of this module.
    noise : DataArray or float, optional
        Noise in the spectrum; subtracted first.

    Returns
    -------
    Dataset
        ``E``, corrected (NaN where not valid), and ``valid``: gain above 0.1 and signal above 3 times the
        noise.
    """
    signal = energy - noise
    valid = (gain > MIN_GAIN) & (signal > MIN_SIGNAL_TO_NOISE * noise)
    corrected = (signal / gain).where(valid)
    corrected.attrs = dict(energy.attrs)
    return annotate(xr.Dataset({"E": corrected, "valid": valid}))


def time_gains(welch: Welch) -> xr.Dataset:
    """Power gains (omega,) of the mean of two, four and six frames, and of displacements."""
    omega, dt = welch.omega, welch.record.dt
    means = {
        f"gain_{word}_frames": gain_frame_mean(omega, dt, n)
        for n, word in zip((2, 4, 6), ("two", "four", "six"))
    }
    gains = means | {"gain_displacement": gain_displacement(omega, dt, welch.frames)}
    return xr.Dataset({name: ("omega", gain) for name, gain in gains.items()})


register(Product("time_gains", ("welch",), time_gains, group="spectra"))


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
    return {"measured": transform_space(measured), "true": transform_space(exact)}


def _sums(
    near: Array, path: Array, first: dict[str, Array], second: dict[str, Array], begin: int
) -> dict[str, Array]:
    """Powers and products per cell over the band around the dispersion relation, at both signs of omega."""
    out = {name: np.zeros(near.shape[0]) for name in ("true", "measured", "cross", "quadrature")}
    for slab in slabs(near.shape[0]):
        mine, true = (transform_time(first[name][slab], second[name][slab]) for name in ("measured", "true"))
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
        sums = sum_segments(arrays, record, welch.half, make, partial(_sums, near, path)).compute()
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
