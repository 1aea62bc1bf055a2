"""How far the water goes is found before a run, stated, and told where it went further than was searched."""

import json
from dataclasses import replace

import numpy as np
import pytest
from cube_cases import HERE

from wavefield.commands.cli import main
from wavefield.cubes import check, run, status
from wavefield.images import read_image, write_image
from wavefield.measurement import Plan, Settings
from wavefield.measurement.first_heights import first_heights, high_enough
from wavefield.measurement.frame import ready
from wavefield.rig import Rig
from wavefield.tank import Scene, Tank
from wavefield.variables import FrameFault


def with_settings(experiment, settings, last=3):
    text = experiment.read_text() + f"frames: {{last: {last}}}\n" + f"settings: {settings}\n"
    experiment.write_text(text)
    return experiment


@pytest.mark.parametrize("level", [0.0, 0.09, 0.2, -0.15])
def test_water_is_found_however_high_it_stands(level):
    tank = Tank(Scene.load("demo"))
    images = tank.render(0)
    lower = {
        name: replace(camera, translation=camera.T - camera.R @ [0.0, 0.0, level])
        for name, camera in tank.rig.cameras.items()
    }
    plan = Plan(Rig(lower), tank.scene.grid, Settings())
    found = first_heights(lambda name, frame: ready(images[name], plan.binning[name]), plan, [0])
    truth = tank.truth(0).z + level
    settings, found = high_enough(Settings(), found)
    assert found.found > 20
    assert found.searched[0] < truth.min() < truth.max() < found.searched[1]
    assert np.mean(found.z) == pytest.approx(level, abs=0.02)
    assert (settings.z_range is None) == (level == 0.0)
    assert f"{100 * found.searched[0]:+.1f} to {100 * found.searched[1]:+.1f} cm" in found.sentence


def test_check_states_the_ranges_and_the_recipe_keeps_them(own_tank, tmp_path):
    """The cameras' frame lies .15 m below the water: outside what is searched unless said otherwise."""
    rig = Rig.load(own_tank.parent / "rig.yaml")
    lower = {n: replace(c, translation=c.T - c.R @ [0.0, 0.0, 0.15]) for n, c in rig.cameras.items()}
    Rig(lower).save(own_tank.parent / "rig.yaml")
    with_settings(own_tank, "{}")
    found = check(own_tank, workflow=HERE)
    assert "motion: " in str(found)
    assert "elevation: +1" in str(found)
    cube = tmp_path / "cube.zarr"
    run(own_tank, out=cube, workflow=HERE)
    recipe = json.loads(json.loads((cube / "zarr.json").read_text())["attributes"]["recipe"])
    low, high = recipe["settings"]["z_range"]
    assert low < 0.14 < 0.16 < high


def test_a_run_whose_water_rises_beyond_the_range_is_told(own_tank, tmp_path, capsys):
    with_settings(own_tank, "{z_range: [-0.003, 0.003]}")
    cube = tmp_path / "cube.zarr"
    run(own_tank, out=cube, workflow=HERE)
    state = status(cube)
    assert {bad.fault for bad in state.bad_frames} == {FrameFault.RANGE}
    assert "the water went further than is searched: frame" in str(state)
    assert "state wider ranges" in str(state)
    assert "copy bad frames" not in str(state)
    before = (cube / "zarr.json").stat().st_mtime_ns, (cube / "z" / "c").stat().st_mtime_ns
    assert run(own_tank, out=cube, workflow=HERE).complete  # nothing is measured again for it
    assert ((cube / "zarr.json").stat().st_mtime_ns, (cube / "z" / "c").stat().st_mtime_ns) == before
    assert main(["status", str(cube), "--json"]) in (0, 3)
    assert '"range"' in capsys.readouterr().out


def test_a_run_whose_water_moves_beyond_the_range_is_told(own_tank, tmp_path):
    with_settings(own_tank, "{piv: {search_x: [24.0, 32.0], search_y: [24.0, 32.0]}}")
    run(own_tank, out=tmp_path / "cube.zarr", workflow=HERE)
    told = {bad.camera for bad in status(tmp_path / "cube.zarr").bad_frames if bad.fault is FrameFault.RANGE}
    assert told == {"cam1", "cam2", "cam3"}


def test_check_counts_only_what_was_measured(own_tank):
    """Half of every image shows nothing: its nodes are filled, finite, and do not count."""
    for path in own_tank.parent.glob("cam*/*.tif"):
        image = read_image(path)
        image[:, image.shape[1] // 2 :] = np.median(image)
        write_image(path, image)
    found = check(with_settings(own_tank, "{}"), workflow=HERE)
    assert 0.2 < found.measured < 0.7
