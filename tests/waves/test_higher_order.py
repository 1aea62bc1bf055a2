import numpy as np
import pytest
from independent_seas import LatticeSea

from wavefield.errors import CubeError
from wavefield.waves.bicoherence import higher_order, tricoherence_of


def gaussian_lines(rng, n, samples):
    return (rng.standard_normal((n, samples)) + 1j * rng.standard_normal((n, samples))).astype("c8")


def test_four_waves_are_found_and_trivial_pairings_are_not():
    rng = np.random.default_rng(2)
    z = gaussian_lines(rng, 20, 40000)
    # 5 + 12 = 8 + 9
    z[9] = z[9] + 1.5 * z[5] * z[12] * z[8].conj() / np.sqrt(8)
    value = tricoherence_of(z, np.zeros((20, 20)), 1.0)
    assert value[5, 12] > 0.2
    assert np.isnan(value[1, 3])  # only 2 + 2 has the same sum, of nearly the same lines
    elsewhere = value[np.isfinite(value) & (np.add.outer(np.arange(20), np.arange(20)) != 17)]
    assert np.median(elsewhere) < 0.03
    assert np.nanmax(np.abs(value - value.T)) == 0


def test_lines_beyond_the_ends_of_a_sea_do_not_seem_coupled():
    fields = [LatticeSea(side=200, shape=(400, 12, 12)).cube(seed, names=("w",)).w for seed in (1, 2)]
    for field in fields:  # without noise: beyond 3 Hz is what the window spreads
        out = higher_order(field.values.reshape(400, -1), 0.05, 100)
        defined = np.isfinite(out.tricoherence)
        assert ((out.tricoherence > out.tricoherence_level).values[defined]).mean() < 0.15


def test_a_bound_harmonic_in_a_time_series_stands_out():
    rng = np.random.default_rng(5)
    t = np.arange(6000) * 0.05
    series = []
    for _ in range(6):
        slow = np.interp(t, t[::100], rng.standard_normal(t[::100].size)) + 2
        phase = 2 * np.pi * 1.0 * t + np.interp(t, t[::100], np.cumsum(rng.standard_normal(t[::100].size)))
        wave = slow * np.cos(phase)
        series.append(wave + 0.1 * slow**2 * np.cos(2 * phase) + 0.02 * rng.standard_normal(t.size))
    out = higher_order(np.array(series).T, 0.05, 200)
    at = out.bicoherence.sel(omega1=2 * np.pi, omega2=2 * np.pi, method="nearest")
    level = out.bicoherence_level.sel(omega1=2 * np.pi, omega2=2 * np.pi, method="nearest")
    assert float(at) > 0.8
    assert float(at) > 2 * float(level)


def test_one_segment_is_not_enough():
    with pytest.raises(CubeError, match="two segments"):
        higher_order(np.zeros((100, 3)), 0.05, 100)
