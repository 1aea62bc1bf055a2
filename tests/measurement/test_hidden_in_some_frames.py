import numpy as np

from wavefield.measurement import GridGeometry, measure
from wavefield.tank import Scene, Tank
from wavefield.variables import Quality


def test_water_that_a_current_brings_into_view_is_measured_by_the_frames_that_show_it():
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
