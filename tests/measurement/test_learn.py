"""What is learned from sample frames of a record: how much of what is learned is waves."""

import numpy as np
from measurement_cases import around

from wavefield.grid import Grid
from wavefield.matching.kernels import BLOCK
from wavefield.measurement import GridGeometry, Model, learn, measure
from wavefield.tank import Scene, Tank


def test_water_at_rest_has_no_waves_and_its_uncertainty_is_that_of_noise(model):
    scene = Scene.load("rest").with_(rig={"crop": 0.22}, frames=6, surface={"brightness": 110.0})
    tank = Tank(scene)
    images = [tank.render(k) for k in range(6)]
    grid = Grid(x=(-0.18, 0.18), y=(-0.14, 0.14), step=0.01)
    still = GridGeometry(tank.rig, grid)
    record = learn([(images[k], images[k + 1]) for k in (1, 3)], still)
    assert record is not None
    assert record.elevation.wave_fraction < 0.5
    assert max(prior.wave_fraction for _, prior in record.displacement) < 0.3
    frames = {name: [image[name] for image in images] for name in tank.rig}
    found = measure(around(frames), still, 20.0, Model(still, record))
    inside = np.s_[0, 6:-6, 6:-6]
    ratio = np.abs([found[name][inside] / found[f"{name}_std"][inside] for name in "uvw"])
    assert 0.5 < np.mean(ratio < 1) < 0.98  # in so small a field weak waves of few blocks cannot be excluded
    assert np.mean(ratio > 3) < 0.02
    sea = model.record
    assert [sea.elevation.wave_fraction, *(prior.wave_fraction for _, prior in sea.displacement)] == [1.0] * 4


def test_short_waves_of_two_cameras_are_not_taken_for_noise():
    grid = {"x": (-0.28, 0.28), "y": (-0.21, 0.21), "step": 0.01}
    sea = {"kind": "random", "rms": 0.00124, "spectrum": {"kind": "jonswap", "peak": 4.6, "enhancement": 1.6}}
    sea |= {"direction": 112.0, "spread": 0.0, "shortest": 0.04, "period": 2.0}
    tank = Tank(
        Scene.load("two_cameras").with_(rig={"scale": 0.72, "crop": 0.31}, grid=grid, sea=sea, frames=4)
    )
    images = [tank.render(number) for number in range(4)]
    geometry = GridGeometry(tank.rig, Grid(**grid))
    record = learn([(images[0], images[1]), (images[2], images[3])], geometry)
    assert record is not None
    k = 2 * np.pi / 0.073 * BLOCK * geometry.pixel  # of the peak, rad per block
    assert record.elevation.signal_to_noise(np.array([k]), np.zeros(1)).mean() > 5.0
