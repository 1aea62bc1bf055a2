"""Paths of six frames: smooth where the frame rate is high beside the waves, else exact."""

from dataclasses import replace

import numpy as np
import pytest

from wavefield.grid import Grid
from wavefield.measurement import GridGeometry, Model, learn, measure
from wavefield.measurement.model import LearnedRecord
from wavefield.tank import Scene, Tank
from wavefield.variables import EXACT_SIX

RATE = 40.0
STEPS = 3
WAVE = {"kind": "single", "wavelength": 0.08, "amplitude": 0.0018, "direction": 20.0}
NAMES = ("u", "v", "w", "z_t")


def taken(rate, frames, **more):
    grid = {"x": (-0.18, 0.18), "y": (-0.14, 0.14), "step": 0.01}
    scene = Scene.load("demo").with_(rig={"crop": 0.22}, grid=grid, frames=frames, frame_rate=rate)
    tank = Tank(scene.with_(**more))
    images = [tank.render(k) for k in range(frames)]
    geometry = GridGeometry(tank.rig, Grid(**grid))
    record = learn([(images[k], images[k + 1]) for k in range(4)], geometry, frame_rate=rate)
    assert record is not None
    return (
        tank,
        {name: [image[name] for image in images] for name in tank.rig},
        geometry,
        Model(geometry, record),
    )


@pytest.fixture(scope="module")
def fast():
    return taken(RATE, STEPS + 5)


@pytest.fixture(scope="module")
def cube(fast):
    _, frames, geometry, model = fast
    return measure(frames, geometry, RATE, model)


def errors(cube, tank):
    inside = np.s_[4:-4, 4:-4]
    off = {name: [] for name in NAMES[:3]}
    for step in range(STEPS):
        truth = vars(tank.truth(step + 2))
        for name, values in off.items():
            values.append((cube[name][step] - truth[name])[inside])
    return {name: float(np.sqrt(np.mean(np.square(values)))) for name, values in off.items()}


def test_smooth_paths_are_taken_where_waves_turn_slowly(fast, cube):
    tank, frames, geometry, model = fast
    assert model.record.path_frames == 6
    assert LearnedRecord.from_dict(model.record.to_dict()) == model.record
    four = measure(frames, geometry, RATE, Model(geometry, replace(model.record, path_frames=4)))
    six, other = errors(cube, tank), errors(four, tank)
    for name in six:
        assert six[name] < 0.85 * other[name], name
        assert np.median(cube[f"{name}_std"]) < 0.97 * np.median(four[f"{name}_std"]), name
    np.testing.assert_allclose(cube["z"], four["z"], atol=1e-7)


@pytest.mark.slow
def test_exact_paths_are_taken_where_waves_turn_fast():
    tank, frames, geometry, model = taken(20.0, STEPS + 5, sea=WAVE)
    assert model.record.path_frames == EXACT_SIX
    exact = errors(measure(frames, geometry, 20.0, model), tank)
    record = replace(model.record, path_frames=4)
    four = errors(measure(frames, geometry, 20.0, Model(geometry, record)), tank)
    assert exact["u"] < 0.95 * four["u"]
    assert exact["w"] < four["w"]
