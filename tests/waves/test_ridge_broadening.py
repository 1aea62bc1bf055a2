"""Width and shift of the dispersion ridge: waves whose amplitudes keep their phase for a known time."""

import numpy as np
import pytest
import xarray as xr
from exact_waves import GRAVITY, SteadyWave
from independent_seas import still_frequency

import wavefield as wf
from wavefield.errors import CubeError

WAVES, DT, DX = 400, 0.05, 0.035
HIGHEST_HZ = 3.4


def sea(seed, width, shift, spread=3.0, steps=800, exponential=False):
    """w of waves on a current with amplitudes that are Gaussian processes; the current, and the depth.

    Their correlation is exp(-(width omega t)^2 / 2), or exp(-width omega t); frequencies are 1 + shift times
    those of linear theory.
    """
    rng = np.random.default_rng([seed, 43])
    depth, speed = float(rng.choice([0.2, 0.7, 5.0])), rng.uniform(0, 0.12)
    towards = rng.uniform(-np.pi, np.pi)
    current = speed * np.cos(towards), speed * np.sin(towards)
    f = 1.1 + (HIGHEST_HZ - 1.1) * (np.arange(WAVES) + rng.random(WAVES)) / WAVES
    table = np.linspace(0.05, 400, 40000)
    k = np.interp(2 * np.pi * f, still_frequency(table, depth), table)
    angle = rng.uniform(-np.pi, np.pi) + rng.normal(0, spread, WAVES)
    kx, ky, sigma = k * np.cos(angle), k * np.sin(angle), 2 * np.pi * f
    line = 2 * np.pi * np.fft.fftfreq(4 * steps, DT)[:, None] / (max(width, 1e-9) * sigma)
    density = 1 / (1 + line**2) if exponential else np.exp(-(line**2) / 2)
    draw = rng.standard_normal((4 * steps, WAVES)) + 1j * rng.standard_normal((4 * steps, WAVES))
    a = np.fft.ifft(np.sqrt(density) * draw, axis=0)[:steps] / np.sqrt(density.sum(axis=0))
    a = a * f**-2
    a *= 0.008 / np.sqrt((abs(a) ** 2).mean(axis=0).sum() / 2)
    t, y, x = np.arange(steps) * DT, np.arange(48) * DX, np.arange(56) * DX
    omega = (1 + shift) * sigma + kx * current[0] + ky * current[1]
    turned = (-1j * omega * a * np.exp(-1j * np.outer(t, omega))).astype("c8")
    e_x, e_y = np.exp(1j * np.outer(kx, x)).astype("c8"), np.exp(1j * np.outer(y, ky)).astype("c8")
    w = ((turned[:, None] * e_y).reshape(-1, WAVES) @ e_x).real.reshape(steps, 48, 56)
    w = w + rng.uniform(0, 3e-3) * rng.standard_normal(w.shape, dtype="f4")
    coords = {"time": t, "y": y, "x": x, "water_depth": depth}
    return xr.DataArray(w, coords, ("time", "y", "x"), attrs={"units": "m s-1"}), current, depth


def inside(found, depth):
    """Rings well inside of the sea, and their frequencies."""
    table = np.linspace(0.05, 400, 40000)
    highest = np.interp(2 * np.pi * HIGHEST_HZ, still_frequency(table, depth), table)
    found = found.sel(k=slice(None, highest - 2))
    return found, still_frequency(found.k.values, depth)


def broadened(seed):
    """What is found in a sea; frequencies; true width and shift, rad/s."""
    width, shift = (0.03, 0.05)[seed % 2], (0.0, 0.01, 0.03)[seed % 3]
    field, current, depth = sea(seed, width, shift)
    found, omega = inside(wf.ridge_broadening(field, current=current), depth)
    return found, omega, width * omega, shift * omega


def errors_of(seed):
    """Errors over standard uncertainties, by quantity."""
    found, _, width, shift = broadened(seed)
    return {
        "width": ((found.width - width) / found.width_std).values,
        "shift": ((found.frequency_shift - shift) / found.frequency_shift_std).values,
    }


