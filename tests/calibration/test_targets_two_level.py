"""Stereo PIV's target: staggered dots on two levels, a square and a triangle, partly out of view."""

import numpy as np
import pytest
from rendering import Picture, camera_at, two_level_picture

from wavefield.calibration import Target, find_target
from wavefield.errors import CalibrationError

MESH, DEPTH, DIAMETER, EXTENT = 0.0075, 0.002, 0.0032, (-12, 12, -10, 10)
MARKS = (0, 1), (1, 0)
TARGET = Target("two-level", MESH, depth=DEPTH, diameter=DIAMETER)


def picture(camera, read=0.6, marks=MARKS):
    how = Picture(dark=20, bright=200, light=0.3, read=read)
    return two_level_picture(camera, MESH, DEPTH, DIAMETER, EXTENT, marks, how, samples=2)


def dots_in_view(camera, margin):
    i, j = np.meshgrid(np.arange(EXTENT[0], EXTENT[1] + 1), np.arange(EXTENT[2], EXTENT[3] + 1))
    dot = i % 2 == j % 2
    i, j = i[dot], j[dot]
    seen = camera.sees(i * MESH, j * MESH, np.where(j % 2, -DEPTH, 0.0), margin)
    return set(zip(i[seen].tolist(), j[seen].tolist()))


@pytest.mark.parametrize(
    ("tilt", "turn", "roll", "at", "read"),
    [(0, 0, 0, (0.0, 0.0), 0.6), (35, 180, -4, (0.01, 0.01), 3.0), (45, 200, 30, (-0.03, 0.02), 5.0)],
)
def test_both_levels_are_found_from_any_side(tilt, turn, roll, at, read):
    check(camera_at((416, 320), tilt, turn, roll, 0.8, 2150.0, at), read)


def check(camera, read):
    points = find_target(picture(camera, read), TARGET)
    exact = np.stack(camera.project(points.node[:, 0] * MESH, points.node[:, 1] * MESH, points.z), -1)
    error = np.hypot(*(points.pixel - exact).T)
    assert (error < 0.5).all()  # no dot is taken for another
    missed = dots_in_view(camera, 14.0) - set(map(tuple, points.node.tolist()))
    assert len(missed) <= 0.01 * len(points)
    assert np.sqrt((error**2).mean() / 2) < 0.05
    np.testing.assert_array_equal(points.z, np.where(points.node[:, 1] % 2, -DEPTH, 0.0))


def test_a_target_without_its_marks_is_refused_with_what_was_found():
    camera = camera_at((320, 256), 30.0, 0.0, 0.0, 0.8, 1700.0)
    with pytest.raises(CalibrationError, match=r"not both in view .* dots were found"):
        find_target(picture(camera, marks=((99, 99), (98, 98))), TARGET)
    with pytest.raises(CalibrationError, match="no two levels"):
        find_target(np.random.default_rng(0).integers(0, 255, (200, 200)).astype(np.uint8), TARGET)
    with pytest.raises(CalibrationError, match="needs its depth"):
        Target.from_dict({"kind": "two-level", "mesh": 0.0075})
