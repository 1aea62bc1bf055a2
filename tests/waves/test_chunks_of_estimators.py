"""Estimators that read a record in pieces give the same bits however it is chunked, and bridge its gaps."""

import numpy as np
import pytest
import xarray as xr
from independent_seas import LatticeSea

import wavefield as wf

CALLS = {
    "linear_surface": lambda cube: wf.linear_surface(cube),
    "wavelet_directions": lambda cube: wf.wavelet_directions(cube.w, (1.6, 2.0)),
    "ridge_broadening": lambda cube: wf.ridge_broadening(cube.w, current=(0.0, 0.0)),
    "energy_flux": lambda cube: wf.energy_flux(
        cube * np.exp(-0.1 * cube.time).astype("f4"), frequencies=(1.0, 2.0, 3.0)
    ),
}


@pytest.fixture(scope="module")
def sea():
    directions = ((0.4, 10.0, 1.0),)
    lattice = LatticeSea(side=200, shape=(400, 32, 36), directions=directions, lowest=1.4, depth=5.0)
    return lattice.cube(1, names=("z", "w"))


@pytest.mark.parametrize("name", CALLS)
def test_chunks_change_no_bit(sea, name):
    whole = CALLS[name](sea)
    chunked = CALLS[name](sea.chunk(time=37, y=11))
    xr.testing.assert_identical(whole, chunked)


@pytest.mark.parametrize(
    ("name", "variable", "tolerance"),
    [
        ("linear_surface", "z_linear", 0.001),  # m
        ("wavelet_directions", "direction", 0.05),  # rad
        ("ridge_broadening", "frequency_shift", 0.05),  # rad/s
        ("energy_flux", "decay_rate", 0.03),  # 1/s
    ],
)
def test_missing_steps_and_nodes_are_bridged(sea, name, variable, tolerance):
    holes = sea.copy(deep=True)
    for values in holes.values():
        values[200] = np.nan
        values[100:120, 10:12, 20:22] = np.nan
    off = np.subtract(*(CALLS[name](cube)[variable].values for cube in (holes, sea)))
    assert np.isfinite(off).mean() > 0.15
    assert np.sqrt(np.nanmean(off**2)) < tolerance
