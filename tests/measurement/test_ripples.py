"""Ripples shorter than blocks move the beads of all cameras alike: they are found, noise is not."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from measurement_cases import RATE

from wavefield.grid import Grid
from wavefield.measurement import GridGeometry, Model, learn, measure
from wavefield.measurement.error_budget import ripple_rise, ripples, shared_motion
from wavefield.measurement.model import LearnedRecord
from wavefield.measurement.regrid import BlockLattice
from wavefield.tank import Scene, Tank

SIDE = 60
LATTICE = BlockLattice(2.0, 2.0, 5.0, (SIDE, SIDE))
SIGHTS = {  # px per metre: two cameras at 45 degrees along x, one above
    "cam1": [[450.0, 0, 450], [0, 640, 0]],
    "cam2": [[450.0, 0, -450], [0, 640, 0]],
    "cam3": [[540.0, 0, 0], [0, 540, 0]],
}


def found(seed, waves, noise, cameras):
    """Std of the rise that is stated, m: beads move by short waves, m, and by noise, px."""
    rng = np.random.default_rng(seed)
    water = rng.normal(0, waves, (3, SIDE, SIDE)) * np.sqrt([0.5, 0.5, 1.0])[:, None, None]
    valid = rng.random((SIDE, SIDE)) > 0.1
    hessian = rng.gamma(2.0, 1.0, (3, SIDE, SIDE)).astype(np.float32)
    hessian[1] = 0.1 * np.sqrt(hessian[0] * hessian[2])
    xx, xy, yy = hessian
    y, x = LATTICE.step * np.mgrid[:SIDE, :SIDE] + LATTICE.x0
    estimates, sights = {}, {}
    for name in cameras:
        J = np.array(SIGHTS[name])
        u, v = np.einsum("ik,kyx->iyx", J, water) + rng.normal(0, noise, (2, SIDE, SIDE))
        one = SimpleNamespace(
            hessian=hessian, score=np.stack([xx * u + xy * v, xy * u + yy * v]), valid=valid
        )
        estimates[name] = SimpleNamespace(found=one)
        at = np.concatenate([np.stack([x, y]), np.broadcast_to(J.reshape(6, 1, 1), (6, SIDE, SIDE))])
        sights[name] = SimpleNamespace(at=lambda z, at=at: at, lattice=LATTICE)
    geometry = SimpleNamespace(sights=sights)
    return ripple_rise(*shared_motion(estimates, np.zeros((SIDE, SIDE)), geometry))


@pytest.mark.parametrize("cameras", [("cam1", "cam2"), ("cam1", "cam3"), ("cam1", "cam2", "cam3")])
def test_waves_that_all_cameras_see_are_found_in_any_noise_and_noise_alone_is_not(cameras):
    for seed in range(3):
        noise = float(np.random.default_rng(seed).uniform(0.01, 0.3))
        assert found(seed, 0.0, noise, cameras) == 0.0
        size = 2.0 * noise / 500.0
        rise = found(seed, size, noise, cameras)
        twice = found(seed, 2.0 * size, 2.0 * noise, cameras)
        assert 0.8 < rise / size < 3.2  # of two cameras' blocks not all beads are the same
        assert twice == pytest.approx(2.0 * rise)


def test_standard_uncertainties_contain_them_and_values_do_not_change(series, geometry, model):
    waves = 2e-4, 0.02
    record = replace(model.record, ripples=waves)
    assert LearnedRecord.from_dict(record.to_dict()) == record
    without, cube = (measure(series.block(0, 1), geometry, RATE, m) for m in (model, Model(geometry, record)))
    z, u, _, w = np.sqrt(ripples(waves, RATE))
    for name, std in {"z": z, "u": u * RATE, "w": w * RATE}.items():
        assert np.array_equal(cube[name], without[name], equal_nan=True)
        good = np.isfinite(cube[name]) & ((cube["quality"] & 1) > 0)
        added = np.sqrt(np.square(cube[f"{name}_std"]) - np.square(without[f"{name}_std"]))
        assert added[good] == pytest.approx(std, rel=1e-2)


def test_short_waves_that_blocks_resolve_are_not_found_as_unresolved_ones():
    seed = 1
    length = float(np.random.default_rng(seed).uniform(0.055, 0.09))
    sea = {
        "rms": 0.1 * length / (2.0 * np.pi),
        "spectrum": {"kind": "power", "peak": 1.0, "exponent": 3.0},
        "shortest": length / 1.2,
        "longest": length * 1.2,
        "period": 1.0,
    }
    scene = Scene.load("demo").with_(seed=seed, rig={"crop": 0.3}, frames=4, sea=sea)
    tank = Tank(scene)
    images = [tank.render(k) for k in range(4)]
    geometry = GridGeometry(tank.rig, Grid(x=(-0.24, 0.24), y=(-0.18, 0.18), step=0.01))
    record = learn([(images[0], images[1]), (images[2], images[3])], geometry)
    assert record.ripples[0] == 0.0
