"""Crests, troughs and errors of moments on Gaussian and second-order seas."""

import numpy as np
import pytest
import xarray as xr
from waves_cases import GaussianSea, second_order_sea

import wavefield.waves as wv
from wavefield.errors import CubeError


@pytest.fixture(scope="module")
def gaussian():
    sea = GaussianSea(n=32, dx=0.06, steps=2400, band=(0.9, 3.0))
    # a piece of the periodic box: over the whole of it triads cancel
    piece = {"time": slice(0, 2000), "y": slice(0, 8), "x": slice(0, 8)}
    return [wv.crest_statistics(sea.field(s, "m").isel(piece).to_dataset(name="z")) for s in range(8)]


def test_stated_errors_of_moments_are_the_scatter_of_seas(gaussian):
    for name in ("significant_height", "skewness", "kurtosis"):
        values = np.array([float(one[name]) for one in gaussian])
        stated = np.sqrt(np.mean([float(one[f"{name}_std"]) ** 2 for one in gaussian]))
        assert 0.5 < values.std(ddof=1) / stated < 1.8, name
    # a Gaussian sea has none
    for name in ("skewness", "kurtosis"):
        pulls = [float(one[name] / one[f"{name}_std"]) for one in gaussian]
        assert np.abs(np.mean(pulls)) < 1.5, name


def test_crests_of_a_gaussian_sea_are_those_of_rayleigh(gaussian):
    levels = slice(1.0, 3.0)
    crest = np.mean([one.crest_exceedance.sel(level=levels) for one in gaussian], axis=0)
    trough = np.mean([one.trough_exceedance.sel(level=levels) for one in gaussian], axis=0)
    rayleigh = gaussian[0].rayleigh.sel(level=levels)
    # short waves on long ones make some crests small: a tenth fewer
    np.testing.assert_allclose(crest, rayleigh, rtol=0.2, atol=2e-3)
    np.testing.assert_allclose(crest, trough, rtol=0.1, atol=1e-3)


def test_crests_of_a_second_order_sea_are_those_of_tayfun():
    sea = second_order_sea(seed=5, n=60, sigma=0.02, spread=30, lowest=1.0, highest=1.4)
    t, y, x = np.arange(3000) * 0.05, np.arange(8) * 0.08, np.arange(8) * 0.08
    z = np.stack([sea.on_grid(x, y, now, ("z",))["z"] for now in t])
    found = wv.crest_statistics(xr.Dataset({"z": (("time", "y", "x"), z)}, {"time": t, "y": y, "x": x}))
    assert float(found.skewness) > 0.2
    assert float(found.skewness) > 4 * float(found.skewness_std)
    high = slice(2.0, 3.0)
    crest, trough = found.crest_exceedance.sel(level=high), found.trough_exceedance.sel(level=high)
    misfit = {
        name: float(np.abs(np.log(crest / found[name].sel(level=high))).mean())
        for name in ("tayfun", "rayleigh")
    }
    assert misfit["tayfun"] < 0.6 * misfit["rayleigh"]
    assert bool((crest > 1.5 * trough).all())


def test_a_record_of_few_waves_is_refused():
    sea = GaussianSea(n=16, dx=0.06, steps=200).field(0, "m")
    with pytest.raises(CubeError, match="fewer than 8 blocks"):
        wv.crest_statistics(sea.to_dataset(name="z"))
