"""Waves shorter than blocks move the beads of all cameras alike: they are found, noise is not."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.fft
from measurement_cases import RATE

from wavefield.matching import Modes, PosteriorVariance, Prior
from wavefield.matching.matching_gain import footprint
from wavefield.measurement import LearnedRecord, Model, measure
from wavefield.measurement.differences import Differences
from wavefield.measurement.regrid import BlockLattice
from wavefield.measurement.unresolved_waves import missing_waves, unresolved_rise, unresolved_std

SIDE = 60
LATTICE = BlockLattice(2.0, 2.0, 5.0, (SIDE, SIDE))
SIGHTS = {  # px per metre: two cameras at 45 degrees along x, one above
    "cam1": [[450.0, 0, 450], [0, 640, 0]],
    "cam2": [[450.0, 0, -450], [0, 640, 0]],
    "cam3": [[540.0, 0, 0], [0, 540, 0]],
}


def found(seed, waves, noise, cameras, removed=0.0):
    """Rise found where beads move by short waves with this std of the rise, m, and by noise, px.
    The prior removes waves whose rise has the std removed, m.
    """
    rng = np.random.default_rng(seed)
    water = rng.normal(0, waves, (3, SIDE, SIDE)) * np.sqrt([0.5, 0.5, 1.0])[:, None, None]
    valid = rng.random((SIDE, SIDE)) > 0.1
    hessian = rng.gamma(2.0, 1.0, (3, SIDE, SIDE)).astype(np.float32)
    hessian[1] = 0.1 * np.sqrt(hessian[0] * hessian[2])
    xx, xy, yy = hessian
    estimates, missing = {}, {}
    for name in cameras:
        J = np.array(SIGHTS[name])
        u, v = np.einsum("ik,kyx->iyx", J, water) + rng.normal(0, noise, (2, SIDE, SIDE))
        one = SimpleNamespace(
            hessian=hessian, score=np.stack([xx * u + xy * v, xy * u + yy * v]), valid=valid
        )
        estimates[name] = SimpleNamespace(found=one)
        part = np.square(J) @ [0.5, 0.5, 1.0] * removed**2
        missing[name] = np.broadcast_to(part[:, None, None], (2, SIDE, SIDE))
    return unresolved_rise(estimates, missing, np.zeros((SIDE, SIDE)), geometry_of(cameras))


def geometry_of(cameras):
    """Nodes at the blocks of cameras with the same Jacobian everywhere."""
    place = LATTICE.step * np.mgrid[:SIDE, :SIDE][::-1] + LATTICE.x0
    sights = {}
    for name in cameras:
        J = np.array(SIGHTS[name]).reshape(6, 1, 1)
        at = np.concatenate([place, np.broadcast_to(J, (6, SIDE, SIDE))])
        sights[name] = SimpleNamespace(at=lambda z, at=at: at, lattice=LATTICE)
    return SimpleNamespace(sights=sights)


@pytest.mark.parametrize("cameras", [("cam1", "cam2"), ("cam1", "cam3"), ("cam1", "cam2", "cam3")])
def test_waves_that_all_cameras_see_are_found_in_any_noise_and_noise_alone_is_not(cameras):
    for seed in range(6):
        noise = float(np.random.default_rng(seed).uniform(0.01, 0.3))
        assert found(seed, 0.0, noise, cameras)[0] < 0.0
        size = 2.0 * noise / 500.0
        variance, wavelength = found(seed, size, noise, cameras)
        twice, _ = found(seed, 2.0 * size, 2.0 * noise, cameras)
        assert 0.8 < np.sqrt(variance) / size < 2.7  # of two cameras' blocks not all beads are the same
        assert twice == pytest.approx(4.0 * variance)
        assert wavelength == pytest.approx(2.5 * 5.0 / 540.0, rel=0.1)


def test_waves_that_the_prior_removes_are_not_stated_twice():
    for seed in range(3):
        noise = float(np.random.default_rng(seed).uniform(0.01, 0.1))
        size = noise / 500.0
        shares = [found(seed, size, noise, tuple(SIGHTS), part * size)[0] for part in (0.0, 0.3, 1.0, 3.0)]
        assert shares == sorted(shares, reverse=True)
        assert shares[1] > 0.6 * shares[0], "waves beside them are"
        assert shares[3] < 0.25 * shares[0]


def share_found(seed, share, cameras):
    """How much of a spectrum is found missing, and its std, of waves with a share of it and much noise."""
    rng = np.random.default_rng(seed)
    ky, kx = (np.pi * np.arange(SIDE) / SIDE for _ in range(2))
    k = np.hypot(kx, ky[:, None])
    noise, slope = 0.1, rng.uniform(-4.0, 0.0)  # px; of the spectrum

    size = rng.uniform(0.2, 1.0) * noise / 500.0

    def power(k):
        return size**2 * np.maximum(k, 0.1) ** slope

    parts = np.sqrt([0.5, 0.5, 1.0])[:, None, None]
    water = parts * np.sqrt(share * power(k)) * rng.standard_normal((3, SIDE, SIDE))
    found, modes = {}, {}
    rings = np.linspace(0.04, 3.1, 40)
    for name in cameras:
        J = np.array(SIGHTS[name])
        components = np.square(J) @ [0.5, 0.5, 1.0]
        table = tuple((tuple(map(float, one * power(rings))),) for one in components)
        modes[name] = m = Modes(Prior(tuple(rings), table, noise**-2), (SIDE, SIDE))
        waves = footprint(kx, ky[:, None]) * np.einsum("ik,kyx->iyx", J, water)
        blocks = scipy.fft.idctn(waves, axes=(1, 2), norm="ortho") + rng.normal(0, noise, waves.shape)
        a = np.stack([np.ones((SIDE, SIDE)), np.zeros((SIDE, SIDE)), np.ones((SIDE, SIDE))]) / noise**2
        a, blocks = np.float32(a), np.float32(blocks)
        none = np.zeros((2, *m.shape), np.float32)
        solved = m.solve(a, blocks / np.float32(noise**2), none, 1e-3, none, m.factor(a[0]))
        valid = SimpleNamespace(valid=rng.random((SIDE, SIDE)) > 0.1)
        found[name] = SimpleNamespace(waves=solved, mean=none, found=valid)
    shown = missing_waves(found, modes, np.zeros((SIDE, SIDE)), geometry_of(cameras))
    return Differences((0.0, 0.0), True, missing=shown).share


@pytest.mark.parametrize("cameras", [("cam1", "cam2"), ("cam1", "cam2", "cam3")])
def test_of_waves_that_a_field_lacks_as_much_is_found_as_cameras_have_in_common(cameras):
    for share in (0.0, 0.4, 1.0):
        off = []
        for seed in range(8):
            estimate, std = share_found([seed, 7], share, cameras)
            assert std < 0.7
            off.append((estimate - share) / std)
        assert abs(np.mean(off)) < 1.2, "no bias beyond chance"
        assert 0.3 < np.sqrt(np.mean(np.square(off))) < 2.0, "as uncertain as stated"


def test_a_hole_lacks_all_of_the_waves_whatever_blocks_lack_of_them():
    prior = Prior.isotropic((0.04, 0.5, 3.1), (1.0, 0.1, 1e-5), 100.0)
    everywhere = np.full((SIDE, SIDE), 100.0, np.float32)
    hole = everywhere.copy()
    hole[20:40, 20:40] = 0.0
    few = replace(prior, share=(0.05, 0.02), of_all=True)
    missing = [[PosteriorVariance(p, (SIDE, SIDE))(a)[1] for a in (everywhere, hole)] for p in (prior, few)]
    (most, most_in_hole), (least, least_in_hole) = (([m[0, 30, 30] for m in one]) for one in missing)
    assert least < 0.15 * most
    assert least_in_hole > 0.9 * most_in_hole


def test_without_blocks_in_common_no_waves_are_found():
    assert found(1, 1e-3, 0.1, ("cam1",)) == (0.0, 0.0)


def test_what_cameras_see_from_the_same_side_is_not_taken_for_waves(monkeypatch):
    """Two cameras at sea see the same reflections change: nothing shows that water rises."""
    turned = np.array(SIGHTS["cam1"]) @ [[1, 0, 0], [0, 1, 0.05], [0, 0, 1]]
    monkeypatch.setitem(SIGHTS, "beside", turned.tolist())
    variance, wavelength = found(1, 1e-3, 0.1, ("cam1", "beside"))
    z, rise = unresolved_std(np.sqrt(variance), wavelength, RATE)
    assert z == 0 < rise


def test_standard_uncertainties_contain_them_and_values_do_not_change(series, geometry, model):
    waves = 2e-4, 0.02
    record = replace(model.record, unresolved=waves)
    assert LearnedRecord.from_dict(record.to_dict()) == record
    without, cube = (measure(series.block(0, 1), geometry, RATE, m) for m in (model, Model(geometry, record)))
    z, rise = unresolved_std(*waves, RATE)
    for name, std in {"z": z, "u": np.sqrt(0.5) * rise * RATE, "w": rise * RATE}.items():
        assert np.array_equal(cube[name], without[name], equal_nan=True)
        good = np.isfinite(cube[name]) & ((cube["quality"] & 1) > 0)
        added = np.sqrt(np.square(cube[f"{name}_std"]) - np.square(without[f"{name}_std"]))
        assert added[good] == pytest.approx(std, rel=1e-2)
