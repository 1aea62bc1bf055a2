"""Intermittency, vortices, paths of the surface water and the energy budget: on fields known exactly."""

import numpy as np
import pytest
import xarray as xr
from waves_cases import Waves, axes, cube, random_waves, relation

import wavefield as wf
import wavefield.waves as wv
from wavefield.errors import CubeError
from wavefield.tank.sea import Sea
from wavefield.water import group_velocity
from wavefield.waves.estimation.windows import hann


def field(values, dt=0.05, dx=0.02):
    t, y, x = axes(*values.shape, dt, dx)
    return xr.DataArray(values, {"time": t, "y": y, "x": x}, ("time", "y", "x"), attrs={"units": "m"})


@pytest.mark.parametrize("differences", [1, 2])
def test_increments_of_a_wave_are_those_of_a_sine(differences):
    k, omega, a = 2 * np.pi / 0.32, 2 * np.pi / 0.8, 0.01
    t, y, x = axes(640, 16, 96, 0.05, 0.02)
    wave = a * np.cos(k * x - omega * t[:, None, None] + 0 * y[:, None])
    found = wf.structure_functions(field(wave), differences=differences)
    factor = 4 ** (differences - 1) * 2 * a**2
    for name, lag, rate in (("time", found.lag_time, omega), ("x", found.lag_x, k)):
        expected = factor * np.sin(rate * lag / 2) ** (2 * differences)
        got = found[f"structure_{name}"].sel(order=2)
        np.testing.assert_allclose(got, expected, rtol=0.03, atol=0.003 * factor, err_msg=name)
        flat = found[f"flatness_{name}"].where(expected > 0.1 * factor, drop=True)
        np.testing.assert_allclose(flat, 1.5, atol=0.05, err_msg=name)


def test_increments_of_a_gaussian_field_have_flatness_three_within_their_errors():
    rng = np.random.default_rng(4)
    found = wf.structure_functions(field(rng.standard_normal((512, 24, 30))))
    for name in ("time", "x", "y"):
        off = (found[f"flatness_{name}"] - 3) / found[f"flatness_{name}_std"]
        assert float(np.abs(off).max()) < 4, name
        assert float((off**2).mean()) < 4, name
    np.testing.assert_allclose(found.structure_x.sel(order=2), 2, rtol=0.02)


def test_intermittent_increments_have_the_flatness_of_their_law():
    # Gaussian noise whose size differs from place to place: flatness 3 <A^4> / <A^2>^2 in time
    rng = np.random.default_rng(2)
    size = np.exp(0.4 * rng.standard_normal((24, 30)))
    found = wf.structure_functions(field(size * rng.standard_normal((512, 24, 30))))
    seen = size[::4, ::4]
    expected = 3 * (seen**4).mean() / (seen**2).mean() ** 2
    assert expected > 4
    np.testing.assert_allclose(found.flatness_time, expected, rtol=0.12)
    assert bool((found.flatness_time > 3 + 3 * found.flatness_time_std).all())


def test_increments_without_blocks_are_refused():
    with pytest.raises(CubeError, match="choose a shorter lag or a longer record"):
        wf.structure_functions(field(np.random.default_rng(0).standard_normal((12, 10, 10))))
    with pytest.raises(CubeError, match="choose 1 or 2"):
        wf.structure_functions(field(np.zeros((64, 10, 10))), differences=3)


@pytest.fixture(scope="module")
def irrotational():
    t, y, x = axes(300, 40, 50, 0.05, 0.035)
    waves = random_waves(seed=3, n=60, lowest=1.8, highest=3.0)
    return cube(waves.on_grid(t, y, x, "u", "v"), t, y, x)


def test_waves_have_no_vortices(irrotational):
    found = wf.waves_and_vortices(irrotational, segment=100)
    assert abs(float(found.vortical_fraction)) < float(found.vortical_fraction_std) < 0.015
    both = wv.komega(irrotational.u, segment=100).E + wv.komega(irrotational.v, segment=100).E
    inside = found.valid & (both > 1e-4 * both.max())
    total = (found.E_waves + found.E_vortices).where(inside)
    np.testing.assert_allclose(total, both.where(inside), rtol=1e-4)


def test_vortices_among_waves_are_found(irrotational):
    rng = np.random.default_rng(1)
    k, angle, omega = rng.uniform(10, 25, 40), 2 * np.pi * rng.random(40), rng.normal(0, 2, 40)
    t, y, x = (irrotational[name].values for name in ("time", "y", "x"))
    size = 0.6 * float(irrotational.u.std()) * np.sqrt(2 / 40)
    e_x, e_y = np.exp(1j * np.outer(k * np.cos(angle), x)), np.exp(1j * np.outer(k * np.sin(angle), y))
    e_t = np.exp(1j * (2 * np.pi * rng.random(40)[:, None] - np.outer(omega, t)))
    swirl = [
        size * np.einsum("n,nt,ny,nx->tyx", part, e_t, e_y, e_x, optimize=True).real
        for part in (-np.sin(angle), np.cos(angle))
    ]
    mixed = irrotational.assign(u=irrotational.u + swirl[0], v=irrotational.v + swirl[1])
    found = wf.waves_and_vortices(mixed.astype("f4"), segment=100)

    def energy(u, v):
        parts = (wv.komega(irrotational.u.copy(data=part), segment=100).E for part in (u, v))
        return float(sum(parts).where(found.valid).sum())

    expected = energy(*swirl) / energy(mixed.u.values, mixed.v.values)
    assert 0.03 < expected < 0.2
    assert float(found.vortical_fraction) == pytest.approx(expected, rel=0.15)
    assert abs(float(found.vortical_fraction) - expected) < 2 * float(found.vortical_fraction_std)


