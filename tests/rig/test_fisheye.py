"""Cameras with fisheye lenses, up to more than a half-space in view."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from rig_cases import random_fisheye

from wavefield.errors import RigError
from wavefield.rig import Camera, Rig
from wavefield.rig.field import common_field

SEEDS = range(2)


def directions(seed, widest, n=300):
    """Points in a camera's frame, up to an angle (degrees) off its axis, at distances of 1 to 5 m."""
    rng = np.random.default_rng(seed + 50)
    angle, around = np.radians(rng.uniform(0, widest, n)), rng.uniform(0, 2 * np.pi, n)
    angle[0] = 0.0  # on the axis
    unit = np.stack([np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.cos(angle)])
    return unit * rng.uniform(1, 5, n)


def in_world(camera, points):
    return camera.R.T @ (points - camera.T[:, None])


@pytest.mark.parametrize("seed", SEEDS)
def test_projection_is_that_of_opencvs_fisheye(seed):
    camera = random_fisheye(seed)
    world = in_world(camera, directions(seed, 85))
    K = camera.K.copy()
    alpha, K[0, 1] = K[0, 1] / K[0, 0], 0.0
    expected = cv2.fisheye.projectPoints(
        world.T[:, None], cv2.Rodrigues(camera.R)[0], camera.T, K, camera.D, alpha=alpha
    )[0][:, 0]
    # OpenCV rounds the rotation vector
    assert np.abs(np.stack(camera.project(*world), -1) - expected).max() < 1e-6


@pytest.mark.parametrize("seed", SEEDS)
def test_pixels_to_a_plane_and_back_beyond_90_degrees_off_the_axis(seed):
    rng = np.random.default_rng(seed)
    camera = random_fisheye(seed)
    points = directions(seed, 100)
    X, Y = camera.project(*in_world(camera, points))
    assert np.isfinite(X).all()
    z = rng.uniform(-0.1, 0.1)
    x, y = camera.unproject(X, Y, z)
    there = np.isfinite(x)
    assert there.any()
    back = camera.project(x, y, z)
    assert max(np.abs(back[0] - X)[there].max(), np.abs(back[1] - Y)[there].max()) < 1e-7
    a, _ = camera.tangents(X, Y)
    assert np.array_equal(np.isfinite(a), points[2] > 0)


@pytest.mark.parametrize("seed", SEEDS)
def test_derivatives_by_points(seed):
    camera = random_fisheye(seed)
    points = directions(seed, 100)
    world, h = in_world(camera, points), 1e-5
    jacobian = camera.jacobian(*world)
    for j, step in enumerate(h * np.eye(3)):
        ahead, behind = (np.stack(camera.project(*(world + s * step[:, None])), -1) for s in (1, -1))
        assert np.abs((ahead - behind) / (2 * h) - jacobian[..., j]).max() < 1e-4 * camera.fx


def test_what_the_lens_does_not_show_is_no_number():
    camera = replace(random_fisheye(0), k1=-0.2, k2=0.0, k3=0.0, k4=0.0)  # turns back at 74 degrees
    shown = np.isfinite(camera.project(*in_world(camera, directions(0, 120)))[0])
    points = directions(0, 120)
    angle = np.degrees(np.arctan2(np.hypot(*points[:2]), points[2]))
    assert np.array_equal(shown, angle < np.degrees(np.sqrt(1 / 0.6)))
    assert np.isnan(camera.unproject(camera.cx + 3 * camera.fx, camera.cy)[0])


def test_terms_of_the_other_kind_of_lens_are_refused():
    camera = random_fisheye(1)
    with pytest.raises(RigError, match="does not have the terms p1"):
        replace(camera, p1=1e-3)
    with pytest.raises(RigError, match="does not have the terms k4"):
        replace(camera, fisheye=False, k4=0.01)
    with pytest.raises(RigError, match="fisheye model has 4"):
        Camera.from_opencv(camera.K, [0.1, 0.0], camera.R, camera.T, camera.size, fisheye=True)


def test_a_rig_of_fisheyes_is_stored_and_sees_a_common_field(tmp_path):
    cameras = {f"cam{n}": random_fisheye(n) for n in (1, 2)}
    Rig(cameras).save(tmp_path / "rig.yaml")
    assert Rig.load(tmp_path / "rig.yaml").cameras == cameras
    grid = common_field(cameras.values())
    corners = np.array([(x, y) for x in grid.x for y in grid.y]).T
    assert all(camera.sees(*corners, 0.0).all() for camera in cameras.values())
    half = cameras["cam1"].scaled(0.5)
    X, Y = cameras["cam1"].project(0.3, 0.2, 0.0)
    assert np.allclose(half.project(0.3, 0.2, 0.0), ((X + 0.5) / 2 - 0.5, (Y + 0.5) / 2 - 0.5))
