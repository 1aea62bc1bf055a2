"""Other people's targets: moved along z, of two levels, in tables."""

from dataclasses import replace

import numpy as np
import pytest
from rendering import write_points
from solve_cases import nodes, poses

from wavefield.calibration import Target, calibrate
from wavefield.calibration.points import TargetPoints, read_points
from wavefield.calibration.target_images import placed_at
from wavefield.commands.cli import main
from wavefield.errors import CalibrationError
from wavefield.rig import Rig
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
        world = np.column_stack([0.1 * grid, np.full(len(grid), height)])
        for name in rig:
            points = placed_at(seen(rig[name], grid, world, rng, 0.02), height)
            write_points(tmp_path / f"{name}{height}.csv", points)
            views[name][f"at {height}"] = read_points(tmp_path / f"{name}{height}.csv")
    found = calibrate(views, 0.1, flat="", model=MODEL)
    assert found.usable, found.problems
    assert worst_pixel(found.rig, rig) < 0.01
    flat = {n: {p: replace(v, z=None, placed=False) for p, v in views[n].items()} for n in views}
    assert any("moved along z" in p for p in calibrate(flat, 0.1, flat="", model=MODEL).problems)


def test_nodes_of_two_levels_are_where_they_are():
    rig, grid, rng = paper_rig(), nodes(), np.random.default_rng(5)
    level = np.where(grid[:, 1] % 2, -0.02, 0.0)
    views = {name: {} for name in rig}
    for pose, (R, t) in poses(seed=2).items():
        world = np.column_stack([0.1 * grid, level]) @ R.T + t
        for name in rig:
            views[name][pose] = seen(rig[name], grid, world, rng, 0.02, z=level)
    found = calibrate(views, 0.1, model=MODEL)
    assert found.usable, found.problems
    assert worst_pixel(found.rig, rig) < 0.02
    assert found.fit.scale == pytest.approx(1.0, abs=0.05)


def test_a_refused_rig_is_written_on_request_and_marked(tmp_path, capsys, undrawn):
    exact, grid, rng = paper_rig(), nodes()[::8], np.random.default_rng(7)
    for pose, (R, t) in poses(seed=2).items():
        world = np.column_stack([0.1 * grid, np.zeros(len(grid))]) @ R.T + t
        for name in exact:
            points = seen(exact[name], grid, world, rng, 3.0)
            write_points(tmp_path / f"{name}_{pose}.csv", points)
    text = "name: lab\nframe_rate: 20.0\ncameras:\n"
    text += "".join(f'  {name}: {{images: "{name}/{{frame}}.tif"}}\n' for name in exact)
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


def test_free_points_of_known_position_calibrate_from_tables(tmp_path):
    rig, rng = paper_rig(), np.random.default_rng(11)
    points = rng.uniform([-0.8, -0.6, -0.2], [0.8, 0.6, 0.2], (150, 3))
    views = {}
    for name in rig:
        one = seen(rig[name], np.arange(300).reshape(150, 2), points, rng, 0.02)
        place = 1e3 * points[one.node[:, 0] // 2]
        lines = [",".join(f"{v:.6f}" for v in row) for row in np.hstack([place, one.pixel])]
        (tmp_path / name).write_text("x,y,z,X,Y\n" + "\n".join(lines))
        views[name] = {"body": read_points(tmp_path / name, rig[name].size, unit=1e-3)}
    found = calibrate(views, Target("points", mesh=1e-3), flat="", model=MODEL)
    assert found.usable, found.problems
    assert worst_pixel(found.rig, rig) < 0.05


def test_a_table_of_free_points_that_lacks_a_column_is_refused(tmp_path):
    (tmp_path / "points.csv").write_text("x,y,X,Y\n1,2,3,4\n")
    with pytest.raises(CalibrationError, match="x,y,z,X,Y"):
        read_points(tmp_path / "points.csv", (100, 100), unit=1e-3)
