"""Tags of TIFF files mean the same whatever the compression and the reader; JPEG files damaged inside."""

import struct

import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st

from wavefield.errors import FrameError
from wavefield.images import decode_image, read_image
from wavefield.images.jpeg_scan import is_damaged
from wavefield.series.readers import FrameEntry, close_files, count_images, read_entry

COMPRESSIONS = {"none": 1, "LZW": 5, "deflate": 8, "packed bits": 32773}
ORIENTATION, PHOTOMETRIC = 274, 262


@pytest.fixture(scope="module")
def picture():
    noise = np.random.default_rng(4).integers(0, 255, (48, 64), dtype=np.uint8)
    return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.5), None, 0, 250, cv2.NORM_MINMAX)


def write_tagged(path, image, compression, **tags):
    """A TIFF file as OpenCV compresses it, with other values of its tags."""
    cv2.imwrite(str(path), image, [cv2.IMWRITE_TIFF_COMPRESSION, compression])
    data = bytearray(path.read_bytes())
    with tifffile.TiffFile(path) as tiff:
        page = tiff.pages.first
        place = dict.fromkeys(("photometric",), page.tags[PHOTOMETRIC].valueoffset)
        # OpenCV writes no orientation: its tag takes the place of one that has its default value
        place["orientation"] = page.tags["PlanarConfiguration"].offset
    if "photometric" in tags:
        struct.pack_into("<H", data, place["photometric"], tags["photometric"])
    if "orientation" in tags:
        struct.pack_into("<HHII", data, place["orientation"], ORIENTATION, 3, 1, tags["orientation"])
    path.write_bytes(bytes(data))


def readings(path):
    """The image by all readers, and as the second image of a file of many."""
    yield read_image(path)
    yield decode_image(path.read_bytes(), str(path))
    kind, count = count_images(path)
    yield read_entry(FrameEntry(kind, str(path), count - 1))
    close_files()


@pytest.mark.parametrize("compression", COMPRESSIONS.values(), ids=COMPRESSIONS)
@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_pixels_are_as_stored_whatever_the_orientation(tmp_path, picture, compression, dtype, orientation):
    image = picture.astype(dtype) * (1 if dtype == "uint8" else 200)
    write_tagged(tmp_path / "a.tif", image, compression, orientation=orientation)
    for read in readings(tmp_path / "a.tif"):
        np.testing.assert_array_equal(read, image)


@pytest.mark.parametrize("compression", COMPRESSIONS.values(), ids=COMPRESSIONS)
@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
@pytest.mark.parametrize("orientation", [1, 6])
def test_bright_is_bright_where_the_smallest_value_is_white(
    tmp_path, picture, compression, dtype, orientation
):
    image = picture.astype(dtype) * (1 if dtype == "uint8" else 200)
    write_tagged(tmp_path / "a.tif", image, compression, photometric=0, orientation=orientation)
    for read in readings(tmp_path / "a.tif"):
        np.testing.assert_array_equal(read, np.iinfo(dtype).max - image)


@pytest.mark.parametrize("photometric", ["minisblack", "miniswhite"])
def test_pages_mean_the_same_as_files(tmp_path, picture, photometric):
    for name, compression in (("a.tif", None), ("b.tif", "zlib")):
        with tifffile.TiffWriter(tmp_path / name) as tiff:
            for k in range(3):
                tags = [(ORIENTATION, "H", 1, 3, True)]
                tiff.write(
                    picture + np.uint8(k), photometric=photometric, compression=compression, extratags=tags
                )
        assert count_images(tmp_path / name) == ("page", 3)
        read = read_entry(FrameEntry("page", str(tmp_path / name), 2))
        np.testing.assert_array_equal(read, picture + 2 if photometric == "minisblack" else 253 - picture)
        np.testing.assert_array_equal(read_image(tmp_path / name, 2), read)
        with pytest.raises(FrameError, match="has 3 images; name this file alone to read all"):
            read_image(tmp_path / name)
    close_files()


def test_thumbnails_are_no_frames(tmp_path, picture):
    small, path = picture[::4, ::4].copy(), tmp_path / "a.tif"
    for order in ([picture, small], [small, picture], [small, picture, small]):
        with tifffile.TiffWriter(path) as tiff:
            for image in order:
                tiff.write(image, subfiletype=int(image is small), contiguous=False)
        for read in readings(path):
            np.testing.assert_array_equal(read, picture)
    with tifffile.TiffWriter(path) as tiff:
        for k in range(3):
            tiff.write(picture + np.uint8(k), contiguous=False)
            tiff.write(small, subfiletype=1, contiguous=False)
    assert count_images(path) == ("page", 3)
    np.testing.assert_array_equal(read_entry(FrameEntry("page", str(path), 2)), picture + 2)
    close_files()


