"""The view to photograph next is the one that adds most."""

import cv2
import numpy as np
import pytest

from wavefield.calibration import TargetPoints, calibrate
from wavefield.calibration.next_view import next_view
from wavefield.rig import Rig
from wavefield.tank.rigs import paper_rig

NODES = np.mgrid[-8:9, -6:7].reshape(2, -1).T
MESH, STD = 0.1, 0.6
EXACT = paper_rig()


def pose(tilt, shift=(0.0, 0.0)):
    """Target to world: a turn in degrees, and where its middle is."""
    turn = cv2.Rodrigues(np.radians([*tilt, 0.0]))[0]
    return turn, np.array([*shift, 0.0])


def views(poses, seed=0):
    """Points of poses as the cameras see them, with noise."""
    rng = np.random.default_rng(seed)
    board = np.column_stack([MESH * NODES, np.zeros(len(NODES))])
    out = {name: {} for name in EXACT}
    for number, (turn, shift) in enumerate(poses):
        points = board @ turn.T + shift
        for name, camera in EXACT.cameras.items():
            seen = camera.sees(*points.T)
            pixel = np.stack(camera.project(*points[seen].T), axis=-1)
            pixel += rng.normal(0, STD, pixel.shape)
            label = "flat" if number == 0 else f"tilted {number}"
            out[name][label] = TargetPoints(NODES[seen], pixel, np.full(seen.sum(), STD), camera.size)
    return out


FEW = [pose((0, 0)), pose((15, 0)), pose((-12, 5))]


@pytest.fixture(scope="module")
def few():
    return calibrate(views(FEW), MESH, model="paper")


def test_the_view_reduces_the_uncertainty_as_predicted(few):
    advice = next_view(few)
    assert advice.helps
    assert advice.z_std[0] == few.predicted.z_std
    box = np.stack([camera.corners() for camera in few.rig.cameras.values()])
    lo, hi = box.min(axis=1).max(axis=0), box.max(axis=1).min(axis=0)
    shift = (lo + hi) / 2 + 0.3 * np.array(advice.place) * (hi - lo) / 2
    then = calibrate(views([*FEW, pose(advice.tilt, shift)]), MESH, model="paper")
    assert then.predicted.z_std == pytest.approx(advice.z_std[1], rel=0.2)
    assert max(then.predicted.reprojection.values()) == pytest.approx(advice.reprojection[1], rel=0.2)
    # and more than the same view again
    again = calibrate(views([*FEW, FEW[1]]), MESH, model="paper")
    assert then.predicted.z_std < again.predicted.z_std


def test_a_target_tilted_one_way_only_is_asked_for_the_other_way():
    about_x = calibrate(views([pose((0, 0)), pose((20, 0)), pose((-20, 0))]), MESH, model="paper")
    assert next_view(about_x).tilt[1] != 0
    about_y = calibrate(views([pose((0, 0)), pose((0, 20)), pose((0, -20))]), MESH, model="paper")
    assert next_view(about_y).tilt[0] != 0


def test_many_good_views_need_no_more():
    tilts = [(0, 0), (25, 0), (-25, 0), (0, 25), (0, -25), (20, 20), (-20, 20), (20, -20), (-20, -20)]
    poses = [pose(tilt, (0.02 * k, 0.0)) for k, tilt in enumerate(tilts)]
    assert not next_view(calibrate(views(poses), MESH, model="paper")).helps


def test_no_view_is_proposed_without_a_solution(few):
    assert next_view(calibrate({name: {} for name in EXACT}, MESH)) is None
    one = calibrate({"cam1": views(FEW)["cam1"]}, MESH, model="paper")
    assert "pixels known to" in next_view(one).words
    assert isinstance(few.rig, Rig)
