import importlib
from itertools import combinations

import numpy as np
import pytest
from waves_cases import axes, cube, linear_cube, random_waves

import wavefield.waves as wv
from wavefield.waves.cross import cross_spectra

coherence_module = importlib.import_module("wavefield.waves.cross")
NAMES, PAIRS = ("rise", "w", "nl"), (("rise", "w"), ("rise", "nl"), ("w", "nl"))


def white_cube(seed, steps=512, ny=24, nx=30):
    rng = np.random.default_rng(seed)
    t, y, x = axes(steps, ny, nx, 0.05, 0.04)
    fields = {n: rng.standard_normal((steps, ny, nx), dtype="f4") for n in ("z", "z_t", "u", "v", "w")}
    return cube(fields, t, y, x)


def u_as_nonlinear_term(ring):
    names = {axis: [name.replace("u", "nl") for name in ring[axis].values] for axis in ("quantity", "pair")}
    return ring.assign_coords(names)


@pytest.fixture(scope="module")
def sea():
    return linear_cube(random_waves(n=150, sigma=0.02), 400, 40, 50, dx=0.02, noise_z=0.0003, noise_dz=0.0002)


def test_the_parts_add_up_to_the_whole(sea):
    C = wv.coherence(sea, segment=128)
    for ending in ("", "_komega"):
        w, nl, total = (C[f"C{ending}"].sel(term=term, drop=True) for term in ("w", "nl", "tot"))
        difference = np.abs(w + nl - total).where(np.isfinite(total))
        assert float(difference.max()) < 1e-12
    assert np.iscomplexobj(C.C)


def test_a_linear_sea_is_coherent_where_its_waves_are(sea):
    C = wv.coherence(sea, segment=128)
    band = C.sel(k=slice(8, 30), term="w")
    assert float(band.gamma2.min()) > 0.97
    assert float(np.abs(np.angle(band.C)).max()) < 0.05


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
    np.testing.assert_allclose(np.abs(inner.C.sel(term="w")), 1.3, rtol=1e-4)
    np.testing.assert_allclose(inner.C.sel(term="nl").real, -0.3, rtol=1e-4)
    np.testing.assert_allclose(inner.gamma2.sel(term="w"), 1.0, rtol=1e-6)


def test_cross_spectra_are_the_power_for_a_field_with_itself(sea):
    ring = cross_spectra(sea, NAMES, (("w", "w"), *PAIRS), segment=128)
    S, E = ring.S.sel(pair="w*w"), ring.E.sel(quantity="w")
    np.testing.assert_allclose(S.real, E, rtol=1e-6)
    assert float(np.abs(S.imag).max()) < 1e-9 * float(E.max())


def test_the_rate_of_rise_lags_the_elevation_by_a_quarter_turn():
    sea = linear_cube(random_waves(n=150), 400, 40, 50, dx=0.02)
    ring = cross_spectra(sea, ("z", "z_t"), (("z", "z_t"),), segment=128)
    line = ring.sel(omega=2 * np.pi * 1.5, method="nearest")
    E_z = line.E.sel(quantity="z")
    S = complex(line.S.where(E_z == E_z.max(), 0).sum())
    # z at frame times is half a step early
    half_step = float(line.omega) * 0.05 / 2
    assert np.angle(S) == pytest.approx(-np.pi / 2 - half_step, abs=0.05)


def test_a_surface_without_slopes_has_no_coherence_with_its_nonlinear_term():
    names = ("rise", "w", "u")
    ring = cross_spectra(white_cube(0, steps=128), names, tuple(combinations(names, 2)), segment=32)
    made = u_as_nonlinear_term(ring)
    flat = made.assign(
        E=made.E.where(made["quantity"] != "nl", 0.0), S=made.S.where(made["pair"] == "rise*w", 0.0)
    )
    # in pieces, since xarray keeps silent about what it divides at once; any warning is an error here
    C = coherence_module.coherence_group(flat.chunk()).compute()
    assert np.isnan(C.gamma2.sel(term="nl")).all()
    assert np.isnan(C.gamma2_komega.sel(term="nl")).all()
    assert np.isfinite(C.gamma2.sel(term="w")).sum() == np.isfinite(C.gamma2.sel(term="tot")).sum() > 0
