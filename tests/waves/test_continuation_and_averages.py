"""Phase averages, exponents of spectra, and the water below the surface, against exact truth."""

import numpy as np
import pytest
import xarray as xr
from exact_waves import SteadyWave
from hypothesis import given, settings
from hypothesis import strategies as st

import wavefield as wf
from wavefield.errors import CubeError

DIMS = ("time", "y", "x")


def cube_of(fields, t, y, x, **attrs):
    units = {name: "m" if name == "z" else "m s-1" for name in fields}
    return xr.Dataset(
        {n: (DIMS, f, {"units": units[n]}) for n, f in fields.items()}, {"time": t, "y": y, "x": x}, attrs
    )


@settings(max_examples=5, deadline=None, derandomize=True)
@given(
    period=st.floats(0.31, 1.4),
    noise=st.floats(1e-4, 3e-3),
    second=st.floats(0, 0.4),
    seed=st.integers(0, 99),
    drift=st.floats(-0.01, 0.01),
)
def test_harmonics_of_a_wave_maker_are_found_in_other_waves(period, noise, second, seed, drift):
    rng = np.random.default_rng(seed)
    t, y, x = np.arange(500) * 0.05, np.arange(8) * 0.04, np.arange(9) * 0.04
    # a wave maker whose period drifts: the probe follows it
    phase = 2 * np.pi * (t / period + drift * (t / t[-1]) ** 2 * t[-1] / period)
    place = 5 * x + 2 * y[:, None]
    angle = phase[:, None, None] - place
    z = 0.01 * np.cos(angle) + second * 0.01 * np.cos(2 * angle + 0.7)
    z = z + noise * rng.standard_normal(z.shape)
    cube = cube_of({"z": z}, t, y, x)
    times = np.arange(-20, 2520) * 0.01
    stroke = np.cos(2 * np.pi * (times / period + drift * (times / t[-1]) ** 2 * t[-1] / period))
    probe = xr.DataArray(stroke, {"time": times}, ("time",))
    found = wf.phase_average(cube, probe=probe)
    size = found.harmonic_amplitude.mean(("y", "x")).values
    # sums of steps scatter by noise sqrt(2 / 500) at each node; the probe's phase adds a little
    error = 4 * noise * np.sqrt(2 / 500)
    assert size[0] == pytest.approx(0.01, abs=error + 3e-4)
    assert size[1] == pytest.approx(second * 0.01, abs=error + 3e-4)
    assert found.attrs["period"] == pytest.approx(period, rel=0.03)
    assert float(found.z_rest.mean()) == pytest.approx(noise, rel=0.1, abs=4e-4)


def test_standard_uncertainties_of_phase_averages_cover_their_errors():
    rng = np.random.default_rng(5)
    t, y, x = np.arange(600) * 0.05, np.arange(12) * 0.04, np.arange(14) * 0.04
    z = 0.002 * rng.standard_normal((600, 12, 14))
    found = wf.phase_average(cube_of({"z": z}, t, y, x), 0.83, phases=10)
    assert 0.62 < float((abs(found.z) < found.z_std).mean()) < 0.74


def test_phase_averages_refuse_what_has_no_phase():
    t, y, x = np.arange(100) * 0.05, np.arange(8) * 0.04, np.arange(9) * 0.04
    cube = cube_of({"z": np.zeros((100, 8, 9))}, t, y, x)
    probe = xr.DataArray(np.cos(8 * t), {"time": t + 1.0}, ("time",))
    for options, words in (
        ({}, "one of the two"),
        ({"period": 2.0}, "2.5 periods"),
        ({"period": 0.09}, "more than two steps"),
        ({"period": 0.5}, "choose fewer"),
        ({"probe": probe}, "must cover"),
    ):
        with pytest.raises(CubeError, match=words):
            wf.phase_average(cube, **options)


def test_exponents_of_known_spectra_lie_in_their_intervals():
    inside, errors = 0, []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        exponent = rng.uniform(-6, -2)
        # Gaussian noise of E ~ omega^exponent above 1 Hz at nodes far apart, (time, y, x)
        lines = np.fft.rfftfreq(2048, 0.05)
        size = np.where(lines > 0.6, np.maximum(lines, 0.6) ** (exponent / 2), 0.0)[:, None, None]
        white = rng.standard_normal((2, lines.size, 8, 10))
        w = np.fft.irfft(size * (white[0] + 1j * white[1]), axis=0)[:900]
        field = cube_of({"w": w}, np.arange(900) * 0.05, np.arange(8) * 0.1, np.arange(10) * 0.1).w
        found = wf.spectral_slope(field, 1.4, 5.0)
        inside += float(found.slope_low) < exponent < float(found.slope_high)
        errors.append((float(found.slope) - exponent) / float(found.slope_std))
        assert 0.4 < float(found.misfit) < 1.8
    assert inside >= 17  # 1 % of sound intervals have fewer
    assert 0.6 < np.sqrt(np.mean(np.square(errors))) < 1.4


