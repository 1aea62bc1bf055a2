"""The fitted current of seas whose short waves are weak, in noise, or missing."""

import numpy as np
import pytest
from independent_seas import Sea

import wavefield.waves as wv
from wavefield.waves.current import current_used


def fitted(sea, lines=slice(None)):
    E = wv.spectrum(sea.cube(("w",))["w"]).E.sel(omega=lines)
    return wv.fit_dispersion(E, sea.depth)


def test_a_fit_to_a_band_of_the_spectrum_finds_the_current():
    sea = Sea(current=(0.1, 0.05), shape=(400, 60, 80), seed=3)
    fit = fitted(sea, slice(2 * np.pi * 2.0, 2 * np.pi * 4.0))
    assert float(fit.ridge_omega.min()) >= 2 * np.pi * 2.0
    assert float(fit.current_x) == pytest.approx(0.1, abs=0.004)


def analysed(sea, **asked):
    return wv.analyze(sea.cube(("z", "z_t", "u", "v", "w")), depth=0.7, segment=64, **asked)


def test_products_record_the_current_that_they_used():
    sea = Sea(current=(0.1, 0.05), depth=0.7, shape=(360, 40, 48), dx=0.03, seed=5)
    waves = analysed(sea)
    fit = waves["dispersion"]
    for group in ("fusion", "direction"):
        attrs = waves[group].attrs
        assert attrs["current_source"] == "fit"
        assert attrs["current"] == [float(fit["current_x"]), float(fit["current_y"])]
        assert attrs["current_std"] == [float(fit["current_x_std"]), float(fit["current_y_std"])]
    assert waves["spectra"]["Ez"].attrs["current_source"] == "fit"


def test_without_a_fit_products_use_the_given_current_or_none_and_record_why():
    noise = Sea(height=1e-6, noise=1e-3, depth=0.7, shape=(200, 24, 32), dx=0.03, waves=8)
    waves = analysed(noise)
    assert analysed(noise, current=(0.1, 0.0))["fusion"].attrs["current"] == [0.1, 0.0]
    assert "current_x" not in waves["dispersion"]
    for group in ("fusion", "direction"):
        assert waves[group].attrs["current_source"] == "none"
        assert waves[group].attrs["current"] == [0.0, 0.0]
        assert waves[group].attrs["current_fit_refused"]
    refused = waves["dispersion"].to_dataset()
    given = current_used(refused, (0.1, 0.0))
    assert (given.source, given.velocity) == ("given", (0.1, 0.0))
    assert np.isnan(given.std).all()
    assert given.reason == waves["fusion"].attrs["current_fit_refused"]
