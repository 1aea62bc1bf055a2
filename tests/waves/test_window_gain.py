import numpy as np
import pytest
import xarray as xr
from waves_cases import PeriodicSea

import wavefield.waves as wv
from wavefield.errors import CubeError, StoreError


@pytest.fixture(scope="module")
def pair():
    """The same sea through 4 cm boxes, with noise, and as it is."""
    measured = PeriodicSea(n=128, box=0.04).cube(300, 48, 56, noise_z=2e-5, noise_dz=1e-5)
    exact = PeriodicSea(n=128, box=0).cube(300, 48, 56)
    return measured, exact.assign(dz=(exact.w * 0.05).assign_attrs(units="m"))


def box(k, angle):
    return np.sqrt(wv.gain_box(k * np.cos(angle), k * np.sin(angle), 0.04))


def test_the_gain_of_a_box_comes_back(pair):
    gain = wv.window_gain(*pair, segment=128)
    for name in ("gain_z", "gain_w"):
        part = gain[name].isel(k=(gain.k > 20) & (gain.k < 110))
        error = part - box(part.k.values, part.direction.values[:, None])
        assert float(np.abs(error.mean("direction")).max()) < 0.02
        assert float(np.abs(error.mean("k")).max()) < 0.03
        # along the axes a box takes more than along its diagonals
        short = part.sel(k=slice(90, 110)).mean("k")
        assert float(short.sel(direction=np.pi / 4) - short.sel(direction=0)) > 0.03


def test_an_undone_spectrum_is_that_of_the_truth(pair):
    measured, exact = pair
    gain = wv.window_gain(measured, exact, segment=128).gain_w
    E, true = (wv.komega(cube.w, segment=128).E for cube in pair)
    undone = wv.undo(E, (gain**2).mean("direction")).E
    for f in (2.0, 3.0, 4.0, 5.0):
        k = float(wv.wavenumber(2 * np.pi * f, 0.7))
        cell = {"k": slice(k - 6, k + 6), "omega": slice(2 * np.pi * (f - 0.2), 2 * np.pi * (f + 0.2))}
        assert float(undone.sel(cell).sum() / true.sel(cell).sum()) == pytest.approx(1, abs=0.05), f


def test_what_is_lost_in_noise_has_no_gain(pair):
    measured, exact = pair
    noise = np.random.default_rng(0).standard_normal(measured.w.shape)
    gain = wv.window_gain(measured.assign(w=measured.w + 0.05 * noise), exact, segment=128)
    assert int(gain.gain_w[0].count()) < int(gain.gain_z[0].count()) - 3


def test_a_truth_of_other_steps_or_nodes_is_refused(pair):
    measured, exact = pair
    with pytest.raises(CubeError, match="differ in 'time'"):
        wv.window_gain(measured, exact.isel(time=slice(0, 200)))
    with pytest.raises(CubeError, match="differ in 'x'"):
        wv.window_gain(measured, exact.assign_coords(x=exact.x + 0.01))
    with pytest.raises(CubeError, match="truth has no 'dz'"):
        wv.window_gain(measured, exact.drop_vars("dz"))


def test_a_gain_is_kept_in_a_store(pair, tmp_path):
    gain = wv.window_gain(*pair, segment=128)
    gain.to_zarr(tmp_path / "gain.zarr", consolidated=False)
    xr.testing.assert_identical(wv.read_gain(tmp_path / "gain.zarr"), gain)
    with pytest.raises(StoreError, match="cannot be read as a gain"):
        wv.read_gain(tmp_path / "none.zarr")
    with pytest.raises(StoreError, match="no 'gain_w' over direction and k"):
        wv.read_gain(gain.drop_vars("gain_w"))
