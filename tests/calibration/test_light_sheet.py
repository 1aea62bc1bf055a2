"""A light sheet: where it lies, from its particles, and three components in it."""

from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from wavefield.calibration.light_sheet import fit_sheet
from wavefield.commands.cli import cli
from wavefield.errors import CalibrationError, ExperimentError
from wavefield.measurement import GridGeometry, Settings, measure
from wavefield.rig import Rig
from wavefield.series import Experiment
from wavefield.tank import Scene, Tank, simulate
from wavefield.variables import Quality

PIXEL = 2e-4
FRAMES = 6
BESIDE = {"kind": "sheet", "height": 0.002, "tilt": [0.8, -0.5]}
SMALL = {"size": [480, 360]}
GRID = {"x": (-0.04, 0.04), "y": (-0.03, 0.03), "step": 0.002}


def scene(**changes):
    return Scene.load("sheet").with_(**({"frames": FRAMES, "seed": 4, "rig": SMALL, "grid": GRID} | changes))


@pytest.fixture(scope="module")
def beside():
    """A tank whose sheet lies beside the target's plane, its images, and what was found of it."""
    tank = Tank(scene(surface=BESIDE))
    images = [tank.render(k) for k in range(FRAMES)]
    return tank, images, fit_sheet(lambda name, k: images[k][name], range(FRAMES), tank.rig)


def velocities(tank, images, rig):
    settings = Settings.from_dict({"preset": "sheet", "sheet_thickness": 1e-3})
    frames = {name: [None, *(image[name] for image in images), None] for name in rig}
    cube = measure(frames, GridGeometry(rig, tank.scene.grid, settings), tank.scene.frame_rate)
    measured = (cube["quality"] & Quality.MEASURED) != 0
    truth = [tank.truth(step) for step in range(1, len(images) - 2)]
    scale = 1.0 / tank.scene.frame_rate / PIXEL
    errors = {n: (cube[n] - [getattr(t, n) for t in truth])[measured] * scale for n in ("u", "v", "w")}
    return cube, measured, errors, scale


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def test_the_plane_of_a_sheet_is_found_from_its_particles(beside):
    _, _, found = beside
    assert found.height == pytest.approx(0.002, abs=2e-5)
    assert np.degrees(np.arctan(found.slope)) == pytest.approx((0.8, -0.5), abs=0.05)
    assert found.disparity_before > 10
    assert found.disparity < 0.3
    assert "no camera has moved" in found.sentence


def test_three_components_are_measured_in_the_sheet_that_was_found(beside):
    tank, images, found = beside
    cube, measured, errors, scale = velocities(tank, images, found.rig)
    assert measured.mean() > 0.98
    assert rms(errors["u"]) < 0.1
    assert rms(errors["v"]) < 0.1
    assert rms(errors["w"]) < 0.2
    for name, error in errors.items():
        std = cube[f"{name}_std"][measured] * scale
        assert 0.6 < np.mean(np.abs(error) < std) < 0.9
        assert np.mean(np.abs(error) < 2 * std) > 0.88
    assert not cube["z"].any()
    np.testing.assert_allclose(cube["z_std"], 2.5e-4)
    assert np.isnan(cube["eps_y"]).all()


def test_with_the_rig_of_the_target_the_cameras_are_inconsistent_and_nodes_are_rejected(beside):
    tank, images, _ = beside
    cube, measured, *_ = velocities(tank, images, tank.rig)
    assert measured.mean() < 0.5
    assert ((cube["quality"] & Quality.REJECTED_EPS) != 0)[~measured].mean() > 0.9


