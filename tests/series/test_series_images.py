"""Reading and writing single images."""

import cv2
import numpy as np
import pytest
import tifffile

from wavefield.errors import FrameError
from wavefield.images import plain_tiff, read_image, write_image
from wavefield.series.frames import check_content


@pytest.fixture
def picture():
    rng = np.random.default_rng(3)
    return cv2.GaussianBlur(rng.integers(0, 256, (60, 80), dtype=np.uint8), (0, 0), 2.0)


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
@pytest.mark.parametrize("name", ["a.tif", "a.tiff", "a.png"])
def test_what_is_written_is_read_back(tmp_path, picture, name, dtype):
    image = picture.astype(dtype) * (16 if dtype == "uint16" else 1)
    write_image(tmp_path / "new" / name, image)
    got = read_image(tmp_path / "new" / name)
    assert got.dtype == image.dtype
    np.testing.assert_array_equal(got, image)


@pytest.mark.parametrize("compression", [1, 5, 8, 32773], ids=["none", "lzw", "deflate", "packbits"])
def test_compressed_tiff_needs_no_further_package(tmp_path, picture, compression):
    path = str(tmp_path / "a.tif")
    image = picture.astype(np.uint16) * 16
    cv2.imwrite(path, image, [cv2.IMWRITE_TIFF_COMPRESSION, compression])
    np.testing.assert_array_equal(read_image(path), image)


@pytest.mark.parametrize(
    "layout", [{"rowsperstrip": 7}, {"tile": (16, 16)}, {"byteorder": ">"}, {"bigtiff": True}]
)
def test_tiff_layouts(tmp_path, picture, layout):
    image = picture.astype(np.uint16) * 200
    tifffile.imwrite(tmp_path / "a.tif", image, **layout)
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), image)


def test_twelve_bits_in_sixteen_keep_their_values(tmp_path):
    image = np.arange(4096, dtype=np.uint16).reshape(64, 64)
    write_image(tmp_path / "a.tif", image)
    assert read_image(tmp_path / "a.tif").max() == 4095


def test_bmp_and_jpeg(tmp_path, picture):
    cv2.imwrite(str(tmp_path / "a.bmp"), picture)
    np.testing.assert_array_equal(read_image(tmp_path / "a.bmp"), picture)
    cv2.imwrite(str(tmp_path / "a.jpg"), picture, [cv2.IMWRITE_JPEG_QUALITY, 100])
    assert np.abs(read_image(tmp_path / "a.jpg").astype(int) - picture).max() <= 3


def test_colour_becomes_grey(tmp_path, picture):
    colour = np.dstack([picture, np.zeros_like(picture), np.zeros_like(picture)])  # blue only
    cv2.imwrite(str(tmp_path / "a.png"), colour)
    got = read_image(tmp_path / "a.png")
    assert got.shape == picture.shape
    assert np.abs(got - 0.114 * picture).max() < 1


def test_pages_of_a_tiff(tmp_path, picture):
    pages = np.stack([picture, picture[::-1], 255 - picture])
    tifffile.imwrite(tmp_path / "a.tif", pages, photometric="minisblack")
    for k in range(3):
        np.testing.assert_array_equal(read_image(tmp_path / "a.tif", page=k), pages[k])
    with pytest.raises(FrameError, match="has 3 pages: there is no page 3"):
        read_image(tmp_path / "a.tif", page=3)


@pytest.mark.parametrize("ending", ["tif", "png", "bmp", "jpg"])
@pytest.mark.parametrize("share", [0.02, 0.5, 0.99])
def test_truncated_files_are_refused(tmp_path, picture, ending, share):
    path = tmp_path / f"a.{ending}"
    cv2.imwrite(str(path), picture)
    raw = path.read_bytes()
    path.write_bytes(raw[: int(share * len(raw))])
    with pytest.raises(FrameError, match="a." + ending):
        read_image(path)


