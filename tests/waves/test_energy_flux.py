"""Energy flux from decay: random seas whose waves decay at known rates, and seas that do not."""

import numpy as np
import pytest
import xarray as xr
from independent_seas import GRAVITY, TENSION, still_frequency

import wavefield as wf
from wavefield.errors import CubeError

WAVES = 500


def decaying_sea(seed, rate, steps=900):
    """A cube of w; frequencies (Hz), wavenumbers, energies at the start, and decay rates of its waves."""
    rng = np.random.default_rng([seed, 9])
    depth, slope = float(rng.choice([0.3, 0.7, 5.0])), rng.uniform(1.5, 2.5)
    f = 1.2 + 3.8 * (np.arange(WAVES) + rng.random(WAVES)) / WAVES
    table = np.linspace(0.05, 400, 40000)
    k = np.interp(2 * np.pi * f, still_frequency(table, depth), table)
    angle = rng.uniform(-np.pi, np.pi) + rng.normal(0, rng.choice([0.3, 0.8, 3.0]), WAVES)
    a = f**-slope * (rng.standard_normal(WAVES) + 1j * rng.standard_normal(WAVES))
    a *= 0.008 / np.sqrt((abs(a) ** 2).sum() / 2)
    rates = rate * (f / 1.5) ** rng.uniform(0, 1.5)
    t, y, x = np.arange(steps) * 0.05, np.arange(56) * 0.03, np.arange(70) * 0.03
    omega = still_frequency(k, depth)
    e_x = np.exp(1j * np.outer(k * np.cos(angle), x)).astype("c8")
    e_y = np.exp(1j * np.outer(y, k * np.sin(angle))).astype("c8")
    turned = ((-1j * omega * a) * np.exp(np.outer(t, -1j * omega - rates / 2))).astype("c8")
    w = ((turned[:, None] * e_y).reshape(-1, WAVES) @ e_x).real.reshape(steps, 56, 70)
    w = w + rng.uniform(0, 0.003) * rng.standard_normal(w.shape, dtype="f4")
    attrs = {"velocity": "instantaneous", "water_depth": depth}
    cube = xr.Dataset({"w": (("time", "y", "x"), w, {"units": "m s-1"})}, {"time": t, "y": y, "x": x}, attrs)
    return cube, f, k, 500 * (GRAVITY + TENSION * k**2) * abs(a) ** 2, rates


def compared(seed, rate=0.06):
    """What is found in a decaying sea, and the true decay rates, flux and viscous loss."""
    cube, f, k, energy, rates = decaying_sea(seed, rate)
    found = wf.energy_flux(cube, frequencies=(1.0, 1.5, 2.0, 3.0))
    energy = energy * np.exp(-rates * float(cube.time[-1]) / 2)
    edges = np.r_[found.attrs["lowest"], found.edge.values]
    inside = (f > edges[0]) & (f < edges[-1])
    band = np.digitize(f[inside], edges) - 1
    sums = [np.bincount(band, part[inside]) for part in (energy, energy * rates, 4e-6 * k**2 * energy)]
    return found, sums[1] / sums[0], np.cumsum(sums[1] - sums[2]), np.cumsum(sums[2])


def errors_of(seed):
    """Errors over standard uncertainties, by quantity."""
    found, rates, flux, _ = compared(seed)
    return {
        "decay rate": ((found.decay_rate - rates) / found.decay_rate_std).values,
        "flux": (found.flux.values - flux) / found.flux_std.values,
    }


def test_rates_and_fluxes_of_decaying_seas_are_known_within_their_uncertainties():
    off = []
    for seed in range(300, 308):
        found, rates, flux, loss = compared(seed)
        off.append((found.decay_rate - rates) / found.decay_rate_std)
        off.append((found.flux.values - flux) / found.flux_std.values)
        assert float(found.total_decay_rate) == pytest.approx(0.06, rel=0.9)
    off = np.concatenate(off)
    assert 0.55 < (abs(off) < 1).mean() < 0.85
    assert abs(off).max() < 4
    np.testing.assert_allclose(found.loss_below, loss, rtol=0.35)


@pytest.mark.parametrize("rate", [0.0, -0.05])
def test_stationary_and_growing_seas_give_no_flux(rate):
    for seed in range(3):
        with pytest.raises(CubeError, match="stationary, forced or mostly noise"):
            wf.energy_flux(decaying_sea(seed, rate)[0], frequencies=(1.0, 1.5, 2.0, 3.0))


def test_short_records_and_narrow_bands_give_no_flux():
    cube = decaying_sea(0, 0.1, 200)[0]
    for options, words in (
        ({"segment": 100}, "3 segments"),
        ({"frequencies": (1.5, 1.6, 3.0)}, "wider bands"),
        ({"frequencies": (0.2, 0.5)}, "longer than half the field|wider bands"),
    ):
        with pytest.raises(CubeError, match=words):
            wf.energy_flux(cube, **options)


def test_the_noise_of_short_waves_is_no_energy():
    quiet, noisy = (decaying_sea(1, 0.05)[0] for _ in range(2))
    noisy["w"] = noisy.w + 0.02 * np.random.default_rng(0).standard_normal(noisy.w.shape)
    budgets = [wf.energy_budget(cube, bands=(1.5, 2.0, 3.0)) for cube in (quiet, noisy)]
    np.testing.assert_allclose(budgets[1].energy, budgets[0].energy, rtol=0.1)
