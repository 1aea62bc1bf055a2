"""The best elevation as a time series: stereo and integrated velocity, filtered without phase."""

from typing import Any

import dask
import dask.array as da
import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft

from wavefield.errors import CubeError
from wavefield.variables import CUBE_DIMS, TABLE
from wavefield.water import water_of
from wavefield.waves.dispersion_relation.doppler_correction import Distances, blend
from wavefield.waves.estimation import wave_kernels
from wavefield.waves.estimation.transfer_functions import path_factor, to_frame_time
from wavefield.waves.estimation.wave_record import Record, fill, find_record, piece
from wavefield.waves.estimation.welch import frames_of, frames_of_z, moves_with_flow
from wavefield.waves.estimation.windows import hann
from wavefield.waves.fused.fused_spectra import NAMES
from wavefield.waves.spectra.cross_spectra import door

Array = NDArray[Any]


def _filter(
    pieces: list[Any],
    steps: Array,
    first: int,
    missing: Array,
    segment: int,
    distances: Distances,
    frames: tuple[int, int],
    with_flow: bool,
    weight: Array,
    gain: Array,
    current: tuple[float, float],
    water: tuple[float, float],
    noise: float,
) -> Array:
    dt = distances[0]
    z, z_t, w = (fill(np.asarray(part), missing) for part in pieces)
    # beyond the ends of a run the waves run backwards in time: z even, its rates odd
    inside = np.clip(steps, first, first + z.shape[0] - 1)
    mirrored = np.where(steps < first, 2 * first - 1 - steps, steps)
    last = first + z.shape[0]
    mirrored = np.where(steps >= last, 2 * last - 1 - steps, mirrored) - first
    sign = np.where(inside == steps, 1.0, -1.0).astype(z.dtype)[:, None, None]
    z, z_t, w = z[mirrored], z_t[mirrored] * sign, w[mirrored] * sign
    half = segment // 2
    shape = z.shape[1:]
    window = hann(segment).astype(z.dtype)[:, None]
    omega = 2 * np.pi * np.arange(half + 1) / (segment * dt)
    b = omega * dt / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        # numpy's signs: exp(+i omega t)
        still = -1j * dt / (2 * np.sin(b) * path_factor(omega, dt, frames[0]))
    still[0] = 0
    advance = np.exp(1j * b)
    out = np.zeros((half, *shape), z.dtype)
    for start, kept in ((0, slice(half, None)), (half, slice(0, half))):
        part = slice(start, start + segment)
        z_flat, z_t_flat = (array[part].reshape(segment, -1) for array in (z, z_t))
        starts = np.empty_like(z_flat)
        halves = [array[some] for array in (z_flat, z_t_flat) for some in (slice(half), slice(half, None))]
        if frames[0] == 2:
            given = *halves, z.dtype.type(dt), 0, starts[:half], starts[half:]
            wave_kernels.frames(*given)
            lines = fft.rfft(starts * window, axis=0)
        else:
            lines = fft.rfft(z_flat * window, axis=0)
            if with_flow and any(current):
                lines *= advance.conj()[:, None]
            else:
                lines += fft.rfft(z_t_flat * window, axis=0) * to_frame_time(omega, dt, *frames)[:, None]
        lines *= advance[:, None]
        risen = fft.rfft(w[part].reshape(segment, -1) * window, axis=0)
        if any(current):
            by_z, by_w = (array.reshape(-1, *shape) for array in (lines, risen))
            moved = blend(by_z, by_w, omega, distances, current, water, noise, frames[0])
            lines = moved.reshape(lines.shape)
        else:
            lines = lines * weight[:, None] + risen * (still * (1 - weight))[:, None]
        lines *= gain[:, None]
        out += fft.irfft(lines, segment, axis=0)[kept].reshape(half, *shape).astype(z.dtype)
    return out


def fused_series(
    cube: xr.Dataset,
    fusion: xr.Dataset,
    *,
    gain: xr.DataArray | None = None,
    record: Record | None = None,
) -> xr.DataArray:
    """Elevation as a time series from the best combination of stereo and integrated velocity.

    Parameters
    ----------
    cube : Dataset
        z, z_t, w over (time, y, x), m and m/s.
    fusion : Dataset
        As `fusion` gives it: its ``weight_z``, segment and current are used; on a current its ``sigma_z`` and
        ``sigma_dz`` in place of the weight.
    gain : DataArray, (omega,), optional
        A gain besides, such as ``fusion.wiener``, which gives the least error but too little variance.
    record : Record, optional
        Rectangle and runs; found from the cube if not given.

    Returns
    -------
    DataArray, (time, y, x)
        Elevation at mid-time over the rectangle and the runs, m; lazy where the cube is.

    Raises
    ------
    CubeError
        If a variable is missing or the record is shorter than the segment of ``fusion``.

    Notes
    -----
    Overlapping Hann-windowed segments, filtered without phase and added up. On a current w is integrated at
    omega - k . U and weighted cell by cell, waves that pass faster than frames follow included; within what
    water goes in .4 s from the edges the result passes to stereo alone.
    """
    names = ["z", "z_t", "w"]
    cube = door(cube, NAMES)
    known = [*names, "quality"] if "quality" in cube else names
    record = find_record(cube[known]) if record is None else record
    segment = int(fusion.attrs["segment"])
    if record.longest < segment:
        raise CubeError(
            f"the record has {record.longest} steps, less than one segment of the fusion, {segment}:"
            " take the fusion with a shorter segment"
        )
    half = segment // 2
    weight = fusion["weight_z"].values
    more = np.ones_like(weight) if gain is None else np.asarray(gain.values, float)
    task = dask.delayed(_filter, pure=False)
    bridged = np.asarray(record.bridged, int)
    ny, nx = record.shape
    dtype = cube["z"].dtype
    distances = record.dt, record.dy, record.dx
    ux, uy = fusion.attrs.get("current", (0.0, 0.0))
    noise = float((fusion["sigma_z"] / fusion["sigma_dz"]) ** 2) if float(fusion["sigma_dz"]) > 0 else np.inf
    moving = (float(ux), float(uy)), water_of(fusion.attrs), noise
    rows, steps_used = [], []
    for run in record.runs:
        if run[1] - run[0] < segment:
            continue
        for a in range(run[0], run[1], half):
            requested = np.arange(a - half, a + 2 * half)
            lo, hi = max(a - half, run[0]), min(a + 2 * half, run[1])
            if hi - lo < 2 * half:  # the end of a run: enough to mirror
                lo = max(hi - 2 * half, run[0])
            area = slice(*record.y), slice(*record.x)
            pieces = [piece(cube[name], slice(lo, hi), *area) for name in names]
            missing = np.isin(np.arange(lo, hi), bridged)
            frames = frames_of(cube), frames_of_z(cube)
            given = segment, distances, frames, moves_with_flow(cube), weight, more
            block = task(pieces, requested, lo, missing, *given, *moving)
            count = min(half, run[1] - a)
            rows.append(da.from_delayed(block, (half, ny, nx), dtype)[:count])
            steps_used.append(np.arange(a, a + count))
    steps = np.concatenate(steps_used)
    out = xr.DataArray(
        da.concatenate(rows),
        {
            "time": cube["time"].isel(time=steps),
            "y": cube["y"].isel(y=slice(*record.y)),
            "x": cube["x"].isel(x=slice(*record.x)),
        },
        CUBE_DIMS,
        name="z",
        attrs=TABLE["z"].attrs | {"comment": "stereo and integrated velocity combined"},
    )
    return out if cube["z"].chunks is not None else out.compute()
