"""Read TIFF files, decoded by tifffile and imagecodecs.

Images stay as stored: orientation tags are ignored, because cameras are calibrated with the stored images.
Values are inverted if the tags say that 0 is white, so that large values are always bright.
"""

import logging
from collections.abc import Sequence
from typing import Any, BinaryIO

import numpy as np
import tifffile
from numpy.typing import NDArray
from tifffile import COMPRESSION, PHOTOMETRIC

from wavefield.errors import FrameError
from wavefield.text import one_line

logging.getLogger("tifffile").addHandler(logging.NullHandler())  # damage is reported by our own errors
ENDINGS = (".tif", ".tiff")
STARTS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
GREY = (PHOTOMETRIC.MINISBLACK, PHOTOMETRIC.MINISWHITE)
COLOUR = (PHOTOMETRIC.RGB, PHOTOMETRIC.PALETTE)
JPEG = (COMPRESSION.JPEG, COMPRESSION.OJPEG)  # their YCbCr is decoded as RGB
PAGES_TRIED = 4  # pages that are tested for thumbnails: if none of these is one, no page is


class TiffImages:
    """The images of a TIFF file, (row, column) or (row, column, RGB), without its thumbnails.
    ImageJ's stacks beyond 4 GB, which describe only their first image, are read too."""

    def __init__(self, source: str | BinaryIO, name: str) -> None:
        self.name = name
        try:
            self.file = tifffile.TiffFile(source)
            pages: Any = self.file.pages
            some = [pages[k] for k in range(min(len(pages), PAGES_TRIED))]
            self._pages: Sequence[int] = range(len(pages))
            if not all(map(_is_frame, some)):
                self._pages = [k for k in self._pages if _is_frame(pages[k])]
            stacked = int((self.file.imagej_metadata or {}).get("images", 1)) if len(pages) == 1 else 1
        except FileNotFoundError:
            raise FrameError(f"{name}: no such image") from None
        except Exception as error:  # of many kinds, by the damage
            raise _corrupt(name, error) from None
        self._stacked = stacked > 1
        self.count = stacked if self._stacked else len(self._pages)

    def read(self, index: int) -> NDArray[Any]:
        """Return the image at an index, from 0: (row, column) or (row, column, RGB). FrameError if bad."""
        try:
            number = index if self._stacked else self._pages[index]
            page: Any = self.file.pages[0 if self._stacked else number]
            refuse_page(page, self.name)
            _refuse_missing_parts(page, self.file.filehandle.size)
            if self._stacked and index:
                return _as_bright(page, self._in_stack(page, index), self.name)
            return _as_bright(page, page.asarray(), self.name)
        except FrameError:
            raise
        except Exception as error:
            if index >= self.count:
                raise FrameError(f"{self.name} has no image {index}: is it truncated?") from None
            raise _corrupt(self.name, error) from None

    def _in_stack(self, page: Any, index: int) -> NDArray[Any]:
        """Return the image at an index from 0 of an ImageJ stack, whose only `page` is the first image."""
        if page.compression != COMPRESSION.NONE:
            raise FrameError(f"{self.name} is a compressed stack with one directory; save each image")
        handle = self.file.filehandle
        handle.seek(page.dataoffsets[0] + index * page.nbytes)
        dtype = page.dtype.newbyteorder(self.file.byteorder)
        pixels = handle.read_array(dtype, int(np.prod(page.shape)))
        return np.asarray(pixels.reshape(page.shape), page.dtype)

    def close(self) -> None:
        """Close the file."""
        self.file.close()


def _corrupt(name: str, error: Exception) -> FrameError:
    """Return the error to raise for a file that tifffile cannot read."""
    return FrameError(f"{name} is corrupt or truncated: {one_line(error)}; copy it again from the camera")


def _is_frame(page: tifffile.TiffPage) -> bool:
    """Whether a TIFF page is an image in full size, not a thumbnail or a mask."""
    return not (page.is_reduced or page.is_mask)


def refuse_page(page: Any, name: str) -> None:
    """Raise FrameError if a page of the TIFF file `name` is of a kind that is not supported.
    Supported are grey and colour images of real numbers, with a compression that tifffile decodes."""
    if page.dtype is not None and page.dtype.kind == "c":
        raise FrameError(f"{name} has complex pixels; save their magnitudes")
    if page.imagedepth > 1:
        raise FrameError(f"{name} is a volume of {page.imagedepth} slices; save each as an image")
    if page.compression not in tifffile.TIFF.DECOMPRESSORS:
        raise FrameError(f"{name}: compression {_words(page.compression)} is not supported; save it plain")
    ycbcr = page.photometric == PHOTOMETRIC.YCBCR and page.compression in JPEG
    if page.photometric not in (*GREY, *COLOUR) and not ycbcr:
        raise FrameError(f"{name}: pixels of kind {_words(page.photometric)} are not supported; save in grey")
    colours = 1 if page.photometric in (*GREY, PHOTOMETRIC.PALETTE) else 3
    if page.samplesperpixel - len(page.extrasamples) > colours or len(page.extrasamples) > 1:
        raise FrameError(f"{name} has {page.samplesperpixel} channels; save one of them as a grey image")
    if 0 in page.shape:
        raise FrameError(f"{name} is corrupt: its header is that of no image; copy it again from the camera")
    if page.dtype is None or len(page.shape) not in (2, 3):
        raise FrameError(f"{name}: pixels of {page.bitspersample} bits are not supported; save 8 or 16 bits")


def _words(code: Any) -> str:
    """Return the name of a TIFF tag's value, such as "LZW" for a compression; its number if it has none."""
    return getattr(code, "name", str(code))


def _refuse_missing_parts(page: Any, size: int) -> None:
    """Raise ValueError if some pixels of a TIFF page are empty, or lie beyond the `size` (bytes) of the file.
    Without this check tifffile would return zeros for the missing pixels."""
    ends = [start + count for start, count in zip(page.dataoffsets, page.databytecounts)]
    if not ends or min(page.databytecounts) == 0 or max(ends) > size:
        raise ValueError("the file ends before its pixels")


def _as_bright(page: Any, image: NDArray[Any], name: str) -> NDArray[Any]:
    """Return the decoded image of a page as (row, column) or (row, column, RGB), with large values bright.
    Alpha is dropped, palettes are applied, images in which 0 is white are inverted, bits become 0 or 255."""
    if image.ndim == 3 and page.planarconfig == tifffile.PLANARCONFIG.SEPARATE:
        image = np.moveaxis(image, 0, -1)
    if page.extrasamples:
        image = image[..., : -len(page.extrasamples)]
        image = image[..., 0] if image.shape[-1] == 1 else image
    if page.photometric == PHOTOMETRIC.PALETTE:
        return np.asarray(np.moveaxis(page.colormap[:, image] >> 8, 0, -1), np.uint8)
    if page.photometric == PHOTOMETRIC.MINISWHITE:
        if image.dtype.kind not in "ub":
            raise FrameError(f"{name} is a negative (MinIsWhite) of signed numbers; save it as MinIsBlack")
        image = ~image if image.dtype == bool else image.dtype.type(2**page.bitspersample - 1) - image
    return np.where(image, np.uint8(255), np.uint8(0)) if image.dtype == bool else image
