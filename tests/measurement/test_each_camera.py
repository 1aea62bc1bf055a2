"""The noise of each camera, from how they differ: it changes uncertainties, not values."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from wavefield.measurement.camera_displacements import CameraDisplacements
from wavefield.measurement.each_camera import noise_of_each, own_noise
from wavefield.measurement.learned_record import LearnedRecord
from wavefield.measurement.velocity import shares, solve_motion

OBLIQUE = np.array(
    [[450.0, 0, 450], [0, 640, 0], [450, 0, -450], [0, 640, 0], [540, 0, 0], [0, 540, 0]]
)  # px per metre: two cameras at 45 degrees along x, one above


def test_each_camera_is_as_noisy_as_it_differs_from_the_others():
    rng = np.random.default_rng(1)
    nodes, noise = 20_000, np.full(6, 4e-4)
    factors = np.array([2.0, 1.0, 0.5])
    water = rng.normal(0, 2e-3, (nodes, 3)) @ OBLIQUE.T  # moves all cameras' images: no noise
    moved = water + rng.normal(0, np.sqrt(noise * np.repeat(factors, 2)), (nodes, 6))
    moved[:1000, 2] += 5.0  # one camera does not match there
    J = np.tile(OBLIQUE, (nodes, 1, 1))
    found = noise_of_each(J, moved, np.tile(noise, (nodes, 1)), np.tile(1 / noise, (nodes, 1)))
    assert found == pytest.approx(factors, rel=0.15)


def test_two_cameras_share_their_noise_and_one_has_none():
    rng = np.random.default_rng(2)
    noise = np.full((20_000, 4), 4e-4)
    moved = rng.normal(0, np.sqrt(3.0 * noise))
    J = np.tile(OBLIQUE[:4], (len(noise), 1, 1))
    assert noise_of_each(J, moved, noise, 1 / noise) == pytest.approx([3.0, 3.0], rel=0.1)
    with pytest.raises(ValueError, match="two cameras"):
        noise_of_each(J[:, :2], moved[:, :2], noise[:, :2], 1 / noise[:, :2])


def seen_by_three(noise, missing, motion=1.0):
    J = np.tile(OBLIQUE[:, :, None, None], (1, 1, 4, 5))
    shape = (3, 4, 5)
    moved = np.random.default_rng(3).normal(0.0, motion, (6, 4, 5))
    none, frames = np.zeros(shape, np.uint16), np.full((4, 5), 4, np.uint8)
    along, own = np.ones((2, 6))
    return CameraDisplacements(
        J,
        moved,
        np.full(moved.shape, noise),
        np.full(moved.shape, missing),
        along,
        own,
        none,
        frames,
        np.array([1.0, 0.0]),
        moved,
        np.zeros_like(moved),
        np.zeros((3, 3)),
    )


def test_what_cameras_miss_alike_does_not_make_one_certain():
    found = own_noise([{"cam1": 1.3, "cam2": 0.6}, {"cam1": 1.1, "cam2": 0.7, "cam3": 0.9}])
    assert found == pytest.approx({"cam1": 1.125, "cam2": 0.9375, "cam3": 0.9375})


def learned_of(moved, sheet=None):
    record = SimpleNamespace(moved=moved, camera_jitter=(0.0, 0.0))
    return shares(SimpleNamespace(sheet_thickness=sheet), record), record


def test_a_cameras_own_noise_changes_uncertainties_and_no_values():
    seen, learned = seen_by_three(4e-4, 1e-12), learned_of((1.0, 1.0, 1.0))
    noisy = solve_motion(replace(seen, own=np.array([4.0, 4, 4, 4, 1, 1])), *learned)
    alike = solve_motion(seen, *learned)
    np.testing.assert_array_equal(noisy.d, alike.d)
    np.testing.assert_array_equal(noisy.misfit, alike.misfit)  # nor who contradicts whom
    assert noisy.d_std[2] == pytest.approx(2.0 * alike.d_std[2], rel=1e-3)  # w rests on the oblique ones
    assert (noisy.d_std[0] < 1.8 * alike.d_std[0]).all()
    assert (noisy.d_std > alike.d_std).all()


def test_what_the_prior_takes_is_shared_as_short_waves_move_the_water():
    seen = seen_by_three(1e-12, 4e-4, motion=0.0)
    u, v, w = (float(std.mean()) for std in solve_motion(seen, *learned_of((1.0, 2.0, 1.0))).d_std)
    assert (u, w) == pytest.approx((v, np.sqrt(2.0) * v), rel=1e-3)  # whatever way the long ones go
    u, v, w = (
        float(std.mean()) for std in solve_motion(seen, *learned_of((1.0, 2.0, 0.1), sheet=1e-3)).d_std
    )
    assert (v, w) == pytest.approx((2.0 * u, 0.1 * u), rel=1e-3)


def test_a_record_keeps_the_noise_of_each_camera(model):
    record = replace(model.record, noise=(("cam1", 1.25), ("cam2", 0.5)))
    again = LearnedRecord.from_dict(record.to_dict())
    assert again == record
    assert (again.own_noise("cam2"), again.own_noise("cam9")) == (0.5, 1.0)
