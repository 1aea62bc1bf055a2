"""Other people's targets: moved along z, of two levels, in tables; pairs of cameras without a flat view."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from rendering import write_points
from solve_cases import nodes, poses

from wavefield.calibration import Target, calibrate
from wavefield.calibration.model_choice import predict_errors
from wavefield.calibration.points import TargetPoints, read_points
from wavefield.commands.cli import main
from wavefield.errors import CalibrationError
from wavefield.rig import Camera, Rig
from wavefield.tank.rigs import paper_rig

MODEL = "f tilt k1"  # of the simulated cameras


def seen(camera, grid, points, rng, noise, **more):
    inside = camera.sees(*points.T, margin=5)
    pixel = np.stack(camera.project(*points[inside].T), -1) + rng.normal(0, noise, (inside.sum(), 2))
    more = {k: v[inside] if isinstance(v, np.ndarray) else v for k, v in more.items()}
    return TargetPoints(grid[inside], pixel, np.full(inside.sum(), noise), camera.size, **more)


def worst_pixel(found, exact):
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 5), np.linspace(-0.5, 0.5, 5))
    return max(
        np.hypot(*(np.array(found[n].project(x, y, 0.02)) - exact[n].project(x, y, 0.02))).max()
        for n in exact
    )


def test_a_target_moved_along_z_calibrates_from_tables(tmp_path):
    rig, grid, rng = paper_rig(), nodes()[::2], np.random.default_rng(3)
    views = {name: {} for name in rig}
    for height in (-0.06, -0.03, 0.0, 0.03, 0.06):
        z = np.full(len(grid), height)
        for name in rig:
            points = seen(rig[name], grid, np.column_stack([0.1 * grid, z]), rng, 0.02, z=z, placed=True)
            write_points(tmp_path / f"{name}{height}.csv", points)
            views[name][f"at {height}"] = read_points(tmp_path / f"{name}{height}.csv")
    found = calibrate(views, 0.1, flat="", model=MODEL)
    assert found.usable, found.problems
    assert worst_pixel(found.rig, rig) < 0.01
    flat = {n: {p: replace(v, z=None, placed=False) for p, v in views[n].items()} for n in views}
    assert any("moved along z" in p for p in calibrate(flat, 0.1, flat="", model=MODEL).problems)


@pytest.mark.parametrize("line", ["0,0,5.0,6.0,high", "0,0,5.0,6.0"])
def test_a_table_without_its_heights_is_refused(tmp_path, line):
    (tmp_path / "points.csv").write_text(f"# size 100 80\ni,j,X,Y,z\n{line}\n")
    with pytest.raises(CalibrationError, match="point 1 is not made of numbers"):
        read_points(tmp_path / "points.csv")


def pair_without_a_flat_view(seed, noise):
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(np.arange(9), np.arange(6)), -1).reshape(-1, 2)
    left = Camera(540, 538, 330, 240, np.eye(3), (0, 0, 0), (640, 480), k1=-0.28, k2=0.08)
    right = replace(left, rotation=cv2.Rodrigues(np.array([0, 0.1, 0.0]))[0], translation=(-0.1, 0, 0))
    views = {"left": {}, "right": {}}
    for pose in range(8):
        R = cv2.Rodrigues(rng.uniform(-0.45, 0.45, 3))[0]
        t = rng.uniform((-0.13, -0.1, 0.45), (-0.05, 0, 0.6))
        world = np.column_stack([0.03 * grid, np.zeros(54)]) @ R.T + t
        for name, camera in (("left", left), ("right", right)):
            views[name][f"pose {pose}"] = seen(camera, grid, world, rng, noise)
    return views


def test_a_good_pair_is_assessed_where_its_target_was_by_the_errors_that_its_model_predicts():
    found = calibrate(pair_without_a_flat_view(3, 0.1), 0.03, flat="")
    assert found.usable, found.problems
    best = {row.model: row for row in found.models}
    richest = min(found.models, key=lambda row: row.bic)
    assert best[found.model].parameters < richest.parameters  # BIC would have taken another
    assert best[found.model].expected < 1.05 * min(row.expected for row in found.models)
    assert max(found.predicted.reprojection.values()) < 0.1
    # on the plane of the first view, which lies anywhere, it would have been refused
    elsewhere = predict_errors(found.observations, found.fit, level=True)
    assert max(elsewhere.reprojection.values()) > 3 * max(found.predicted.reprojection.values())


def test_a_refused_rig_is_written_on_request_and_marked(tmp_path, capsys, undrawn):
    """Points of 3 px: what comes of them is no rig to trust, but one to look at."""
    exact, grid, rng = paper_rig(), nodes()[::8], np.random.default_rng(7)
    for pose, (R, t) in poses(seed=2).items():
        world = np.column_stack([0.1 * grid, np.zeros(len(grid))]) @ R.T + t
        for name in exact:
            points = seen(exact[name], grid, world, rng, 3.0)
            write_points(tmp_path / f"{name}_{pose}.csv", points)
    text = "name: lab\nframe_rate: 20.0\ncameras:\n"
    text += "".join(f'  {name}: {{images: "{name}/*.tif"}}\n' for name in exact)
    text += "calibration:\n  target: {kind: chessboard, mesh: 0.1, shape: [9, 6]}\n"
    text += '  tilted: "{camera}_tilt_*.csv"\n  flat: "{camera}_flat.csv"\n  model: f\n'
    (tmp_path / "experiment.yaml").write_text(text)
    assert main(["-q", "calibrate", str(tmp_path / "experiment.yaml"), "--anyway"]) == 0
    printed = capsys.readouterr()
    assert "not usable: " in printed.err
    assert "REFUSED" in printed.out
    written = Rig.load(tmp_path / "rig.yaml")
    assert list(written) == list(exact)
    assert written.provenance["usable"] is False
    assert written.provenance["images"].keys() == set(written)
    assert written.provenance["problems"]


def test_images_that_were_squeezed_when_they_were_stored_have_oblong_pixels():
    rng, grid = np.random.default_rng(8), nodes()[::2]
    square = paper_rig()
    rig = Rig(
        {
            n: replace(c, fx=0.84 * c.fx, cx=0.84 * c.cx, size=(int(0.84 * c.size[0]), c.size[1]))
            for n, c in square.cameras.items()
        }
    )
    views = {name: {} for name in rig}
    for pose, (R, t) in poses(seed=4).items():
        world = np.column_stack([0.1 * grid, np.zeros(len(grid))]) @ R.T + t
        for name in rig:
            views[name][pose] = seen(rig[name], grid, world, rng, 0.05)
    found = calibrate(views, 0.1, model="paper")
    assert found.usable, found.problems
    assert worst_pixel(found.rig, rig) < 0.1
    for name in rig:
        assert found.rig[name].fy / found.rig[name].fx == pytest.approx(1 / 0.84, abs=1e-3)


@pytest.mark.parametrize("header", ["", "x,y,z,X,Y\n"])
def test_free_points_of_known_position_calibrate_from_tables(tmp_path, header):
    rig, rng = paper_rig(), np.random.default_rng(11)
    points = rng.uniform([-0.8, -0.6, -0.2], [0.8, 0.6, 0.2], (150, 3))
    views = {}
    for name in rig:
        one = seen(rig[name], np.arange(300).reshape(150, 2), points, rng, 0.02)
        place = 1e3 * points[one.node[:, 0] // 2]
        rows = np.hstack([place, one.pixel] if header else [one.pixel, place])
        lines = [("," if header else "\t").join(f"{v:.6f}" for v in row) for row in rows]
        (tmp_path / name).write_text(header + "\n".join(lines))
        views[name] = {"body": read_points(tmp_path / name, rig[name].size, unit=1e-3)}
    found = calibrate(views, Target("points", mesh=1e-3), flat="", model=MODEL)
    assert found.usable, found.problems
    assert worst_pixel(found.rig, rig) < 0.05


def test_a_table_of_free_points_that_lacks_a_column_is_refused(tmp_path):
    (tmp_path / "points.csv").write_text("x,y,X,Y\n1,2,3,4\n")
    with pytest.raises(CalibrationError, match="x,y,z,X,Y"):
        read_points(tmp_path / "points.csv", (100, 100), unit=1e-3)
