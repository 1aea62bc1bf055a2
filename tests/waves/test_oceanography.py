"""Directional spectra, current by depth, crests about to break: on seas known exactly."""

import numpy as np
import pytest
import xarray as xr
from exact_waves import SteadyWave
from waves_cases import GaussianSea, Waves, axes, cube, relation, second_order_sea

import wavefield.waves as wv
from wavefield.waves.surface.breaking import CrestSettings, crest_ratio


@pytest.fixture(scope="module")
def directional():
    sea = GaussianSea(spread=10, heading=np.radians(30), n=96, dx=0.03, steps=512, lowest=1.2, highest=4.0)
    w = sea.field(5).isel(y=slice(0, 64), x=slice(0, 80))
    made = xr.Dataset({"w": w}, attrs={"water_depth": 0.7})
    return made, wv.directional_spectrum(made, current=(0.0, 0.0), segment=128)


def test_wavespectra_reads_a_directional_spectrum(directional, tmp_path):
    wavespectra = pytest.importorskip("wavespectra")
    made, spectrum = directional
    omega = 2 * np.pi * spectrum.freq
    energy = wv.komega(made.w, segment=128)
    elevation = wv.E_omega(energy).E * wv.elevation_from_w(energy.omega, 0.05)
    inside = (energy.omega >= float(omega[0])) & (energy.omega <= float(omega[-1]))
    height = 4 * np.sqrt(float(elevation.where(inside).sum()) * float(energy.omega[1]))
    assert float(spectrum.spec.hs()) == pytest.approx(height, rel=0.06)
    # waves that go 30 degrees from x towards y come from 240 degrees, clockwise from y
    assert float(spectrum.spec.dm()) == pytest.approx(240, abs=4)
    assert float(spectrum.mean_direction.sel(freq=2, method="nearest")) == pytest.approx(240, abs=6)
    # cos^20(theta / 2): r1 = s / (s + 1)
    assert float(spectrum.spec.dspr()) == pytest.approx(np.degrees(np.sqrt(2 / 11)), rel=0.12)
    spectrum.to_netcdf(tmp_path / "sea.nc")
    read = wavespectra.read_netcdf(tmp_path / "sea.nc")
    assert float(read.spec.hs()) == pytest.approx(float(spectrum.spec.hs()), rel=1e-6)


def test_heights_and_periods_are_those_of_mhkit(directional):
    resource = pytest.importorskip("mhkit.wave.resource")
    _, spectrum = directional
    S = (spectrum.efth.sum("dir") * 10).to_series()  # 36 sectors of 10 degrees
    S.index.name, S.name = "f", "S"
    frame = S.to_frame()
    step = float(spectrum.freq[1] - spectrum.freq[0])
    height = float(np.ravel(resource.significant_wave_height(frame))[0])
    assert height == pytest.approx(4 * np.sqrt(float(S.sum()) * step), rel=0.03)
    period = float(np.ravel(resource.peak_period(frame))[0])
    assert period == pytest.approx(1 / float(S.idxmax()), rel=1e-6)
    wavespectra = pytest.importorskip("wavespectra")
    assert wavespectra
    assert height == pytest.approx(float(spectrum.spec.hs()), rel=0.03)
    # theirs takes a parabola through the peak
    assert period == pytest.approx(float(spectrum.spec.tp()), rel=0.06)


def test_a_directional_spectrum_on_a_current_holds_the_energy_of_still_water():
    k, a, current = 20.0, 0.01, (0.25, 0.0)
    sigma = float(relation(k))
    t, y, x = axes(256, 50, 60, 0.05, 0.025)
    phase = k * x - (sigma + k * current[0]) * t[:, None, None] + 0 * y[:, None]
    w = a * sigma * np.sinc(sigma * 0.05 / 2 / np.pi) * np.sin(phase)
    found = wv.directional_spectrum(cube({"w": w}, t, y, x), current=current, segment=128)
    step = float(found.freq[1] - found.freq[0])
    variance = float(found.efth.sum()) * 10 * step
    assert variance == pytest.approx(a**2 / 2, rel=0.1)
    peak = float(found.freq[int(np.argmax(found.efth.sum("dir").values))])
    assert peak == pytest.approx(sigma / (2 * np.pi), abs=step)


