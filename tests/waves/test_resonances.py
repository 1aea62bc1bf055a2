"""Coherences of wave vectors on random seas, with and without a quartet or triad planted in them."""

import dask.array
import numpy as np
import pytest
from independent_seas import LatticeSea
from scipy import stats
from waves_cases import GaussianSea, relation

import wavefield.waves as wv
from wavefield.errors import CubeError
from wavefield.waves.nonlinear.resonance_lines import probabilities

NY, NX, DX = 24, 32, 0.06
CELL = 2 * np.array([2 * np.pi / (NY * DX), 2 * np.pi / (NX * DX)])  # two of the k plane


@pytest.fixture(scope="module")
def sea():
    return GaussianSea(n=40, steps=3072, dx=DX, lowest=1.2, highest=3.0, width=0.6)


def piece(field):
    field = field.isel(y=slice(0, NY), x=slice(0, NX))
    field.name = "w"
    return field


def train(rng, n, dt=0.05, band=1.0):
    """A wave's complex amplitude, Gaussian, that remembers itself for a second or so."""
    omega = 2 * np.pi * np.fft.fftfreq(n, dt)
    lines = rng.standard_normal(n) + 1j * rng.standard_normal(n)
    a = np.fft.ifft(lines * np.exp(-0.5 * (omega / band) ** 2))
    return a / np.sqrt((np.abs(a) ** 2).mean())


def with_waves(field, vectors, omegas, amplitudes):
    out = field.copy(data=field.values.copy())
    t, y, x = (field[name].values for name in ("time", "y", "x"))
    for (ky, kx), omega, a in zip(vectors, omegas, amplitudes):
        series = (a * np.exp(-1j * omega * t)).astype("c8")
        plane = np.exp(1j * (ky * y[:, None] + kx * x)).astype("c8")
        out.values += (series[:, None, None] * plane).real
    return out


def test_random_phases_give_no_coherence(sea):
    for seed in range(3):
        field = piece(sea.field(seed)).isel(time=slice(0, 2048))
        found = wv.resonances(field, 0.7, settings=wv.ResonanceSettings(modes=60))
        assert int(found.quartet_tests) > 1000
        assert int(found.triad_tests) > 500
        assert not found.quartet_significant.any()
        assert not found.triad_significant.any()
        pulls = found.coherence_excess / found.coherence_excess_std
        assert float(np.abs(pulls).median()) < 3


def test_a_short_record_of_a_linear_sea_has_no_excess_at_any_mismatch():
    # quartets off resonance had one 17 standard uncertainties below zero, those on resonance 5 above it
    sea = LatticeSea(side=200, shape=(400, 26, 32))
    found = [wv.resonances(sea.cube(draw, ("w",)).w, sea.depth) for draw in range(4)]
    pulls = np.array([one.coherence_excess / one.coherence_excess_std for one in found])
    assert np.sqrt((pulls**2).mean()) < 2.5
    assert np.abs(pulls.mean(axis=0)).max() < 4
    assert not any(bool(one.quartet_significant.any()) for one in found)


def test_a_planted_quartet_is_found_and_named(sea):
    field = piece(sea.field(7))
    rng = np.random.default_rng(7)
    # k and its mirror images: all of one length, so that the frequencies meet too
    cells = np.array([(2, 2), (-2, -2), (2, -2), (-2, 2)])
    a = [train(rng, field.sizes["time"]) for _ in range(3)]
    product = a[0] * a[1] * a[2].conj()
    a.append(product / np.sqrt((np.abs(product) ** 2).mean()))
    omega = relation(np.hypot(*(CELL * cells[0])), 0.7)
    size = 0.3 * float(field.std())
    planted = with_waves(field, cells * CELL, [omega] * 4, [size * one for one in a])
    found = wv.resonances(planted, 0.7)
    assert bool(found.quartet_significant[0])
    k = np.stack([found.quartet_ky[0] / CELL[0], found.quartet_kx[0] / CELL[1]], axis=-1).round()
    assert {tuple(v) for v in k.astype(int).tolist()} == {tuple(v) for v in cells.tolist()}
    assert float(found.quartet_coherence[0]) > 0.2
    assert float(np.abs(found.quartet_omega[0] - omega).max()) < 0.5
    assert float(np.abs(found.quartet_mismatch[0])) < 3 * float(found.quartet_mismatch_std[0]) < 1.5
    # random phases in the fourth wave: none
    a[3] = train(rng, field.sizes["time"])
    unrelated = with_waves(field, cells * CELL, [omega] * 4, [size * one for one in a])
    assert not wv.resonances(unrelated, 0.7).quartet_significant.any()


def resonant_quartet():
    """Wave vectors (ky, kx) between the cells, with k1 + k2 = k3 + k4 and their frequencies on resonance."""
    first, second, way = np.array([14.9, 2.0]), np.array([-13.2, 5.3]), np.array([0.05, 1.0])
    total = relation(np.hypot(*first), 0.7) + relation(np.hypot(*second), 0.7)
    length = np.linspace(12, 24, 8001)
    fourth = first + second - length[:, None] * way  # (ky, kx)
    off = total - relation(length, 0.7) - relation(np.hypot(*fourth.T), 0.7)
    i = int(np.abs(off).argmin())
    assert abs(off[i]) < 1e-2
    return np.array([first, second, length[i] * way, fourth[i]])


