"""Something stands in the water: a grey disc in every image, masked."""

import cv2
import numpy as np
import pytest
from measurement_cases import RATE, around

from wavefield.measurement import GridGeometry, Model, learn, measure
from wavefield.measurement.diagnostics import diagnose
from wavefield.measurement.model import LearnedRecord
from wavefield.series.frames import CameraMask, covered_pixels
from wavefield.series.masks import MaskSection, footprints, outline_in_image
from wavefield.variables import Quality

ANGLES = np.linspace(0.0, 2 * np.pi, 32, endpoint=False)
DISC = MaskSection(polygon=(0.03 * np.stack([np.cos(ANGLES), np.sin(ANGLES)], -1)).tolist())
FIELDS = ("z", "u", "v", "w")
MASKED = int(Quality.MASKED)


def masks_of(rig):
    return {
        name: covered_pixels(CameraMask(camera.size[::-1], (outline_in_image(DISC, camera),)))
        for name, camera in rig.cameras.items()
    }


@pytest.fixture(scope="module")
def drawn(series):
    """The same sea with a disc in it, and what it covers."""
    masks = masks_of(series.rig)
    frames = {}
    for name, images in series.frames.items():
        grey = int(np.percentile(images[0], 90))
        frames[name] = [np.where(masks[name], np.asarray(grey, i.dtype), i) for i in images[:4]]
    return frames, {name: [mask] * 4 for name, mask in masks.items()}


@pytest.fixture(scope="module")
def free(series, geometry, model):
    return measure(series.block(), geometry, RATE, model)


@pytest.fixture(scope="module")
def masked(series, model, drawn):
    """That sea measured, with the disc named as a polygon on the water."""
    geometry = GridGeometry(series.rig, series.grid, covered=footprints({"water": [DISC]}))
    found = measure(around(drawn[0]), geometry, RATE, Model(geometry, model.record), around(drawn[1]))
    return geometry, found


def overdrawn(frames, masks):
    """The same images with noise where they are masked."""
    noise = np.random.default_rng(0)
    return {
        n: [np.where(m, noise.integers(0, 255, i.shape).astype(i.dtype), i) for i, m in zip(f, masks[n])]
        for n, f in frames.items()
    }


def far(series, quality, metres):
    covered = (quality & MASKED) != 0
    return cv2.distanceTransform((~covered).astype(np.uint8), cv2.DIST_L2, 5) * series.grid.step > metres


def test_a_masked_disc_changes_little_beyond_a_window(series, geometry, model, drawn, free, masked):
    with_mask, found = masked
    window = max(with_mask.settings.piv.window, with_mask.settings.stereo.window) * with_mask.pixel
    away = far(series, found["quality"][0], window)
    assert away.sum() > 100
    change = {n: np.abs(found[n][0] - free[n][0])[away] / free[f"{n}_std"][0][away] for n in FIELDS}
    assert {
        n: c for n, c in ((n, float(np.sqrt(np.mean(c**2)))) for n, c in change.items()) if c > 0.12
    } == {}
    without = measure(around(drawn[0]), geometry, RATE, model)
    unmasked = {n: np.abs(without[n][0] - free[n][0])[away] / free[f"{n}_std"][0][away] for n in FIELDS}
    worse = {n: float(np.sqrt(np.mean(unmasked[n] ** 2) / np.mean(change[n] ** 2))) for n in FIELDS}
    assert min(worse.values()) > 1.05


def test_masked_nodes_hold_nothing_and_are_flagged(series, masked):
    found = masked[1]
    covered = (found["quality"][0] & MASKED) != 0
    x, y = np.meshgrid(series.grid.x_nodes, series.grid.y_nodes)
    assert covered[np.hypot(x, y) < 0.029].all()
    assert not covered[np.hypot(x, y) > 0.09].any()
    assert found["quality"].dtype == np.uint16
    for name in FIELDS:
        np.testing.assert_array_equal(np.isnan(found[name][0]), covered)
    assert not ((found["quality"][0] & int(Quality.FILLED)) != 0)[covered].any()


def test_a_mask_in_one_camera_leaves_its_nodes_to_the_others(series, geometry, model, drawn, free):
    masks = {"cam1": drawn[1]["cam1"]}
    frames = {n: [*images[:4]] for n, images in series.frames.items()} | {"cam1": drawn[0]["cam1"]}
    found = measure(around(frames), geometry, RATE, model, around(masks))
    assert not (found["quality"] & MASKED).any()
    x, y = np.meshgrid(series.grid.x_nodes, series.grid.y_nodes)
    here = np.hypot(x, y) < 0.03
    for name in FIELDS:
        apart = (found[name][0] - free[name][0])[here] / found[f"{name}_std"][0][here]
        assert np.sqrt(np.mean(apart**2)) < 2.0, name
    blind = measure(around(frames), geometry, RATE, model, around(masks | {"cam2": drawn[1]["cam2"]}))
    assert ((blind["quality"][0] & MASKED) != 0)[here].all()


def test_what_a_mask_covers_changes_no_bit(series, geometry, model, drawn):
    frames, masks = drawn
    one = measure(around(frames), geometry, RATE, model, around(masks))
    copies = {n: [m.copy() for m in ms] for n, ms in masks.items()}
    again = measure(around(overdrawn(*drawn)), geometry, RATE, model, around(copies))
    for name, field in one.items():
        np.testing.assert_array_equal(field, again[name], err_msg=name)


def test_pairs_are_compared_without_what_is_covered(series, drawn):
    frames, masks = drawn
    geometry = GridGeometry(series.rig, series.grid, covered=footprints({"water": [DISC]}))
    hidden = {n: m[:2] for n, m in masks.items()}
    one, again = (
        diagnose({n: f[1:3] for n, f in some.items()}, geometry, masks=hidden)
        for some in (frames, overdrawn(*drawn))
    )
    for pair, eps in one.eps_y.items():
        np.testing.assert_array_equal(eps, again.eps_y[pair])


def test_a_record_is_learned_without_what_is_covered(series, drawn):
    geometry = GridGeometry(series.rig, series.grid)
    frames, masks = drawn
    known = [
        learn(
            [tuple({n: f[k] for n, f in some.items()} for k in (1, 2))],
            geometry,
            [tuple({n: m[k] for n, m in masks.items()} for k in (1, 2))],
        )
        for some in (frames, overdrawn(*drawn))
    ]
    assert isinstance(known[0], LearnedRecord)
    assert known[0] == known[1]
