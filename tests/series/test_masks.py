import cv2
import numpy as np
import pytest

from wavefield.errors import ExperimentError
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
    return masks.covered_series(experiment.mask, series, rig or Rig({}), lab, 0.05)


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


@pytest.mark.parametrize("height", [0.0, 0.2])
def test_a_cylinder_hides_itself_in_every_camera(height):
    rig = paper_rig(0.3)
    cylinder = masks.MaskSection(
        cylinder={"x": 0.03, "y": -0.02, "radius": 0.04, "top": 0.2, "bottom": -0.05}
    )
    angle = np.linspace(0, 2 * np.pi, 100)
    x, y = 0.03 + 0.04 * np.cos(angle), -0.02 + 0.04 * np.sin(angle)
    for camera in rig.cameras.values():
        outline = np.array(masks.outline_in_image(cylinder, camera, 0.05), np.float32)
        X, Y = camera.project(x, y, height)
        inside = [cv2.pointPolygonTest(outline, (float(a), float(b)), True) for a, b in zip(X, Y)]
        assert min(inside) > -0.1
        X, Y = camera.project(0.03 + 0.06 * np.cos(angle), -0.02 + 0.06 * np.sin(angle), 0.0)
        free = [cv2.pointPolygonTest(outline, (float(a), float(b)), False) < 0 for a, b in zip(X, Y)]
        assert np.mean(free) > 0.4


def test_the_recipe_depends_on_the_content_of_an_image_of_a_mask(lab):
    cv2.imwrite(str(lab / "m.png"), np.zeros(SIZE, np.uint8))
    one = masks.as_data({"cam1": [masks.MaskSection(image="m.png")]}, lab)
    cv2.imwrite(str(lab / "m.png"), np.eye(*SIZE, dtype=np.uint8))
    assert masks.as_data({"cam1": [masks.MaskSection(image="m.png")]}, lab) != one


def test_a_cylinder_without_height_is_refused(lab):
    with pytest.raises(ExperimentError, match="above its bottom"):
        opened(lab, "{water: {cylinder: {x: 0, y: 0, radius: 1, top: 0, bottom: 1}}}")
