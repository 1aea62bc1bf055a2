import cv2
import numpy as np
import pytest

from wavefield.rig import Rig
from wavefield.series import Experiment, masks
from wavefield.tank import paper_rig

SIZE = (40, 60)


@pytest.fixture
def lab(tmp_path):
    for camera in ("cam1", "cam2"):
        (tmp_path / camera).mkdir()
        for k in range(4):
            image = np.random.default_rng(k).integers(0, 200, SIZE, dtype=np.uint8)
            cv2.imwrite(str(tmp_path / camera / f"{k:03d}.png"), image)
    return tmp_path


def opened(lab, mask, rig=None):
    path = lab / "experiment.yaml"
    path.write_text(
        "name: lab\nframe_rate: 20\n"
        'cameras: {cam1: "cam1/{frame:03d}.png", cam2: "cam2/{frame:03d}.png"}\n'
        f"mask: {mask}\n"
    )
    experiment = Experiment.load(path)
    series = experiment.open_frames()
    return masks.covered_series(experiment.mask, series, rig or Rig({}), lab)


def test_a_polygon_covers_its_inside_and_nothing_of_other_cameras(lab):
    series = opened(lab, "{cam1: {polygon: [[10, 5], [30, 5], [30, 25], [10, 25]]}}")
    covered = series["cam1"].covered(2)
    expected = np.zeros(SIZE, bool)
    expected[5:26, 10:31] = True
    np.testing.assert_array_equal(covered, expected)
    assert series["cam2"].covered(2) is None


def test_what_is_not_black_in_an_image_is_covered(lab):
    image = np.zeros(SIZE, np.uint8)
    image[:10] = 1
    cv2.imwrite(str(lab / "m.png"), image)
    series = opened(lab, "{cam1: m.png, cam2: [m.png, {polygon: [[0, 20], [9, 20], [0, 29]]}]}")
    np.testing.assert_array_equal(series["cam1"].covered(0), image > 0)
    assert series["cam2"].covered(0)[22, 2]
    assert series["cam2"].covered(0)[2, 2]


def test_the_recipe_depends_on_the_content_of_an_image_of_a_mask(lab):
    cv2.imwrite(str(lab / "m.png"), np.zeros(SIZE, np.uint8))
    one = masks.as_data({"cam1": [masks.MaskSection(image="m.png")]}, lab)
    cv2.imwrite(str(lab / "m.png"), np.eye(*SIZE, dtype=np.uint8))
    assert masks.as_data({"cam1": [masks.MaskSection(image="m.png")]}, lab) != one


def test_a_polygon_on_the_water_covers_its_place_in_every_camera():
    rig = paper_rig(0.3)
    shape = masks.MaskSection(polygon=[(-0.04, -0.05), (0.05, -0.03), (0.02, 0.06)])
    for camera in rig.cameras.values():
        outline = np.array(masks.outline_in_image(shape, camera), np.float32)
        for (x, y), inside in (((0.0, 0.0), True), ((0.03, -0.03), True), ((-0.05, 0.05), False)):
            place = tuple(map(float, camera.project(x, y, 0.0)))
            assert (cv2.pointPolygonTest(outline, place, False) > 0) == inside
