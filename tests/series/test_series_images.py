"""Reading and writing single images, and the pages of TIFF files, by the meaning of their tags."""

import itertools
import struct

import cv2
import numpy as np
import pytest
import tifffile

from wavefield.errors import FrameError
from wavefield.images import read_image, write_image
from wavefield.series.frames import check_content
from wavefield.series.readers import FrameEntry, close_files, count_images, read_entry

SHAPE = (48, 64)


@pytest.fixture(scope="module")
def picture():
    noise = np.random.default_rng(4).integers(0, 255, SHAPE, dtype=np.uint8)
    return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.5), None, 0, 250, cv2.NORM_MINMAX)


@pytest.fixture(autouse=True)
def _closed():
    yield
    close_files()


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
@pytest.mark.parametrize("name", ["a.tif", "a.tiff", "a.png"])
def test_what_is_written_is_read_back(tmp_path, picture, name, dtype):
    image = picture.astype(dtype) * (16 if dtype == "uint16" else 1)
    write_image(tmp_path / "new" / name, image)
    got = read_image(tmp_path / "new" / name)
    assert got.dtype == image.dtype
    np.testing.assert_array_equal(got, image)


def test_bmp_and_jpeg(tmp_path, picture):
    cv2.imwrite(str(tmp_path / "a.bmp"), picture)
    np.testing.assert_array_equal(read_image(tmp_path / "a.bmp"), picture)
    cv2.imwrite(str(tmp_path / "a.jpg"), picture, [cv2.IMWRITE_JPEG_QUALITY, 100])
    assert np.abs(read_image(tmp_path / "a.jpg").astype(int) - picture).max() <= 3


@pytest.mark.parametrize("name", ["a.png", "a.tif"])
@pytest.mark.parametrize("alpha", [None, 128])
@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_colour_becomes_luminance_and_alpha_is_ignored(tmp_path, picture, name, alpha, dtype):
    planes = [picture, 0 * picture, picture // 2] + ([] if alpha is None else [np.full_like(picture, alpha)])
    colour = np.dstack(planes).astype(dtype) * (200 if dtype == "uint16" else 1)
    if name == "a.tif":
        extra = {} if alpha is None else {"extrasamples": ["unassalpha"]}
        tifffile.imwrite(tmp_path / name, colour, photometric="rgb", **extra)
    else:
        cv2.imwrite(str(tmp_path / name), colour[..., [2, 1, 0, 3][: colour.shape[2]]])
    expected = colour[..., :3] @ [0.299, 0.587, 0.114]
    assert np.abs(read_image(tmp_path / name) - expected).max() < 1


COMPRESSIONS = (None, "lzw", "zlib", "zstd", "packbits", "lzma")


def public_style_tiffs():
    """Combinations of depth, compression, predictor, samples, photometric, planes, byte order and tiles."""
    depths = ("u1", "u2", "u4", "i2", "f4", "f8")
    for dtype, compression, predictor, order in itertools.product(depths, COMPRESSIONS, (0, 1), "<>"):
        if predictor and compression in (None, "packbits"):
            continue
        for kind in ("minisblack", "miniswhite", "rgb", "rgba", "planar", "tiles"):
            if kind == "miniswhite" and dtype[0] != "u":
                continue
            yield dtype, compression, predictor, order, kind


def test_tiffs_of_all_kinds_hold_the_values_that_tifffile_reads(tmp_path, picture):
    cases = list(public_style_tiffs())
    chosen = np.random.default_rng(1).permutation(len(cases))[:100]
    path = tmp_path / "a.tif"
    for dtype, compression, predictor, order, kind in (cases[k] for k in chosen):
        image = picture.astype(dtype) * (1 if dtype == "u1" else 100)
        if kind in ("rgb", "rgba", "planar"):
            stack = [image, image // 2, image // 3, *([image // 4] if kind == "rgba" else [])]
            image = np.stack(stack, 0 if kind == "planar" else -1)
        how = {"photometric": kind if "minis" in kind else "minisblack" if kind == "tiles" else "rgb"}
        how |= {"extrasamples": ["unassalpha"]} if kind == "rgba" else {}
        how |= {"planarconfig": "separate"} if kind == "planar" else {}
        how |= {"tile": (16, 16)} if kind == "tiles" else {"rowsperstrip": 7}
        tifffile.imwrite(
            path, image, byteorder=order, compression=compression, predictor=bool(predictor), **how
        )
        expected = tifffile.imread(path)
        if kind == "planar":
            expected = np.moveaxis(expected, 0, -1)
        if kind == "miniswhite":
            expected = np.iinfo(dtype).max - expected
        got = read_image(path)
        assert got.dtype == expected.dtype.newbyteorder("=")
        assert got.dtype.isnative
        if expected.ndim == 3:
            expected = expected[..., :3] @ [0.299, 0.587, 0.114]
            scale = 1.0 if got.dtype.kind in "iu" else 1e-2
            np.testing.assert_allclose(got, expected, atol=scale, err_msg=f"{dtype} {compression} {kind}")
        else:
            np.testing.assert_array_equal(got, expected, f"{dtype} {compression} {predictor} {order} {kind}")


def write_bits(path, image, bits, photometric):
    """A TIFF file of packed bits."""
    text = "".join(f"{v:0{bits}b}" for v in image.ravel())
    pixels = int(text, 2).to_bytes(len(text) // 8, "big")
    rows, columns = image.shape
    tags = [(256, 3, columns), (257, 3, rows), (258, 3, bits), (259, 3, 1), (262, 3, photometric)]
    tags += [(273, 4, 8), (277, 3, 1), (278, 3, rows), (279, 4, len(pixels))]
    body = b"".join(
        struct.pack("<HHI", code, kind, 1) + struct.pack("<I", value) for code, kind, value in tags
    )
    head = struct.pack("<2sHI", b"II", 42, 8 + len(pixels))
    path.write_bytes(head + pixels + struct.pack("<H", len(tags)) + body + bytes(4))


@pytest.mark.parametrize("bits", [1, 4, 10, 12, 14])
@pytest.mark.parametrize("photometric", [0, 1])
def test_packed_bits_are_read_and_bright_is_bright(tmp_path, bits, photometric):
    image = np.random.default_rng(bits).integers(0, 2**bits, (8, 8)).astype("u2")
    write_bits(tmp_path / "a.tif", image, bits, photometric)
    bright = image if photometric else 2**bits - 1 - image
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), bright * (255 if bits == 1 else 1))


def test_a_palette_becomes_luminance(tmp_path, picture):
    ramp = np.arange(256, dtype="u2") * 256
    tifffile.imwrite(tmp_path / "a.tif", picture, photometric="palette", colormap=np.stack([ramp] * 3))
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), picture)


