"""Images of a TIFF file by the meaning of their tags, alike for every compression.

Pixels are those of the sensor: an orientation tag turns nothing, since a rig belongs to images as they were
stored. Bright is bright: where the tags state that the smallest value is white, values are inverted.
"""

import struct
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from wavefield.errors import FrameError

MAX_COPIED_BYTES = 2**30  # of a file whose tags are changed in memory, for OpenCV to decode it
PAGES_TRIED = 4  # for thumbnails: where these have none, no page has
MAX_CHANNELS = 4


def frame_pages(tiff: tifffile.TiffFile) -> Sequence[int]:
    """Numbers of the pages that hold images; thumbnails and masks among them are left out."""
    pages: Any = tiff.pages
    if all(_is_frame(pages[k]) for k in range(min(len(pages), PAGES_TRIED))):
        return range(len(pages))
    return [k for k in range(len(pages)) if _is_frame(pages[k])]


def _is_frame(page: tifffile.TiffPage) -> bool:
    return not (page.is_reduced or page.is_mask)


def page_of(tiff: tifffile.TiffFile, page: int | None, name: str) -> int | NDArray[Any]:
    """Number of a page that any reader reads alike, or its image; None stands for the only one."""
    number = page
    if number is None:
        pages = frame_pages(tiff)
        if not pages:
            raise FrameError(f"{name} is corrupt or truncated: it has no image")
        if len(pages) > 1:
            raise FrameError(
                f"{name} has {len(pages)} images; name this file alone to read all, or save each to a file"
            )
        number = pages[0]
    elif number >= len(tiff.pages):
        raise FrameError(f"{name} has {len(tiff.pages)} pages: there is no page {number}")
    found: Any = tiff.pages[number]
    refuse_page(found, name)
    return number if is_as_stored(found) else read_by_tags(tiff, number, name)


def refuse_page(page: Any, name: str) -> None:
    """Refuse a page that is not one grey or colour image of real numbers."""
    if page.dtype is not None and page.dtype.kind == "c":
        raise FrameError(f"{name} has complex pixels; save their magnitudes")
    if page.imagedepth > 1:
        raise FrameError(f"{name} is a volume of {page.imagedepth} slices; save each as an image")
    if page.samplesperpixel > MAX_CHANNELS:
        raise FrameError(f"{name} has {page.samplesperpixel} channels; save one of them as a grey image")
    if page.subifds and any(inner.size > page.size for inner in page.pages):
        raise FrameError(f"{name} has a larger image inside of another (SubIFD); save that as a plain TIFF")


def is_as_stored(page: Any) -> bool:
    """Whether every reader gives the same pixels: neither turned nor inverted, nor in planes."""
    tag = page.tags.get("Orientation")
    plain = page.photometric != tifffile.PHOTOMETRIC.MINISWHITE and (tag is None or tag.value == 1)
    return plain and not _has_planes(page)


def _has_planes(page: Any) -> bool:
    """Whether channels are stored one after another, of which OpenCV reads right those of 8 bits only."""
    separate = page.planarconfig == tifffile.PLANARCONFIG.SEPARATE
    return bool(separate and page.samplesperpixel > 1 and page.bitspersample != 8)


def read_by_tags(tiff: tifffile.TiffFile, number: int, name: str) -> NDArray[Any]:
    """Read a page whose tags turn or invert its pixels, (row, column) or (row, column, blue-green-red)."""
    page: Any = tiff.pages[number]
    try:
        return read_page(tiff, number)
    except ValueError as error:  # of a compression that needs a package of its own
        if "imagecodecs" not in str(error):
            raise
    file = tiff.filehandle
    if file.size > MAX_COPIED_BYTES or _has_planes(page):
        raise FrameError(f"{name} is compressed, and turned, inverted or in planes; save it uncompressed")
    file.seek(0)
    data = bytearray(file.read())
    place = ("Q", 8) if tiff.is_bigtiff else ("I", 4)
    struct.pack_into(tiff.byteorder + place[0], data, place[1], page.offset)
    inverted = page.photometric == tifffile.PHOTOMETRIC.MINISWHITE
    for key in ("Orientation", *(["PhotometricInterpretation"] if inverted else [])):
        tag = page.tags.get(key)
        if tag is not None and int(tag.dtype) == tifffile.DATATYPE.SHORT:
            struct.pack_into(tiff.byteorder + "H", data, tag.valueoffset, 1)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise FrameError(f"{name} is corrupt or truncated, or of a compression that is not known")
    pixels: NDArray[Any] = np.asarray(image)
    if not inverted:
        return pixels
    return _inverted(pixels, 2 ** (8 * pixels.itemsize) - 1 if pixels.dtype.kind == "u" else None, name)


def read_page(tiff: tifffile.TiffFile, number: int) -> NDArray[Any]:
    """Read a page with tifffile, (row, column) or (row, column, blue-green-red)."""
    page: Any = tiff.pages[number]
    return as_bright(page, page.asarray())


def as_bright(page: Any, image: NDArray[Any]) -> NDArray[Any]:
    """Pixels of a page as tifffile reads them, blue first as OpenCV has it, and not inverted."""
    if image.dtype == bool:
        image = np.where(image, np.uint8(255), np.uint8(0))
    if image.ndim == 3 and page.planarconfig == tifffile.PLANARCONFIG.SEPARATE:
        image = np.moveaxis(image, 0, -1)
    if image.ndim == 3 and image.shape[2] >= 3:
        image = image[..., 2::-1]
    if page.photometric != tifffile.PHOTOMETRIC.MINISWHITE:
        return image
    bits = 8 * image.itemsize if page.bitspersample == 1 else page.bitspersample
    return _inverted(image, 2**bits - 1 if image.dtype.kind == "u" else None, page.parent.filename)


def _inverted(image: NDArray[Any], largest: int | None, name: str) -> NDArray[Any]:
    if largest is None:
        raise FrameError(f"{name} is a negative (MinIsWhite) of signed numbers; save it as MinIsBlack")
    return np.asarray(image.dtype.type(largest) - image)
