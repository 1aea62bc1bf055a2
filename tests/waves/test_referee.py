"""Seas with a direction, a current and gaps: what a referee would try."""

import pytest
from waves_cases import GaussianSea, fused_spectra, linear_cube, random_waves

import wavefield.waves as wv
from wavefield.errors import CubeError

THIN = {"width": 0.06, "n": 96, "dx": 0.03, "band": (1.2, 4.2)}  # a ridge thinner than a cell


@pytest.fixture(scope="module")
def directional():
    """Waves ~ cos^20(theta / 2) without a current and on one."""

    def spectrum(current):
        sea = GaussianSea(spread=10, current=current, steps=512, **THIN).field(3)
        return wv.spectrum(sea.isel(y=slice(0, 64), x=slice(0, 80)), segment=256)

    return {current: spectrum(current) for current in ((0.0, 0.0), (-0.3, 0.1))}


@pytest.mark.parametrize("current", [(0.0, 0.0), (-0.3, 0.1)])
def test_the_current_of_a_directional_sea_is_found(directional, current):
    S = directional[current]
    fit = wv.fit_dispersion(S.E, 0.7)
    for name, true in zip(("current_x", "current_y"), current):
        assert float(fit[name]) == pytest.approx(true, abs=0.004)
        assert abs(float(fit[name]) - true) < 3 * float(fit[f"{name}_std"])
    assert float(fit.ridge_fraction) > 0.95


def test_a_ridge_that_no_current_explains_is_refused(directional):
    E = directional[(0.0, 0.0)].E
    wrong = E.assign_coords(omega=2.2 * E.omega)  # a frame rate mistaken
    with pytest.raises(CubeError, match="check depth, frame rate and grid step"):
        wv.fit_dispersion(wrong, 0.7)


def test_leakage_of_the_peak_is_not_valid():
    # waves up to 2.5 Hz without noise: beyond them there is but what the window lets through
    waves = random_waves(n=80, lowest=1.0, highest=2.5)
    out = fused_spectra(linear_cube(waves, 400, 40, 50, dx=0.02, dtype="f8"), segment=100)
    assert not bool(out.valid_Ez.where(out.frequency > 5.0, False).any())
    fusion = out.valid_Ez.sel(source="fusion")
    assert bool(fusion.where((out.frequency > 1.2) & (out.frequency < 2.3), True).all())


def test_what_stands_still_is_no_wave():
    cube = linear_cube(random_waves(n=60), 200, 30, 40, dx=0.02)
    tilt = 0.02 * (cube.x - cube.x.mean())
    plain, lifted = wv.statistics(cube), wv.statistics(cube.assign(z=(cube.z + tilt).transpose(*cube.z.dims)))
    for name in ("std", "skewness", "kurtosis"):
        was, now = (float(s[name].sel(quantity="z")) for s in (plain, lifted))
        assert now == pytest.approx(was, rel=1e-4, abs=1e-4 * (name != "std")), name


def test_an_outlier_is_reported():
    cube = linear_cube(random_waves(n=40), 128, 24, 28, dx=0.03)
    assert "beyond six" not in wv.analyze(cube, segment=32).attrs["notes"]
    cube["w"][60, 12, 14] = 30.0
    assert "1 of dz" in wv.analyze(cube, segment=32).attrs["notes"]


def test_a_depth_that_is_none_is_refused():
    cube = linear_cube(random_waves(n=20), 64, 20, 24, dx=0.03)
    with pytest.raises(CubeError, match="depth of the water is 0"):
        wv.analyze(cube, depth=0.0)