@pytest.mark.parametrize("orientation", [3, 6])
def test_pixels_are_as_stored_whatever_the_orientation(tmp_path, picture, orientation):
    tags = [(274, "H", 1, orientation, True)]
    tifffile.imwrite(tmp_path / "a.tif", picture, compression="zlib", extratags=tags)
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), picture)


def write_stack(path, images, **how):
    with tifffile.TiffWriter(path) as tiff:
        for image in images:
            tiff.write(image, contiguous=False, **how)


@pytest.mark.parametrize("how", [{}, {"photometric": "miniswhite"}, {"compression": "zlib"}])
def test_pages_mean_the_same_as_files(tmp_path, picture, how):
    path = tmp_path / "a.tif"
    write_stack(path, [picture + np.uint8(k) for k in range(3)], **how)
    assert count_images(path) == ("images", 3)
    read = read_entry(FrameEntry("images", str(path), 2))
    np.testing.assert_array_equal(read, 253 - picture if "photometric" in how else picture + 2)
    with pytest.raises(FrameError, match="has 3 images; name this file alone to read all"):
        read_image(path)
    with pytest.raises(FrameError, match="has no image 3"):
        read_entry(FrameEntry("images", str(path), 3))


@pytest.mark.parametrize("order", "<>")
def test_a_stack_of_imagej_with_one_directory_has_all_its_images(tmp_path, order):
    path = tmp_path / "a.tif"
    stack = np.random.default_rng(1).integers(0, 4000, (12, 48, 64)).astype(f"{order}u2")
    how = {"imagej": True, "byteorder": order, "metadata": {"axes": "TYX"}, "truncate": True}
    tifffile.imwrite(path, stack, **how)
    assert count_images(path) == ("images", 12)
    for k in (0, 7, 11):
        np.testing.assert_array_equal(read_entry(FrameEntry("images", str(path), k)), stack[k])
    path.write_bytes(path.read_bytes()[:-100])
    close_files()
    with pytest.raises(FrameError, match=r"a\.tif is corrupt or truncated"):
        read_entry(FrameEntry("images", str(path), 11))


def test_thumbnails_are_not_frames(tmp_path, picture):
    small, path = picture[::4, ::4].copy(), tmp_path / "a.tif"
    for order in ([picture, small], [small, picture], [small, picture, small]):
        with tifffile.TiffWriter(path) as tiff:
            for image in order:
                tiff.write(image, subfiletype=int(image is small), contiguous=False)
        np.testing.assert_array_equal(read_image(path), picture)
        assert count_images(path) == ("file", 1)


