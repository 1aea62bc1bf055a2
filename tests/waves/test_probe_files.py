"""Spectra of probes with gaps."""

import numpy as np
import pytest
import xarray as xr

from wavefield.errors import CubeError
from wavefield.waves.probes import probe_spectra


def waves(height, period, rate=10.0, duration=300.0, seed=0):
    """Elevation of irregular waves of a significant height (m) and a mean period (s)."""
    rng = np.random.default_rng(seed)
    time = np.arange(0, duration, 1 / rate)
    omega = 2 * np.pi / period * rng.normal(1, 0.1, 60)
    z = np.cos(omega * time[:, None] + rng.uniform(0, 2 * np.pi, 60)).sum(axis=1)
    return time, z * height / 4 / z.std()


def spectra(time, z, span=None):
    names = [f"p{k}" for k in range(len(z))]
    coords = {"time": time, "probe": names} | {f"probe_{a}": ("probe", np.zeros(len(z))) for a in "xy"}
    omega = xr.DataArray(2 * np.pi * np.arange(90) / 20.0, dims="omega")
    return probe_spectra(xr.Dataset({"elevation": (("probe", "time"), z)}, coords), omega, span or (0, 299))


def test_of_a_record_with_gaps_the_longest_whole_part_is_used():
    seed = 0
    rng = np.random.default_rng(seed)
    time, z = waves(2.0, 5.0, seed=seed)
    first = int(rng.integers(200, 500))
    expected = spectra(time[first + 30 :], z[None, first + 30 :], (time[first + 30], 299.9)).Ez_probes
    holed = z.copy()
    holed[first : first + 30] = np.nan
    with pytest.warns(UserWarning, match="longest part"):
        found = spectra(time, holed[None], (0, 299.9)).Ez_probes
    assert np.allclose(found, expected, equal_nan=True, rtol=1e-6)
    kept = np.delete(np.arange(len(time)), np.arange(first, first + 30))  # a logger that paused
    for clock in (0.0, 0.037):  # and went on at times of its own
        later = time[kept] + clock * (kept > first)
        with pytest.warns(UserWarning, match="longest part"):
            paused = spectra(later, z[None, kept], (0, 299.99)).Ez_probes
        assert np.allclose(paused, expected, equal_nan=True, rtol=2e-3)


def test_without_a_whole_segment_probes_are_refused():
    time, z = waves(2.0, 5.0)
    z[::100] = z[1::100] = z[2::100] = z[3::100] = np.nan
    with pytest.raises(CubeError, match="none is whole for one segment"):
        spectra(time, z[None])
