import dask
import numpy as np
import pytest
import xarray as xr
from independent_seas import LatticeSea
from waves_cases import axes, cube, linear_cube, random_waves

import wavefield.waves as wv


@pytest.fixture(scope="module")
def sea():
    return linear_cube(random_waves(n=150, sigma=0.02), 400, 40, 50, dx=0.02, noise_z=0.0003, noise_dz=0.0002)


def test_the_parts_add_up_to_the_whole(sea):
    C = wv.coherence(sea, segment=128)
    for ending in ("", "_komega"):
        total = C[f"C_tot{ending}"]
        use = np.isfinite(total)
        difference = np.abs(C[f"C_w{ending}"] + C[f"C_nl{ending}"] - total).where(use)
        assert float(difference.max()) < 1e-12
    assert np.iscomplexobj(C.C_w)


def test_a_cancelling_nonlinear_term_lifts_the_paper_curve_above_one_and_not_the_standard_one():
    rng = np.random.default_rng(5)
    t, y, x = axes(128, 24, 30, 0.05, 0.04)
    z_t = rng.standard_normal((128, 24, 30))
    # a steep plane, so that u . grad z = .3 z_t
    z = 1e4 * np.broadcast_to(x, z_t.shape)
    fields = {"z": z, "z_t": z_t, "u": 0.3e-4 * z_t, "v": 0 * z_t, "w": 1.3 * z_t}
    made = cube(fields, t, y, x, "f8")
    C = wv.coherence(made, segment=64)
    inner = C.sel(k=slice(15, 40))
    np.testing.assert_allclose(np.abs(inner.C_w), 1.3, rtol=1e-4)
    np.testing.assert_allclose(inner.C_nl.real, -0.3, rtol=1e-4)
    np.testing.assert_allclose(inner.gamma2_w, 1.0, rtol=1e-6)


def test_chunks_do_not_matter_and_lazy_stays_lazy(sea):
    lazy = wv.coherence(sea.chunk({"time": 33, "x": 21}), segment=128)
    assert dask.is_dask_collection(lazy.C_w)
    xr.testing.assert_equal(lazy.compute(), wv.coherence(sea, segment=128))


def test_the_rate_of_rise_lags_the_elevation_by_a_quarter_turn():
    sea = linear_cube(random_waves(n=150), 400, 40, 50, dx=0.02)
    ring = wv.cross_spectra(sea, ("z", "z_t"), (("z", "z_t"),), segment=128)
    line = ring.sel(omega=2 * np.pi * 1.5, method="nearest")
    S = complex(line.S_z_z_t.where(line.E_z == line.E_z.max(), 0).sum())
    # z at frame times is half a step early
    half_step = float(line.omega) * 0.05 / 2
    assert np.angle(S) == pytest.approx(-np.pi / 2 - half_step, abs=0.05)


def test_spectra_of_a_cube_have_fewer_degrees_of_freedom_where_its_current_keeps_waves_in_the_window():
    cube = LatticeSea(side=180, shape=(240, 24, 30), current=(0.2, 0.15)).cube(0, ("u", "v", "w"))
    still = cube.assign(u=cube.u - cube.u.mean(), v=cube.v - cube.v.mean())
    on, off = (wv.cross_spectra(one, ("u", "v", "w"), segment=64) for one in (cube, still))
    waves = on.valid & (on.E_w > 1e-3 * on.E_w.max())
    relative_variance = [float((1 / found.dof_w).where(waves).mean()) for found in (on, off)]
    assert relative_variance[0] > 1.1 * relative_variance[1]
