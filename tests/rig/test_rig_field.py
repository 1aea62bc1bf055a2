"""The common field of cameras, the size of their pixels on the water, and their pairs."""

import numpy as np
import pytest
from rig_cases import random_camera

from wavefield.errors import RigError
from wavefield.grid import Grid
from wavefield.rig import Camera, common_field
from wavefield.rig.field import pixel_sides, pixel_size
from wavefield.rig.rig import pairs_of
from wavefield.tank import paper_rig

FACING_DOWN = np.diag([1.0, -1.0, -1.0])


def down(x=0.0, f=1000.0):
    return Camera(f, f, 499.5, 499.5, FACING_DOWN, -FACING_DOWN @ np.array([x, 0.0, 4.0]), (1000, 1000))


def test_field_of_two_shifted_cameras_is_their_overlap():
    grid = common_field([down(), down(x=1.0)], step=0.01, height=0.0, margin=0.0)
    # the sensor reaches from pixel centre 0 to 999: 1.998 m to each side
    assert grid.x == pytest.approx((-0.99, 1.99), abs=0.011)
    assert grid.y == pytest.approx((-1.99, 1.99), abs=0.011)


@pytest.mark.parametrize("seed", range(2))
def test_every_node_stays_in_view_when_the_surface_moves(seed):
    cameras = [random_camera(seed + k) for k in (0, 10, 20)]
    grid = common_field(cameras, height=0.08, margin=20.0)
    x, y = np.meshgrid(grid.x_nodes, grid.y_nodes)
    for camera in cameras:
        for z in (-0.08, 0.0, 0.08):
            assert camera.sees(x, y, z, 19.0).all()
    assert np.allclose(grid.x_nodes / grid.step, np.round(grid.x_nodes / grid.step))


def test_a_step_that_suits_the_pixels_is_chosen():
    assert common_field([down()]).step == 0.02  # five pixels of 4 mm
    assert common_field([down(f=2700.0)]).step == 0.01  # of 1.5 mm


def test_cameras_without_a_common_field_are_refused():
    with pytest.raises(RigError, match="no common field"):
        common_field([down(), down(x=10.0)])
    with pytest.raises(RigError, match="narrower"):
        common_field([down()], step=5.0)


def test_a_field_ends_short_of_the_horizon():
    level = Camera(1000, 1000, 500, 500, ((1, 0, 0), (0, 0, -1), (0, 1, 0)), (0, 2, 0), (1000, 1000))
    x, y = np.meshgrid(*(common_field([level]).x, common_field([level]).y))
    nearest = 2.0 * np.sqrt(5.0)  # the image's lowest row points down by 1 in 2 from 2 m
    assert level.sees(x, y, 0.0).all()
    assert np.sqrt(x**2 + y**2 + 4.0).max() < 3.2 * nearest


def test_a_camera_that_sees_no_water_is_refused():
    upwards = Camera(1000, 1000, 500, 500, ((1, 0, 0), (0, -1, 0), (0, 0, 1)), (0, 0, -2), (1000, 1000))
    with pytest.raises(RigError, match="does not see the water"):
        common_field([upwards])


@pytest.mark.parametrize("scale", [0.1, 1.0, 20.0])
def test_the_elevations_kept_in_view_follow_from_the_cameras_distance(scale):
    cameras = [Camera(1000, 1000, 499.5, 499.5, FACING_DOWN, (0, 0, 4.0 * scale), (1000, 1000))]
    own = common_field(cameras, step=0.004 * scale, margin=0.0)
    assert own == common_field(cameras, step=0.004 * scale, margin=0.0, height=0.04 * scale)


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
