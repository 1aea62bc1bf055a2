"""Directions and wavenumbers in time: two wave systems, one after the other, whose truth is known."""

import numpy as np
import pytest
import xarray as xr
from independent_seas import still_frequency

import wavefield as wf
from wavefield.errors import CubeError

FREQUENCIES = (1.4, 1.7, 2.0, 2.4)
WAVES, CHANGE = 120, 12.0  # of a system; s, when the second follows the first


def two_systems(seed, spread, together=False):
    """z; frequency in the frame of the cameras, wave vector, amplitude and system of each wave."""
    rng = np.random.default_rng([seed, 31])
    depth, n = float(rng.choice([0.2, 0.7, 5.0])), 2 * WAVES
    f = rng.permutation(1.1 + 2.2 * (np.arange(n) + rng.random(n)) / n)
    table = np.linspace(0.05, 400, 40000)
    k = np.interp(2 * np.pi * f, still_frequency(table, depth), table)
    heading = rng.uniform(-np.pi, np.pi)
    heading = heading, heading + rng.uniform(1.7, 2 * np.pi - 1.7)
    first = np.arange(n) < WAVES
    angle = np.where(first, *heading) + spread * rng.standard_normal(n)
    current, towards = rng.uniform(0, 0.04), rng.uniform(-np.pi, np.pi)
    a = f**-2 * (rng.standard_normal(n) + 1j * rng.standard_normal(n))
    a *= 0.008 / np.sqrt((abs(a[first]) ** 2).sum() / 2)
    omega = still_frequency(k, depth) + k * current * np.cos(angle - towards)
    t, y, x = np.arange(480) * 0.05, np.arange(48) * 0.035, np.arange(60) * 0.035
    early = 1 / (1 + np.exp((t - CHANGE) / 0.3))[:, None]
    there = np.ones((t.size, n)) if together else np.where(first, early, 1 - early)
    e_x = np.exp(1j * np.outer(k * np.cos(angle), x)).astype("c8")
    e_y = np.exp(1j * np.outer(y, k * np.sin(angle))).astype("c8")
    turned = (there * a * np.exp(-1j * np.outer(t, omega))).astype("c8")
    z = ((turned[:, None] * e_y).reshape(-1, n) @ e_x).real.reshape(t.size, y.size, x.size)
    z = z + rng.uniform(2e-4, 3e-3) * rng.standard_normal(z.shape, dtype="f4")
    coords = {"time": t, "y": y, "x": x, "water_depth": depth}
    field = xr.DataArray(z, coords, ("time", "y", "x"), attrs={"units": "m"})
    return field, omega, k * np.cos(angle), k * np.sin(angle), a, first


def compared(seed):
    """Errors of directions, rad, their std; relative errors of k of the sea and of the moment, its std."""
    z, omega, kx, ky, a, first = two_systems(seed, (0.0, 0.1, 0.2, 0.3)[seed % 4])
    e_x, e_y = np.exp(1j * np.outer(kx, z.x)), np.exp(1j * np.outer(z.y, ky))
    found = wf.wavelet_directions(z, FREQUENCIES, interval=1.0)
    rows = []
    for f in FREQUENCIES:
        one = found.sel(frequency=f)
        one = one.sel(time=abs(one.time - CHANGE) > 21 / (2 * np.pi * f) + 1.0)
        gain = np.exp(-((6 * (omega / (2 * np.pi * f) - 1)) ** 2) / 2)
        shares = abs(gain * a) ** 2
        parts = [shares * part for part in (kx, ky, np.hypot(kx, ky), 1)]
        sums = [[part[of].sum() for part in parts] for of in (first, ~first)]
        x, y, k, total = np.where((one.time.values < CHANGE)[:, None], *sums).T
        turn = (one.direction - np.arctan2(y, x) + np.pi) % (2 * np.pi) - np.pi
        now = []
        for t in one.time.values:
            lines = gain * a * np.where(first == (t < CHANGE), np.exp(-1j * omega * t), 0)
            plane, times_k = (((e_y * part) @ e_x) for part in (lines, lines * np.hypot(kx, ky)))
            now.append((plane.conj() * times_k).real.sum() / (abs(plane) ** 2).sum())
        of_k = [one.k / truth - 1 for truth in (k / total, np.array(now))]
        rows.append(np.stack([turn, one.direction_std, *of_k, one.k_std / one.k]))
    return np.concatenate(rows, axis=1)


def errors_of(seed):
    """Errors over standard uncertainties, by quantity."""
    turn, std, _, of_k, k_std = compared(seed)
    return {"direction": turn / std, "k of the moment": of_k / k_std}


def test_directions_and_wavenumbers_of_two_systems_are_those_of_their_time():
    turn, std, of_k, _, _ = np.concatenate([compared(seed) for seed in range(500, 512)], axis=1)
    assert np.nanmax(abs(turn)) < 0.5
    off = turn / std
    assert np.isfinite(off).mean() > 0.75
    assert 0.6 < (abs(off[np.isfinite(off)]) < 1).mean() < 0.85
    assert abs(np.nanmedian(of_k)) < 0.02
    assert np.nanstd(of_k) < 0.12  # groups pass, whose frequency differs from the mean of the band


def test_several_directions_at_a_time_have_none():
    opposite = two_systems(1, 0.0, together=True)[0]
    found = wf.wavelet_directions(opposite, FREQUENCIES)
    crossing = found.resultant < 0.7
    assert crossing.mean() > 0.3
    assert found.direction.where(crossing).isnull().all()
    assert (found.direction_std.where(~crossing).notnull() | crossing | found.resultant.isnull()).all()


def test_a_wave_off_the_frequency_of_the_wavelet_has_its_own_wavenumber_and_frequency():
    t, y, x = np.arange(600) * 0.05, np.arange(40) * 0.03, np.arange(60) * 0.03
    sigma = still_frequency(14.0, np.inf)
    wave = np.cos(14.0 * (0.6 * x + 0.8 * y[:, None]) - sigma * t[:, None, None])
    field = xr.DataArray(wave, {"time": t, "y": y, "x": x}, ("time", "y", "x"))
    found = wf.wavelet_directions(field, (1.7, 1.9))
    np.testing.assert_allclose(found.local_frequency.dropna("time"), sigma / (2 * np.pi), rtol=2e-3)
    np.testing.assert_allclose(found.k.dropna("time"), 14.0, rtol=5e-3)
    np.testing.assert_allclose(found.direction.dropna("time"), np.arctan2(0.8, 0.6), atol=2e-3)


def test_waves_that_nodes_or_field_do_not_resolve_are_refused():
    z = two_systems(0, 0.0)[0]
    for frequencies, part, words in (
        ((9.0,), z, "shorter than five nodes"),
        ((0.3,), z, "longer than the field"),
        ((1.5,), z[:40], "as long as a wavelet"),
    ):
        with pytest.raises(CubeError, match=words):
            wf.wavelet_directions(part, frequencies)
    assert wf.wavelet_directions(z, (1.5, 9.0)).k.isel(frequency=1).isnull().all()