def sheared(felt, n=1200, seed=0):
    """Points of a ridge over a current that waves of wavenumber k feel as felt(k) along x."""
    rng = np.random.default_rng(seed)
    k, angle = rng.uniform(7, 60, n), 2 * np.pi * rng.random(n)
    omega = relation(k, 0.7) + k * felt(k) * np.cos(angle) + 0.004 * k * rng.standard_normal(n)
    names = {"ridge_k": k, "ridge_angle": angle, "ridge_omega": omega, "ridge_weight": np.ones(n)}
    return xr.Dataset({name: ("point", values) for name, values in names.items()} | {"depth": 0.7})


def test_a_sheared_current_is_found_at_depth():
    def felt(k):  # 2 k int .1 exp(z / .1) exp(2 k z) dz
        return 0.1 * 2 * k / (2 * k + 10)

    found = wv.current_by_depth(sheared(felt), surface=(0.1, 0.0))
    true = 0.1 * np.exp(found.z / 0.1)
    error = float(np.sqrt(((found.current_x - true) ** 2).mean()))
    assert error < 0.003
    plain = np.interp(found.z, -found.effective_depth[::1], found.doppler_x)
    assert error < np.sqrt(((plain - true) ** 2).mean()) / 3
    assert float(np.abs(found.current_y).max()) < 0.005
    assert float(found.current_x_std.max()) < 0.01
    # the variation of the current within a band is no error
    std = found.doppler_x_std.values
    assert std[0] < 1.3 * np.median(std)  # 1.47 if it were


def test_a_sheared_current_is_found_in_a_field():
    made = {"n": 96, "dx": 0.03, "steps": 512, "width": 0.06, "lowest": 1.2, "highest": 4.2}
    sea = GaussianSea(felt=lambda k: 0.1 * 2 * k / (2 * k + 10), **made).field(2)
    S = wv.spectrum(sea.isel(y=slice(0, 64), x=slice(0, 80)), segment=256)
    ridge = wv.fit_dispersion(S.E, 0.7)
    found = wv.current_by_depth(ridge, surface=(0.1, 0.0))
    true = 0.1 * np.exp(found.z / 0.1)
    error = float(np.sqrt(((found.current_x - true) ** 2).mean()))
    assert error < 0.003
    plain = np.interp(found.z, -found.effective_depth, found.doppler_x)
    assert error < float(np.sqrt(((plain - true) ** 2).mean())) / 1.6
    # its uncertainty holds what a polynomial leaves of an exponential
    assert float(np.sqrt((((found.current_x - true) / found.current_x_std) ** 2).mean())) < 2.2
    assert float(np.abs(found.current_y).max()) < 0.003


def test_a_uniform_current_stays_uniform():
    found = wv.current_by_depth(sheared(lambda k: 0.05 + 0 * k), surface=(0.05, 0.0))
    assert found.attrs["degree"] == 0
    np.testing.assert_allclose(found.current_x, 0.05, atol=0.002)


def test_crests_of_a_steep_wave_have_its_steepness_for_ratio_whatever_the_current():
    t, y, x = axes(6, 40, 160, 0.05, 0.01)
    k = 2 * np.pi / 0.6
    for current in ((0.0, 0.0), (0.1, 0.0)):
        wave = Waves(np.array([k]), np.array([0.0]), np.array([0.3 / k + 0j]), current=current)
        f = wave.on_grid(t[:1], y, x, "z", "z_t", "u", "v")
        fields = {name: f[name][0] for name in ("z", "z_t", "u", "v")}
        fields["u"] = fields["u"] + current[0]
        ratio, speed = crest_ratio(fields, CrestSettings((0.01, 0.01), 0.05, 0.01, current))
        assert np.isfinite(ratio).sum() >= 2 * 40
        # a k over tanh kh, a node beside the crest it is a little less
        np.testing.assert_allclose(ratio[np.isfinite(ratio)], 0.3 / np.tanh(k * 0.7), atol=0.01)
        np.testing.assert_allclose(speed[np.isfinite(speed)], relation(k, 0.7) / k, rtol=0.01)


def highest(sea, x, y, n, now):
    """Distance along n from points to the highest one within 10 cm, and whether there is one."""
    s = np.linspace(-0.1, 0.1, 201)
    z = sea.at(x[:, None] + s * n[0][:, None], y[:, None] + s * n[1][:, None], now, ("z",))["z"]
    i = z.argmax(axis=1)
    inside = (i > 0) & (i < s.size - 1)
    a, b, c = (z[np.arange(i.size), i.clip(1, s.size - 2) + d] for d in (-1, 0, 1))
    return s[i] + 0.0005 * (a - c) / np.where(inside, a - 2 * b + c, 1), inside


