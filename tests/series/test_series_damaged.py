"""Damaged files of each kind are reported in one sentence; videos and DaVis' buffers are read."""

import cv2
import numpy as np
import pytest
import tifffile
import zarr
from series_cases import complaint, count_reported, damaged

from wavefield.errors import ExperimentError, FrameError
from wavefield.images import read_image
from wavefield.series.readers import close_files, read_entry

COUNT, ROWS, COLUMNS = 6, 48, 64


def images(dtype="uint8"):
    grains = np.random.default_rng(4).normal(size=(COUNT, ROWS, COLUMNS)).astype(np.float32)
    grey = 120 + 90 * np.stack([cv2.GaussianBlur(one, (0, 0), 1.5) for one in grains])
    return np.clip(grey, 0, 255).astype(dtype) * (1 if dtype == "uint8" else 16)


def write_video(path, code):
    film = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*code), 25.0, (COLUMNS, ROWS), isColor=True)
    for image in images():
        film.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    film.release()


def write_pages(path):
    with tifffile.TiffWriter(path) as tiff:
        for image in images("uint16"):
            tiff.write(image, contiguous=False)


def write_im7(path):
    lvpyio = pytest.importorskip("lvpyio", reason="LaVision's package is an extra: pip install lvpyio")
    lvpyio.write_buffer(lvpyio.arrays_to_buffer(images("uint16")[0]), str(path))


FILES = {
    "tif": lambda p: tifffile.imwrite(p, images("uint16")[0]),
    "packed.tif": lambda p: cv2.imwrite(str(p), images("uint16")[0], [cv2.IMWRITE_TIFF_COMPRESSION, 5]),
    "pages.tif": write_pages,
    "png": lambda p: cv2.imwrite(str(p), images("uint16")[0]),
    "bmp": lambda p: cv2.imwrite(str(p), images()[0]),
    "jpg": lambda p: cv2.imwrite(str(p), images()[0]),
    "im7": write_im7,
    "mjpg.avi": lambda p: write_video(p, "MJPG"),
    "mp4": lambda p: write_video(p, "mp4v"),
}


@pytest.mark.parametrize("name", FILES)
def test_damaged_files_are_reported_in_one_sentence(tmp_path, name):
    path = tmp_path / f"a.{name}"
    FILES[name](path)
    assert count_reported(path) >= 15  # most that were cut; of many images the first ones may be whole


def test_a_zarr_array_that_lost_or_broke_a_part_is_reported(tmp_path):
    path, rng, reported = tmp_path / "cam1.zarr", np.random.default_rng(2), 0
    for k in range(50):
        how = {"shape": (3, ROWS, COLUMNS), "dtype": "u2", "chunks": (1, ROWS, COLUMNS)}
        zarr.create_array(str(path), **how, overwrite=True)[:] = images("uint16")[:3]
        parts = sorted(p for p in path.rglob("*") if p.is_file())
        part = parts[rng.integers(0, len(parts))]
        part.write_bytes(damaged(part.read_bytes(), k, rng))
        words = complaint(path)
        reported += bool(words)
        assert not words or "cam1.zarr" in words
        assert "\n" not in words
    assert reported >= 30


def test_buffers_of_davis_and_sets_of_them(tmp_path):
    lvpyio = pytest.importorskip("lvpyio", reason="LaVision's package is an extra: pip install lvpyio")
    from wavefield.series.listing import number_frames

    frames = images("uint16")
    lvpyio.write_set([lvpyio.arrays_to_buffer(image) for image in frames], str(tmp_path / "cam1.set"))
    entries = number_frames("{camera}.set", tmp_path, "cam1")
    assert len(entries) == COUNT
    np.testing.assert_array_equal(read_entry(entries[4]), frames[4])
    close_files()
    (tmp_path / "cam1" / "B00002.im7").rename(tmp_path / "B00002.im7")  # those behind it keep their places
    entries = number_frames("{camera}.set", tmp_path, "cam1")
    np.testing.assert_array_equal(read_entry(entries[2]), frames[2])
    with pytest.raises(FrameError, match=r"B00002\.im7: no such image"):
        read_entry(entries[1])
    close_files()
    (tmp_path / "B00002.im7").rename(tmp_path / "cam1" / "B00002.im7")
    singly = number_frames("cam1/B{frame:05d}.im7", tmp_path, "cam1")
    assert sorted(singly) == list(range(1, COUNT + 1))
    np.testing.assert_array_equal(read_entry(singly[3]), frames[2])
    pairs = [lvpyio.arrays_to_buffer([frames[k], frames[k + 1]]) for k in range(2)]
    lvpyio.write_set(pairs, str(tmp_path / "pair.set"))
    np.testing.assert_array_equal(read_entry(number_frames("pair.set/1", tmp_path, "cam1")[0]), frames[1])
    for name, words in (("pair.set", "name one, as pair.set/0"), ("pair.set/2", "images 0 to 1")):
        with pytest.raises(ExperimentError, match=words):
            number_frames(name, tmp_path, "cam1")
    with pytest.raises(FrameError, match="2 images: name the set"):
        read_image(tmp_path / "pair" / "B00001.im7")
    close_files()
