"""Read and write grey images: TIFF, PNG, BMP, JPEG, and DaVis' IM7."""

import re
from pathlib import Path
from typing import BinaryIO

import cv2
import imagecodecs
import numpy as np
import simplejpeg
import tifffile

from wavefield.atomic_write import Product, atomic
from wavefield.errors import FrameError, StoreError
from wavefield.file_access import refuse_pipe
from wavefield.images import tiff
from wavefield.images.davis_image import read_buffer
from wavefield.text import one_line

PNG, JPEG, BMP = b"\x89PNG", b"\xff\xd8\xff", b"BM"
ENDINGS = (*tiff.ENDINGS, ".png", ".bmp", ".jpg", ".jpeg")
CONVERTED = (np.uint8, np.uint16, np.float32)  # types of colour images that OpenCV can convert to grey


def read_image(path: str | Path) -> np.ndarray:
    """Return an image as grey levels in the file's type, (row, column), from TIFF, PNG, BMP, JPEG or IM7.
    FrameError if the file is missing, damaged or of another format, or if it has several images."""
    path = Path(path)
    refuse_pipe(path, FrameError)
    if path.suffix.lower() == ".im7":
        return read_buffer(path)
    try:
        with path.open("rb") as stream:
            return _read(stream, str(path))
    except FileNotFoundError:
        raise FrameError(f"{path}: no such image") from None
    except IsADirectoryError:
        raise FrameError(f"{path} is a folder, not an image") from None
    except OSError as error:
        raise FrameError(f"{path} cannot be read: {error.strerror or error}") from None


def _read(stream: BinaryIO, name: str) -> np.ndarray:
    """Return a grey image, (row, column), from the open file `stream`, called `name` in messages."""
    start = stream.read(4)
    stream.seek(0)
    if start in tiff.STARTS:
        images = tiff.TiffImages(stream, name)
        if images.count != 1:
            raise FrameError(
                f"{name} has {images.count} images; name this file alone to read all, or save each to a file"
                if images.count
                else f"{name} is corrupt or truncated: it has no image"
            )
        return grey(images.read(0))
    try:
        image = _decode(stream.read(), start)
    except (imagecodecs.PngError, imagecodecs.BmpError, ValueError, MemoryError) as error:
        words = one_line(error)
        if re.search("unsupported (jpeg|color)", words, re.IGNORECASE):  # a valid file of an unsupported kind
            raise FrameError(f"{name} is not supported ({words}); save it as TIFF or PNG") from None
        raise FrameError(f"{name} is corrupt or truncated: {words}; copy it again from the camera") from None
    if image is None:
        raise FrameError(_unknown(name, start))
    if image.ndim not in (2, 3) or not image.size:
        raise FrameError(f"{name} is corrupt: its header is that of no image; copy it again from the camera")
    return grey(image)


def _decode(data: bytes, start: bytes) -> np.ndarray | None:
    """Return the image in `data`, a PNG, JPEG or BMP file that begins with the bytes `start`; else None."""
    if start == PNG:
        return np.asarray(imagecodecs.png_decode(data))
    if start[:3] == JPEG:  # strict: warnings of libjpeg, such as truncated data, are errors
        return np.asarray(simplejpeg.decode_jpeg(data, "GRAY", strict=True))[..., 0]
    return np.asarray(imagecodecs.bmp_decode(data)) if start[:2] == BMP else None


def _unknown(name: str, start: bytes) -> str:
    """Return the error message for a file whose first bytes, `start`, belong to no supported format."""
    if not start:
        return f"{name} is empty; copy it again from the camera"
    ending = Path(name).suffix.lower()
    if ending in ENDINGS:
        return f"{name} is corrupt: it does not begin as {ending} does; copy it again from the camera"
    return f"{name}: {ending or 'a name without ending'} is not supported; export TIFF or PNG"


def grey(image: np.ndarray) -> np.ndarray:
    """Return the luminance, (row, column), of an image (row, column, channel), in the type of the image.
    Channels are red, green, blue and alpha (ignored); of one or two channels the first is taken."""
    if image.ndim == 2:
        return image
    if image.shape[2] < 3:
        return np.ascontiguousarray(image[..., 0])
    kind = image.dtype if image.dtype in CONVERTED else np.float32
    luminance = cv2.cvtColor(np.ascontiguousarray(image[..., :3], kind), cv2.COLOR_RGB2GRAY)
    if kind == image.dtype:
        return luminance
    return np.asarray(np.rint(luminance) if image.dtype.kind in "iu" else luminance, image.dtype)


def write_image(path: str | Path, image: np.ndarray, product: Product | None = None) -> None:
    """Write a grey image, (row, column), completely or not at all; the ending of `path` gives the format.
    Without a `product`, an existing file is replaced. With a `product` (kind and source of an output) it is
    replaced only if it is an unchanged output of that kind and source. FrameError if writing fails."""
    path = Path(path)
    try:
        with atomic(path, product, replace=product is None) as draft:
            if path.suffix.lower() in tiff.ENDINGS:
                tifffile.imwrite(draft, image)
            else:
                draft.write_bytes(cv2.imencode(path.suffix, image)[1].tobytes())
    except StoreError as error:
        raise FrameError(str(error)) from None
    except cv2.error:
        raise FrameError(
            f"{path} cannot be written: {path.suffix or 'no ending'} is no image format"
        ) from None


def fill_masked(image: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """Return a copy of an image, (row, column), with one grey level where the mask `covered` is true.
    This level is the median of the other pixels in every eighth row and column."""
    free = image[::8, ::8][~covered[::8, ::8]]
    out = image.copy()
    out[covered] = np.partition(free, free.size // 2)[free.size // 2] if free.size else 0
    return out
