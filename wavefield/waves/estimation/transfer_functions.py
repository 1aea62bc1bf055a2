"""What measuring does to a spectrum: gains of averages, differences and windows, and their undoing.

All gains here are of power; b = omega dt / 2.
"""

from typing import Any

import numpy as np
import xarray as xr

from wavefield.variables import PATH_WEIGHTS, annotate
from wavefield.water import dispersion

LEAST_GAIN = 0.1  # below it a correction would only blow up noise
LEAST_SIGNAL = 3.0  # signal over noise
MIN_AMPLITUDE = 0.5  # of a wave that an interpolation in time leaves: less is not undone altogether


def gain_two_frames(omega: Any, dt: float) -> Any:
    """Gain of the mean of two frames, cos^2 b.

    Parameters
    ----------
    omega : array_like
        Angular frequency, rad/s.
    dt : float
        Time between frames, s.

    Returns
    -------
    array_like
        Gain of power, 0 to 1.

    Examples
    --------
    >>> round(float(gain_two_frames(2 * np.pi * 5, 0.05)), 2)
    0.5
    """
    return np.cos(omega * dt / 2) ** 2


def gain_four_frames(omega: Any, dt: float) -> Any:
    """Gain of the cubic through four frames at its middle, ((9 cos b - cos 3b) / 8)^2.

    Parameters
    ----------
    omega : array_like
        Angular frequency, rad/s.
    dt : float
        Time between frames, s.

    Returns
    -------
    array_like
        Gain of power, 0 to 1.
    """
    b = omega * dt / 2
    return ((9 * np.cos(b) - np.cos(3 * b)) / 8) ** 2


def gain_six_frames(omega: Any, dt: float) -> Any:
    """Gain of the polynomial through six frames at its middle, ((150 cos b - 25 cos 3b + 3 cos 5b) / 128)^2.

    Parameters
    ----------
    omega : array_like
        Angular frequency, rad/s.
    dt : float
        Time between frames, s.

    Returns
    -------
    array_like
        Gain of power, 0 to 1.

    Examples
    --------
    >>> round(float(gain_six_frames(2 * np.pi * 5, 0.05)), 2)
    0.9
    """
    b = omega * dt / 2
    return ((150 * np.cos(b) - 25 * np.cos(3 * b) + 3 * np.cos(5 * b)) / 128) ** 2


def path_factor(omega: Any, dt: float, frames: int) -> Any:
    """Amplitude of a velocity along a path over that of one displacement.

    With weights w of displacements d (`wavefield.variables.PATH_WEIGHTS`), w_0 d(k) + w_1 [d(k-1) + d(k+1)]
    + ..., it is w_0 + 2 w_1 cos omega dt + 2 w_2 cos 2 omega dt: (26 - 2 cos omega dt) / 24 of four frames.

    With omega, rad/s.

    Examples
    --------
    Waves of 5 Hz in 40 frames/s:

    >>> [round(float(path_factor(2 * np.pi * 5, 0.025, frames)), 3) for frames in (4, 6)]
    [1.024, 1.003]
    """
    own, *beside = PATH_WEIGHTS[frames]
    out = np.full_like(omega, own, dtype=float)
    for n, weight in enumerate(beside, 1):
        out = out + 2 * weight * np.cos(n * omega * dt)
    return out


def to_frame_time(omega: Any, dt: float, frames: int, z_frames: int = 4) -> Any:
    """Factor T so that z + T z_t is the elevation at a step's first frame, in numpy's signs exp(+i omega t).

    With d the differences over dt, the mean of the two frames is z + (dt / 16) (d(k+1) - d(k-1)) for four
    frames, z + (dt / 256) [22 (d(k+1) - d(k-1)) - 3 (d(k+2) - d(k-2))] for six.

    With omega, rad/s.
    """
    if z_frames == 6:
        mean = dt / 128 * 1j * (22 * np.sin(omega * dt) - 3 * np.sin(2 * omega * dt))
    else:
        mean = dt / 8 * 1j * np.sin(omega * dt)
    return (mean - dt / 2) / path_factor(omega, dt, frames)


def from_moving_frame(k: Any, omega: Any, dt: float) -> Any:
    """Factor from z at mid-time in a frame that moves with the mean flow to z at the step's first frame.

    Beside the mean flow a free wave turns by sigma(k) dt from frame to frame, whatever the current: of its
    amplitude six frames leave the root of `gain_six_frames` of that, which is undone, up to twofold. Half a
    step earlier its phase is less by omega dt / 2.

    With k, rad/m; omega, rad/s.
    """
    kept = np.sqrt(gain_six_frames(dispersion(np.asarray(k, float)), dt))
    return np.exp(-0.5j * omega * dt) / np.maximum(kept, MIN_AMPLITUDE)


def gain_displacement(omega: Any, dt: float, frames: int = 2) -> Any:
    """Gain of a velocity taken from the displacement over dt, (sin b / b)^2, or along a path.

    Parameters
    ----------
    omega : array_like
        Angular frequency, rad/s.
    dt : float
        Time between frames, s.
    frames : int
        Frames that the velocity comes from (`path_factor`).

    Returns
    -------
    array_like
        Gain of power, 0 to 1.
    """
    return (np.sinc(omega * dt / (2 * np.pi)) * path_factor(omega, dt, frames)) ** 2


def elevation_from_w(omega: Any, dt: float, frames: int = 2) -> Any:
    """Factor from the spectrum of w to that of the elevation, (dt / 2)^2 / sin^2 b; infinite at omega = 0.

    Parameters
    ----------
    omega : array_like
        Angular frequency, rad/s.
    dt : float
        Time between frames, s.
    frames : int
        Frames that the velocity comes from (`path_factor`).

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
        return (dt / 2) ** 2 / (np.sin(omega * dt / 2) * path_factor(omega, dt, frames)) ** 2


def gain_box(kx: Any, ky: Any, width: float) -> Any:
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
    return (np.sinc(kx * width / (2 * np.pi)) * np.sinc(ky * width / (2 * np.pi))) ** 2


def undo(energy: xr.DataArray, gain: xr.DataArray, noise: xr.DataArray | float = 0.0) -> xr.Dataset:
    """Divide a spectrum by a power gain where that can be trusted.

    Parameters
    ----------
    energy : DataArray
        A spectrum as measured, noise included.
    gain : DataArray
        Power gain over some of its dimensions, from a calibration on simulated images or one of this module.
    noise : DataArray or float, optional
        Noise in the spectrum; taken off first.

    Returns
    -------
    Dataset
        ``E``, corrected (NaN where not valid), and ``valid``: gain above 0.1 and signal above 3 times the
        noise.
    """
    signal = energy - noise
    valid = (gain > LEAST_GAIN) & (signal > LEAST_SIGNAL * noise)
    corrected = (signal / gain).where(valid)
    corrected.attrs = dict(energy.attrs)
    return annotate(xr.Dataset({"E": corrected, "valid": valid}))
