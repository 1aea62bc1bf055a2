"""Which target image is which pose."""

import random

import numpy as np
import pytest
import yaml

from wavefield.calibration.target import Target
from wavefield.errors import CalibrationError
from wavefield.images import write_image
from wavefield.series import Experiment, listing


def note(folder, tilted, flat=None):
    section = {"target": {"kind": "dots", "mesh": 0.01}, "tilted": tilted} | ({"flat": flat} if flat else {})
    cameras = {name: {"images": f"{name}/img_{{frame:05d}}.tif"} for name in ("cam1", "cam2")}
    data = {"name": "plates", "frame_rate": 10.0, "cameras": cameras, "calibration": section}
    (folder / "experiment.yaml").write_text(yaml.safe_dump(data))
    return Experiment.load(folder / "experiment.yaml")


def find_views(experiment):
    return listing.find_views(
        experiment.calibration, experiment.cameras, experiment.image_folder, experiment.path
    )


def touch(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    return path


PATTERNS = (
    "{camera}/*.tif",
    "{camera}/*mm.tif",
    "{camera}_*mm.tif",
    "{camera}*.tif",
    "plate_*mm_{camera}.tif",
    "*/{camera}.tif",
    "{camera}/z_*/board.tif",
    "{camera}/*/*.tif",
)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_every_height_of_a_traversed_plate_is_a_pose_of_its_own(tmp_path, pattern):
    draw = random.Random(0)
    heights = {sign * draw.choice((1, 2, 3, 10, 1.5)) for sign in (-1, 1) for _ in range(4)} | {-3, 3, 0}
    for height in heights:
        for camera in ("cam1", "cam2"):
            name = pattern.replace("*mm", "*").replace("*", f"{height:g}mm")
            touch(tmp_path / name.replace("{camera}", camera))
    views = find_views(note(tmp_path, pattern))
    assert set(views["cam1"]) == set(views["cam2"])
    assert len(set(views["cam1"].values())) == len(heights)
    for pose, path in views["cam1"].items():
        assert ("-" in pose) == ("-" in path.relative_to(tmp_path).as_posix())


def test_two_files_of_one_pose_are_refused_by_name(tmp_path):
    for folder in ("monday", "tuesday"):
        for camera in ("cam1", "cam2"):
            touch(tmp_path / folder / camera / "tilt_1.tif")
    patterns = ["monday/{camera}/tilt_*.tif", "tuesday/{camera}/tilt_*.tif"]
    with pytest.raises(CalibrationError, match=r"both .*monday.*tilt_1\.tif and .*tuesday.*tilt_1\.tif"):
        find_views(note(tmp_path, patterns))
    for camera in ("cam1", "cam2"):
        touch(tmp_path / camera / "1.tif")
        touch(tmp_path / camera / "1.png")
    with pytest.raises(CalibrationError, match=r"1\.png and .*1\.tif.*'1'"):
        find_views(note(tmp_path, "{camera}/*.*"))


def test_a_file_that_two_patterns_name_is_one_pose(tmp_path):
    for height in (-3, 3):
        for camera in ("cam1", "cam2"):
            touch(tmp_path / camera / f"plate_{height}.tif")
    views = find_views(note(tmp_path, ["{camera}/plate_*.tif", "{camera}/plate_-*.tif"]))
    assert sorted(views["cam1"]) == ["plate_-3", "plate_3"]


def test_a_table_of_points_without_a_size_takes_it_from_the_images(tmp_path):
    from wavefield.calibration.target_images import _find_in_file, _frame_sizes

    target = Target("strings", 0.1)
    table = tmp_path / "cam1_pose1.csv"
    table.write_text("i,j,X,Y\n0,0,3.0,4.0\n0,1,13.0,4.0\n")
    assert "no images of its camera" in _find_in_file(table, target)
    for camera in ("cam1", "cam2"):
        for k in range(2):
            write_image(tmp_path / camera / f"img_{k:05d}.tif", np.eye(30, 48, dtype=np.uint8) * 90)
    sizes = _frame_sizes(note(tmp_path, "{camera}_*.csv"))
    assert sizes == {"cam1": (48, 30), "cam2": (48, 30)}
    assert _find_in_file(table, target, sizes["cam1"]).size == (48, 30)


def test_a_camera_name_in_the_pattern_is_no_part_of_the_pose(tmp_path):
    for camera in ("cam1", "cam2"):
        for pose in ("1", "2", "_10"):
            touch(tmp_path / camera / f"{camera}{pose}.tif")
    views = find_views(note(tmp_path, "{camera}/{camera}*.tif"))
    assert set(views["cam1"]) == set(views["cam2"]) == {"1", "2", "10"}


def test_files_that_begin_with_another_name_keep_their_poses(tmp_path):
    for camera in ("cam1", "cam2"):
        for pose in ("cam10", "cam11"):
            touch(tmp_path / camera / f"{pose}.tif")
    assert set(find_views(note(tmp_path, "{camera}/*.tif"))["cam1"]) == {"cam10", "cam11"}


@pytest.mark.parametrize(
    "pattern", ["{camera}_[0-9][0-9].tif", "{camera}_[!a]?.tif", "[0-9][0-9]_{camera}.tif"]
)
def test_brackets_stand_for_one_character_of_the_pose(tmp_path, pattern):
    name = "{n:02d}_{c}.tif" if pattern.startswith("[") else "{c}_{n:02d}.tif"
    for camera in ("cam1", "cam2"):
        for n in range(3):
            touch(tmp_path / name.format(n=n, c=camera))
        touch(tmp_path / f"{camera}_ab.tif")
    views = find_views(note(tmp_path, pattern))
    assert set(views["cam1"]) == set(views["cam2"]) == {"00", "01", "02"}
