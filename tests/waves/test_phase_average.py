"""Phase averages against exact truth."""

import numpy as np
import pytest
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
)
def test_harmonics_of_a_wave_maker_are_found_in_other_waves(period, noise, second, seed):
    rng = np.random.default_rng(seed)
    t, y, x = np.arange(500) * 0.05, np.arange(8) * 0.04, np.arange(9) * 0.04
    angle = 2 * np.pi / period * t[:, None, None] - 5 * x - 2 * y[:, None]
    z = 0.01 * np.cos(angle) + second * 0.01 * np.cos(2 * angle + 0.7)
    z = z + noise * rng.standard_normal(z.shape)
    found = wf.phase_average(cube({"z": z}, t, y, x, "f8"), period)
    size = found.harmonic_amplitude.mean(("y", "x")).values
    error = 4 * noise * np.sqrt(2 / 500)  # sums of steps scatter by noise sqrt(2 / 500) at each node
    assert size[0] == pytest.approx(0.01, abs=error)
    assert size[1] == pytest.approx(second * 0.01, abs=error)
    assert float(found.z_rest.mean()) == pytest.approx(noise, rel=0.1)


def test_standard_uncertainties_of_phase_averages_cover_their_errors():
    rng = np.random.default_rng(5)
    t, y, x = np.arange(600) * 0.05, np.arange(12) * 0.04, np.arange(14) * 0.04
    z = 0.002 * rng.standard_normal((600, 12, 14))
    found = wf.phase_average(cube({"z": z}, t, y, x, "f8"), 0.83, phases=10)
    assert 0.62 < float((abs(found.z) < found.z_std).mean()) < 0.74


def test_phase_averages_refuse_what_has_no_phase():
    t, y, x = np.arange(100) * 0.05, np.arange(8) * 0.04, np.arange(9) * 0.04
    made = cube({"z": np.zeros((100, 8, 9))}, t, y, x, "f8")
    for options, words in (
        ({"period": 2.0}, "2.5 periods"),
        ({"period": 0.09}, "more than two steps"),
        ({"period": 0.5}, "choose fewer"),
    ):
        with pytest.raises(CubeError, match=words):
            wf.phase_average(made, **options)
