"""Printed targets, descriptions of targets, and files of points."""

import numpy as np
import pytest
from rendering import Picture, camera_at, centred, charuco, chessboard, dots, pattern_picture

from wavefield.calibration import Target, find_target
from wavefield.calibration.lattice import SmoothMap
from wavefield.calibration.points import read_points
from wavefield.errors import CalibrationError
from wavefield.images import read_image

SIZE = (512, 400)
PICTURE = Picture(dark=20, bright=200, light=0.3)


def seen(shape, mesh, inside, tilt=35.0, roll=15.0, span=0.55):
    """A picture of a pattern that fills `span` of the width, and the camera that took it."""
    camera = camera_at(SIZE, tilt, 40.0, roll, 2.0, span * SIZE[0] / (max(shape) * mesh) * 2.0)
    camera = centred(camera, shape, mesh)
    return pattern_picture(camera, inside, PICTURE, samples=3), camera


def errors(points, camera, mesh):
    exact = np.stack(camera.project(points.node[:, 0] * mesh, points.node[:, 1] * mesh, 0.0), -1)
    return points.pixel - exact


def test_all_corners_of_a_chessboard_are_numbered_as_it_was_drawn():
    image, camera = seen((8, 5), 0.05, chessboard((8, 5), 0.05))
    points = find_target(image, Target("chessboard", 0.05, (8, 5)))
    error = errors(points, camera, 0.05)
    assert len(points) == 40
    assert np.sqrt((error**2).mean()) < 0.05
    assert np.sqrt((error**2).mean()) < 2.0 * np.median(points.std)
    assert points.notes == ()


def test_a_chessboard_turned_by_half_a_turn_keeps_its_numbers():
    inside = chessboard((8, 5), 0.05)
    _, camera = seen((8, 5), 0.05, inside)
    image, camera = seen((8, 5), 0.05, inside, roll=195.0)
    error = errors(find_target(image, Target("chessboard", 0.05, (8, 5))), camera, 0.05)
    assert np.abs(error).max() < 0.3


def test_a_board_that_is_symmetric_when_turned_is_noted():
    image, _ = seen((7, 5), 0.05, chessboard((7, 5), 0.05))
    points = find_target(image, Target("chessboard", 0.05, (7, 5)))
    assert "has the same image" in points.notes[0]
    e1, e2 = SmoothMap(points.node, points.pixel).slopes(np.array([[3, 2]]))[0]
    assert e1[0] > 0
    assert e1[0] * e2[1] - e1[1] * e2[0] < 0


@pytest.mark.parametrize("bright", [False, True])
def test_dots_are_found_without_the_bias_of_their_centroids(bright):
    mesh, diameter, shape = 0.04, 0.022, (7, 6)
    image, camera = seen(shape, mesh, dots(shape, mesh, diameter, bright), tilt=45.0, roll=195.0)
    plain = find_target(image, Target("dots", mesh, shape))
    corrected = find_target(image, Target("dots", mesh, shape, diameter=diameter))
    bias = np.abs(errors(plain, camera, mesh).mean(0)).max()
    assert len(corrected) == 42
    assert bias > 0.02
    assert np.abs(errors(corrected, camera, mesh).mean(0)).max() < 0.2 * bias
    assert np.sqrt((errors(corrected, camera, mesh) ** 2).mean()) < 0.02


@pytest.mark.parametrize("roll", [15.0, 100.0])
def test_corners_of_a_charuco_board_are_exact_beside_its_markers(roll):
    image, camera = seen((6, 4), 0.05, charuco((7, 5), 0.05, 0.037), tilt=45.0, roll=roll, span=0.65)
    error = errors(find_target(image, Target("charuco", 0.05, (7, 5), marker=0.037)), camera, 0.05)
    assert np.sqrt((error**2).mean()) < 0.04


def test_a_charuco_board_is_numbered_by_its_markers():
    image, camera = seen((6, 4), 0.05, charuco((7, 5), 0.05, 0.037), roll=100.0, span=0.65)
    target = Target("charuco", 0.05, (7, 5), marker=0.037)
    points = find_target(image, target)
    assert len(points) >= 20
    assert np.abs(errors(points, camera, 0.05)).max() < 0.3


def test_hot_pixels_do_not_hide_a_charuco_board():
    target = Target("charuco", 0.05, (8, 6), marker=0.035)
    image, _ = seen((8, 6), 0.05, charuco((8, 6), 0.05, 0.035), tilt=20.0)
    nodes = find_target(image, target).node
    hot = image.astype(np.uint16) * 4 + 100
    hot[[3, 200], [3, 150]] = 65535
    assert len(find_target(hot, target).node) == len(nodes)


