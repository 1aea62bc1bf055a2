import numpy as np
import pytest
import xarray as xr
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from independent_seas import LatticeSea
from scipy import signal
from waves_cases import axes

import wavefield.waves as wv
from wavefield.waves.cross import cross_spectra, significance_level
from wavefield.waves.spectra import total
from wavefield.waves.welch import interval


def field(values, dt=0.05, dx=0.03, units="m"):
    t, y, x = axes(*values.shape, dt, dx)
    return xr.DataArray(values, {"time": t, "y": y, "x": x}, ("time", "y", "x"), "z", {"units": units})


def plane_wave(k, angle, omega, steps=256, ny=48, nx=64, a=0.01, phase=0.4):
    t, y, x = axes(steps, ny, nx, 0.05, 0.03)
    kx, ky = k * np.cos(angle), k * np.sin(angle)
    return field(a * np.cos(kx * x + ky * y[:, None] - omega * t[:, None, None] + phase))


@settings(max_examples=5, phases=[Phase.generate])
@given(st.floats(20, 80), st.floats(0, 2 * np.pi), st.floats(9, 50))
def test_a_plane_wave_holds_half_its_amplitude_squared(k, angle, omega):
    wave = plane_wave(k, angle, omega, steps=128, ny=32, nx=40)
    for result in (wv.spectrum(wave, segment=128).E, wv.komega(wave, segment=128).E):
        assert float(total(result)) == pytest.approx(0.01**2 / 2, rel=1e-3)


@settings(max_examples=5, phases=[Phase.generate])
@given(st.floats(20, 80), st.floats(0, 2 * np.pi), st.floats(8, 50))
def test_k_points_where_the_wave_goes(k, angle, omega):
    E = wv.spectrum(plane_wave(k, angle, omega), segment=128).E
    peak = E.isel(E.argmax(...))
    assert float(peak.kx) == pytest.approx(k * np.cos(angle), abs=0.6 * float(E.kx[1] - E.kx[0]))
    assert float(peak.ky) == pytest.approx(k * np.sin(angle), abs=0.6 * float(E.ky[1] - E.ky[0]))
    assert float(peak.omega) == pytest.approx(omega, abs=0.6 * float(E.omega[1]))


def test_odd_sizes_keep_the_energy_and_the_direction():
    E = wv.spectrum(plane_wave(40.0, 2.0, 12.0, ny=45, nx=51), segment=128).E
    peak = E.isel(E.argmax(...))
    assert float(peak.kx) < 0 < float(peak.ky)
    assert float(total(E)) == pytest.approx(5e-5, rel=1e-3)


