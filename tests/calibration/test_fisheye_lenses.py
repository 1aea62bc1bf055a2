"""Rigs of fisheye lenses from the points of a board held in all directions."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from rendering import Picture, charuco, pattern_picture

from wavefield.calibration import Target, TargetPoints, calibrate, find_target
from wavefield.rig import Camera

MESH, SIZE = 0.1, (1280, 960)
FLAT = np.array([-0.45, -0.3, 0.0])  # of node (0, 0)
NODE = np.mgrid[0:10, 0:7].reshape(2, -1).T
LENSES = {"equisolid": (-1 / 24, 1 / 1920, 0.0, 0.0), "stereographic": (1 / 12, 1 / 120, 17 / 20160, 0.0)}


def pair(rng, field, lens):
    """Two cameras 1.2 m above a board, of a field (degrees) along their images' longer side."""
    half = np.radians(field / 2)
    f = 640 / (half * (1 + sum(k * half ** (2 * n) for n, k in enumerate(lens, 1))))
    return {
        name: placed(rng, side, f, dict(zip(("k1", "k2", "k3", "k4"), lens)) | {"fisheye": True})
        for name, side in (("cam1", -1), ("cam2", 1))
    }


def placed(rng, side, f, terms):
    down = np.diag([1.0, -1.0, -1.0])
    turn = cv2.Rodrigues(np.array([rng.uniform(-0.1, 0.1), np.radians(20.0 * side), rng.uniform(-0.1, 0.1)]))[
        0
    ]
    R, centre = turn @ down, np.array([0.5 * side, 0.0, 1.2])
    c = np.array([639.5, 479.5]) + rng.uniform(-10, 10, 2)
    return Camera(f, f * rng.uniform(0.995, 1.005), *c, R, -R @ centre, SIZE, **terms)


def views_of(rng, cameras, noise=0.03, number=12):
    """Points of a board, also partly in view; every second pose is seen by both cameras."""
    views = {name: {} for name in cameras}
    for i in range(number + 1):
        seen = {}
        while len(seen) < (1 if i % 2 and i < number else 2):
            tilt, shift = np.eye(3), FLAT
            if i < number:
                tilt = cv2.Rodrigues(0.35 * rng.normal(size=3))[0]
                shift = FLAT + rng.uniform((-1.2, -0.8, 0.0), (1.2, 0.8, 0.7))
            points = np.column_stack([NODE * MESH, np.zeros(len(NODE))]) @ tilt.T + shift
            seen = {}
            for name, camera in cameras.items():
                sight = camera.centre - points
                facing = sight @ tilt[:, 2] > 0.1 * np.linalg.norm(sight, axis=1)
                shown = camera.sees(*points.T, 3.0) & facing
                if shown.sum() >= 25:
                    seen[name] = shown
        for name, shown in seen.items():
            pixel = np.stack(cameras[name].project(*points.T), -1)[shown]
            pixel += rng.normal(0, noise, pixel.shape)
            pose = "flat" if i == number else f"tilt_{i}"
            views[name][pose] = TargetPoints(NODE[shown], pixel, np.full(len(pixel), noise), SIZE)
    return views


def error_on_water(found, camera):
    """Rms difference of pixels on z = 0, px, wherever the camera sees it up to 1.2 m from the middle."""
    x, y = np.meshgrid(np.linspace(-1.2, 1.2, 25), np.linspace(-0.9, 0.9, 19))
    shown = camera.sees(x, y, 0.0)
    there, here = camera.project(x, y, 0.0), found.project(x - FLAT[0], y - FLAT[1], 0.0)
    return float(np.sqrt(np.mean((np.array(there) - np.array(here))[:, shown] ** 2)))


@pytest.mark.parametrize(("lens", "field"), [("stereographic", 100), ("equisolid", 180)])
def test_fisheye_lenses_are_recognised_and_calibrated(lens, field):
    rng = np.random.default_rng([field, len(lens), 3])
    cameras = pair(rng, field, LENSES[lens])
    result = calibrate(views_of(rng, cameras), MESH)
    assert result.usable, result.problems
    assert "taken for fisheye lenses, which fit better: cam1, cam2" in result.notes
    for name, camera in cameras.items():
        assert result.rig[name].fisheye
        assert error_on_water(result.rig[name], camera) < 0.1
        assert result.predicted.reprojection[name] < 0.1


def test_perspective_lenses_are_not_taken_for_fisheyes():
    rng = np.random.default_rng([201, 4])
    cameras = {}
    for name, side in (("cam1", -1), ("cam2", 1)):
        terms = dict(zip(("k1", "k2", "p1", "p2"), rng.uniform(-1, 1, 4) * (0.3, 0.1, 2e-3, 2e-3)))
        terms["tau_y"] = rng.uniform(-0.05, 0.05)
        cameras[name] = placed(rng, side, 640 / np.tan(np.radians(rng.uniform(15, 45))), terms)
    result = calibrate(views_of(rng, cameras, 0.02), MESH)
    assert not any(camera.fisheye for camera in result.rig.cameras.values())
    assert not any("fisheye" in note for note in result.notes)


def test_the_kind_of_lens_may_be_stated():
    rng = np.random.default_rng(8)
    cameras = pair(rng, 60, LENSES["equisolid"])
    views = views_of(rng, cameras)
    for lens, fisheye in (("fisheye", True), ("perspective", False)):
        result = calibrate(views, MESH, lens=lens)
        assert [camera.fisheye for camera in result.rig.cameras.values()] == [fisheye, fisheye]
        assert not any("fisheye" in note for note in result.notes)


def test_a_charuco_board_is_found_in_a_fisheyes_image():
    rng = np.random.default_rng(5)
    camera = replace(
        placed(rng, 1, 390.0, {"k1": 0.02, "fisheye": True}), size=(960, 720), cx=479.5, cy=359.5
    )
    tilt = cv2.Rodrigues(np.array([0.2, -0.3, 0.1]))[0]
    own = replace(camera, rotation=camera.R @ tilt, translation=camera.R @ (FLAT * (0.4, 1, 1)) + camera.T)
    board = charuco((11, 8), 0.09, 0.068)
    picture = pattern_picture(
        own, lambda x, y: board(*(np.nan_to_num(np.clip(v, -3, 3), nan=3.0) for v in (x, y))), Picture(), 2
    )
    points = find_target(picture, Target("charuco", 0.09, (11, 8), marker=0.068, dictionary="DICT_4X4_50"))
    exact = np.stack(own.project(*(points.node * 0.09).T, 0.0), -1)
    error = np.abs(points.pixel - exact)
    assert len(points) > 55
    assert np.sqrt(np.median(error**2)) < 0.04
    assert error.max() < 1.0
