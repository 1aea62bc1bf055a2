"""Gains in time on the frequencies of a record: what averaging frames takes from its spectra."""

import xarray as xr

from wavefield.waves.estimation import transfer_functions
from wavefield.waves.estimation.welch import Welch
from wavefield.waves.products import Product, register


def time_gains(welch: Welch) -> xr.Dataset:
    """Power gains (omega,) of the mean of two, four and six frames, and of displacements."""
    means = (
        transfer_functions.gain_two_frames,
        transfer_functions.gain_four_frames,
        transfer_functions.gain_six_frames,
    )
    out = {gain.__name__: ("omega", gain(welch.omega, welch.record.dt)) for gain in means}
    displacement = transfer_functions.gain_displacement(welch.omega, welch.record.dt, welch.frames)
    return xr.Dataset(out | {"gain_displacement": ("omega", displacement)})


register(Product("time_gains", ("welch",), time_gains, group="spectra"))