def test_a_corrupt_png_is_refused(tmp_path, picture):
    path = tmp_path / "a.png"
    cv2.imwrite(str(path), picture)
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 2 : len(raw) // 2 + 50] = bytes(50)
    path.write_bytes(bytes(raw))
    with pytest.raises(FrameError, match="corrupt"):
        read_image(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "no such image"), (b"", "is empty"), (b"GIF89 not at all", "not an image")],
)
def test_what_is_not_an_image_is_named(tmp_path, content, message):
    path = tmp_path / "frame.tif"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(FrameError, match=message):
        read_image(path)


def test_a_folder_in_place_of_an_image(tmp_path):
    with pytest.raises(FrameError, match="cannot be read"):
        read_image(tmp_path)


def test_writing_where_nothing_can_be_written(tmp_path, picture):
    (tmp_path / "file").write_text("")
    for name in ("a.tif", "a.png"):
        with pytest.raises(FrameError, match="cannot be written"):
            write_image(tmp_path / "file" / name, picture)
    with pytest.raises(FrameError, match="cannot be written"):
        write_image(tmp_path / "a.unknown", picture)


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tif"])
def test_a_truncated_file_is_reported_once(tmp_path, picture, capfd, name):
    path = tmp_path / name
    cv2.imwrite(str(path), picture)
    raw = path.read_bytes()
    level = cv2.utils.logging.getLogLevel()
    path.write_bytes(raw[: len(raw) // 2])
    with pytest.raises(FrameError, match=name):
        read_image(path)
    assert capfd.readouterr() == ("", "")
    assert cv2.utils.logging.getLogLevel() == level


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_an_image_with_pixels_that_are_no_numbers_is_not_measured(value):
    image = np.linspace(0, 1, 400, dtype=np.float32).reshape(20, 20)
    image[3, 4] = value
    frame = check_content(image, "cam1 frame 7")
    assert frame.image is None
    assert frame.message == "cam1 frame 7 has 1 pixels that are not finite numbers"


@pytest.mark.parametrize("how", [{}, {"byteorder": ">"}, {"bigtiff": True}, {"rowsperstrip": 5}])
def test_the_directory_of_a_series_of_tiffs_is_parsed_once(tmp_path, monkeypatch, how):
    pictures = np.random.default_rng(3).integers(0, 4096, (5, 18, 22)).astype("u2")
    for k, picture in enumerate(pictures):
        tifffile.imwrite(tmp_path / f"{k}.tif", picture, **how)
    parsed, parse = [], tifffile.TiffFile.__init__
    monkeypatch.setattr(tifffile.TiffFile, "__init__", lambda *a, **k: (parsed.append(1), parse(*a, **k))[1])
    plain_tiff._layouts.clear()
    for k, picture in enumerate(pictures):
        got = read_image(tmp_path / f"{k}.tif")
        np.testing.assert_array_equal(got, picture)
        assert got.dtype == np.uint16
        assert got.dtype.isnative
    assert len(parsed) == 1


def test_a_tiff_of_another_layout_and_the_same_size_is_not_taken_for_one_of_the_series(tmp_path):
    tall = np.arange(18 * 22, dtype="u2").reshape(22, 18)
    tifffile.imwrite(tmp_path / "a.tif", tall.reshape(18, 22))
    tifffile.imwrite(tmp_path / "b.tif", tall)
    data = bytearray((tmp_path / "a.tif").read_bytes())
    assert len(data) == (tmp_path / "b.tif").stat().st_size
    for name, expected in (("a.tif", tall.reshape(18, 22)), ("b.tif", tall)):
        np.testing.assert_array_equal(read_image(tmp_path / name), expected)
    data[:8] = (tmp_path / "b.tif").read_bytes()[:8]
    (tmp_path / "cut.tif").write_bytes(data[:-100])
    with pytest.raises(FrameError, match=r"cut\.tif is"):
        read_image(tmp_path / "cut.tif")
