"""A lab note proposed from a folder: what names show is there, the rest is marked."""

import pytest

from wavefield.commands.cli import main
from wavefield.errors import ExperimentError
from wavefield.series import Experiment
from wavefield.series.proposal import propose


@pytest.fixture
def folder(tmp_path):
    for camera, first in (("cam1", 0), ("cam2", 0), ("cam3", 5)):
        (tmp_path / "run 07" / camera).mkdir(parents=True)
        for k in range(6):
            (tmp_path / "run 07" / camera / f"img_{first + k:04d}.tif").touch()
        (tmp_path / "run 07" / "calib" / camera).mkdir(parents=True)
        for k in range(4):
            (tmp_path / "run 07" / "calib" / camera / f"tilt_{k}.tif").touch()
        (tmp_path / "run 07" / "rest" / camera).mkdir(parents=True)
        for k in range(4):
            (tmp_path / "run 07" / "rest" / camera / f"img_{k}.tif").touch()
    (tmp_path / "run 07" / "cam2" / "img_0003.tif").unlink()
    (tmp_path / "run 07" / "probes.csv").write_text("time,p1 [mm]\n0,1\n")
    return tmp_path / "run 07"


def test_what_is_proposed_is_an_experiment_file(folder, capsys):
    assert main(["init", str(folder)]) == 0
    said = capsys.readouterr().out
    with pytest.raises(ExperimentError, match="frame_rate is empty; fill it in"):
        Experiment.load(folder / "experiment.yaml")
    text = (folder / "experiment.yaml").read_text()
    (folder / "experiment.yaml").write_text(text.replace("frame_rate:", "frame_rate: 50", 1))
    made = Experiment.load(folder / "experiment.yaml")
    assert made.water.depth is None
    assert made.name == "run-07"
    assert made.cameras["cam1"].images == "cam1/img_{frame:04d}.tif"
    assert made.cameras["cam3"].offset == -5
    assert made.calibration.tilted == "calib/{camera}/tilt_*.tif"
    assert made.probes.file == "probes.csv"
    assert made.rest == "rest/{camera}/img_{frame}.tif"
    for words in ("5 images, 0 to 5, 1 missing", "begins 5 later than another", "TO FILL IN: Hz", "p1 [mm]"):
        assert words in said
    assert main(["init", str(folder)]) == 1  # never over a file
    assert "is there already" in capsys.readouterr().err


def test_numbers_that_outgrow_their_zeros_stay_one_record(tmp_path):
    for camera in ("a", "b"):
        (tmp_path / camera).mkdir()
        for k in (8, 9, 10, 11):
            (tmp_path / camera / f"{k:02d}.png").touch()
    assert "4 images, 8 to 11" in propose(tmp_path)


def test_a_folder_without_two_cameras_is_refused_with_its_content(tmp_path):
    (tmp_path / "notes.txt").write_text("nothing")
    with pytest.raises(ExperimentError, match="there are no numbered images"):
        propose(tmp_path)