def test_free_waves_between_cells_and_lines_are_found_on_resonance(sea):
    field = piece(sea.field(10)).isel(time=slice(0, 2048))
    rng = np.random.default_rng(10)
    k = resonant_quartet()
    a = [train(rng, field.sizes["time"], band=0.7) for _ in range(4)]
    product = a[0] * a[1] * a[2].conj()
    a[3] = np.sqrt(0.5) * (a[3] + product / np.sqrt((np.abs(product) ** 2).mean()))
    omega = relation(np.hypot(*k.T), 0.7)
    planted = with_waves(field, k, omega, [0.4 * float(field.std()) * one for one in a])
    (ky1, kx1), (ky2, kx2) = k[:2]
    settings = wv.ResonanceSettings(pair=((kx1, ky1), (kx2, ky2)), modes=60)
    found = wv.resonances(planted, 0.7, settings=settings)
    assert bool(found.quartet_significant[0])
    best = found.isel(quartet=0)
    vectors = np.stack([best.quartet_ky, best.quartet_kx], axis=-1)
    for vector, frequency in zip(k, omega):
        nearest = np.abs(vectors - vector).sum(axis=1).argmin()
        assert (np.abs(vectors[nearest] - vector) < 0.75 * CELL / 2).all()
        assert float(best.quartet_omega[nearest]) == pytest.approx(frequency, abs=0.5)
    assert abs(float(best.quartet_mismatch)) < 3 * float(best.quartet_mismatch_std) < 2
    # the map of the first two waves has its largest coherence at the third or fourth
    row, column = np.unravel_index(np.nanargmax(found.map_coherence), found.map_coherence.shape)
    highest = np.array([found.map_ky[row], found.map_kx[column]])
    assert np.abs((highest - k[2:]) / CELL).max(axis=1).min() < 1
    assert float(found.map_coherence.max()) > 2 * float(found.map_level)


def test_power_is_the_part_of_planted_quartets_that_is_found(sea):
    settings = wv.ResonanceSettings(modes=30)
    short, longer = (
        wv.resonances(piece(sea.field(11)).isel(time=slice(0, n)), 0.7, settings=settings)
        for n in (640, 1920)
    )
    assert (short.power.diff("share") >= -0.05).all()
    assert float(short.power.sel(share=0.3)) < 0.5 < float(longer.power.sel(share=0.5))
    assert float(short.power[0]) < 0.05


def test_a_sea_that_comes_in_groups_has_no_quartets(sea):
    field = piece(sea.field(12)).isel(time=slice(0, 2048))
    swell = 1 + 0.9 * np.sin(2 * np.pi * field.time / 20)
    settings = wv.ResonanceSettings(modes=60)
    assert not wv.resonances(field * swell, 0.7, settings=settings).quartet_significant.any()


def test_cells_that_hold_what_windows_spread_are_no_waves():
    field = LatticeSea(highest=2.0, side=120, shape=(400, 24, 24)).cube(3, names=("w",)).w
    found = wv.resonances(field, 0.7, settings=wv.ResonanceSettings(surrogates=2))
    assert int(found.modes) > 20
    assert float(found.quartet_omega.max()) < 2 * np.pi * 2.3
    assert not found.quartet_significant.any()


def test_a_forced_wave_shows_as_a_triad_off_resonance(sea):
    field = piece(sea.field(8))
    rng = np.random.default_rng(8)
    cells = np.array([(1, 2), (1, 1), (2, 3)])
    a = [train(rng, field.sizes["time"]) for _ in range(2)]
    a.append(a[0] * a[1])
    omegas = [relation(np.hypot(*(CELL * c)), 0.7) for c in cells[:2]]
    size = 0.3 * float(field.std())
    planted = with_waves(field, cells * CELL, [*omegas, sum(omegas)], [size * one for one in a])
    found = wv.resonances(planted, 0.7)
    assert bool(found.triad_significant[0])
    k = np.stack([found.triad_ky[0] / CELL[0], found.triad_kx[0] / CELL[1]], axis=-1).round()
    assert k[2].tolist() == [2, 3]
    assert float(np.abs(found.triad_mismatch[0])) > 2.0


def test_chunks_do_not_matter(sea):
    field = piece(sea.field(9)).isel(time=slice(0, 800))
    settings = wv.ResonanceSettings(modes=20, surrogates=2)
    plain = wv.resonances(field, 0.7, settings=settings)
    chunked = field.copy(data=dask.array.from_array(field.values, chunks=(93, 24, 11)))
    assert plain.identical(wv.resonances(chunked, 0.7, settings=settings))
    # nor does the unit: products of four lie far from single precision's end
    small = wv.resonances(field.copy(data=1e-8 * field.values), 0.7, settings=settings)
    np.testing.assert_allclose(small.quartet_coherence, plain.quartet_coherence, rtol=1e-3)


def test_a_short_record_is_refused(sea):
    with pytest.raises(CubeError, match="need 8"):
        wv.resonances(piece(sea.field(9)).isel(time=slice(0, 200)), 0.7)


def test_probabilities_are_those_of_chance():
    rng = np.random.default_rng(0)
    p = probabilities(rng.exponential(size=20_000), rng.exponential(size=40_000))
    for level in (0.5, 0.05, 0.005, 0.0005):
        assert np.mean(p < level) == pytest.approx(level, rel=0.05 + 2 / np.sqrt(20_000 * level))
    false = [
        stats.false_discovery_control(
            probabilities(rng.exponential(size=500), rng.exponential(size=3000))
        ).min()
        <= 0.05
        for _ in range(200)
    ]
    assert np.mean(false) < 0.1