NOT_READ = {
    "complex pixels; save their magnitudes": lambda p, path: tifffile.imwrite(path, p.astype("c8")),
    "volume of 3 slices": lambda p, path: tifffile.imwrite(
        path, np.stack([p] * 3), volumetric=True, photometric="minisblack"
    ),
    "5 channels": lambda p, path: tifffile.imwrite(
        path, np.stack([p] * 5, -1), photometric="minisblack", planarconfig="contig"
    ),
    "negative .MinIsWhite. of signed numbers": lambda p, path: tifffile.imwrite(
        path, p.astype("f4"), photometric="miniswhite"
    ),
    "pixels of kind CFA are not supported": lambda p, path: tifffile.imwrite(path, p, photometric=32803),
    "pixels of kind SEPARATED are not supported": lambda p, path: tifffile.imwrite(
        path, np.stack([p] * 4, -1), photometric="separated"
    ),
}


@pytest.mark.parametrize("words", NOT_READ)
def test_what_is_not_one_image_of_real_numbers_is_not_supported(tmp_path, picture, words):
    NOT_READ[words](picture, tmp_path / "a.tif")
    with pytest.raises(FrameError, match=words) as error:
        read_image(tmp_path / "a.tif")
    assert "corrupt" not in str(error.value)


def test_an_unknown_compression_and_other_kinds_of_file_are_not_called_corrupt(tmp_path, picture):
    tifffile.imwrite(tmp_path / "a.tif", picture)
    with tifffile.TiffFile(tmp_path / "a.tif", mode="r+") as tiff:
        tiff.pages.first.tags["Compression"].overwrite(34713)
    (tmp_path / "run.nd2").write_bytes(bytes.fromhex("dacebe0a") + bytes(4096))
    (tmp_path / "img.b16").write_bytes(b"PCO-" + bytes(4096))
    (tmp_path / "img.dng").write_bytes((tmp_path / "a.tif").read_bytes())
    for name in ("a.tif", "run.nd2", "img.b16", "img.dng"):
        with pytest.raises(FrameError, match="not supported") as error:
            read_image(tmp_path / name)
        assert "corrupt" not in str(error.value)


@pytest.mark.parametrize("trailer", [0, 34000])
def test_a_jpeg_with_the_cameras_own_data_behind_it_is_read(tmp_path, picture, trailer):
    data = cv2.imencode(".jpg", picture)[1].tobytes()
    (tmp_path / "plain.jpg").write_bytes(data)
    (tmp_path / "a.jpg").write_bytes(data + b"\x01\x00" * (trailer // 2))
    np.testing.assert_array_equal(read_image(tmp_path / "a.jpg"), read_image(tmp_path / "plain.jpg"))


def test_most_jpegs_that_are_damaged_inside_are_refused(tmp_path, picture):
    data, found = cv2.imencode(".jpg", np.tile(picture, (4, 4)))[1].tobytes(), 0
    for seed in range(100):
        chance, damaged = np.random.default_rng(seed), bytearray(data)
        at = int(chance.integers(700, len(data) - 200))
        damaged[at : at + 100] = chance.bytes(100)
        (tmp_path / "a.jpg").write_bytes(damaged)
        try:
            read_image(tmp_path / "a.jpg")
        except FrameError as error:
            found += "a.jpg is corrupt or truncated" in str(error)
    assert found > 80


@pytest.mark.parametrize("ending", ["tif", "png", "bmp", "jpg"])
@pytest.mark.parametrize("fraction", [0.02, 0.99])
def test_truncated_files_are_refused_once_and_quietly(tmp_path, picture, capfd, ending, fraction):
    path = tmp_path / f"a.{ending}"
    cv2.imwrite(str(path), picture)
    raw = path.read_bytes()
    path.write_bytes(raw[: int(fraction * len(raw))])
    level = cv2.utils.logging.getLogLevel()
    with pytest.raises(FrameError, match="a." + ending):
        read_image(path)
    assert capfd.readouterr() == ("", "")
    assert cv2.utils.logging.getLogLevel() == level


def test_every_changed_byte_of_a_png_is_found(tmp_path, picture):
    data = cv2.imencode(".png", picture)[1].tobytes()
    for seed in range(50):
        chance, damaged = np.random.default_rng(seed), bytearray(data)
        damaged[int(chance.integers(8, len(data) - 12))] ^= 1 << int(chance.integers(8))
        (tmp_path / "a.png").write_bytes(damaged)
        with pytest.raises(FrameError, match=r"a\.png is corrupt or truncated"):
            read_image(tmp_path / "a.png")


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "no such image"), (b"", "is empty"), (b"GIF89 not at all", "does not begin as .tif does")],
)
def test_what_is_not_an_image_is_named(tmp_path, content, message):
    path = tmp_path / "frame.tif"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(FrameError, match=message):
        read_image(path)
    with pytest.raises(FrameError, match="is a folder"):
        read_image(tmp_path)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_an_image_with_pixels_that_are_not_numbers_is_not_measured(value):
    image = np.linspace(0, 1, 400, dtype=np.float32).reshape(20, 20)
    image[3, 4] = value
    frame = check_content(image, "cam1 frame 7")
    assert frame.image is None
    assert frame.message == "cam1 frame 7 has 1 pixels that are not finite numbers"
