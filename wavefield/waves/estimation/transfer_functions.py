"""Gains that averages, differences and windows have in a spectrum, and their correction.

All gains here are of power; b = omega dt / 2.
"""

from typing import Any, TypeVar

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from wavefield.variables import INSTANTANEOUS, PATH_WEIGHTS, annotate
from wavefield.water import dispersion
from wavefield.waves.estimation.welch import Welch
from wavefield.waves.products import WaveProduct, register

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


register(WaveProduct("time_gains", ("welch",), time_gains, group="spectra"))
