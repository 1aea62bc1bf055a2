"""Waves below the noise of every single camera are found in products of cameras, and noise alone is not."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from wavefield.grid import Grid
from wavefield.matching import Prior
from wavefield.measurement import GridGeometry, Model, learn, measure
from wavefield.measurement.common_waves import CommonWaves, expected_power
from wavefield.tank import Scene, Tank
from wavefield.variables import Quality

GRID = Grid(x=(-0.3, 0.3), y=(-0.23, 0.23), step=0.01)
X, Y = np.meshgrid(GRID.x_nodes, GRID.y_nodes)
SEEDS = 60, 61, 62
FAST_SEEDS = 100, 110
LONE_SEEDS = 200, 201, 206
SCALE = 0.65  # of the images: a pixel of 2.8 mm


def dark_scene(seed, still=False):
    """A weak sea of short waves, or still water, in dark and noisy images."""
    rng = np.random.default_rng(seed)
    length, slope = rng.uniform(0.055, 0.09), rng.uniform(0.01, 0.025)
    sea = {
        "rms": slope * length / (2.0 * np.pi),
        "spectrum": {"kind": "power", "peak": 1.0, "exponent": 3.0},
        "direction": float(rng.uniform(0.0, 360.0)),
        "spread": float(rng.choice([2.0, 10.0, 40.0])),
        "shortest": length / 1.3,
        "longest": length * 1.3,
        "period": 2.0,
    }
    light = {"read_noise": float(rng.uniform(3.0, 8.0)), "blur": float(rng.uniform(0.6, 1.0))}
    beads = {
        "brightness": float(rng.uniform(50.0, 100.0)),
        "density": float(rng.uniform(0.5, 1.2)) * 1.1e4 * SCALE**2,
        "diameter": 0.7e-3 / SCALE,
    }
    return Scene.load("demo").with_(
        seed=seed,
        frames=6,
        frame_rate=float(rng.uniform(50.0, 90.0)),
        rig={"scale": SCALE, "crop": 0.34},
        sea={"kind": "still"} if still else sea,
        light=light,
        surface=beads,
    )


def coarse_scene(seed):
    """A weak sea of waves that are eleven to fourteen pixels long."""
    rng = np.random.default_rng(seed)
    scale, length = float(rng.uniform(0.42, 0.5)), float(rng.uniform(0.05, 0.06))
    sea = {
        "rms": float(rng.uniform(0.012, 0.025)) * length / (2.0 * np.pi),
        "spectrum": {"kind": "power", "peak": 1.0, "exponent": 3.0},
        "spread": 2.0,
        "shortest": length / 1.2,
        "longest": length * 1.2,
        "period": 2.0,
    }
    beads = {"brightness": 120.0, "density": 1.1e4 * scale**2, "diameter": 0.7e-3 / scale}
    light, rig = {"read_noise": 2.0, "blur": 0.8}, {"scale": scale, "crop": 0.4}
    return dark_scene(seed).with_(sea=sea, rig=rig, light=light, surface=beads)


def fast_scene(seed):
    """A very weak sea whose waves turn by two to three radians from frame to frame."""
    rng = np.random.default_rng(seed)
    scene, length = coarse_scene(seed), float(rng.uniform(0.045, 0.055))
    sea = {"rms": float(rng.uniform(0.006, 0.012)) * length / (2.0 * np.pi), "spread": 40.0}
    lengths = {"shortest": length / 1.2, "longest": length * 1.2}
    return scene.with_(frame_rate=float(rng.uniform(13.0, 15.0)), sea=scene.sea.model_dump() | sea | lengths)


def lone_wave(seed):
    """One low wave of 15 to 17 pixels in the images of two cameras."""
    rng = np.random.default_rng(seed)
    scale = 0.43
    pixel = 1.8e-3 / scale
    sea = {
        "kind": "single",
        "wavelength": 5.0 * pixel * float(rng.uniform(3.0, 3.4)),
        "amplitude": pixel * float(rng.uniform(0.055, 0.08)),
        "direction": float(rng.uniform(0.0, 360.0)),
    }
    beads = {"brightness": 120.0, "density": 1.1e4 * scale**2, "diameter": 0.7e-3 / scale}
    light, rig = {"read_noise": 2.0, "blur": 0.8}, {"scale": scale, "crop": 0.4, "cameras": 2}
    return dark_scene(seed).with_(frame_rate=29.0, sea=sea, rig=rig, light=light, surface=beads)


def measured(scene):
    """Errors over standard uncertainties of z, u, v, and the uncertainties, at nodes flagged as measured."""
    tank = Tank(scene)
    images, rate = [tank.render(k) for k in range(6)], scene.frame_rate
    geometry = GridGeometry(tank.rig, GRID)
    record = learn([(images[k], images[k + 1]) for k in (0, 2, 4)], geometry, frame_rate=rate)
    assert record is not None
    frames = {name: [image[name] for image in images] for name in tank.rig}
    out = measure(frames, geometry, rate, Model(geometry, record))
    inside = (np.abs(X) < 0.24) & (np.abs(Y) < 0.17) & ((out["quality"][0] & Quality.MEASURED) > 0)
    exact = tank.basin.snapshot(tank.time(2.5), ("z", "u", "v"))(X, Y)
    pixel = 1.8e-3 / SCALE * np.array([1.0, rate, rate])
    std = np.array([out[f"{name}_std"][0][inside] for name in "zuv"])
    error = np.array([(out[name][0] - one)[inside] for name, one in zip("zuv", exact)])
    return error / std, std / pixel[:, None]


def wrong(ratio):
    """Share of the nodes that are wrong by five standard uncertainties."""
    return float(np.mean((np.abs(ratio) > 5.0).any(axis=0)))


def test_weak_seas_of_short_waves_are_not_still_water():
    ratio = np.concatenate([measured(dark_scene(seed))[0] for seed in SEEDS], axis=1)
    assert ratio.shape[1] > 3000
    assert wrong(ratio) < 0.03
    assert (np.mean(np.abs(ratio) < 2.0, axis=1) > 0.8).all()


def test_without_products_of_cameras_they_are(monkeypatch):
    monkeypatch.setattr(sys.modules["wavefield.measurement.learn"], "common_waves", lambda *_: None)
    assert wrong(measured(dark_scene(SEEDS[0]))[0]) > 0.2


@pytest.mark.parametrize("seed", [70, 73])
def test_weak_waves_of_few_blocks_are_not_still_water(seed):
    ratio, _ = measured(coarse_scene(seed))
    assert wrong(ratio) < 0.01
    assert (np.mean(np.abs(ratio) < 2.0, axis=1) > 0.92).all()


def test_where_they_are_not_searched_for_they_are(monkeypatch):
    monkeypatch.setattr(sys.modules["wavefield.measurement.common_waves"], "SHORTEST_IN_COMMON", 2.0)
    assert (np.mean(np.abs(measured(coarse_scene(73))[0]) < 2.0, axis=1) < 0.92).all()


@pytest.mark.parametrize("seed", FAST_SEEDS)
def test_very_weak_waves_that_turn_fast_are_not_still_water(seed):
    ratio, _ = measured(fast_scene(seed))
    assert wrong(ratio) < 0.005
    assert np.mean(np.abs(ratio[0]) < 2.0) > 0.9


def test_without_their_heights_they_are(monkeypatch):
    monkeypatch.setattr(sys.modules["wavefield.measurement.common_waves"], "_LARGEST_PHASE", 2.0)
    ratio, _ = measured(fast_scene(FAST_SEEDS[1]))
    assert np.mean(np.abs(ratio[0]) < 2.0) < 0.8


@pytest.mark.parametrize("seed", LONE_SEEDS)
def test_a_wave_that_the_elevation_shows_moves_the_water(seed):
    ratio, _ = measured(lone_wave(seed))
    assert wrong(ratio) < 0.005
    assert (np.mean(np.abs(ratio) < 2.0, axis=1) > 0.9).all()


@pytest.mark.parametrize("seed", LONE_SEEDS)
def test_otherwise_it_does_not(seed, monkeypatch):
    monkeypatch.setattr(CommonWaves, "with_elevation", lambda common, *_: common)
    assert wrong(measured(lone_wave(seed))[0]) > 0.05


def test_the_rise_of_rings_that_the_elevation_shows_is_that_of_their_height():
    block, rate, k = 0.02, 30.0, np.linspace(0.1, 2.5, 25)
    power = np.random.default_rng(1).uniform(1e-6, 1e-5, k.size)
    shown = (k > 1.0) & (k < 1.6)
    prior = replace(Prior.isotropic(k, power, 1.0), shown=(tuple(shown.astype(float)),))
    found = CommonWaves(k / block, np.where(k > 2.0, 1e-12, 0.0)).with_elevation(prior, block, rate)
    height = found.of_elevation(block, k, rate)[0, 0]
    np.testing.assert_allclose(height[shown], power[shown])
    np.testing.assert_array_equal(found.density[~shown], np.where(k > 2.0, 1e-12, 0.0)[~shown])


@pytest.mark.parametrize("seed", SEEDS[:2])
def test_still_water_stays_certain(seed):
    ratio, std = measured(dark_scene(seed, still=True))
    assert wrong(ratio) == 0.0
    assert (np.median(std, axis=1) < 0.02).all()  # px


def test_power_is_expected_where_it_exceeds_chance():
    std, largest = np.full(3, 0.1), np.ones(3)
    nothing, some, much = expected_power(np.array([0.0, 0.5, 5.0]), std, largest)
    assert nothing < 0.01
    assert some == pytest.approx(0.5, rel=0.01)
    assert much == pytest.approx(1.0, rel=0.1)


def test_chance_alone_is_seldom_taken_for_waves():
    found = np.random.default_rng(0).normal(0.0, 0.05, 4000)
    power = expected_power(found, np.full(4000, 0.05), np.ones(4000))
    assert np.mean(power) < 0.01
    assert np.mean(power > 0.1) < 0.01