def test_widths_and_shifts_are_known_within_their_uncertainties():
    limits, errors = [], {"width": [], "shift": []}
    for seed in range(600, 610):
        found, omega, width, shift = broadened(seed)
        errors["width"].append((found.width - width) / found.width_std)
        errors["shift"].append((found.frequency_shift - shift) / found.frequency_shift_std)
        limits.append(width < found.width_limit)
        np.testing.assert_allclose(found.tau_linear, 1 / omega, rtol=1e-6)
        np.testing.assert_allclose(found.tau_nonlinear, 1 / found.width)
    for off in map(np.concatenate, errors.values()):
        off = off[np.isfinite(off)]
        assert off.size > 40
        assert 0.55 < (abs(off) < 1).mean() < 0.88
        assert abs(off).max() < 4.5
    assert np.concatenate(limits).mean() > 0.85


def test_waves_that_keep_their_phase_have_a_limit_and_no_width():
    for seed in range(3):
        field, current, depth = sea(seed, 0.0, 0.02)
        found, omega = inside(wf.ridge_broadening(field, current=current), depth)
        assert found.width.isnull().mean() > 0.8
        assert float((found.width_limit / omega)[found.k > 20].max()) < 0.03
        np.testing.assert_allclose((found.frequency_shift / omega)[found.k > 20], 0.02, atol=0.008)


def test_an_exponential_memory_shows_as_stated():
    field, current, depth = sea(2, 0.04, 0.0, exponential=True)
    found, omega = inside(wf.ridge_broadening(field, current=current), depth)
    ratio = found.width / np.sqrt(1.8 * 0.04 * omega / found.longest_lag)
    assert float(ratio.mean()) == pytest.approx(1, abs=0.1)


def test_a_fitted_current_takes_the_shift_of_waves_of_one_direction_up():
    broad, _, depth = sea(5, 0.0, 0.02)
    found, omega = inside(wf.ridge_broadening(broad), depth)
    assert np.nanmean(found.frequency_shift / omega) == pytest.approx(0.02, abs=0.006)
    narrow, current, _ = sea(5, 0.0, 0.02, spread=0.2)
    found = wf.ridge_broadening(narrow)
    assert found.frequency_shift.isnull().all()
    assert found.frequency_shift_std.isnull().all()
    assert not wf.ridge_broadening(narrow, current=current).frequency_shift.isnull().all()


@pytest.mark.parametrize("steepness", [0.05, 0.15, 0.25])
def test_steep_waves_are_faster_as_exact_theory_has_it_and_their_harmonics_are_no_ridge(steepness):
    wave = SteadyWave(steepness, 0.5, 0.4)
    t, y, x = np.arange(500) * DT, np.arange(50) * DX, np.arange(60) * DX
    w = wave.fields(t, y, x)["w"]
    w = w + 1e-4 * np.random.default_rng(0).standard_normal(w.shape)
    field = xr.DataArray(w, {"time": t, "y": y, "x": x}, ("time", "y", "x"))
    found = wf.ridge_broadening(field, current=(0.0, 0.0), gamma=0.0)
    found = found.isel(k=np.flatnonzero(found.frequency_shift.notnull()))
    np.testing.assert_allclose(found.k, 4 * np.pi, rtol=0.06)
    excess = 4 * np.pi * (wave.speed - np.sqrt(GRAVITY / (4 * np.pi)))
    assert abs(found.frequency_shift - excess).max() < 2 * float(found.frequency_shift_std.min())


def test_few_segments_and_small_fields_are_refused():
    field, current, _ = sea(0, 0.0, 0.0, steps=200)
    with pytest.raises(CubeError, match="the width of the ridge needs 8"):
        wf.ridge_broadening(field, current=current, segment=100)
    with pytest.raises(CubeError, match="too small"):
        wf.ridge_broadening(field[:, :8, :8], current=current)
