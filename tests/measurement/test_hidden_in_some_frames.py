"""Water that some of the six frames around a step do not show: z of the step comes from the others there."""

from dataclasses import replace

import numpy as np
import pytest

from wavefield.measurement import GridGeometry, measure
from wavefield.measurement.elevation import Surface
from wavefield.measurement.midtime import z_at_mid_time
from wavefield.tank import Scene, Tank
from wavefield.variables import Quality

SHAPE = 24, 30
STEP = 0.01
X, Y = np.meshgrid(np.arange(SHAPE[1]) * STEP, np.arange(SHAPE[0]) * STEP)
TIMES = np.arange(6) - 2.5
FILLED_ERROR = 0.2  # metres, of what was filled where a frame shows nothing


def hidden_disc(rng):
    """A disc anywhere, (ny, nx)."""
    x, y = rng.uniform(0, X.max()), rng.uniform(0, Y.max())
    return np.hypot(X - x, Y - y) < rng.uniform(0.02, 0.1)


def drawn_surfaces(seed, flow):
    """Six surfaces of a wave in water that moves with the flow, where some frames have a filled disc."""
    rng = np.random.default_rng(seed)
    turn, k = rng.uniform(0.2, 0.8), rng.uniform(10.0, 40.0, 2)

    def z_at(x, y, t):
        return 0.01 * np.cos(k[0] * (x - t * flow[0]) + k[1] * (y - t * flow[1]) - turn * t)

    hidden = [hidden_disc(rng) if rng.random() < 0.5 else np.zeros(SHAPE, bool) for _ in TIMES]

    def surface(t, disc):
        def is_measured(x, y, z=None):
            column, row = np.rint(x / STEP).astype(int), np.rint(y / STEP).astype(int)
            inside = (column >= 0) & (column < SHAPE[1]) & (row >= 0) & (row < SHAPE[0])
            return inside & ~disc[row.clip(0, SHAPE[0] - 1), column.clip(0, SHAPE[1] - 1)]

        def read(x, y):
            return (z_at(x, y, t) + FILLED_ERROR * ~is_measured(x, y)).astype(np.float32)

        none = np.zeros(SHAPE, np.uint16)
        return Surface(X, X, X, X, 0.0, none, none > 0, read, is_measured)

    lost = rng.choice([-1, -1, -1, 0, 1, 4, 5])
    frames = [None if n == lost else surface(t, disc) for n, (t, disc) in enumerate(zip(TIMES, hidden))]
    return frames, z_at(X, Y, 0.0), hidden


@pytest.mark.parametrize("flow", [(0.0, 0.0), (0.021, -0.011), (-0.013, 0.024)])
def test_frames_that_do_not_show_the_water_change_no_measured_node(flow):
    with_all = []
    for seed in range(60):
        frames, exact, hidden = drawn_surfaces(seed, flow)
        seen = [one and replace(one, is_measured=lambda x, y, z: x == x) for one in frames]
        orders, _, _ = z_at_mid_time(seen, flow, X, Y)
        by_measured, used, measured = z_at_mid_time(frames, flow, X, Y)
        # two frames of a wave of 1 cm that turns by 0.8 rad in a step
        assert np.abs(by_measured[0] - exact)[measured].max(initial=0.0) < 1e-3
        assert set(np.unique(used)) <= {2, 3, 4, 6}
        np.testing.assert_array_equal(by_measured[0][~measured], orders[0][~measured])
        if flow == (0.0, 0.0):
            np.testing.assert_array_equal(measured, ~(hidden[2] | hidden[3]))
        with_all.append(np.abs(orders[0] - exact)[measured].max(initial=0.0))
    assert np.mean(np.array(with_all) > 1e-3) > 0.3


def test_water_that_a_current_brings_into_view_is_measured_by_the_frames_that_show_it():
    """Frames before and after were read beyond the view, where fields are extrapolated."""
    seed = 2
    rng = np.random.default_rng(seed)
    speed, towards = rng.uniform(0.6, 0.8), rng.uniform(0, 2 * np.pi)
    length = rng.uniform(0.5, 0.8)
    sea = {
        "rms": 0.12 * length / (2 * np.pi),
        "spectrum": {"kind": "power", "peak": 1.0, "exponent": 3.0},
        "shortest": length / 1.3,
        "longest": length * 1.3,
        "period": 3.0,
        "current": (speed * np.cos(towards), speed * np.sin(towards)),
    }
    scene = Scene.load("demo").with_(seed=seed, frames=8, frame_rate=13.0, sea=sea, rig={"crop": 0.3})
    scene = scene.with_(grid={"x": (-0.2, 0.2), "y": (-0.15, 0.15), "step": 0.01})
    tank = Tank(scene)
    images = {name: [tank.render(k)[name] for k in range(8)] for name in tank.rig}
    geometry = GridGeometry(tank.rig, scene.grid)
    cube = measure(images, geometry, scene.frame_rate)
    exact = np.array([tank.truth(k).z for k in (2, 3, 4)])
    measured = (cube["quality"] & int(Quality.MEASURED)) > 0
    off = np.abs(cube["z"] - exact) > 5 * cube["z_std"]
    assert measured[:, 4:-4, 4:-4].mean() > 0.8
    assert off[measured].mean() < 0.01
