"""The best elevation as a time series: stereo and integrated velocity, filtered without phase."""

from dataclasses import dataclass
from typing import Any

import dask
import dask.array as da
import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft

from wavefield.errors import CubeError
from wavefield.variables import CUBE_DIMS, INSTANTANEOUS, TABLE
from wavefield.water import water_of
from wavefield.waves.dispersion_relation.doppler_correction import Distances, blend
from wavefield.waves.estimation import wave_kernels
from wavefield.waves.estimation.inputs import a_cube, takes
from wavefield.waves.estimation.transfer_functions import path_factor, to_frame_time
from wavefield.waves.estimation.wave_record import Record, fill, find_record, piece
from wavefield.waves.estimation.welch import frames_of, frames_of_z, moves_with_flow
from wavefield.waves.estimation.windows import hann
from wavefield.waves.fused.fused_spectra import NAMES
from wavefield.waves.spectra.cross_spectra import door

Array = NDArray[Any]


@dataclass(frozen=True)
class _Filter:
    """Combines stereo and integrated velocity of half a segment, from the segments on either side of it."""

    segment: int
    distances: Distances
    frames: tuple[int, int]  # that velocities and that elevations come from
    with_flow: bool  # whether z is interpolated in time in a frame that moves with the mean flow
    weight: Array  # (omega,), of stereo, on still water
    gain: Array  # (omega,)
    current: tuple[float, float]  # m/s
    water: tuple[float, float]  # depth, surface tension over density
    noise: float  # variance of z over that of dz

    def __call__(self, pieces: list[object], steps: Array, first: int, missing: Array) -> Array:
        """Elevation (n / 2, ny, nx) from z, z_t and w from the step `first` on, for steps (3 n / 2,)."""
        segment, dt, flows = self.segment, self.distances[0], any(self.current)
        z, z_t, w = (fill(np.asarray(part), missing) for part in pieces)
        # beyond the ends of a run the waves run backwards in time: z even, its rates odd
        last = first + z.shape[0]
        mirrored = np.where(steps < first, 2 * first - 1 - steps, steps)
        mirrored = np.where(steps >= last, 2 * last - 1 - steps, mirrored) - first
        sign = np.where((steps >= first) & (steps < last), 1.0, -1.0).astype(z.dtype)[:, None, None]
        z, z_t, w = z[mirrored], z_t[mirrored] * sign, w[mirrored] * sign
        half, shape = segment // 2, z.shape[1:]
        window = hann(segment).astype(z.dtype)[:, None]
        omega = 2 * np.pi * np.arange(half + 1) / (segment * dt)
        b = omega * dt / 2
        with np.errstate(divide="ignore", invalid="ignore"):
            # numpy's signs: exp(+i omega t)
            integral = -1j * dt / (2 * np.sin(b) * path_factor(omega, dt, self.frames[0]))
        integral[0] = 0
        out = np.zeros((half, *shape), z.dtype)
        for start, used in ((0, slice(half, None)), (half, slice(0, half))):
            part = slice(start, start + segment)
            z_flat, z_t_flat, w_flat = (array[part].reshape(segment, -1) for array in (z, z_t, w))
            lines = self._z_lines(z_flat, z_t_flat, window, omega)
            lines *= np.exp(1j * b)[:, None]
            w_lines = fft.rfft(w_flat * window, axis=0)
            if flows:
                z_plane, w_plane = (array.reshape(-1, *shape) for array in (lines, w_lines))
                blended = blend(
                    z_plane,
                    w_plane,
                    omega,
                    self.distances,
                    self.current,
                    self.water,
                    self.noise,
                    self.frames[0],
                )
                lines = blended.reshape(lines.shape)
            else:
                weight = self.weight[:, None]
                lines = lines * weight + w_lines * (integral * (1 - self.weight))[:, None]
            lines *= self.gain[:, None]
            out += fft.irfft(lines, segment, axis=0)[used].reshape(half, *shape).astype(z.dtype)
        return out

    def _z_lines(self, z: Array, z_t: Array, window: Array, omega: Array) -> Array:
        """Transform in time, (lines, nodes), of z at the first frames of the steps."""
        dt, half = self.distances[0], self.segment // 2
        if self.frames[0] == 2:
            starts = np.empty_like(z)
            halves = [array[part] for array in (z, z_t) for part in (slice(half), slice(half, None))]
            arguments = *halves, z.dtype.type(dt), 0, starts[:half], starts[half:]
            wave_kernels.frames(*arguments)
            return np.asarray(fft.rfft(starts * window, axis=0))
        lines = np.asarray(fft.rfft(z * window, axis=0))
        if self.frames[0] == INSTANTANEOUS or (self.with_flow and any(self.current)):
            lines *= np.exp(1j * (omega * dt / 2)).conj()[:, None]
        else:
            lines += fft.rfft(z_t * window, axis=0) * to_frame_time(omega, dt, *self.frames)[:, None]
        return lines


@takes(a_cube)
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
        As `fused_spectra` gives it: its ``weight_z``, segment and current are used; on a current its
        ``sigma_z`` and ``sigma_dz`` in place of the weight.
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
    omega - k . U and weighted cell by cell, waves that pass faster than frames follow included; nearer to the
    edges than water moves in 0.4 s the result is stereo alone.
    """
    names = ["z", "z_t", "w"]
    cube = door(cube, NAMES)
    record = (
        find_record(cube[[*names, "quality"] if "quality" in cube else names]) if record is None else record
    )
    segment = int(fusion.attrs["segment"])
    if record.longest < segment:
        raise CubeError(
            f"the record has {record.longest} steps, less than one segment of the fusion, {segment}:"
            " take the fusion with a shorter segment"
        )
    half = segment // 2
    weight = fusion["weight_z"].values
    ux, uy = fusion.attrs.get("current", (0.0, 0.0))
    filtered = _Filter(
        segment,
        (record.dt, record.dy, record.dx),
        (frames_of(cube), frames_of_z(cube)),
        moves_with_flow(cube),
        weight,
        np.ones_like(weight) if gain is None else np.asarray(gain.values, float),
        (float(ux), float(uy)),
        water_of(fusion.attrs),
        float((fusion["sigma_z"] / fusion["sigma_dz"]) ** 2) if float(fusion["sigma_dz"]) > 0 else np.inf,
    )
    task = dask.delayed(filtered, pure=False)
    area = slice(*record.y), slice(*record.x)
    blocks, steps_used = [], []
    for start, stop in record.runs:
        if stop - start < segment:
            continue
        for a in range(start, stop, half):
            requested = np.arange(a - half, a + 2 * half)
            first, last = max(a - half, start), min(a + 2 * half, stop)
            if last - first < segment:  # the end of a run: enough to mirror
                first = max(last - segment, start)
            pieces = [piece(cube[name], slice(first, last), *area) for name in names]
            missing = np.isin(np.arange(first, last), record.bridged)
            count = min(half, stop - a)
            block = task(pieces, requested, first, missing)
            blocks.append(da.from_delayed(block, (half, *record.shape), cube["z"].dtype)[:count])
            steps_used.append(np.arange(a, a + count))
    steps = np.concatenate(steps_used)
    out = xr.DataArray(
        da.concatenate(blocks),
        {
            "time": cube["time"].isel(time=steps),
            "y": cube["y"].isel(y=area[0]),
            "x": cube["x"].isel(x=area[1]),
        },
        CUBE_DIMS,
        name="z",
        attrs=TABLE["z"].attrs | {"comment": "stereo and integrated velocity combined"},
    )
    return out if cube["z"].chunks is not None else out.compute()
