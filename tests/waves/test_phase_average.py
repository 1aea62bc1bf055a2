"""Phase averages, exponents of spectra, and the water below the surface, against exact truth."""

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from waves_cases import cube

import wavefield as wf
from wavefield.errors import CubeError


@settings(max_examples=5, deadline=None, derandomize=True)
@given(
    period=st.floats(0.31, 1.4),
    noise=st.floats(1e-4, 3e-3),
    second=st.floats(0, 0.4),
    seed=st.integers(0, 99),
    drift=st.floats(-0.01, 0.01),
)
def test_harmonics_of_a_wave_maker_are_found_in_other_waves(period, noise, second, seed, drift):
    rng = np.random.default_rng(seed)
    t, y, x = np.arange(500) * 0.05, np.arange(8) * 0.04, np.arange(9) * 0.04
    # a wave maker whose period drifts: the probe follows it
    phase = 2 * np.pi * (t / period + drift * (t / t[-1]) ** 2 * t[-1] / period)
    place = 5 * x + 2 * y[:, None]
    angle = phase[:, None, None] - place
    z = 0.01 * np.cos(angle) + second * 0.01 * np.cos(2 * angle + 0.7)
    z = z + noise * rng.standard_normal(z.shape)
    made = cube({"z": z}, t, y, x, "f8")
    times = np.arange(-20, 2520) * 0.01
    stroke = np.cos(2 * np.pi * (times / period + drift * (times / t[-1]) ** 2 * t[-1] / period))
    probe = xr.DataArray(stroke, {"time": times}, ("time",))
    found = wf.phase_average(made, probe=probe)
    size = found.harmonic_amplitude.mean(("y", "x")).values
    # sums of steps scatter by noise sqrt(2 / 500) at each node; the probe's phase adds a little
    error = 4 * noise * np.sqrt(2 / 500)
    assert size[0] == pytest.approx(0.01, abs=error + 3e-4)
    assert size[1] == pytest.approx(second * 0.01, abs=error + 3e-4)
    assert found.attrs["period"] == pytest.approx(period, rel=0.03)
    assert float(found.z_rest.mean()) == pytest.approx(noise, rel=0.1, abs=4e-4)


def test_standard_uncertainties_of_phase_averages_cover_their_errors():
    rng = np.random.default_rng(5)
    t, y, x = np.arange(600) * 0.05, np.arange(12) * 0.04, np.arange(14) * 0.04
    z = 0.002 * rng.standard_normal((600, 12, 14))
    found = wf.phase_average(cube({"z": z}, t, y, x, "f8"), 0.83, phases=10)
    assert 0.62 < float((abs(found.z) < found.z_std).mean()) < 0.74


def test_phase_averages_refuse_what_has_no_phase():
    t, y, x = np.arange(100) * 0.05, np.arange(8) * 0.04, np.arange(9) * 0.04
    made = cube({"z": np.zeros((100, 8, 9))}, t, y, x, "f8")
    probe = xr.DataArray(np.cos(8 * t), {"time": t + 1.0}, ("time",))
    for options, words in (
        ({}, "one of the two"),
        ({"period": 2.0}, "2.5 periods"),
        ({"period": 0.09}, "more than two steps"),
        ({"period": 0.5}, "choose fewer"),
        ({"probe": probe}, "must cover"),
    ):
        with pytest.raises(CubeError, match=words):
            wf.phase_average(made, **options)
