"""Images of targets show their points where the camera projects them."""

import numpy as np
import pytest

from wavefield.calibration import Target, find_target
from wavefield.tank import Scene, Tank, paper_rig, targets
from wavefield.tank.scene_parts import Chessboard, Dots, Strings

BLUR = 0.6
RIG = paper_rig(crop=0.35)
(TILTED,) = targets.poses(1, 20.0, (-0.35, 0.35), (-0.25, 0.25), 0)


def pixels_of(camera, pose, nodes):
    return np.stack(camera.project(*(pose.rotation @ nodes.T + pose.origin[:, None])), -1)


DOTS = Dots(kind="dots", mesh=0.06, shape=(5, 4), diameter=0.02)
CHESSBOARD = Chessboard(kind="chessboard", mesh=0.06, shape=(6, 5))


@pytest.mark.parametrize(
    ("drawn", "target", "camera", "error"),
    [
        (Strings(mesh=0.05), Target("strings", 0.05), "cam1", 0.002),
        (Strings(mesh=0.05), Target("strings", 0.05), "cam3", 0.002),
        (DOTS, Target("dots", 0.06, (5, 4), diameter=0.02), "cam3", 0.006),
        (CHESSBOARD, Target("chessboard", 0.06, (6, 5)), "cam3", 0.03),
    ],
)
def test_nodes_are_found_where_the_camera_sees_them(drawn, target, camera, error):
    image = targets.draw(RIG[camera], drawn, TILTED, BLUR)
    points = find_target(np.clip(np.rint(image), 0, 255).astype(np.uint8), target)
    middle = np.zeros(2) if target.shape is None else (np.array(target.shape) - 1) / 2
    node = np.pad((points.node - middle) * target.mesh, ((0, 0), (0, 1)))
    off = points.pixel - pixels_of(RIG[camera], TILTED, node)
    assert len(node) >= 20
    assert np.sqrt((off**2).mean()) < error


@pytest.mark.parametrize("scene", ["two_cameras", "sheet"])
def test_boards_that_must_be_seen_whole_are_held_in_view_of_every_camera(scene):
    for seed in range(10):
        tank = Tank(Scene.load(scene).with_(seed=seed))
        board = tank.scene.calibration.target
        beyond = 1.5 if board.kind == "chessboard" else 0.5
        half = ((np.array(board.shape) - 1) / 2 + beyond) * board.mesh
        node = np.array([(x, y, 0.0) for x in (-1, 1) for y in (-1, 1)]) * (*half, 0.0)
        for pose in tank.target_poses.values():
            for name in tank.rig:
                assert tank.rig[name].sees(*(pose.rotation @ node.T + pose.origin[:, None])).all(), seed
        assert len({round(float(pose.origin[2]), 5) for pose in tank.target_poses.values()}) >= 4, seed
