"""How far the water goes is found before a run and stated; where it went further, the run reports it."""

from dataclasses import replace

import numpy as np
import pytest
from cube_cases import HERE

from wavefield.images import read_image, write_image
from wavefield.measurement import GridGeometry, Settings
from wavefield.measurement.images import ready
from wavefield.measurement.search_range import first_heights, high_enough
from wavefield.pipeline import check
from wavefield.rig import Rig
from wavefield.tank import Scene, Tank


@pytest.mark.parametrize("level", [0.0, 0.2, -0.15])
def test_water_is_found_however_high_it_stands(level):
    tank = Tank(Scene.load("demo"))
    images = tank.render(0)
    lower = {
        name: replace(camera, translation=camera.T - camera.R @ [0.0, 0.0, level])
        for name, camera in tank.rig.cameras.items()
    }
    geometry = GridGeometry(Rig(lower), tank.scene.grid, Settings())
    found = first_heights(
        lambda name, frame: ready(images[name], geometry.sights[name].binning), geometry, [0]
    )
    truth = tank.truth(0).z + level
    settings, found = high_enough(Settings(), found)
    assert found.found > 20
    assert found.searched[0] < truth.min() < truth.max() < found.searched[1]
    assert np.mean(found.z) == pytest.approx(level, abs=0.02)
    assert (settings.z_range is None) == (level == 0.0)
    assert f"{100 * found.searched[0]:+.3g} to {100 * found.searched[1]:+.3g} cm" in found.sentence


def test_check_counts_only_what_was_measured(own_tank):
    for path in own_tank.parent.glob("cam*/*.tif"):
        image = read_image(path)
        image[:, image.shape[1] // 2 :] = np.median(image)
        write_image(path, image)
    own_tank.write_text(own_tank.read_text() + "frames: {last: 3}\n")
    found = check(own_tank, workflow=HERE)
    assert 0.15 < found.measured < 0.7
