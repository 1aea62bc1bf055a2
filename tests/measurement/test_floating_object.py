"""Something floats in view, unmasked: a grey disc above the water that drifts in all images."""

import cv2
import numpy as np
import pytest
from measurement_cases import RATE, around

from wavefield.measurement import measure
from wavefield.variables import Quality


def covered(series, radius, height, drift):
    """The images with a disc of a radius and height, metres, that drifts (dx, dy), metres per frame."""
    angle = np.linspace(0, 2 * np.pi, 60)
    out = {}
    for name, images in series.frames.items():
        out[name] = []
        for k, image in enumerate(images):
            x, y = (radius * f(angle) + (k - 2.5) * one for f, one in zip((np.cos, np.sin), drift))
            outline = np.stack(series.rig[name].project(x, y, np.full(60, height)), axis=-1)
            grey = int(np.percentile(images[0], 90))
            drawn = cv2.fillPoly(image.copy(), [np.round(outline).astype(np.int32)], grey)
            out[name].append(drawn)
    return out


@pytest.mark.parametrize("seed", [1, 5])
def test_water_beside_a_floating_object_is_measured_or_filled_but_not_wrong(series, geometry, model, seed):
    rng = np.random.default_rng(seed)
    speed, towards = rng.uniform(1e-3, 4e-3), rng.uniform(0, 2 * np.pi)
    drift = speed * np.cos(towards), speed * np.sin(towards)
    frames = covered(series, rng.uniform(0.015, 0.03), rng.uniform(0.0, 0.04), drift)
    found, truth = measure(around(frames, first=1), geometry, RATE, model), series.truth[1]
    measured = ((found["quality"][0] & int(Quality.MEASURED)) != 0) & series.inside
    off = [np.abs(found[n][0] - truth[n]) > 5 * found[f"{n}_std"][0] for n in "zuvw"]
    assert np.any(off, axis=0)[measured].mean() < 0.005
    assert measured.sum() > 0.7 * series.inside.sum()
