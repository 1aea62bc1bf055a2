"""A lab note proposed from a folder: what names show is there, the rest is marked."""

import itertools
import re

import pytest
import yaml

from wavefield.commands.cli import main
from wavefield.errors import ExperimentError
from wavefield.series import Experiment
from wavefield.series.proposal import camera_names, find_series, propose


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
    return tmp_path / "run 07"


def test_what_is_proposed_is_an_experiment_file(folder, capsys):
    assert main(["init", str(folder)]) == 0
    printed = capsys.readouterr().out
    note = folder / "experiment.yaml"
    assert printed.endswith(f"then: wavefield check '{note}'\n")
    with pytest.raises(ExperimentError, match="frame_rate is empty; fill it in"):
        Experiment.load(note)
    note.write_text(note.read_text().replace("frame_rate:", "frame_rate: 50", 1))
    made = Experiment.load(note)
    assert made.water.depth is None
    assert made.name == "run-07"
    assert {name: one.images for name, one in made.cameras.items()} == {
        f"cam{k}": f"cam{k}/img_{{frame:04d}}.tif" for k in (1, 2, 3)
    }
    assert made.cameras["cam3"].offset == -5
    for words in (
        "5 images, 0 to 5",
        "6 images, 5 to 10",
        "TO FILL IN: Hz",
        "24 images are not of waves, by their names",
    ):
        assert words in printed
    assert main(["init", str(folder)]) == 1  # never over a file
    assert "is there already" in capsys.readouterr().err


def test_the_lines_to_complete_are_those_of_an_experiment_file(folder):
    text = propose(folder).replace("frame_rate:", "frame_rate: 50", 1)
    complete = re.sub(r"(?m)^# (?=( |calibration|rig|rest|probes))", "", text)
    (folder / "experiment.yaml").write_text(complete)
    made = Experiment.load(folder / "experiment.yaml")
    assert made.calibration.flat == "calib/{camera}/flat.tif"
    assert made.rest == "rest/{camera}/img_{frame:05d}.tif"
    assert made.probes.file == "probes.csv"


def test_names_with_a_time_and_a_number_are_proposed_as_one_camera_each(tmp_path):
    for camera in ("flir1", "flir2"):
        (tmp_path / camera).mkdir()
        for k in range(12):
            (tmp_path / camera / f"run-05032024{101138 + k // 4}-{k}.tif").touch()
    cameras = yaml.safe_load(propose(tmp_path))["cameras"]
    assert [one["images"] for one in cameras.values()] == [f"flir{k}/run-*-{{frame}}.tif" for k in (1, 2)]


def test_a_folder_without_two_cameras_is_refused_with_its_content(tmp_path):
    (tmp_path / "notes.txt").write_text("nothing")
    with pytest.raises(ExperimentError, match="there are no numbered images"):
        propose(tmp_path)


@pytest.mark.parametrize("digits", ["{:d}", "{:03d}", "{:06d}"])
@pytest.mark.parametrize("layout", ["{cam}/img_{n}.tif", "run 3/{cam}/{n}.tif", "{cam}/frame_{n}_800us.tif"])
@pytest.mark.parametrize("cameras", [("cam1", "cam2", "cam3"), ("left", "right"), ("Camera_1", "Camera_2")])
def test_frames_and_cameras_are_found_in_a_folder_of_each_camera(layout, cameras, digits):
    numbers = range(7, 19)
    paths = [layout.format(cam=c, n=digits.format(n)) for c, n in itertools.product(cameras, numbers)]
    found = find_series(sorted(paths))
    assert [one.numbers for one in found] == [tuple(numbers)] * len(cameras)
    assert camera_names([one.pattern for one in found]) == sorted(cameras)
    both = find_series([f"{n}_{c}.tif" for c in ("top", "side") for n in numbers])
    assert camera_names([one.pattern for one in both]) == ["cam1", "cam2"]


def test_linked_folders_are_searched_and_a_link_to_its_own_parent_ends_nothing(tmp_path):
    for camera in ("left", "right"):
        (tmp_path / "disk" / camera).mkdir(parents=True)
        for k in range(4):
            (tmp_path / "disk" / camera / f"{k:03d}.png").touch()
    run = tmp_path / "run"
    run.mkdir()
    for camera in ("left", "right"):
        (run / camera).symlink_to(tmp_path / "disk" / camera)
    (run / "again").symlink_to(run)
    assert sorted(yaml.safe_load(propose(run))["cameras"]) == ["left", "right"]
