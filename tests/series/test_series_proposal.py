"""A lab note proposed from a folder: what names show is there, the rest is marked."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from wavefield.commands.cli import main
from wavefield.errors import ExperimentError
from wavefield.rig import Rig
from wavefield.series import Experiment
from wavefield.series.proposal import camera_names, find_series, propose
from wavefield.tank.rigs import platform_rig


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
    (tmp_path / "run 07" / "probes.csv").write_text("time,p1\n0,0.01\n1,0\n")
    return tmp_path / "run 07"


def test_what_is_proposed_is_an_experiment_file(folder, capsys):
    assert main(["init", str(folder)]) == 0
    printed = capsys.readouterr().out
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
    for words in (
        "5 images, 0 to 5, 1 missing",
        "begins 5 later than another",
        "TO FILL IN: Hz",
        "p1: [x, y]",
    ):
        assert words in printed
    assert main(["init", str(folder)]) == 1  # never over a file
    assert "is there already" in capsys.readouterr().err


def test_numbers_that_outgrow_their_zeros_stay_one_record(tmp_path):
    for camera in ("a", "b"):
        (tmp_path / camera).mkdir()
        for k in (8, 9, 10, 11):
            (tmp_path / camera / f"{k:02d}.png").touch()
    assert "4 images, 8 to 11" in propose(tmp_path)


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


LAYOUTS = (
    "{cam}/img_{n}.tif",
    "{cam}/{n}.tif",
    "img_{n}_{cam}.tif",
    "{cam}_{n}.tif",
    "2024-05-17/frame{n}-{cam}.tif",
    "{cam}/frame_{n}_800us.tif",
)
CAMERAS = (("cam1", "cam2", "cam3"), ("left", "right"), ("camA", "camB"), ("Camera_1", "Camera_2"))


@settings(max_examples=60)
@given(
    st.sampled_from(LAYOUTS),
    st.sampled_from(CAMERAS),
    st.sampled_from(["{:d}", "{:03d}", "{:06d}"]),
    st.integers(0, 1200),
    st.integers(4, 15),
)
def test_frames_and_cameras_are_found_wherever_they_are_in_names(layout, cameras, digits, first, count):
    numbers = range(first, first + count)
    paths = [layout.format(cam=c, n=digits.format(n)) for c, n in itertools.product(cameras, numbers)]
    found = find_series(sorted(paths))
    assert [one.numbers for one in found] == [tuple(numbers)] * len(cameras)
    names = camera_names([one.pattern for one in found])
    assert [name.replace("-", "_") for name in names] == sorted(cameras)


def test_a_folder_of_a_laboratory_is_proposed_with_its_own_names(tmp_path):
    for camera in ("left", "right"):
        for folder, names in (
            (camera, [f"img_{k:05d}.tif" for k in range(6)]),
            (f"calib/{camera}", ["flat.tif", *(f"tilt_{k}.tif" for k in range(4))]),
        ):
            (tmp_path / folder).mkdir(parents=True)
            for name in names:
                (tmp_path / folder / name).touch()
    (tmp_path / "readme.txt").write_text("first day")
    (tmp_path / "aaa.csv").write_text("pump,on\n1,2\n")
    (tmp_path / "wave_gauges.csv").write_text("time,WG1\n0.00,0.012\n0.01,0.013\n")
    note = yaml.safe_load(propose(tmp_path))
    assert set(note["cameras"]) == {"left", "right"}
    assert note["calibration"]["tilted"] == "calib/{camera}/tilt_*.tif"
    assert note["calibration"]["flat"] == "calib/{camera}/flat.tif"
    assert note["probes"] == "wave_gauges.csv"


def test_a_proposal_points_to_the_calibration_where_there_are_target_images(folder, capsys):
    assert main(["init", str(folder)]) == 0
    assert capsys.readouterr().out.endswith(f"then: wavefield calibrate '{folder / 'experiment.yaml'}'\n")


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


def test_lenses_beside_the_images_are_proposed_as_the_rig(tmp_path):
    rig = platform_rig(12.0, 2.5, 20.0, 750.0, (80, 60))
    for camera in rig:
        (tmp_path / camera).mkdir()
        for k in range(4):
            (tmp_path / camera / f"{k:02d}.png").touch()
    assert "\nrig:" not in propose(tmp_path)
    lenses = {n: replace(c, rotation=np.eye(3), translation=np.zeros(3)) for n, c in rig.cameras.items()}
    Rig(lenses).save(tmp_path / "lenses.yaml")
    proposed = yaml.safe_load(propose(tmp_path).replace("frame_rate:", "frame_rate: 4", 1))
    assert proposed["rig"] == "lenses.yaml"
    assert proposed["settings"] == {"preset": "texture"}
    rig.save(tmp_path / "rig.yaml")
    proposed = yaml.safe_load(propose(tmp_path))
    assert proposed["rig"] == "rig.yaml"
    assert "settings" not in proposed