def test_pictures_without_the_printed_target_are_refused():
    rng = np.random.default_rng(1)
    image = rng.integers(90, 140, (200, 240)).astype(np.uint8)
    with pytest.raises(CalibrationError, match="no chessboard with 8 x 5"):
        find_target(image, Target("chessboard", 0.05, (8, 5)))
    with pytest.raises(CalibrationError, match="no grid of 8 x 5 dots"):
        find_target(image, Target("dots", 0.05, (8, 5)))
    with pytest.raises(CalibrationError, match="ChArUco"):
        find_target(image, Target("charuco", 0.05, (8, 5), marker=0.03))
    with pytest.raises(CalibrationError, match="DICT_NONE"):
        find_target(image, Target("charuco", 0.05, (8, 5), marker=0.03, dictionary="DICT_NONE"))


@pytest.mark.real_data
def test_every_sharp_real_chessboard_is_found_and_by_both_cameras_with_the_same_numbers(shared):
    pictures = sorted((shared / "data" / "stereo_chessboard").glob("*.jpg"))
    target = Target("chessboard", 0.03, (9, 6))
    found = {path.name: find_target(read_image(path), target) for path in pictures}
    assert len(found) == 26
    assert {len(points) for points in found.values()} == {54}
    left, right = found["left09.jpg"], found["right09.jpg"]
    order = [np.lexsort(points.node.T) for points in (left, right)]
    shift = left.pixel[order[0]] - right.pixel[order[1]]
    assert np.ptp(shift, axis=0).max() < 40  # a disparity, not a board turned round
    assert max(left.std.max(), right.std.max()) < 0.25


@pytest.mark.parametrize(
    ("block", "expected"),
    [
        ({"kind": "ropes", "mesh": 0.1}, "target.kind should be 'strings', 'chessboard'"),
        ({"kind": "strings"}, "mesh is missing"),
        ({"kind": "strings", "mesh": -1}, "target.mesh: give metres, above 0.00005 and below 2"),
        ({"kind": "strings", "mesh": "ten"}, "target.mesh: give metres, above 0.00005 and below 2"),
        ({"kind": "strings", "mesh": 0.1, "colour": "white"}, "target.colour is not a known key"),
        ({"kind": "strings", "mesh": 0.1, "x_mark": "cross"}, "small disc"),
        ({"kind": "chessboard", "mesh": 0.1}, "needs its shape"),
        ({"kind": "chessboard", "mesh": 0.1, "shape": 9}, "target.shape should be a valid tuple, not 9"),
        (
            {"kind": "chessboard", "mesh": 0.1, "shape": [9, 1]},
            "target.shape.1 should be greater than or equal to 3",
        ),
        ({"kind": "dots", "mesh": 0.1, "shape": [9, 6], "diameter": 0.2}, "larger than its mesh"),
        ({"kind": "charuco", "mesh": 0.1, "shape": [9, 6]}, "side of its markers"),
        ({"kind": "charuco", "mesh": 0.1, "shape": [9, 6], "marker": 0.2}, "larger than its squares"),
    ],
)
def test_an_impossible_target_is_refused(block, expected):
    with pytest.raises(CalibrationError, match=expected):
        Target.from_dict(block)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("i,j,X,Y\n0,0,1,2\n", "size"),
        ("# size 64 48\ni,j,X\n0,0,1\n", "lacks the column Y"),
        ("# size 64 48\ni,j,X,Y\n0,0,1,two\n", "not made of numbers"),
        ("# size 64 48\ni,j,X,Y\n0.5,0,1,2\n", "whole numbers"),
        ("# size 64 48\ni,j,X,Y\n0,0,1,2\n0,0,3,4\n", "twice"),
        ("# size 64\ni,j,X,Y\n0,0,1,2\n", "size"),
        ("# size 100 80\ni,j,X,Y,z\n0,0,5.0,6.0,high\n", "point 1 is not made of numbers"),
        ("# size 100 80\ni,j,X,Y,z\n0,0,5.0,6.0\n", "point 1 is not made of numbers"),
    ],
)
def test_a_file_of_points_that_is_no_table_is_refused(tmp_path, text, expected):
    (tmp_path / "points.csv").write_text(text)
    with pytest.raises(CalibrationError, match=expected):
        read_points(tmp_path / "points.csv")
    with pytest.raises(CalibrationError, match="no such file"):
        read_points(tmp_path / "other.csv")


def test_points_without_uncertainty_get_the_one_given(tmp_path):
    (tmp_path / "points.csv").write_text("i, j, X, Y\n0, 1, 10.5, 20\n")
    points = read_points(tmp_path / "points.csv", size=(64, 48), std=0.2)
    assert points.std.tolist() == [0.2]
    assert points.pixel.tolist() == [[10.5, 20.0]]
