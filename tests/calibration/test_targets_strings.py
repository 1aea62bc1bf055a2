"""The grid of strings is found, located to a hundredth of a pixel, and refused where it is not there."""

import numpy as np
import pytest
from rendering import Picture, camera_at, string_picture, string_truth

from wavefield.calibration import Target, find_target
from wavefield.calibration.lattice import SmoothMap
from wavefield.errors import CalibrationError

SIZE = (640, 512)
TARGET = Target("strings", mesh=0.10)


def view(tilt, focal=1500.0, distance=3.5, **where):
    return camera_at(SIZE, tilt, distance=distance, focal=focal, **where)


def compared(camera, picture, **grid):
    """Found fraction, number of false points, errors (n, 2), standard uncertainties (n,)."""
    points = find_target(string_picture(camera, picture, **grid), TARGET)
    node = string_truth(camera, **grid)
    got = set(map(tuple, points.node))
    found = np.mean([tuple(n) in got for n in node])
    exact = np.stack(camera.project(points.node[:, 0] * 0.1, points.node[:, 1] * 0.1, 0.0), -1)
    error = points.pixel - exact
    false = np.hypot(*error.T) > 0.5
    assert points.size == SIZE
    return found, int(false.sum()), error[~false], points.std[~false]


@pytest.mark.parametrize(
    ("tilt", "turn", "roll", "blur", "width"),
    [(0, 0, 0, 0.5, 0.003), (45, 200, -130, 0.9, 0.006), (65, 100, 170, 0.6, 0.004)],
)
def test_crossings_in_good_light_are_all_found_within_a_hundredth_of_a_pixel(tilt, turn, roll, blur, width):
    camera = view(tilt, turn=turn, roll=roll)
    picture = Picture(light=0.5, blur=blur, string=width, origin_radius=0.025, x_radius=0.016, seed=tilt)
    found, false, error, std = compared(camera, picture)
    assert found >= 0.99
    assert false == 0
    assert np.sqrt((error**2).mean(0)).max() < 0.01
    within = np.mean(np.abs(error) < std[:, None])
    assert 0.55 < within < 0.85


POOR = {  # the least fraction found, and the largest rms error, px
    "low light": ({"bright": 45, "gain": 8, "read": 2, "seed": 3}, 0.95, 0.1),
    "dust and spots of light": ({"dust": 100, "spots": 10, "seed": 5}, 0.90, 0.05),
    "a reflection beside the strings": ({"ghost": 0.4, "ghost_shift": 0.015, "seed": 2}, 0.95, 0.02),
}


@pytest.mark.parametrize("kind", POOR)
def test_poor_pictures_cost_crossings_but_make_no_false_ones(kind):
    how, least, most = POOR[kind]
    picture = Picture(string=0.003, origin_radius=0.025, x_radius=0.016, **how)
    found, false, error, std = compared(view(45, turn=30, roll=20), picture)
    assert found >= least
    assert false == 0
    assert np.sqrt((error**2).mean()) < most
    if kind == "low light":
        assert 0.55 < np.mean(np.abs(error) < std[:, None]) < 0.85


def test_a_target_that_ends_inside_the_picture_gives_no_points_beyond_its_end():
    camera = view(30, turn=70, roll=10, distance=4.5)
    grid = {"extent": (-4, 5, -3, 4)}
    picture = Picture(string=0.004, origin_radius=0.025, x_radius=0.016)
    points = find_target(string_picture(camera, picture, **grid), TARGET)
    assert points.node.min(0).tolist() == [-4, -3]
    assert points.node.max(0).tolist() == [5, 4]


def test_crossings_under_the_marks_are_left_out_and_indices_are_right_handed():
    camera = view(20, turn=10, roll=35)
    picture = Picture(string=0.003, origin_radius=0.025, x_radius=0.016)
    points = find_target(string_picture(camera, picture), TARGET)
    nodes = set(map(tuple, points.node))
    assert (0, 0) not in nodes
    assert (1, 0) not in nodes
    e1, e2 = SmoothMap(points.node, points.pixel).slopes(np.array([[0, 0]]))[0]
    assert e1[0] * e2[1] - e1[1] * e2[0] < 0  # rows run downwards


def test_sixteen_bits_and_floats_give_what_eight_bits_give():
    camera = view(30, turn=70, roll=10)
    image = string_picture(camera, Picture(string=0.003, origin_radius=0.025, x_radius=0.016))
    first = find_target(image, TARGET)
    second = find_target(image.astype(np.uint16) * 257, TARGET)
    np.testing.assert_array_equal(first.node, second.node)
    np.testing.assert_allclose(first.pixel, second.pixel, atol=1e-3)


def test_pictures_without_a_target_are_refused_in_one_sentence():
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 40, (200, 200)).astype(np.uint8)
    with pytest.raises(CalibrationError, match="no grid of white strings"):
        find_target(noise, TARGET)
    with pytest.raises(CalibrationError, match="empty"):
        find_target(np.zeros((200, 200), np.uint8), TARGET)
    white = np.full((200, 200), 255, np.uint8)
    white[:60] = noise[:60]
    with pytest.raises(CalibrationError, match="overexposed"):
        find_target(white, TARGET)
    with pytest.raises(CalibrationError, match="one grey image"):
        find_target(np.zeros((20, 200, 3), np.uint8), TARGET)
    with pytest.raises(CalibrationError, match="not numbers"):
        find_target(np.full((200, 200), np.nan), TARGET)


def test_a_grid_whose_marks_are_not_seen_is_refused():
    image = string_picture(view(20, turn=10), Picture(string=0.003), marks=False)
    with pytest.raises(CalibrationError, match="not its marks"):
        find_target(image, TARGET)
