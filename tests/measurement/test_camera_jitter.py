"""Cameras that move against each other: it shows on the mean over the field and makes the water uncertain."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from measurement_cases import RATE

from wavefield.measurement import GridGeometry, Model, measure
from wavefield.measurement.camera_jitter import (
    displacement_variance,
    elevation_variance,
    level_jitter,
    mean_residuals,
    motion_for_level,
    row_direction,
)
from wavefield.variables import Quality

LINE = np.array([1.0, 0.0])


def rows(*slopes):
    """Jacobians of cameras along x that see a rise of 1 as a move by so much: (2N, 3, 12, 15)."""
    one = np.concatenate([[[1.0, 0.0, slope], [0.0, 1.0, 0.0]] for slope in slopes])
    return np.tile(one[..., None, None], (1, 1, 12, 15))


def test_how_far_cameras_move_follows_from_their_residuals():
    rng = np.random.default_rng(1)
    J = rows(0.6, -0.6, 0.0)
    good, weight = np.ones((12, 15), bool), np.ones((6, 12, 15))
    water = np.einsum("rcyx,cyx->ryx", J, rng.normal(0, 1, (3, 12, 15)))
    found, off = [], []
    back = np.linalg.pinv(J[..., 0, 0])
    for _ in range(400):
        moves = rng.normal(0, [0.3, 0.1] * 3)
        _, size = mean_residuals(J, water + moves[:, None, None], weight, good, LINE)
        found.append(size)
        off.append(back @ moves)
    assert np.sqrt(np.mean(np.square(found), axis=0)) == pytest.approx([0.3, 0.1], rel=0.1)
    stated = displacement_variance(J, weight, good, LINE, (0.3, 0.1))
    assert np.mean(np.square(off), axis=0) == pytest.approx(stated, rel=0.15)


def test_two_cameras_are_thought_to_move_along_their_line_as_across_it():
    moved = np.zeros((4, 12, 15))
    moved[0], moved[1] = 5.0, 0.2  # the first passes for a rise
    _, (along, across) = mean_residuals(
        rows(0.6, -0.6), moved, np.ones_like(moved), np.ones((12, 15), bool), LINE
    )
    assert across == pytest.approx(0.2 / np.sqrt(2))
    assert along == across


def test_the_line_of_cameras_is_that_along_which_they_stand():
    centres = [np.array([2.0, 1.0, 4.0]), np.array([0.0, 0.1, 4.0]), np.array([-2.0, -1.0, 4.0])]
    assert row_direction(centres) == pytest.approx([0.894, 0.447], abs=0.01)


def test_elevation_is_as_uncertain_as_moving_pictures_make_it():
    rng = np.random.default_rng(2)
    lengths = np.array([1.1, -0.9])
    moves = rng.normal(0, 1, (4000, 3))
    z = (moves[:, 1:] - moves[:, :1]) / lengths
    off = z @ (lengths**2 / np.sum(lengths**2))
    stated = np.mean([elevation_variance(one, lengths) for one in z])
    assert stated == pytest.approx(np.mean(off**2), rel=0.06)
    assert elevation_variance(z[0, :1], lengths[:1]) == 0.0
    assert elevation_variance(z[0, :1], lengths[:1], 0.5) > 0.5


def test_a_level_that_no_water_has_is_unsteady_and_a_tank_that_sloshes_is_not():
    rng = np.random.default_rng(4)
    t = np.arange(6)
    jumps = [level_jitter(rng.normal(0, 0.1, 6) + np.sin(0.2 * t + p), 0.5) for p in np.linspace(0, 6, 900)]
    assert np.sqrt(np.mean(np.square(jumps))) == pytest.approx(0.1, rel=0.1)
    for turn in (0.1, 0.5, 1.0):
        assert max(level_jitter(np.sin(turn * t + p), 1.2 * turn) for p in np.linspace(0, 6, 50)) < 0.03
    lengths = np.array([1.1, -0.9])
    assert elevation_variance(np.zeros(2), lengths, motion_for_level(0.3, lengths) ** 2) == pytest.approx(
        0.09
    )


def test_of_two_cameras_of_which_one_vibrates_along_their_line_nothing_is_certain_and_wrong(
    series, geometry, model
):
    rng = np.random.default_rng(6)
    rig = type(series.rig)({name: series.rig[name] for name in ("cam1", "cam2")})
    steady = {name: series.block(1)[name] for name in rig}
    frames = {name: list(images) for name, images in steady.items()}
    for k, image in enumerate(frames["cam1"]):
        moved = np.array([[1.0, 0.0, rng.normal(0, 0.2)], [0.0, 1.0, 0.0]])
        frames["cam1"][k] = cv2.warpAffine(image, moved, image.shape[::-1], flags=cv2.INTER_LANCZOS4)
    known = tuple(prior for prior in model.record.displacement if prior[0] in frames)
    two = GridGeometry(rig, series.grid)
    learned = Model(two, replace(model.record, displacement=known))
    still, out = (measure(f, two, RATE, learned) for f in (steady, frames))
    measured = series.inside & ((out["quality"][0] & Quality.MEASURED) > 0)
    assert measured.sum() > 0.5 * series.inside.sum()
    for name in ("z", "w"):
        error = np.abs(out[name][0] - series.truth[1][name])[measured]
        assert (error > 5 * still[f"{name}_std"][0][measured]).mean() > 0.5
        assert (error > 5 * out[f"{name}_std"][0][measured]).mean() < 0.01


def test_a_camera_that_vibrates_along_the_line_is_not_certain_to_a_hundredth_of_a_pixel(
    series, geometry, model
):
    frames = {name: list(images) for name, images in series.block(1).items()}
    moved = np.array([[1.0, 0.0, 0.05], [0.0, 1.0, 0.0]])
    for k in (2, 4):
        image = frames["cam1"][k]
        frames["cam1"][k] = cv2.warpAffine(image, moved, image.shape[::-1], flags=cv2.INTER_LANCZOS4)
    steady, out = (measure(f, geometry, RATE, model) for f in (series.block(1), frames))
    measured = series.inside & ((out["quality"][0] & Quality.MEASURED) > 0)
    assert measured.sum() > 0.95 * series.inside.sum()
    truth = series.truth[1]
    wrong, misled = np.zeros((2, *measured.shape), bool)
    for name in ("z", "u", "v", "w"):
        error = np.abs(out[name][0] - truth[name])
        wrong |= error > 5 * out[f"{name}_std"][0]
        misled |= error > 5 * steady[f"{name}_std"][0]
    assert misled[measured].mean() > 0.5  # as it would be without knowing of it
    assert wrong[measured].mean() < 0.01
    assert np.median(out["v_std"][0][measured]) < 1.5 * np.median(steady["v_std"][0][measured])
