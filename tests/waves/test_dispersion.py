import numpy as np
import pytest
import xarray as xr
from independent_seas import LatticeSea
from scipy.ndimage import gaussian_filter
from waves_cases import GaussianSea, PeriodicSea, relation

import wavefield.waves as wv
from wavefield.errors import CubeError
from wavefield.waves.record import whole_record

CURRENT = (0.04, -0.02)


@pytest.fixture(scope="module")
def spectrum():
    sea = PeriodicSea(n=160, current=CURRENT).cube(2048, 75, 100, noise_z=0.00057, noise_dz=0.00028)
    return wv.spectrum(sea.w, segment=512, record=whole_record(sea))


@pytest.fixture(scope="module")
def fit(spectrum):
    return wv.fit_dispersion(spectrum.E, 0.7)


def test_the_current_comes_back(fit):
    assert float(fit.current_x) == pytest.approx(CURRENT[0], abs=0.001)
    assert float(fit.current_y) == pytest.approx(CURRENT[1], abs=0.001)


def test_the_uncertainty_holds_the_truth(fit):
    for name, truth in (("current_x", CURRENT[0]), ("current_y", CURRENT[1])):
        spread = float(fit[f"{name}_std"])
        assert 0 < spread
        assert abs(float(fit[name]) - truth) < 3 * spread
        assert spread < 0.003


def test_the_ridge_is_unbiased(fit):
    band = fit.ridge_error.where((fit.band_frequency > 2) & (fit.band_frequency < 4.8), drop=True)
    assert band.size >= 5
    assert float(np.abs(band).max()) < 0.01
    # in omega, as the dispersion relation is read: the mean over k = 12 to 60
    use = (fit.ridge_k > 12) & (fit.ridge_k < 60)
    k, angle = fit.ridge_k[use], fit.ridge_angle[use]
    theory = relation(k, 0.7) + k * (np.cos(angle) * CURRENT[0] + np.sin(angle) * CURRENT[1])
    assert abs(float((fit.ridge_omega[use] / theory - 1).median())) < 0.002


@pytest.fixture(scope="module")
def quiet():
    return PeriodicSea(n=160, box=0).cube(512, 75, 100).w


def test_short_segments_do_not_bend_the_ridge(quiet):
    # lines .08 Hz apart: each holds more of the slower ones, .7 % in k at 1.75 Hz if that is not undone
    fit = wv.fit_dispersion(wv.spectrum(quiet, segment=256, record=whole_record(quiet)).E, 0.7)
    band = fit.ridge_error.where((fit.band_frequency > 1.5) & (fit.band_frequency < 5), drop=True)
    assert band.size == 7
    assert float(np.abs(band).max()) < 0.0035


def test_waves_too_long_for_the_rectangle_are_left_out(quiet):
    part = quiet.isel(y=slice(0, 35), x=slice(0, 45))
    fit = wv.fit_dispersion(wv.spectrum(part, segment=256, record=whole_record(part)).E, 0.7)
    assert float(fit.ridge_k.min()) > 2.2 * 2 * np.pi / (35 * 0.02)
    band = fit.ridge_error.where(fit.band_frequency < 5, drop=True)
    assert float(np.abs(band).max()) < 0.025  # two lines near the longest waves; .003 elsewhere
    assert float(np.abs(band[1:]).max()) < 0.005


def test_an_isotropic_sea_is_even_over_the_directions_of_a_rectangle():
    E = GaussianSea().expected_map(38, 50, 128)
    D = wv.directions(E, [2.0, 2.4, 2.8], 0.7, current=(0.0, 0.0))
    np.testing.assert_allclose(D.D * 2 * np.pi, 1, atol=0.01)
    assert float(D.isotropy.min()) > 0.99


@pytest.mark.parametrize(("power", "heading"), [(2, 0.3), (30, 5.1)])
def test_mean_direction_and_spread_of_a_known_sea_come_back(power, heading):
    # the mean of the estimate, so that no sampling hides a bias: 1.5 x 2 m, 1.7 Hz is a wave of .54 m
    E = GaussianSea(spread=power, heading=heading).expected_map(38, 50, 128)
    D = wv.directions(E, [1.7, 2.0, 2.4, 2.8], 0.7, current=(0.0, 0.0))
    np.testing.assert_allclose(D.direction, heading, atol=np.radians(1))
    expected = np.sqrt(2 / (power + 1))  # of cos(theta / 2)^(2 power): first harmonic power / (power + 1)
    np.testing.assert_allclose(D.spread, expected, rtol=0.1)
    np.testing.assert_allclose(D.spread[1:], expected, rtol=0.03)


def test_a_spectrum_without_a_ridge_is_refused(spectrum):
    with pytest.raises(CubeError, match="no dispersion relation was found"):
        wv.fit_dispersion(spectrum.E * 0, 0.7)
    with pytest.raises(CubeError, match="outside the spectrum"):
        wv.directions(spectrum.E, [12.0], current=(0.0, 0.0))
    coarse = labelled(np.random.default_rng(0).standard_normal((128, 16, 20)), dx=0.05)
    with pytest.raises(CubeError, match="resolve no frequency"):
        wv.directions(wv.spectrum(coarse, segment=16), current=(0.0, 0.0))


def labelled(values, dx=0.02, dt=0.05):
    t, y, x = (np.arange(n) * step for n, step in zip(values.shape, (dt, dx, dx)))
    return xr.DataArray(values, {"time": t, "y": y, "x": x}, ("time", "y", "x"))


@pytest.mark.parametrize("smooth", [0, 2])
def test_noise_states_no_current(smooth):
    # its best current was 20 to 170 mm/s, stated to 2 to 10
    noise = np.random.default_rng(11).standard_normal((200, 36, 48))
    E = wv.spectrum(labelled(gaussian_filter(noise, (0, smooth, smooth))), segment=64).E
    with pytest.raises(CubeError, match="no dispersion relation was found"):
        wv.fit_dispersion(E, 0.7)


@pytest.mark.parametrize("seed", [21, 22])
def test_a_small_noisy_field_without_a_current_states_none_or_holds_it_within_its_error(seed):
    quiet, noisy = (
        wv.spectrum(PeriodicSea(seed=seed, n=128).cube(300, 30, 40, noise_dz=noise).w, segment=64).E
        for noise in (0.001, 0.01)
    )
    with pytest.raises(CubeError, match="no dispersion relation was found"):
        wv.fit_dispersion(noisy, 0.7)
    fit = wv.fit_dispersion(quiet, 0.7)
    for name in ("current_x", "current_y"):
        assert abs(float(fit[name])) < 3 * float(fit[f"{name}_std"])


@pytest.mark.slow
def test_the_interval_of_directions_holds_waves_that_a_current_keeps_in_the_window():
    current = -0.3 * np.cos(0.4), -0.3 * np.sin(0.4)  # against the waves, nearly as fast as their groups
    sea = LatticeSea(side=150, shape=(400, 26, 30), current=current, directions=((0.4, 20.0, 1.0),))
    lines = [2.0, 2.3, 2.6]
    found = [wv.directions(sea.cube(draw, ("w",)).w, lines, sea.depth, current=current) for draw in range(12)]
    D = np.array([one.D.values for one in found])
    strong = D.mean(axis=0) > 0.1 * D.mean(axis=0).max(axis=1, keepdims=True)
    relative = (D.var(axis=0, ddof=1) / D.mean(axis=0) ** 2)[strong].mean()
    dof = 1 / np.mean([1 / one.dof.values[strong] for one in found])
    assert 0.6 < dof * relative / 2 < 1.3  # 1.9 if segments counted as independent
