import numpy as np
import pytest
from waves_cases import PeriodicSea

import wavefield.waves as wv
from wavefield.errors import CubeError


@pytest.fixture(scope="module")
def pair():
    """The same sea through 4 cm boxes, with noise, and as it is."""
    measured = PeriodicSea(n=128, box=0.04).cube(300, 48, 56, noise_z=2e-5, noise_dz=1e-5)
    exact = PeriodicSea(n=128, box=0).cube(300, 48, 56)
    return measured, exact.assign(dz=exact.w * 0.05)


def box(k):
    angle = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    return np.sqrt(wv.gain_box(k * np.cos(angle), k * np.sin(angle), 0.04)).mean()


def test_the_gain_of_a_box_comes_back(pair):
    gain = wv.window_gain(*pair, segment=128)
    for name in ("gain_z", "gain_w"):
        part = gain[name].dropna("k")
        part = part.isel(k=(part.k > 20) & (part.k < 120))
        assert part.size > 10
        # both seas have rms 1.5 cm: the one through the boxes is scaled up by the same factor at every k
        ratio = part / [box(k) for k in part.k.values]
        np.testing.assert_allclose(ratio / ratio.mean(), 1, atol=0.02)


def test_an_undone_spectrum_is_that_of_the_truth(pair):
    measured, exact = pair
    gain = wv.window_gain(measured, exact, segment=128).gain_w
    E, true = (wv.komega(cube.w, segment=128).E for cube in pair)
    undone = wv.undo(E, gain**2).E
    for f in (2.0, 3.0, 4.0, 5.0):
        k = float(wv.wavenumber(2 * np.pi * f, 0.7))
        cell = {"k": slice(k - 6, k + 6), "omega": slice(2 * np.pi * (f - 0.2), 2 * np.pi * (f + 0.2))}
        assert float(undone.sel(cell).sum() / true.sel(cell).sum()) == pytest.approx(1, abs=0.05), f


def test_what_is_lost_in_noise_has_no_gain(pair):
    measured, exact = pair
    noise = np.random.default_rng(0).standard_normal(measured.w.shape)
    gain = wv.window_gain(measured.assign(w=measured.w + 0.05 * noise), exact, segment=128)
    assert int(gain.gain_w.count()) < int(gain.gain_z.count()) - 3


def test_a_truth_of_other_steps_or_nodes_is_refused(pair):
    measured, exact = pair
    with pytest.raises(CubeError, match="differ in 'time'"):
        wv.window_gain(measured, exact.isel(time=slice(0, 200)))
    with pytest.raises(CubeError, match="differ in 'x'"):
        wv.window_gain(measured, exact.assign_coords(x=exact.x + 0.01))
    with pytest.raises(CubeError, match="truth has no 'dz'"):
        wv.window_gain(measured, exact.drop_vars("dz"))