@pytest.mark.parametrize("current", [0.0, 0.03])
def test_water_drifts_as_stokes_has_it(current):
    k, a = 2 * np.pi / 0.5, 0.006
    sea = Sea([k], [0.0], [a], bound=1, current=(current, 0.0))
    t, y, x = axes(200, 20, 100, 0.05, 0.02)
    steps = [sea.on_grid(x, y, now, ("u", "v")) for now in t]
    made = cube({name: np.array([step[name] for step in steps]) for name in ("u", "v")}, t, y, x)
    stokes = a**2 * float(sea.sigma[0]) * k
    found = wf.surface_paths(made, duration=3 * 2 * np.pi / float(sea.sigma[0]), spacing=0.05)
    assert float(found.drift_x) - current == pytest.approx(stokes, rel=0.03)
    assert float(found.mean_x) - current == pytest.approx(stokes / 2, rel=0.01)
    assert abs(float(found.drift_y)) < 1e-6
    assert float(found.stayed) > 0.7
    assert np.isnan(found.path_x[..., -1]).any()  # those that start by the edge leave the field


@pytest.mark.parametrize("depth", [np.inf, 0.06])
def test_stokes_drift_of_a_spectrum_is_that_of_its_wave(depth):
    k, a, current = 25.0, 0.004, (0.05, 0.0)
    t, y, x = axes(256, 40, 50, 0.05, 0.03)
    wave = Waves(np.array([0.8 * k]), np.array([0.6 * k]), np.array([a + 0j]), depth, current)
    S = wv.spectrum(cube(wave.on_grid(t, y, x, "z"), t, y, x).z, segment=128)
    found = wf.stokes_drift(S.E, depth, current=current, dof=float(S.dof))
    kh = min(k * depth, 300.0)
    expected = a**2 * float(relation(k, depth)) * k * np.cosh(2 * kh) / (2 * np.sinh(kh) ** 2)
    assert float(found.stokes_x) == pytest.approx(0.8 * expected, rel=0.04)
    assert float(found.stokes_y) == pytest.approx(0.6 * expected, rel=0.06)


def test_paths_longer_than_the_record_are_refused():
    t, y, x = axes(40, 12, 12)
    still = cube({"u": np.zeros((40, 12, 12)), "v": np.zeros((40, 12, 12))}, t, y, x)
    with pytest.raises(CubeError, match="cannot be followed for 10 s"):
        wf.surface_paths(still)


def budget_of(decay, growth, current=0.0):
    k, a = 36.0, 0.01
    t, y, x = axes(480, 40, 60, 0.05, 0.025)
    sigma = float(relation(k))
    size = np.exp(-x / decay) * np.exp(t / growth)[:, None, None]
    phase = k * x - (sigma + k * current) * t[:, None, None] + 0 * y[:, None]
    w = a * size * sigma * np.sinc(sigma * 0.05 / 2 / np.pi) * np.sin(phase)
    window = hann(60) ** 2
    seen = np.average(np.exp(-2 * x / decay), weights=window) * np.exp(2 * t / growth).mean()
    energy = 1000 * (9.81 + 7.28e-5 * k**2) * a**2 / 2 * seen
    found = wf.energy_budget(cube({"w": w}, t, y, x), bands=(1.75, 2.55, 4.0), current=(current, 0.0))
    return found.isel(band=1), energy, float(group_velocity(k)), k


def test_energy_that_decays_along_its_way_shows_in_the_divergence():
    found, energy, speed, k = budget_of(6.0, np.inf)
    assert float(found.energy) == pytest.approx(energy, rel=0.02)
    assert float(found.flux_x) == pytest.approx(speed * energy, rel=0.02)
    assert float(found.divergence) == pytest.approx(-2 / 6.0 * speed * energy, rel=0.04)
    assert float(found.viscous) == pytest.approx(4e-6 * k**2 * energy, rel=0.05)
    assert abs(float(found.growth)) < 1e-3 * abs(float(found.divergence))


def test_energy_that_grows_in_time_and_is_carried_by_a_current():
    found, energy, speed, _ = budget_of(np.inf, 30.0, current=0.1)
    assert float(found.energy) == pytest.approx(energy, rel=0.04)
    assert float(found.growth / found.energy) == pytest.approx(2 / 30.0, rel=0.06)
    assert float(found.flux_x / found.energy) == pytest.approx(speed + 0.1, rel=0.02)


def test_a_sea_in_balance_is_in_balance_and_the_field_reports_what_prevents_it():
    t, y, x = axes(480, 40, 60, 0.05, 0.025)
    waves = random_waves(seed=1, n=150, lowest=1.6, highest=3.5, power=3)
    w = np.gradient(waves.on_grid(t, y, x, "z")["z"], 0.05, axis=0)
    found = wf.energy_budget(cube({"w": w}, t, y, x), bands=(1.2, 1.8, 2.55, 3.0))
    assert np.isnan(found.energy[0])  # waves longer than half the side
    assert np.isnan(found.divergence[1])  # longer than a quarter of it
    assert np.isfinite(found.energy[1])
    for name in ("growth", "divergence"):
        assert abs(float(found[name][2])) < 3 * float(found[f"{name}_std"][2]), name
    assert 0 < float(found.longest_decay[2]) < 20
    with pytest.raises(CubeError, match="choose a shorter segment"):
        wf.energy_budget(cube({"w": w[:64]}, t[:64], y, x), segment=32)
