import numpy as np
import pytest

from wavefield.errors import RigError
from wavefield.grid import Grid
from wavefield.rig import Rig
from wavefield.rig.field import pixel_sides, pixel_size
from wavefield.rig.rig import middle_camera, pairs_of
from wavefield.tank import paper_rig


def test_pixel_of_the_papers_rig_is_that_of_the_paper():
    assert 1.5e-3 < pixel_size(paper_rig(), Grid((-1, 1), (-0.75, 0.75), 0.01)) < 2.0e-3


def test_a_place_behind_the_camera_has_no_pixel():
    camera = paper_rig()["cam1"]
    behind = camera.centre - 100.0 * camera.R[2]
    with pytest.raises(RigError, match="does not see the middle"):
        pixel_sides(camera, *behind[:2])


@pytest.mark.parametrize("away", [(0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (-3.0, 5.0, 1.0)])
def test_pairs_follow_from_the_cameras_alone_wherever_the_origin_is(away):
    rig = paper_rig().moved(np.eye(3), away)
    assert pairs_of(rig, list(rig)) == (("cam3", "cam1"), ("cam3", "cam2"))


def test_of_two_cameras_the_first_is_the_reference():
    rig = paper_rig()
    assert middle_camera(Rig({n: rig[n] for n in ("cam2", "cam1")}), ["cam2", "cam1"]) == "cam2"
