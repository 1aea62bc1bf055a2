"""Target images show the target where the camera sees it."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates, spline_filter

from wavefield.tank import Scene, Tank, paper_rig, targets
from wavefield.tank.scene_parts import Chessboard, Dots, Strings

BLUR = 0.6
RIG = paper_rig(crop=0.35)
POSES = {"flat": targets.Pose(np.eye(3), np.zeros(3)), **{
    f"tilt_{i}": pose
    for i, pose in enumerate(targets.poses(3, 20.0, (-0.35, 0.35), (-0.25, 0.25), 0))
}}  # fmt: skip


def pixels_of(camera, pose, nodes):
    return np.array(camera.project(*(pose.rotation @ nodes.T + pose.origin[:, None])))


def crossing(image, X, Y, arm=6.0):
    """Centre of a bright cross near (X, Y): the point about which the image is its own mirror image."""
    top, left = int(Y) - 12, int(X) - 12
    near = spline_filter(image[top : top + 26, left : left + 26], order=5)
    d = np.arange(-arm, arm + 0.01, 0.5)
    dy, dx = np.meshgrid(d, d, indexing="ij")

    def look(x, y):
        return map_coordinates(near, [y - top + dy, x - left + dx], order=5, prefilter=False)

    x, y = X, Y
    for _ in range(5):
        here = look(x, y)
        gx, gy = look(x + 0.5, y) - look(x - 0.5, y), look(x, y + 0.5) - look(x, y - 0.5)
        # a shift of the centre by s changes the odd part of the image by s . (odd part of the gradient)
        odd = [(g - g[::-1, ::-1]).ravel() for g in (gx, gy)]
        step = np.linalg.lstsq(np.stack(odd, axis=1), -(here - here[::-1, ::-1]).ravel(), rcond=None)[0]
        x, y = x + step[0], y + step[1]
    return x, y


@pytest.mark.parametrize("pose", sorted(POSES))
@pytest.mark.parametrize("name", ["cam1", "cam3"])
def test_strings_cross_where_the_camera_sees_the_nodes(name, pose):
    camera, target = RIG[name], Strings(mesh=0.05)
    image = targets.draw(camera, target, POSES[pose], BLUR).astype(float)
    i, j = np.meshgrid(np.arange(-4, 5), np.arange(-4, 5))
    nodes = np.stack([i.ravel() * 0.05, j.ravel() * 0.05, np.zeros(i.size)], axis=1)
    marked = (np.abs(i.ravel()) <= 1) & (j.ravel() == 0)
    X, Y = pixels_of(camera, POSES[pose], nodes)
    inside = (X > 14) & (Y > 14) & (X < camera.size[0] - 15) & (Y < camera.size[1] - 15) & ~marked
    errors = [np.subtract(crossing(image, x, y), (x, y)) for x, y in zip(X[inside], Y[inside], strict=True)]
    assert len(errors) > 15
    assert np.sqrt(np.mean(np.square(errors))) < 0.005


def test_errors_of_the_nodes_are_as_large_as_set_and_spare_the_marks():
    offsets = targets.node_offsets(Strings(half=10, node_offset=1e-3), 3)
    assert offsets.shape == (21, 21, 3)
    assert offsets.std(axis=(0, 1)) == pytest.approx([1e-3] * 3, rel=0.1)
    assert not offsets[10, 10:12].any()
    assert offsets[10, 9].any()


@pytest.mark.parametrize("pose", ["flat", "tilt_2"])
def test_dots_have_their_area_and_place(pose):
    camera, target = RIG["cam3"], Dots(kind="dots", mesh=0.06, shape=(5, 4), diameter=0.02, brightness=100.0)
    image = targets.draw(camera, target, POSES[pose], BLUR).astype(float)
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    for i, j in ((0, 0), (4, 3), (2, 1)):
        centre = np.array([(i - 2) * 0.06, (j - 1.5) * 0.06, 0.0])
        rim = centre + 0.01 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
        X, Y = pixels_of(camera, POSES[pose], rim)
        x, y = X - X.mean(), Y - Y.mean()
        cross = x * np.roll(y, -1) - y * np.roll(x, -1)
        area = cross.sum() / 2
        cx = X.mean() + ((x + np.roll(x, -1)) * cross).sum() / (6 * area)
        cy = Y.mean() + ((y + np.roll(y, -1)) * cross).sum() / (6 * area)
        top, left = int(cy) - 22, int(cx) - 22
        patch = image[top : top + 45, left : left + 45]
        assert patch.sum() / 100.0 == pytest.approx(abs(area), rel=0.003)
        rows, columns = np.mgrid[top : top + 45, left : left + 45]
        assert (patch * columns).sum() / patch.sum() == pytest.approx(cx, abs=0.01)
        assert (patch * rows).sum() / patch.sum() == pytest.approx(cy, abs=0.01)


def test_chessboard_has_its_corners_and_colours():
    camera, pose = RIG["cam3"], POSES["tilt_0"]
    target = Chessboard(kind="chessboard", mesh=0.06, shape=(6, 5), brightness=100.0)
    image = targets.draw(camera, target, pose, BLUR).astype(float)
    for i, j in ((0, 0), (5, 4), (2, 3)):
        node = np.array([(i - 2.5) * 0.06, (j - 2.0) * 0.06, 0.0])
        squares = [node + 0.03 * np.array([a, b, 0]) for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
        X, Y = pixels_of(camera, pose, np.array(squares))
        grey = map_coordinates(image, [Y, X], order=1)
        light = grey > 50
        assert light.tolist() in ([True, False, True, False], [False, True, False, True])
        X, Y = pixels_of(camera, pose, node[None])
        assert map_coordinates(image, [Y, X], order=3)[0] == pytest.approx(52.5, abs=6)
    # neighbours differ, also at the edge of the board
    row = np.array([[(i - 3.0) * 0.06, 0.03, 0.0] for i in range(7)])
    X, Y = pixels_of(camera, pose, row)
    assert np.all(np.diff(map_coordinates(image, [Y, X], order=1) > 50))


@pytest.mark.parametrize("shape", [(6, 5), (5, 6)])
def test_the_corners_of_a_chessboard_are_found_where_they_were_drawn(shape):
    from wavefield.calibration import Target, find_target

    camera, pose = RIG["cam3"], POSES["tilt_0"]
    image = targets.draw(camera, Chessboard(kind="chessboard", mesh=0.06, shape=shape), pose, BLUR)
    points = find_target(np.clip(image, 0, 255).astype(np.uint8), Target("chessboard", 0.06, shape))
    node = np.pad((points.node - (np.array(shape) - 1) / 2) * 0.06, ((0, 0), (0, 1)))
    assert np.abs(points.pixel - np.stack(pixels_of(camera, pose, node), -1)).max() < 0.1


def test_poses_are_tilted_towards_all_sides_and_reproducible():
    six = targets.poses(6, 20.0, (-1, 1), (-0.75, 0.75), 4)
    normals = np.array([pose.rotation[:, 2] for pose in six])
    tilts = np.degrees(np.arccos(normals[:, 2]))
    assert 8 < tilts.min() < tilts.max() <= 20.0
    assert normals[:, 0].min() < -0.1 < 0.1 < normals[:, 0].max()
    assert normals[:, 1].min() < -0.1 < 0.1 < normals[:, 1].max()
    assert len({round(float(pose.origin[2]), 4) for pose in six}) == 6
    again = targets.poses(6, 20.0, (-1, 1), (-0.75, 0.75), 4)
    assert all(np.array_equal(a.rotation, b.rotation) for a, b in zip(six, again, strict=True))


@pytest.mark.parametrize("scene", ["two_cameras", "sheet"])
def test_boards_that_must_be_seen_whole_are_held_in_view_of_every_camera(scene):
    for seed in range(40):
        tank = Tank(Scene.load(scene).with_(seed=seed))
        board = tank.scene.calibration.target
        beyond = 1.5 if board.kind == "chessboard" else 0.5
        half = ((np.array(board.shape) - 1) / 2 + beyond) * board.mesh
        node = np.array([(x, y, 0.0) for x in (-1, 1) for y in (-1, 1)]) * (*half, 0.0)
        for pose in tank.target_poses.values():
            for name in tank.rig:
                assert tank.rig[name].sees(*(pose.rotation @ node.T + pose.origin[:, None])).all(), seed
        assert len({round(float(pose.origin[2]), 5) for pose in tank.target_poses.values()}) >= 4, seed
