"""Every frame at its place in time, whatever holds it and whatever is missing."""

import re

import numpy as np
import pytest
import tifffile
import zarr
from series_cases import number_image, write_experiment, write_frames

from wavefield.errors import ExperimentError
from wavefield.series import Experiment
from wavefield.series.listing import number_frames
from wavefield.series.readers import close_files
from wavefield.variables import FrameFault


@pytest.fixture(autouse=True)
def _no_open_files():
    yield
    close_files()


def open_frames(tmp_path, cameras, rest=""):
    return Experiment.load(write_experiment(tmp_path, cameras, rest)).open_frames()


def numbers_read(series):
    """Frame number -> the number that the image at that place contains."""
    frames = [series.read(i) for i in range(len(series))]
    return {series.first + i: int(f.image[0, 0]) for i, f in enumerate(frames) if f.image is not None}


@pytest.mark.parametrize("images", ["img_{frame:05d}.tif", "img_{frame}.tif", "*_{frame}.tif"])
def test_a_missing_file_does_not_shift_the_rest(tmp_path, images):
    there = [3, 4, 7, 8, 12]
    write_frames(tmp_path / "cam1", there)
    series = open_frames(tmp_path, f'cam1: "{{camera}}/{images}"')["cam1"]
    assert numbers_read(series) == {n: n for n in there}
    assert list(series.missing) == [5, 6, 9, 10, 11]
    assert series.read(2).fault is FrameFault.MISSING
    assert "cam1 frame 5 is missing" in series.read(2).message


def test_cameras_share_one_range_of_frames(tmp_path):
    write_frames(tmp_path / "a", range(2, 7))
    write_frames(tmp_path / "b", [4, 6, 7, 8])
    series = open_frames(tmp_path, "cam1: a/img_{frame}.tif\ncam2: b/img_{frame}.tif")
    assert {(s.first, len(s)) for s in series.values()} == {(4, 3)}  # what all have seen
    assert [s.beyond for s in series.values()] == [(2, 0), (0, 2)]
    assert [list(s.missing) for s in series.values()] == [[], [5]]
    stated = open_frames(
        tmp_path, "cam1: a/img_{frame}.tif\ncam2: b/img_{frame}.tif", "frames: {first: 2, last: 8}\n"
    )
    assert [list(s.missing) for s in stated.values()] == [[7, 8], [2, 3, 5]]
    write_frames(tmp_path / "c", range(102, 107))
    with pytest.raises(ExperimentError, match=r"share no two frames \(frames of cam1 2 to 6, cam2 102"):
        open_frames(tmp_path, "cam1: a/img_{frame}.tif\ncam2: c/img_{frame}.tif")


def test_range_and_offset(tmp_path):
    write_frames(tmp_path / "a", range(10))
    write_frames(tmp_path / "b", range(100, 110))
    cameras = 'cam1: a/img_{frame}.tif\ncam2: {images: "b/img_{frame}.tif", offset: -100}'
    series = open_frames(tmp_path, cameras, "frames: {first: 2, last: 5}\n")
    assert numbers_read(series["cam1"]) == {n: n for n in range(2, 6)}
    assert numbers_read(series["cam2"]) == {n: n + 100 for n in range(2, 6)}


@pytest.mark.parametrize(
    ("names", "images", "message"),
    [
        (["a_1.tif"], "b_{frame}.tif", "no file in .* fits 'b_{frame}.tif'; the folder holds 'a_1.tif'"),
        (["a_1.tif"], "a_1.tif", r"share no two frames \(frames of cam1 0 to 0\)"),
    ],
)
def test_names_that_cannot_be_numbered_are_refused(tmp_path, names, images, message):
    for name in names:
        write_frames(tmp_path / "cam1", [1], name)
    with pytest.raises(ExperimentError, match=message):
        open_frames(tmp_path, f'cam1: "cam1/{images}"')


@pytest.mark.parametrize("folder", ["nowhere", "file"])
def test_folders_that_cannot_be_read_are_named(tmp_path, folder):
    (tmp_path / "file").write_text("")
    with pytest.raises(ExperimentError, match=rf"the folder .*{folder} cannot be read \(.*check its name"):
        open_frames(tmp_path, f"cam1: {folder}/img_{{frame}}.tif")


def test_a_list_keeps_its_order_and_gaps(tmp_path):
    write_frames(tmp_path, [5, 1, 9])
    cameras = "cam1: [img_00005.tif, null, img_00001.tif, img_00009.tif, img_00077.tif]"
    series = open_frames(tmp_path, cameras)["cam1"]
    assert numbers_read(series) == {0: 5, 2: 1, 3: 9}
    assert list(series.missing) == [1]  # what is listed last and not there ends the series earlier


def test_several_multi_page_tiffs_follow_each_other(tmp_path):
    stack = np.stack([number_image(n) for n in range(7)])
    tifffile.imwrite(tmp_path / "a.tif", stack[:4], photometric="minisblack")
    tifffile.imwrite(tmp_path / "b.tif", stack[4:], photometric="minisblack")
    series = open_frames(tmp_path, "cam1: [a.tif, b.tif]")["cam1"]
    assert numbers_read(series) == {n: n for n in range(7)}


def test_zarr_array(tmp_path):
    stack = np.stack([number_image(n) for n in range(5)])
    zarr.save_array(tmp_path / "cam1.zarr", stack)
    zarr.open_group(tmp_path / "group.zarr", mode="w").create_array("image", data=stack)
    series = open_frames(tmp_path, "cam1: cam1.zarr\ncam2: group.zarr\ncam3: group.zarr/image")
    for one in series.values():
        assert numbers_read(one) == {n: n for n in range(5)}
    zarr.save_array(tmp_path / "flat.zarr", stack[0])
    with pytest.raises(ExperimentError, match="images need three"):
        open_frames(tmp_path, "cam1: flat.zarr")


