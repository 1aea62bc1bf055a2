"""Directional spectra of known seas, as the programs of oceanographers read them."""

import numpy as np
import pytest
import xarray as xr
from waves_cases import GaussianSea, axes, cube, relation

import wavefield.waves as wv
from wavefield.waves.gains import elevation_from_w


@pytest.fixture(scope="module")
def directional():
    sea = GaussianSea(spread=10, heading=np.radians(30), n=96, dx=0.03, steps=512, band=(1.2, 4.0))
    w = sea.field(5).isel(y=slice(0, 64), x=slice(0, 80))
    made = xr.Dataset({"w": w}, attrs={"water_depth": 0.7})
    return made, wv.directions(made, current=(0.0, 0.0), segment=128)


def test_wavespectra_reads_a_directional_spectrum(directional, tmp_path):
    wavespectra = pytest.importorskip("wavespectra")
    made, spectrum = directional
    omega = 2 * np.pi * spectrum.freq
    energy = wv.komega(made.w, segment=128)
    elevation = wv.E_omega(energy).E * elevation_from_w(energy.omega, 0.05)
    inside = (energy.omega >= float(omega[0])) & (energy.omega <= float(omega[-1]))
    height = 4 * np.sqrt(float(elevation.where(inside).sum()) * float(energy.omega[1]))
    assert float(spectrum.spec.hs()) == pytest.approx(height, rel=0.06)
    # waves that go 30 degrees from x towards y come from 240 degrees, clockwise from y
    assert float(spectrum.spec.dm()) == pytest.approx(240, abs=4)
    assert float(spectrum.direction.sel(frequency=2, method="nearest")) == pytest.approx(np.pi / 6, abs=0.1)
    # cos^20(theta / 2): r1 = s / (s + 1)
    assert float(spectrum.spec.dspr()) == pytest.approx(np.degrees(np.sqrt(2 / 11)), rel=0.12)
    spectrum.to_netcdf(tmp_path / "sea.nc")
    read = wavespectra.read_netcdf(tmp_path / "sea.nc")
    assert float(read.spec.hs()) == pytest.approx(float(spectrum.spec.hs()), rel=1e-6)


def test_a_directional_spectrum_on_a_current_holds_the_energy_of_still_water():
    k, a, current = 20.0, 0.01, (0.25, 0.0)
    sigma = float(relation(k))
    t, y, x = axes(256, 50, 60, 0.05, 0.025)
    phase = k * x - (sigma + k * current[0]) * t[:, None, None] + 0 * y[:, None]
    w = a * sigma * np.sinc(sigma * 0.05 / 2 / np.pi) * np.sin(phase)
    found = wv.directions(cube({"w": w}, t, y, x), current=current, segment=128)
    step = float(found.freq[1] - found.freq[0])
    variance = float(found.efth.sum()) * 360 / found.sizes["dir"] * step
    assert variance == pytest.approx(a**2 / 2, rel=0.1)
    peak = float(found.freq[int(np.argmax(found.efth.sum("dir").values))])
    assert peak == pytest.approx(sigma / (2 * np.pi), abs=step)
