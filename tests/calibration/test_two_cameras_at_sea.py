"""Two cameras and natural texture: elevation from a run's own path, and what helps where images are poor."""

import numpy as np
import pytest
from sea_pictures import photograph, sea_rig, texture, waves

from wavefield.commands.cli import main
from wavefield.errors import ExperimentError
from wavefield.images import write_image
from wavefield.measurement.settings import Settings
from wavefield.pipeline.assess import fraction_measured
from wavefield.pipeline.chunk import make_chunk, measure_chunk
from wavefield.pipeline.prepare import prepare
from wavefield.rig import Rig
from wavefield.rig.field import pixel_size
from wavefield.tank import Scene, Tank, simulate
from wavefield.variables import Quality

PHASE = 0.02  # from frame to frame


def at_sea(folder, noise):
    cameras, grains = sea_rig(), texture()
    folder.mkdir()
    Rig(cameras).save(folder / "rig.yaml")
    for k in range(4):
        for n, (name, camera) in enumerate(cameras.items()):
            write_image(folder / f"{name}_{k}.png", photograph(camera, grains, PHASE * k, 10 * k + n, noise))
    text = "name: sea\nframe_rate: 10.0\nrig: rig.yaml\ncameras:\n"
    text += "".join(f'  {name}: {{images: "{name}_{{frame}}.png"}}\n' for name in cameras)
    (folder / "experiment.yaml").write_text(text)
    return prepare(folder / "experiment.yaml")


def measured(prepared):
    return measure_chunk(make_chunk(prepared.series, 1, 2), prepared.geometry, 10.0).fields


@pytest.mark.slow
def test_the_elevation_of_a_sea_of_natural_texture(tmp_path):
    sea = at_sea(tmp_path / "sea", 1.5)
    fields = measured(sea)
    x, y = np.meshgrid(sea.grid.x_nodes, sea.grid.y_nodes)
    true = 0.5 * (waves(x, y, PHASE) + waves(x, y, 2 * PHASE))
    inside = np.zeros(true.shape, bool)
    inside[2:-2, 2:-2] = True
    inside &= (fields["quality"][0] & Quality.MEASURED) != 0
    error = (fields["z"][0] - true)[inside] / pixel_size(sea.rig, sea.grid)
    assert fraction_measured(fields["quality"]) > 0.98
    assert np.sqrt(np.mean(error**2)) < 0.1


def test_presets_are_named_where_another_is_asked_for():
    with pytest.raises(ExperimentError, match=r"one of floating, sheet, texture, not 'best'"):
        Settings.from_dict({"preset": "best"})
    assert Settings.from_dict({"preset": "floating"}) == Settings()
    assert Settings.from_dict({"preset": "texture", "stereo": {"window": 40.0}}).stereo.min_correlation == 0.3


def test_small_images_are_reported_as_too_small_for_a_search_of_elevations():
    from wavefield.measurement.search_range import FirstHeights

    assert "too small to find its range" in FirstHeights((0.0, 0.0), 0, 0, (-0.05, 0.05)).sentence


def test_an_open_sea_is_measured_from_lenses_and_a_baseline_alone(tmp_path, capsys):
    scene = Scene.load("sea").with_(
        frames=2, rig={"focal": 300.0, "size": (320, 240)}, sea={"shortest": 2.0}, seed=3
    )
    experiment = simulate(scene, tmp_path / "sea", workers=1)
    true, found = Tank(scene), tmp_path / "rig.yaml"
    assert main(["-q", "rig", "level", str(experiment), "--distance", "2.5", "-o", str(found)]) == 0
    assert "the horizon in left, right gives the vertical" in capsys.readouterr().out
    prepared = prepare(experiment, Rig.load(found))
    fields = measure_chunk(make_chunk(prepared.series, 0, 1), prepared.geometry, scene.frame_rate).fields
    places = [prepared.rig["left"], true.rig["left"]]  # both frames have z up: they differ by a turn
    turn, back = (np.arctan2(*place.R[0, 1::-1]) for place in places)
    c, s = np.cos(back - turn), np.sin(back - turn)
    x, y = np.meshgrid(prepared.grid.x_nodes, prepared.grid.y_nodes)
    x, y = x - places[0].centre[0], y - places[0].centre[1]
    at = c * x - s * y + places[1].centre[0], s * x + c * y + places[1].centre[1]
    error = fields["z"][0] - true.sea.at(*at, scene.start + 0.5 / scene.frame_rate, ("z",))["z"]
    measured = (fields["quality"][0] & Quality.MEASURED) != 0
    assert measured.mean() > 0.7
    assert np.std(error[measured]) < 0.5 * pixel_size(prepared.rig, prepared.grid)
