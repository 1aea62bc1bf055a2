import numpy as np
import pytest
from waves_cases import axes, cube

import wavefield.waves as wv
from wavefield.errors import CubeError


def test_a_second_order_sea_has_its_skewness_and_kurtosis():
    # Tayfun: z = x + mu (x^2 - y^2) / 2 with mu = k sigma = .1: skewness 3 mu, excess kurtosis 12 mu^2 to
    # lowest order, here with all; 2.9 million values scatter by .0014 and .003
    rng = np.random.default_rng(0)
    a, b = rng.standard_normal((2, 1200, 40, 60))
    z = 0.015 * (a + 0.05 * (a * a - b * b))
    t, y, x = axes(1200, 40, 60)
    out = wv.statistics(cube({"z": z}, t, y, x))
    variance = 1 + 0.1**2
    skewness = 3 * 0.1 / variance**1.5
    kurtosis = (3 + 18 * 0.1**2 + 9 * 0.1**4) / variance**2 - 3
    assert skewness == pytest.approx(0.30, abs=0.005)
    assert kurtosis == pytest.approx(0.12, abs=0.005)
    assert float(out.skewness[0]) == pytest.approx(skewness, abs=0.004)
    assert float(out.kurtosis[0]) == pytest.approx(kurtosis, abs=0.009)
    assert float(out.significant_height) == pytest.approx(4 * (z - z.mean(axis=0)).std(), rel=1e-5)


@pytest.fixture(scope="module")
def gaussian():
    rng = np.random.default_rng(1)
    t, y, x = axes(300, 30, 40)
    fields = {n: 0.3 + 0.1 * rng.standard_normal((300, 30, 40)) for n in ("z", "u", "v", "w")}
    return cube(fields, t, y, x)


def test_a_gaussian_field_has_gaussian_densities(gaussian):
    out = wv.statistics(gaussian)
    assert list(out["quantity"].values) == ["z", "dx", "dy", "dz"]
    width = float(out.bin[1] - out.bin[0])
    np.testing.assert_allclose(out.pdf.sum("bin") * width, 1, rtol=1e-4)
    middle = out.where(np.abs(out.bin) < 2, drop=True)
    np.testing.assert_allclose(middle.pdf, middle.gaussian.broadcast_like(middle.pdf), rtol=0.06)
    np.testing.assert_allclose(out["std"], [0.1, 0.005, 0.005, 0.005], rtol=0.01)
    np.testing.assert_allclose(out["mean"], [0.3, 0.015, 0.015, 0.015], rtol=0.01)
    assert float(out["count"][0]) == 300 * 30 * 40


def test_densities_are_scaled_by_the_deviation_that_stands_beside_them(gaussian):
    still = gaussian.assign(z=gaussian.z + 0.03 * np.sin(3 * gaussian.x))
    out = wv.statistics(still).sel(quantity="z")
    assert float(out.pdf_std) == pytest.approx(float(still.z.std()), rel=1e-3)


def test_a_constant_field_does_not_break_them():
    t, y, x = axes(32, 12, 16)
    out = wv.statistics(cube({"z": np.zeros((32, 12, 16))}, t, y, x))
    assert float(out["std"][0]) == 0
    assert np.isnan(out.pdf).all()


def test_a_cube_without_elevation_is_refused(gaussian):
    with pytest.raises(CubeError, match="no 'z'"):
        wv.statistics(gaussian.drop_vars("z"))
