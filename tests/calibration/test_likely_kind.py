"""Where the stated target is not found, one note names what the images show."""

import re

import cv2
import numpy as np
import pytest
import yaml
from rendering import Picture, camera_at, string_picture
from test_target_page import TARGETS, picture_of

from wavefield.calibration.images import calibrate_experiment
from wavefield.calibration.likely_kind import likely_target
from wavefield.calibration.target import Target
from wavefield.errors import CalibrationError
from wavefield.figures.target_page import target_page
from wavefield.images import write_image

STATED = TARGETS | {"strings": Target("strings", mesh=0.1)}
SHOWN = {
    "chessboard": "these look like a chessboard: `kind: chessboard, shape: [9, 6]`",
    "charuco": "these look like a ChArUco board: `kind: charuco`",
    "dots": "these look like dots: `kind: dots`",
    "strings": "these look like strings: `kind: strings`",
}


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    """A picture of each kind of target, seen from the side."""
    folder = tmp_path_factory.mktemp("shown")
    for kind, target in TARGETS.items():
        page = picture_of(target_page(target))
        height, width = page.shape
        corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
        turned = corners + np.array([[60, 40], [-90, 10], [-30, -60], [20, -20]], np.float32)
        picture = cv2.warpPerspective(
            page, cv2.getPerspectiveTransform(corners, turned), (width, height), borderValue=128
        )
        write_image(folder / f"{kind}.png", cv2.GaussianBlur(picture, (0, 0), 0.8))
    camera = camera_at(size=(500, 500), tilt=20, distance=4.0, focal=1300.0)
    write_image(folder / "strings.png", string_picture(camera, Picture()))
    for seed in (1, 2, 3):
        noise = np.random.default_rng(seed).integers(0, 255, (400, 500)).astype(np.uint8)
        write_image(folder / f"water{seed}.png", cv2.GaussianBlur(noise, (0, 0), 1.0 + 0.5 * seed))
    return folder


@pytest.mark.parametrize(("shown", "stated"), [
    ("chessboard", "strings"), ("chessboard", "dots"), ("charuco", "chessboard"), ("dots", "charuco"),
    ("strings", "chessboard"), ("strings", "dots"),
])  # fmt: skip
def test_images_of_another_target_are_named(images, shown, stated):
    assert likely_target([images / f"{shown}.png"], STATED[stated]) == SHOWN[shown]


def test_a_chessboard_of_another_shape_is_given_with_its_shape(images):
    stated = Target("chessboard", mesh=0.025, shape=(7, 5))
    assert likely_target([images / "chessboard.png"], stated) == SHOWN["chessboard"]


@pytest.mark.parametrize(("shown", "stated"), [
    ("chessboard", "chessboard"), ("strings", "strings"), ("water1", "dots"), ("water2", "chessboard"),
    ("water3", "charuco"),
])  # fmt: skip
def test_nothing_is_named_where_the_images_show_what_is_stated_or_no_target(images, shown, stated):
    assert likely_target([images / f"{shown}.png"], STATED[stated]) == ""


def test_one_sentence_where_no_image_shows_the_stated_target(images, tmp_path):
    for camera in ("left", "right"):
        write_image(tmp_path / camera / "1.png", np.zeros((40, 50), np.uint8))
        for pose in (1, 2):
            (tmp_path / f"{camera}_{pose}.png").write_bytes((images / "chessboard.png").read_bytes())
    note = {
        "name": "boards",
        "frame_rate": 10,
        "cameras": {"left": "left/*.png", "right": "right/*.png"},
        "calibration": {
            "target": {"kind": "dots", "mesh": 0.02, "shape": [11, 8]},
            "tilted": "{camera}_*.png",
        },
    }
    (tmp_path / "experiment.yaml").write_text(yaml.safe_dump(note, sort_keys=False))
    words = f"line 7: no dots in the first 3 of 4 target images: {SHOWN['chessboard']}"
    with pytest.raises(CalibrationError, match=re.escape(words)):
        calibrate_experiment(tmp_path / "experiment.yaml")
