from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from wavefield.grid import Grid
from wavefield.measurement import GridGeometry, sample_steps
from wavefield.pipeline.learning import steps_with_waves
from wavefield.tank import Scene, Tank

STEPS = 1000


@pytest.fixture(scope="module")
def geometry():
    rig = Tank(Scene.load("demo").with_(rig={"crop": 0.2})).rig
    return GridGeometry(rig, Grid(x=(-0.1, 0.1), y=(-0.1, 0.1), step=0.01))


def record(geometry, moved):
    """Cameras that see a texture at the places moved (frames,), px."""
    width, height = geometry.rig[geometry.velocity_cameras[0]].size
    noise = np.random.default_rng(1).normal(size=(height, width)).astype(np.float32)
    texture = 128 + 300 * cv2.GaussianBlur(noise, (0, 0), 1.5)

    def read(k):
        shift = np.array([[1.0, 0.0, moved[k]], [0.0, 1.0, 0.0]])
        image = cv2.warpAffine(texture, shift, (width, height), borderMode=cv2.BORDER_WRAP)
        return SimpleNamespace(image=image.clip(0, 255).astype(np.uint8))

    return dict.fromkeys(geometry.cameras, SimpleNamespace(read=read))


@pytest.mark.parametrize("seed", range(2))
def test_waves_that_come_and_go_are_sampled_wherever_they_are(geometry, seed):
    rng = np.random.default_rng(seed)
    first = int(rng.integers(0, STEPS - 60))
    last = int(min(first + rng.integers(60, 200), STEPS))
    waves = np.zeros(STEPS + 1)
    waves[first : last + 1] = rng.uniform(1.0, 4.0) * np.sin(
        rng.uniform(0.2, 0.6) * np.arange(last - first + 1)
    )
    current = rng.uniform(-0.003, 0.003) * np.arange(STEPS + 1)
    chosen = steps_with_waves(record(geometry, waves + current), STEPS, geometry)
    assert all(first - 1 <= k <= last for k in chosen), (chosen, first, last)


def test_a_record_with_waves_throughout_or_none_is_sampled_evenly(geometry):
    k = np.arange(STEPS + 1)
    for moved in (1.5 * np.sin(0.37 * k), 0.0 * k, 0.01 * k):
        assert steps_with_waves(record(geometry, moved), STEPS, geometry) == sample_steps(STEPS)
