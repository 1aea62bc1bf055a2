import dask
import numpy as np
import pytest
import xarray as xr
from waves_cases import PeriodicSea

import wavefield.waves as wv
from wavefield.errors import CubeError

SIGMA_Z, SIGMA_DZ = 0.00057, 0.00028


@pytest.fixture(scope="module")
def measured():
    """A sea ~ f^-6 with the paper's noise in z and dz."""
    return PeriodicSea(n=128).cube(2048, 50, 64, noise_z=SIGMA_Z, noise_dz=SIGMA_DZ)


@pytest.fixture(scope="module")
def record(measured):
    return wv.whole_record(measured)


@pytest.fixture(scope="module")
def fused(measured, record):
    return wv.fusion(measured, record=record, segment=512)


@pytest.fixture(scope="module")
def truth(measured, record):
    E = wv.komega(measured.exact, segment=512, record=record)
    return wv.frequency_spectrum(E).E


def smooth(values):
    return np.convolve(values, np.ones(7) / 7, "same")


def reach(energy, truth):
    """Frequency and decades below the peak up to which a spectrum is right within a factor 2."""
    ratio = smooth(energy) / smooth(truth)
    hertz = energy.frequency.values
    bad = np.flatnonzero((hertz > 1) & ((ratio > 2) | (ratio < 0.5) | ~np.isfinite(ratio)))
    stop = bad[0] if bad.size else -6
    return hertz[stop], np.log10(float(truth.max()) / truth.values[stop])


def test_the_noise_is_found_without_a_rest_record(fused):
    assert float(fused.sigma_z) == pytest.approx(SIGMA_Z, rel=0.02)
    assert float(fused.sigma_dz) == pytest.approx(SIGMA_DZ, rel=0.02)
    assert abs(float(fused.noise_coherence)) < 0.03


def test_each_road_reaches_as_far_as_its_noise_lets_it(fused, truth):
    reached = {road: reach(fused[f"Ez_{road}"], truth) for road in ("stereo", "w", "cross", "fusion")}
    decades = {road: value[1] for road, value in reached.items()}
    assert decades["stereo"] > 3.6
    assert decades["w"] > decades["stereo"] + 0.8  # the paper's "one decade"
    assert decades["cross"] > decades["stereo"] + 2
    assert decades["fusion"] > decades["stereo"] + 2
    assert reached["stereo"][0] > 4.2
    assert reached["fusion"][0] > 6.5


def test_the_range_that_is_said_is_the_range_that_is_reached(fused, truth):
    for road in ("stereo", "w", "cross", "fusion"):
        said = float(fused.range_frequency.sel(road=road))
        reached = reach(fused[f"Ez_{road}"], truth)[0]
        assert said == pytest.approx(reached, rel=0.25), road


def test_integrated_w_is_the_elevation_before_noise():
    quiet = PeriodicSea(n=128).cube(700, 40, 50)
    out = wv.fusion(quiet, segment=256)
    band = (out.frequency > 1) & (out.frequency < 6)
    ratio = out.Ez_w[band] / out.Ez_stereo[band]
    assert np.abs(ratio.mean() - 1) < 0.01
    # a window mixes neighbouring lines, w weighs each by its own frequency: no better than line / frequency
    cross = (out.Ez_cross / out.Ez_stereo)[band] - 1
    assert np.abs(cross.mean()) < 0.01
    assert (np.abs(cross) * out.frequency[band] / float(out.frequency[1])).max() < 1


def test_the_combined_time_series_is_better_than_either(measured, record, fused):
    # elevation at mid-time, exact: from the frames by the same sea
    exact = measured.exact
    best = wv.fuse(measured, fused, record=record)
    wiener = wv.fuse(measured, fused, gain=fused.wiener, record=record)
    # the truth at mid-time: shift frame times by half a step in Fourier space, away from the ends
    lines = np.fft.rfft(exact.values.astype(float), axis=0)
    omega = 2 * np.pi * np.fft.rfftfreq(exact.sizes["time"], 0.05)
    middle = np.fft.irfft(lines * np.exp(0.5j * omega * 0.05)[:, None, None], exact.sizes["time"], axis=0)
    inner = slice(100, -100)
    error = {
        name: float(np.std(series.values[inner] - middle[inner]))
        for name, series in (("stereo", measured.z), ("best", best), ("wiener", wiener))
    }
    assert best.shape == measured.z.shape
    assert error["best"] < 0.8 * error["stereo"]
    assert error["wiener"] < error["best"]


def test_the_ends_of_the_combined_series_are_as_good(measured, record, fused):
    best = wv.fuse(measured, fused, record=record)
    exact = measured.exact
    middle = (9 * (exact[1:-2].values + exact[2:-1].values) - exact[:-3].values - exact[3:].values) / 16
    error = best.values[1:-2] - middle
    assert np.std(error[:30]) < 2 * np.std(error[800:900])
    assert np.std(error[-30:]) < 2 * np.std(error[800:900])


def test_chunks_do_not_matter(measured, fused):
    short = measured.isel(time=slice(0, 1100), y=slice(0, 12), x=slice(0, 14)).drop_vars("exact")
    whole = wv.fuse(short, fused, gain=fused.wiener)
    lazy = wv.fuse(short.chunk({"time": 211, "x": 5}), fused, gain=fused.wiener)
    assert dask.is_dask_collection(lazy)
    xr.testing.assert_equal(lazy.compute(), whole)
    xr.testing.assert_equal(wv.fusion(short.chunk({"time": 90}), segment=128), wv.fusion(short, segment=128))


def test_what_is_missing_is_named(measured, fused):
    with pytest.raises(CubeError, match="no 'w'"):
        wv.fusion(measured.drop_vars("w"))
    with pytest.raises(CubeError, match="less than one segment of the fusion"):
        wv.fuse(measured.isel(time=slice(0, 300)), fused)


def test_a_correction_is_masked_where_it_would_blow_up_noise():
    omega = xr.DataArray(np.linspace(1, 60, 50), dims="omega", name="omega")
    gain = wv.gain_two_frames(omega, 0.05)
    out = wv.undo(omega**-4.0 * gain + 1e-6, gain, 1e-6)
    assert bool(out.valid[0])
    assert not bool(out.valid[-1])
    np.testing.assert_allclose(out.E[0], omega[0] ** -4.0, rtol=1e-6)
    assert np.isnan(out.E[-1])