def test_a_spectrum_that_is_no_power_law_is_reported():
    f = np.linspace(0.2, 9.0, 60)
    both = {"E": ("omega", f**-4.0), "dof": ("omega", np.full(60, 4000.0))}
    law = xr.Dataset(both, {"omega": 2 * np.pi * f})
    straight = wf.spectral_slope(law, 1.0, 6.0)
    assert float(straight.slope) == pytest.approx(-4.0, abs=1e-6)
    bent = wf.spectral_slope(law.assign(E=law.E * np.exp(-f / 2)), 1.0, 6.0)
    assert float(bent.misfit) > 2
    assert float(bent.curvature) < -3 * float(bent.curvature_std)
    with pytest.raises(CubeError, match="five"):
        wf.spectral_slope(law, 1.0, 1.5)
    with pytest.raises(CubeError, match="leave out axis"):
        wf.spectral_slope(law, 1.0, 6.0, axis="k")


@pytest.mark.parametrize("seed", range(3))
def test_velocities_below_a_random_surface_are_those_of_its_potential(seed):
    """Any potential is exact: random waves, their velocity on the surface they draw, and below it."""
    rng = np.random.default_rng(seed)
    depth, n = (0.25, 0.7, 50.0)[seed], 60
    k, heading = rng.uniform(6, 36, n), rng.uniform(-np.pi, np.pi, n)
    kx, ky = k * np.cos(heading), k * np.sin(heading)
    sigma = np.sqrt(9.81 * k * np.tanh(k * depth))
    a = k**-1.75 * np.exp(2j * np.pi * rng.random(n))
    a *= 0.007 / np.sqrt((np.abs(a) ** 2).sum() / 2)
    y, x = np.arange(60) * 0.022, np.arange(80) * 0.022
    wave = a[:, None, None] * np.exp(1j * (kx[:, None, None] * x + ky[:, None, None] * y[:, None]))

    def at(z):
        kz = np.exp(k[:, None, None] * z)
        mirror = np.exp(-k[:, None, None] * (z + 2 * depth))
        s = (sigma / (1 - np.exp(-2 * k * depth)))[:, None, None] * wave
        along = s * (kz + mirror) / k[:, None, None]
        w = (-1j * s * (kz - mirror)).sum(axis=0).real
        return [*((part[:, None, None] * along).sum(axis=0).real for part in (kx, ky)), w]

    z = wave.sum(axis=0).real
    u, v, w = at(z)
    surface = {name: np.stack([field] * 2) for name, field in zip("zuvw", (z, u, v, w))}
    cube = cube_of(surface, [0.0, 0.05], y, x, water_depth=depth)
    levels = [-0.03, -0.08, -0.15]
    found = wf.subsurface(cube, levels).isel(time=0)
    assert float(found.surface_misfit) < 0.12
    assert float(found.horizontal_misfit) < 0.15
    assert float(found.deepest) < -0.3
    for i, level in enumerate(levels):
        holds = found.holds.values[i]
        assert 0.08 < holds.mean() < 0.6
        for name, true in zip("uvw", at(level)):
            error = (found[name].values[i] - true)[holds]
            assert np.sqrt((error**2).mean()) < 0.15 * w.std(), (name, level)


def test_pressure_below_a_steep_wave_is_bernoullis():
    y, x = np.arange(50) * 0.02, np.arange(150) * 0.02
    wave = SteadyWave(0.2, 0.5)
    fields = wave.fields(np.array([0.0, 0.02]), y, x)
    cube = cube_of({name: fields[name] for name in "zuvw"}, [0.0, 0.02], y, x)
    found = wf.subsurface(cube, [-0.05]).isel(time=0, level=0)
    k, c = 2 * np.pi / 0.5, float(wave.speed)
    u, v, w = (found[name] for name in "uvw")
    along = u  # the wave travels along x
    bernoulli = 1000 * (c * along - (u**2 + v**2 + w**2) / 2)
    inner = found.holds
    difference = (found.p - bernoulli).where(inner)
    size = 9810 * (0.2 / k) * np.exp(-0.05 * k)
    assert float((difference - difference.mean()).std()) < 0.1 * size
    assert float(bernoulli.where(inner).std()) > 0.4 * size


def test_levels_and_gaps_are_refused():
    zero = np.zeros((2, 20, 24))
    cube = cube_of(dict.fromkeys("zuvw", zero), [0.0, 0.05], np.arange(20) * 0.02, np.arange(24) * 0.02)
    for given_cube, levels, words in (
        (cube, [0.01], "levels"),
        (cube.assign_attrs(water_depth=0.3), [-0.4], "bottom"),
        (cube, [], "levels"),
        (cube.drop_vars("v"), [-0.1], "no 'v'"),
        (cube.assign(w=cube.w.where(cube.x > 0.1)), [-0.1], "gaps"),
    ):
        with pytest.raises(CubeError, match=words):
            wf.subsurface(given_cube, levels)