def test_time_stamps_show_dropped_frames(tmp_path):
    write_frames(tmp_path / "cam1", range(6))
    kept = np.array([0, 1, 2, 5, 6, 9])  # the camera dropped frames without leaving gaps in its numbers
    jitter = 0.002 * np.array([0, 1, -1, 1, 0, -1])
    (tmp_path / "times.txt").write_text(
        "# clock\nimage, time\n"
        + "".join(f"{i}, {1e5 + t:.6f}\n" for i, t in enumerate(kept / 20.0 + jitter))
    )
    series = open_frames(tmp_path, 'cam1: {images: "cam1/img_{frame}.tif", times: times.txt}')["cam1"]
    assert numbers_read(series) == dict(zip(kept, range(6)))


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("0\n0.05\n", "holds 2 times, but cam1 has 3 images"),
        ("0\n0.05\n0.03\n", "must be increasing times"),
        ("0\n0.05\nlate\n", "line 3: 'late' is not one time"),
        ("0\n0.034\n0.1\n", "do not fit a frame rate of 20.0 Hz"),
    ],
)
def test_time_stamps_that_do_not_fit_are_refused(tmp_path, lines, message):
    write_frames(tmp_path / "cam1", range(3))
    (tmp_path / "times.txt").write_text(lines)
    with pytest.raises(ExperimentError, match=message):
        open_frames(tmp_path, 'cam1: {images: "cam1/img_{frame}.tif", times: times.txt}')


def test_bad_frames_keep_their_place_and_are_distinguished(tmp_path):
    folder = tmp_path / "cam1"
    write_frames(folder, range(7))
    (folder / "img_00001.tif").write_bytes((folder / "img_00001.tif").read_bytes()[:150])
    write_frames(folder, [2], shape=(8, 8))
    tifffile.imwrite(folder / "img_00003.tif", np.zeros((6, 8), np.uint8))
    tifffile.imwrite(folder / "img_00004.tif", number_image(4).astype(np.uint16))
    (folder / "img_00005.tif").unlink()
    series = open_frames(tmp_path, "cam1: cam1/img_{frame}.tif")["cam1"]
    frames = [series.read(i) for i in range(7)]
    assert [f.fault for f in frames] == [
        FrameFault.NONE,
        FrameFault.UNREADABLE,
        FrameFault.WRONG_SIZE,
        FrameFault.BLANK,
        FrameFault.WRONG_SIZE,
        FrameFault.MISSING,
        FrameFault.NONE,
    ]
    assert "8 x 8 uint8, the others are 8 x 6 uint8" in frames[2].message
    assert "img_00003.tif) is blank" in frames[3].message
    assert int(frames[6].image[0, 0]) == 6


def test_a_corrupt_first_frame_does_not_hide_the_series(tmp_path):
    write_frames(tmp_path / "cam1", range(4))
    (tmp_path / "cam1" / "img_00000.tif").write_bytes(b"II*\0")
    series = open_frames(tmp_path, "cam1: cam1/img_{frame}.tif")["cam1"]
    assert series.shape == (6, 8)
    for n in range(4):
        (tmp_path / "cam1" / f"img_{n:05d}.tif").write_bytes(b"")
    with pytest.raises(ExperimentError, match=r"none of 4 tried can be read: .* is empty"):
        open_frames(tmp_path, "cam1: cam1/img_{frame}.tif")


@pytest.mark.parametrize("pattern", ["img_{frame}.tif", "img_{frame:05d}.tif"])
def test_two_files_of_one_frame_number_are_refused(tmp_path, pattern):
    for name in ("img_3.tif", "img_4.tif", "img_00004.tif"):
        (tmp_path / name).touch()
    with pytest.raises(ExperimentError, match=r"cam1: 'img_00004.tif' and 'img_4.tif' are both frame 4"):
        number_frames(pattern, tmp_path, "cam1")


@pytest.mark.parametrize("written", ["img_%05d.tif", "img_####.tif", "img_{number:05d}.tif", "*.tif"])
def test_patterns_without_the_number_of_the_frame_are_refused_with_ours(tmp_path, written):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "img_00001.tif").touch()
    with pytest.raises(ExperimentError, match=re.escape("write {frame} where the number of the frame is")):
        number_frames(f"a/{written}", tmp_path, "cam1")


def test_names_that_look_like_the_placeholders_of_other_programs_are_read(tmp_path):
    (tmp_path / "run#1 at 50%d").mkdir()
    for name in ("img_1.tif", "img_2.tif"):
        (tmp_path / "run#1 at 50%d" / name).touch()
    assert list(number_frames("run#1 at 50%d/img_{frame}.tif", tmp_path, "cam1")) == [1, 2]


def test_folders_with_brackets_and_names_with_a_time_and_a_number_are_read(tmp_path):
    """As FLIR, pco and Basler name them: `run-DATE TIME-NUMBER`; the time varies too."""
    folder = tmp_path / "camera 1 [top]"
    write_frames(folder, range(4))
    series = open_frames(tmp_path, 'cam1: "camera 1 [top]/img_{frame:05d}.tif"')["cam1"]
    assert numbers_read(series) == {n: n for n in range(4)}
    for n in range(4):
        (folder / f"img_{n:05d}.tif").rename(folder / f"run-05032024{101138 + n // 2}-{n}.tif")
    series = open_frames(tmp_path, 'cam1: "camera 1 [top]/run-*-{frame}.tif"')["cam1"]
    assert numbers_read(series) == {n: n for n in range(4)}
