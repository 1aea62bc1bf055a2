"""Gains in time on the frequencies of a record: what averaging frames takes from its spectra."""

import xarray as xr

from wavefield.waves.estimation.transfer_functions import gain_displacement, gain_frame_mean
from wavefield.waves.estimation.welch import Welch
from wavefield.waves.products import Product, register

_FRAMES = {2: "two", 4: "four", 6: "six"}


def time_gains(welch: Welch) -> xr.Dataset:
    """Power gains (omega,) of the mean of two, four and six frames, and of displacements."""
    omega, dt = welch.omega, welch.record.dt
    means = {f"gain_{word}_frames": gain_frame_mean(omega, dt, n) for n, word in _FRAMES.items()}
    gains = means | {"gain_displacement": gain_displacement(omega, dt, welch.frames)}
    return xr.Dataset({name: ("omega", gain) for name, gain in gains.items()})


register(Product("time_gains", ("welch",), time_gains, group="spectra"))