def test_white_noise_is_even_over_the_k_plane_and_its_interval_holds():
    rng = np.random.default_rng(2)
    hits, ratios, cells = [], [], []
    for _ in range(12):
        E = wv.komega(field(rng.standard_normal((320, 30, 40), dtype="f4"), dx=0.05), segment=64)
        truth = 2 * np.pi * E.k * E.coverage / ((2 * np.pi / 0.05) ** 2 * (np.pi / 0.05))
        use = E.valid & (E.omega < 0.95 * E.omega[-1])
        ratio = (E.E / truth).where(use)
        hits.append(((ratio * E.low < 1) & (ratio * E.high > 1)).where(use).mean().item())
        ratios.append(ratio.mean("omega"))
        full = wv.spectrum(field(rng.standard_normal((320, 30, 40), dtype="f4"), dx=0.05), segment=64)
        share = full.E[3:-3, 4:11, 5:15] * ((2 * np.pi / 0.05) ** 2 * (np.pi / 0.05))
        cells.append(((share * full.low < 1) & (share * full.high > 1)).mean().item())
    assert 0.94 < np.mean(cells) < 0.96
    assert 0.94 < np.mean(hits) < 0.96
    mean = np.mean(ratios, axis=0)
    mean = mean[np.isfinite(mean)]
    assert np.sqrt(np.mean((mean[len(mean) // 2 :] - 1) ** 2)) < 0.005
    assert np.abs(mean - 1).max() < 0.03


FREE_SEAS = {"narrow": {"directions": ((0.4, 20.0, 1.0),)}, "on a current": {"current": (0.2, 0.15)}}


@pytest.fixture(scope="module", params=[pytest.param(name, marks=pytest.mark.slow) for name in FREE_SEAS])
def free_sea(request):
    """Draws of a sea of exact free waves, and their spectra."""
    sea = LatticeSea(side=180, shape=(320, 24, 30), **FREE_SEAS[request.param])
    draws = [sea.cube(seed, ("z", "u", "v", "w")) for seed in range(8)]
    names, pairs = ("w", "nl"), (("w", "nl"),)
    draws = [draw.assign(z_t=draw.w) for draw in draws]
    return draws, [cross_spectra(draw, names, pairs) for draw in draws]


def held(energies, dof, there):
    """Fraction of estimates (draws, ...) whose interval holds the mean of the other draws."""
    n = len(energies)
    others = (energies.sum(axis=0) - energies) / (n - 1)
    # the mean of the others errs as well: deviations are wider by sqrt(1 + 1 / (n - 1))
    ratio = np.exp(np.log(others / energies) / np.sqrt(n / (n - 1)))
    low, high = interval(dof)
    return ((ratio > low) & (ratio < high))[:, there].mean()


def test_the_interval_holds_the_truth_for_seas_with_and_without_direction_and_current(free_sea):
    _, found = free_sea
    energies, dof = (np.array([E[name].sel(quantity="w").values for E in found]) for name in ("E", "dof"))
    mean = energies.mean(axis=0)
    assert 0.9 < held(energies, dof, found[0].valid.values & (mean > 1e-3 * mean.max())) < 0.98


def test_the_intervals_of_sums_over_k_and_over_omega_hold_their_truth(free_sea):
    _, found = free_sea
    for axis, over in (("omega", "k"), ("k", "omega")):
        energies = np.array([E.E.sel(quantity="w").sum(over).values for E in found])
        mean = energies.mean(axis=0)
        dof = np.array([E[f"dof_{axis}"].sel(quantity="w").values for E in found])
        assert 0.88 < held(energies, dof, mean > 1e-2 * mean.max()) < 0.99


def test_coherence_without_relation_is_as_small_as_its_samples_let_expect(free_sea):
    draws, found = free_sea
    hits, sizes = {"other": [], "nl": []}, {"other": [], "nl": []}
    for one, other, own in zip(draws[::2], draws[1::2], found):
        pair = xr.Dataset({"z_t": one["w"], "w": other["w"]}, attrs=one.attrs)
        unrelated = cross_spectra(pair, ("z_t", "w"), (("z_t", "w"),))
        for name, ring in (("other", unrelated), ("nl", own)):
            there = ring.valid & (ring.E > 1e-3 * ring.E.max(["omega", "k"])).all("quantity")
            gamma2 = np.abs(ring.S) ** 2 / ring.E.prod("quantity")
            hits[name].append(float((gamma2 > significance_level(ring.samples)).where(there).mean()))
            sizes[name].append(float((gamma2 * ring.samples).where(there).mean()))
    for name in hits:
        assert np.mean(hits[name]) < 0.1
        assert 0.5 < np.mean(sizes[name]) < 1.4


def test_the_frequency_spectrum_is_that_of_scipy_over_all_nodes():
    values = np.random.default_rng(3).standard_normal((640, 20, 30)).cumsum(axis=0).astype("f4")
    got = wv.E_omega(field(values))
    window = 0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(160) + 0.5) / 160)
    _, P = signal.welch(values.reshape(640, -1), 20.0, window, 160, 80, detrend="linear", axis=0)
    np.testing.assert_allclose(got.E[1:-1], P.mean(axis=1)[1:-1] / (2 * np.pi), rtol=1e-3)


def test_results_do_not_depend_on_chunks():
    rng = np.random.default_rng(7)
    values = field(rng.standard_normal((333, 30, 40), dtype="f4"))
    values[200, 3:5, 7] = np.nan
    values[150] = np.nan
    lazy = values.chunk({"time": 64, "y": 11})
    for take in (wv.komega, wv.spectrum):
        whole, pieces = take(values, segment=64), take(lazy, segment=64)
        np.testing.assert_array_equal(whole.E.values, pieces.E.values)


def test_intervals_hold_the_level_of_a_peak_that_the_record_hardly_resolves():
    t, x, segment, inside = np.arange(1024) * 0.05, np.arange(10) * 0.08, 12.8, []
    off = np.linspace(-4, 4, 801) * 0.005  # Hz, from the middle between two lines
    line = (np.sinc(v := off * segment - 0.5) / (1 - v**2)) ** 2  # power of a Hann window
    weight = np.exp(-((off / 0.005) ** 2) / 2)
    level = 0.01**2 / 2 * (weight * line).sum() / weight.sum() * segment / (1.5 * 2 * np.pi)
    for seed in range(40):
        rng = np.random.default_rng([seed, 31])
        f = 17.5 / segment + 0.005 * rng.standard_normal(200)
        size = 0.01 / 20 * (rng.standard_normal(200) + 1j * rng.standard_normal(200))
        along = size[:, None] * np.exp(4j * np.pi**2 / 9.81 * np.outer(f**2, x))
        waves = np.exp(-2j * np.pi * np.outer(t, f)) @ along
        z = np.repeat(waves.real[:, None], 8, axis=1) + 1e-5 * rng.standard_normal((t.size, 8, x.size))
        found = wv.E_omega(wv.komega(field(z, dx=0.08), segment=256)).isel(omega=17)
        inside.append(bool(found.low * found.E < level < found.high * found.E))
    assert np.mean(inside) > 0.8  # with correlation between neighbouring segments alone: a half
