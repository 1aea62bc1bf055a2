"""An open sea measured by two cameras of which only the lenses and their distance are known."""

import numpy as np

from wavefield.commands.cli import main
from wavefield.measurement.search_range import FirstHeights
from wavefield.pipeline.chunk import make_chunk, measure_chunk
from wavefield.pipeline.prepare import prepare
from wavefield.quality.remarks import remark_on_rest
from wavefield.rig import Rig
from wavefield.rig.field import pixel_size
from wavefield.series import Experiment
from wavefield.tank import Scene, Tank, simulate
from wavefield.variables import Quality


def test_an_open_sea_is_measured_from_lenses_and_a_baseline_alone(tmp_path, capsys):
    scene = Scene.load("sea").with_(
        frames=2, rig={"focal": 300.0, "size": (320, 240)}, sea={"shortest": 2.0}, seed=3
    )
    experiment = simulate(scene, tmp_path / "sea", workers=1)
    true, found = Tank(scene), tmp_path / "rig.yaml"
    command = ["-q", "rig", "level", str(experiment), "-o", str(found)]
    assert main(command) == 1
    assert "state the distance between them" in capsys.readouterr().err
    assert main([*command, "--distance", "2.5"]) == 0
    assert "the horizon in left, right gives the vertical" in capsys.readouterr().out
    remark = remark_on_rest(Experiment.load(experiment), Rig.load(found))
    assert remark.means == "z = 0 is the mean surface of moving water"
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


def test_small_images_are_reported_as_too_small_for_a_search_of_elevations():
    assert "too small to find its range" in FirstHeights((0.0, 0.0), 0, 0, (-0.05, 0.05)).sentence