@pytest.mark.parametrize("seed", [1, 2])
def test_crests_of_a_steep_random_sea_have_the_exact_ratio(seed):
    sea = second_order_sea(seed, n=60, sigma=0.02, spread=20, lowest=1.0, highest=1.6)
    x, y, step = np.arange(160) * 0.01, np.arange(80) * 0.01, 0.01
    errors, ratios = [], []
    for t in (0.0, 2.0, 4.0, 6.0):
        f = sea.on_grid(x, y, t, ("z", "z_t", "u", "v"))
        ratio, _ = crest_ratio(f, CrestSettings((step, step), 0.06, 0.02))
        rows, columns = np.nonzero(np.isfinite(ratio[8:-8, 8:-8]))
        rows, columns = rows[::9] + 8, columns[::9] + 8
        n = np.stack([f["u"][rows, columns], f["v"][rows, columns]])
        n /= np.hypot(*n)
        (before, one), (at, two), (after, three) = (
            highest(sea, x[columns], y[rows], n, t + d) for d in (-0.01, 0.0, 0.01)
        )
        water = sea.at(x[columns] + at * n[0], y[rows] + at * n[1], t, ("u", "v"))
        speed = (after - before) / 0.02
        # a crest that meets another along n has no speed of its own
        use = one & two & three & (np.abs(at) < 0.03) & (speed > 0.3) & (speed < 3)
        exact = (water["u"] * n[0] + water["v"] * n[1]) / speed
        errors.append((ratio[rows, columns] - exact)[use])
        ratios.append(exact[use])
    errors, ratios = np.concatenate(errors), np.concatenate(ratios)
    assert errors.size > 20
    assert ratios.max() > 0.25
    assert np.mean(np.abs(errors) < 0.03) > 0.97
    assert abs(errors.mean()) < 0.01


def test_a_crest_that_outruns_itself_is_an_event_with_its_history():
    t, y, x = axes(40, 32, 120, 0.05, 0.01)
    k = 2 * np.pi / 0.6
    passing = 1.2 * k / relation(k, 0.7)  # a crest is at x = .6 m then
    f = Waves(np.array([k]), np.array([0.0]), np.array([0.3 / k + 0j])).on_grid(t, y, x, "z", "z_t", "u", "v")
    # water three times as fast where and while the wave "breaks"
    place = np.exp(-(((x - 0.6) / 0.15) ** 2)) * np.exp(-(((y[:, None] - 0.15) / 0.05) ** 2))
    f["u"] = f["u"] * (1 + 2.2 * place * np.exp(-(((t[:, None, None] - passing) / 0.3) ** 2)))
    found = wv.breaking(cube(f, t, y, x), wavelength=0.6)
    assert found.sizes["event"] >= 1
    top = int(found.event_B.values.argmax())
    assert float(found.event_B[top]) == pytest.approx(0.3 * 3.2, abs=0.12)
    assert float(found.event_time[top]) == pytest.approx(passing, abs=0.15)
    assert float(found.event_x[top]) == pytest.approx(0.6, abs=0.12)
    assert float(found.event_y[top]) == pytest.approx(0.15, abs=0.03)
    assert float(np.nanmax(found.history[top])) == pytest.approx(float(found.event_B[top]))
    assert 0 < float(found.event_duration[top]) < 1.0
    calm = wv.breaking(cube(f | {"u": f["u"] * 0.2}, t, y, x), wavelength=0.6)
    assert calm.sizes.get("event", 0) == 0


@pytest.mark.parametrize("steepness", [0.09, 0.27, 0.42])
def test_water_at_the_crests_of_exact_waves_has_its_share_of_their_speed(steepness):
    rng = np.random.default_rng([90311, int(1000 * steepness)])
    current = rng.uniform(-0.2, 0.2, 2)
    wave = SteadyWave(steepness, 0.5, rng.uniform(-np.pi, np.pi), tuple(current))
    t, y, x = np.arange(36) * 0.05, np.arange(46) * 0.01, np.arange(50) * 0.01
    found = wv.breaking(cube(wave.fields(t, y, x), t, y, x))
    assert float(found.B.median()) == pytest.approx(wave.ratio, abs=0.01)
    assert float(found.crest_speed.median()) == pytest.approx(wave.speed, rel=0.01)


def test_functions_for_notebooks_are_public():
    import wavefield as wf

    for name in ("breaking", "current_by_depth", "directional_spectrum", "fit_dispersion", "kinematics"):
        assert getattr(wf, name) is getattr(wv, name)
