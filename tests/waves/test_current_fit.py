"""The fitted current of seas whose short waves are weak, in noise, or missing."""

import numpy as np
import pytest
from independent_seas import Sea

import wavefield.waves as wv
from wavefield.errors import CubeError
from wavefield.waves.current import current_used
from wavefield.waves.dispersion_points import fit_settings


def fitted(sea, **settings):
    E = wv.spectrum(sea.cube(("w",))["w"]).E
    return wv.fit_dispersion(E, sea.depth, **settings)


def test_the_band_of_the_fit_can_be_given_and_is_recorded():
    sea = Sea(current=(0.1, 0.05), shape=(400, 60, 80), seed=3)
    fit = fitted(sea, lowest=2.0, highest=4.0)
    assert fit.attrs["lowest"] == pytest.approx(2.0)
    assert float(fit.ridge_omega.min()) >= 2 * np.pi * 2.0
    assert float(fit.current_x) == pytest.approx(0.1, abs=0.004)


@pytest.mark.parametrize("wrong", [{"low": 1}, {"lowest": "x"}, {"highest": -1}, {"lowest": 4, "highest": 2}])
def test_a_wrong_setting_of_the_fit_is_named(wrong):
    with pytest.raises(CubeError, match="`fit`"):
        fit_settings(wrong)


def analysed(sea, **asked):
    return wv.analyze(sea.cube(("z", "z_t", "u", "v", "w")), depth=0.7, segment=64, **asked)


def test_products_record_the_current_that_they_used():
    sea = Sea(current=(0.1, 0.05), depth=0.7, shape=(360, 40, 48), dx=0.03, seed=5)
    waves = analysed(sea, fit={"highest": 4.0})
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
