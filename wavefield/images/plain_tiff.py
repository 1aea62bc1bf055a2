"""Grey TIFF files that are not compressed: the layout of a series is parsed once."""

from io import BytesIO, FileIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tifffile
from numpy.typing import NDArray

HEADER_BYTES = 8  # order and kind; the place of the directory in a plain TIFF, before it in a BigTIFF
MAX_LAYOUTS = 64  # remembered
_TAGS_WITH_LISTS = ("StripOffsets", "StripByteCounts", "BitsPerSample", "SampleFormat")


class _TiffLayout(NamedTuple):
    """Place of the pixels in every file of one size that has these bytes at these places."""

    directory: tuple[tuple[int, bytes], ...]
    start: int
    shape: tuple[int, int]
    dtype: np.dtype[Any]


_layouts: dict[tuple[int, bytes], _TiffLayout] = {}


def read_plain_tiff(path: str | Path) -> NDArray[Any] | None:
    """Read a grey TIFF of 8 or 16 bits that is not compressed, (row, column), at the cost of its bytes.

    The directory of the first file of a series is parsed; of the others only size and directory are compared
    with it. None if it is anything else, or damaged: other readers report better what.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "img_00000.tif"
    >>> tifffile.imwrite(path, np.arange(6, dtype="uint16").reshape(2, 3))
    >>> read_plain_tiff(path)
    array([[0, 1, 2],
           [3, 4, 5]], dtype=uint16)
    """
    try:
        with FileIO(str(path)) as stream:
            size = stream.seek(0, 2)
            stream.seek(0)
            key = size, stream.read(HEADER_BYTES)
            # of a series the first directory is parsed; of the others size and directory are compared with it
            layout = _layouts.get(key)
            if layout is None or not _has_layout(stream, layout):
                layout = _parsed(stream, size)
                if layout is None:
                    return None
                if len(_layouts) >= MAX_LAYOUTS:
                    _layouts.clear()
                _layouts[key] = layout
            return _pixels(stream, layout)
    except Exception:  # whatever is wrong with it, other readers report it better
        return None


def _has_layout(stream: FileIO, layout: _TiffLayout) -> bool:
    for place, expected in layout.directory:
        stream.seek(place)
        if stream.read(len(expected)) != expected:
            return False
    return True


def _parsed(stream: FileIO, size: int) -> _TiffLayout | None:
    stream.seek(0)
    with tifffile.TiffFile(stream) as tiff:
        page: Any = tiff.pages.first
        plain = page.photometric == 1 and page.samplesperpixel == 1 and page.imagedepth == 1 and page.is_final
        if not plain or page.is_tiled or page.dtype not in (np.uint8, np.uint16) or page.ndim != 2:
            return None
        if page.bitspersample != 8 * page.dtype.itemsize or page.dataoffsets[0] + page.nbytes > size:
            return None
        kind = tiff.tiff
        if len(tiff.pages) > 1 or page.subifds:
            return None
        # with the place of the next directory, of which there is none
        directory = kind.tagnosize + kind.tagsize * len(page.tags) + kind.offsetsize
        spans = [(HEADER_BYTES, kind.offsetsize if kind.is_bigtiff else 0), (page.offset, directory)]
        for tag in page.tags:
            outside = not page.offset <= tag.valueoffset < page.offset + directory
            if outside and tag.name in _TAGS_WITH_LISTS:
                spans.append((tag.valueoffset, tag.valuebytecount))
        compared = []
        for place, count in spans:
            stream.seek(place)
            compared.append((place, stream.read(count)))
        dtype = page.dtype.newbyteorder(tiff.byteorder)
        return _TiffLayout(tuple(compared), int(page.dataoffsets[0]), page.shape, dtype)


def _pixels(stream: FileIO, layout: _TiffLayout) -> NDArray[Any]:
    out = np.empty(layout.shape, layout.dtype)
    stream.seek(layout.start)
    fill(out, stream)
    return out if out.dtype.isnative else out.byteswap(inplace=True).view(out.dtype.newbyteorder("="))


def fill(out: NDArray[Any], stream: FileIO | BytesIO) -> None:
    """Read bytes until an array is full; `EOFError` where there are too few."""
    rest = memoryview(out.reshape(-1).view(np.uint8))  # type: ignore[arg-type]  # which is a buffer
    while rest:
        count = stream.readinto(rest)
        if not count:
            raise EOFError
        rest = rest[count:]
