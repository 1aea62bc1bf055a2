import numpy as np
import pytest

from wavefield.commands.cli import main
from wavefield.errors import ExperimentError
from wavefield.images import write_image
from wavefield.quality.remarks import remark_on_rest
from wavefield.rig import Rig
from wavefield.series import Experiment
from wavefield.tank import Scene, Tank

SUNK = 0.002  # m by which the target lay below the water
REST = 'rest: "rest/{camera}_{frame:02d}.tif"\n'


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """Still water seen by a rig that takes the water for 2 mm higher than it is."""
    folder = tmp_path_factory.mktemp("rest")
    tank = Tank(Scene.load("rest").with_(rig={"crop": 0.2}))
    tank.rig.moved(np.eye(3), (0.0, 0.0, -SUNK)).save(folder / "rig.yaml")
    for frame in range(2):
        for name, image in tank.render(frame).items():
            write_image(folder / "rest" / f"{name}_{frame:02d}.tif", image)
    path = folder / "experiment.yaml"
    cameras = "".join(f'  {name}: "{name}/{{frame}}.tif"\n' for name in tank.rig)
    grid = "grid: {x: [-0.1, 0.1], y: [-0.08, 0.08], step: 0.01}\n"
    path.write_text(f"name: lab\nframe_rate: 20\nrig: rig.yaml\n{REST}cameras:\n{cameras}{grid}")
    return path


def test_the_record_at_rest_levels_the_rig(lab, capsys):
    before = Rig.load(lab.with_name("rig.yaml"))
    assert main(["-q", "refine", str(lab), "-o", str(lab.with_name("level.yaml")), "--frames", "2"]) == 0
    assert "The water's plane: +1.9" in capsys.readouterr().out
    rig = Rig.load(lab.with_name("level.yaml"))
    rise = rig["cam3"].centre[2] - before["cam3"].centre[2]
    assert rise == pytest.approx(-SUNK, abs=3e-4)
    assert rig.provenance["levelled"]["height_m"] == pytest.approx(SUNK, abs=3e-4)
    remark = remark_on_rest(Experiment.load(lab), rig)
    assert (remark.kind, remark.weight) == ("water level", "note")
    assert "z = 0 is the water at rest" in str(remark)


def test_what_is_not_levelled_is_asked_for(lab, tmp_path):
    rig, experiment = Rig.load(lab.with_name("rig.yaml")), Experiment.load(lab)
    named = remark_on_rest(experiment, rig)
    assert (named.kind, named.weight) == ("water level", "remark")
    assert "Run `wavefield calibrate experiment.yaml` again" in str(named)
    plain = tmp_path / "experiment.yaml"
    plain.write_text(lab.read_text().replace(REST, ""))
    absent = remark_on_rest(Experiment.load(plain), rig)
    assert (absent.kind, absent.weight) == ("water level", "note")
    assert "name them with the key `rest`" in str(absent)
    assert "0.44 mm" in remark_on_rest(Experiment.load(plain), rig, 0.00044).means
    with pytest.raises(ExperimentError, match="names no record at rest"):
        Experiment.load(plain).at_rest()


@pytest.mark.parametrize(
    ("rest", "expected"),
    [
        ("rest/*.tif", "does not contain {camera}"),
        ("{cam1: a/*.tif, cam2: b/*.tif}", "rest names no images of cam3"),
    ],
)
def test_mistakes_in_it_are_named(lab, tmp_path, rest, expected):
    path = tmp_path / "experiment.yaml"
    path.write_text(lab.read_text().replace(REST, f"rest: {rest}\n"))
    with pytest.raises(ExperimentError) as caught:
        Experiment.load(path).at_rest()
    assert expected in str(caught.value)