def test_a_camera_that_moved_is_named_and_corrected():
    tank = Tank(
        scene(surface=BESIDE, rig=SMALL | {"cameras": 3}, faults={"cam1": {"turned": [0.05, 0.03, 0.0]}})
    )
    images = [tank.render(k) for k in range(3)]
    found = fit_sheet(lambda name, k: images[k][name], range(3), tank.rig)
    assert found.check.moved == "cam1"
    assert "cam1 had moved" in found.sentence
    assert "is corrected" in found.sentence
    x, y = np.meshgrid(tank.scene.grid.x_nodes, tank.scene.grid.y_nodes)
    exact = sheet_points(tank, x, y)
    for name in ("cam2", "cam3"):  # which were not knocked
        here, there = (
            np.stack(p) for p in (found.rig[name].project(x, y, 0.0), tank.rig[name].project(*exact))
        )
        assert rms(here - there) < 0.3


@pytest.mark.slow
def test_of_two_cameras_a_motion_is_corrected_and_the_ambiguity_of_positions_is_stated():
    from wavefield.quality.remarks import remark_on_rest

    tank = Tank(scene(surface=BESIDE, faults={"cam1": {"turned": [0.05, 0.03, 0.0]}}))
    images = [tank.render(k) for k in range(3)]
    found = fit_sheet(lambda name, k: images[k][name], range(3), tank.rig)
    assert found.check.faulty_cameras == ("cam1", "cam2")
    assert found.disparity < 0.3
    x, y = np.meshgrid(tank.scene.grid.x_nodes, tank.scene.grid.y_nodes)
    exact = sheet_points(tank, x, y)
    seen = np.stack(tank.rig["cam2"].unproject(*found.rig["cam2"].project(x, y, 0.0), exact[2]))
    beside = np.mean(seen - exact[:2], axis=(1, 2))  # cam2 was not knocked
    assert 1e-4 < np.hypot(*beside) < found.position_ambiguity < 2e-3
    assert f"may be shifted by some {1e3 * found.position_ambiguity:.1f} mm" in found.sentence
    printed = remark_on_rest(SimpleNamespace(settings={"sheet_thickness": 1e-3}), found.rig)
    assert printed.weight == "remark"
    assert f"wrong by {1e3 * found.position_ambiguity:.1f} mm" in str(printed)


def sheet_points(tank, x, y):
    from wavefield.tank.light_sheet_scene import plane

    axes, origin = plane(tank.scene.surface)
    return np.einsum("ij,jyx->iyx", axes, np.stack([x, y, 0 * x])) + origin[:, None, None]


def test_images_that_show_nothing_in_common_are_refused():
    tank = Tank(scene())
    images = [tank.render(k) for k in range(4)]
    mixed = {"cam1": lambda k: images[k]["cam1"], "cam2": lambda k: images[k]["cam1"][::-1, ::-1]}
    with pytest.raises(CalibrationError, match="windows of 4 instants show the same particles"):
        fit_sheet(lambda name, k: mixed[name](k), range(4), tank.rig)


def test_command_finds_the_sheet_of_an_experiment(tmp_path):
    folder = tmp_path / "sheet"
    simulate(scene(surface=BESIDE, frames=3, calibration={"tilted": 0}), folder)
    command = [
        "-q",
        "rig",
        "sheet",
        str(folder / "experiment.yaml"),
        "--rig",
        str(folder / "truth" / "rig.yaml"),
    ]
    result = CliRunner().invoke(cli, [*command, "-o", str(folder / "sheet.yaml")], catch_exceptions=False)
    assert result.exit_code == 0
    assert "light sheet: +2.0" in result.output
    rig = Rig.load(folder / "sheet.yaml")
    assert rig.provenance["light_sheet"]["height_m"] == pytest.approx(0.002, abs=3e-5)

    from wavefield.quality.remarks import remark_on_rest

    experiment = Experiment.load(folder / "experiment.yaml")
    assert "the middle of the light sheet" in str(remark_on_rest(experiment, rig))
    assert "wavefield rig sheet" in str(remark_on_rest(experiment, Rig(rig.cameras)))


def test_settings_that_do_not_fit_a_sheet_are_refused():
    with pytest.raises(ExperimentError, match="sheet_thickness"):
        Settings.from_dict({"sheet_thickness": 0.0})