def test_what_is_not_one_image_of_real_numbers_is_refused(tmp_path, picture):
    path = tmp_path / "a.tif"
    cases = {
        "complex pixels; save their magnitudes": (picture.astype(np.complex64), {}),
        "volume of 3 slices": (np.stack([picture] * 3), {"volumetric": True, "photometric": "minisblack"}),
        "5 channels": (np.stack([picture] * 5, -1), {"photometric": "minisblack", "planarconfig": "contig"}),
        "negative .MinIsWhite. of signed numbers": (picture.astype("f4"), {"photometric": "miniswhite"}),
    }
    for words, (image, how) in cases.items():
        tifffile.imwrite(path, image, **how)
        for read in (read_image, lambda p: decode_image(p.read_bytes(), str(p))):
            with pytest.raises(FrameError, match=words):
                read(path)
    with tifffile.TiffWriter(path) as tiff:
        tiff.write(picture[::4, ::4].copy(), subifds=1)
        tiff.write(picture, subfiletype=0)
    with pytest.raises(FrameError, match="a larger image inside of another"):
        read_image(path)


def test_colours_in_planes_are_read_as_colours_side_by_side(tmp_path, picture):
    planes = np.stack([picture, picture // 2, picture // 3])
    for name, image, how in (("a.tif", planes, "separate"), ("b.tif", np.moveaxis(planes, 0, -1), "contig")):
        with tifffile.TiffWriter(tmp_path / name) as tiff:
            for _ in range(2):
                tiff.write(np.ascontiguousarray(image), photometric="rgb", planarconfig=how, contiguous=False)
    a, b = (read_entry(FrameEntry("page", str(tmp_path / name), 1)) for name in ("a.tif", "b.tif"))
    np.testing.assert_array_equal(a, b)
    assert a.shape == picture.shape
    close_files()


def coded(picture, restart=0, colour=False, optimized=False):
    image = cv2.resize(picture, (200, 150))
    image = np.dstack([image, image[::-1], image[:, ::-1]]) if colour else image
    how = [cv2.IMWRITE_JPEG_RST_INTERVAL, restart, cv2.IMWRITE_JPEG_OPTIMIZE, int(optimized)]
    return cv2.imencode(".jpg", image, how)[1].tobytes()


@given(
    st.integers(1, 90),
    st.integers(1, 90),
    st.integers(0, 7),
    st.booleans(),
    st.booleans(),
    st.integers(1, 100),
)
def test_whole_jpeg_files_are_read(height, width, restart, colour, optimized, quality):
    shape = (height, width, 3) if colour else (height, width)
    image = np.random.default_rng(height * width).integers(0, 255, shape, dtype=np.uint8)
    how = [cv2.IMWRITE_JPEG_RST_INTERVAL, restart, cv2.IMWRITE_JPEG_OPTIMIZE, int(optimized)]
    data = cv2.imencode(".jpg", image, [*how, cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
    assert not is_damaged(data)


@pytest.mark.parametrize("how", [{}, {"restart": 4}, {"colour": True, "optimized": True}])
def test_jpeg_files_damaged_inside_are_refused(tmp_path, picture, how):
    """Codes may still fit by chance; one bit of a number changes no code."""
    whole, chance, path = coded(picture, **how), np.random.default_rng(1), tmp_path / "a.jpg"
    found = {"cleared": 0, "exchanged": 0, "one bit": 0}
    for k in range(150):
        data, at = bytearray(whole), int(chance.integers(700, len(whole) - 60))
        kind = list(found)[k % 3]
        if kind == "cleared":
            data[at : at + 50] = bytes(50)
        elif kind == "exchanged":
            data[at : at + 50] = chance.integers(0, 256, 50, dtype=np.uint8).tobytes()
        else:
            data[at] ^= 1 << int(chance.integers(8))
        path.write_bytes(bytes(data))
        try:
            read_image(path)
        except FrameError as error:
            assert "a.jpg is not an image, corrupt or truncated" in str(error)  # noqa: PT017
            found[kind] += 1
    assert found["cleared"] >= 40
    assert found["exchanged"] >= 30
    assert found["one bit"] >= 9


def test_progressive_jpeg_files_are_not_followed(picture):
    data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    assert not is_damaged(data)
    assert decode_image(data, "a.jpg").shape == picture.shape


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "int16", "uint32", "float32", "float64"])
@pytest.mark.parametrize("planar", ["contig", "separate"])
def test_colours_have_their_luminance_whatever_their_type_and_order(tmp_path, dtype, planar):
    colours = (np.random.default_rng(2).random((24, 30, 3)) * 200).astype(dtype)
    stored = colours if planar == "contig" else np.moveaxis(colours, -1, 0)
    expected = colours @ [0.299, 0.587, 0.114]
    for compression in (None, "zlib"):
        tifffile.imwrite(
            tmp_path / "a.tif", stored, photometric="rgb", planarconfig=planar, compression=compression
        )
        for read in readings(tmp_path / "a.tif"):
            assert read.dtype == dtype
            np.testing.assert_allclose(read, expected, atol=1.0 if read.dtype.kind in "iu" else 1e-3)
