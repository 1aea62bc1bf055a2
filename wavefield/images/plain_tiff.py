"""Grey TIFF files that are not compressed: those of a series are laid out alike, which is found out once."""

from io import FileIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tifffile
from numpy.typing import NDArray

_HEAD = 8  # bytes: order and kind; in a plain TIFF also where its directory is, in a BigTIFF the next eight
_SPREAD = ("StripOffsets", "StripByteCounts", "BitsPerSample", "SampleFormat")  # lists beside the directory
_MOST = 64  # layouts kept in mind


class _TiffLayout(NamedTuple):
    """Where the pixels are, in every file of this size in which these bytes stand in these places."""

    known: tuple[tuple[int, bytes], ...]
    start: int
    shape: tuple[int, int]
    dtype: np.dtype[Any]


_layouts: dict[tuple[int, bytes], _TiffLayout] = {}


def read_plain_tiff(path: str | Path) -> NDArray[Any] | None:
    """Read a whole grey TIFF of 8 or 16 bits that is not compressed, at the cost of its bytes.

    The directory of the first file of a series is parsed; of the others only size and directory are compared
    with it.

    Returns (row, column): None if it is anything else, or damaged: other readers say better what.

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
            key = size, stream.read(_HEAD)
            layout = _layouts.get(key)
            if layout is None or not _is_at(stream, layout):
                layout = _found(stream, size)
                if layout is None:
                    return None
                if len(_layouts) >= _MOST:
                    _layouts.clear()
                _layouts[key] = layout
            return _pixels(stream, layout)
    except Exception:  # whatever is wrong with it, others say it better
        return None


def _is_at(stream: FileIO, layout: _TiffLayout) -> bool:
    for place, expected in layout.known:
        stream.seek(place)
        if stream.read(len(expected)) != expected:
            return False
    return True


def _found(stream: FileIO, size: int) -> _TiffLayout | None:
    stream.seek(0)
    with tifffile.TiffFile(stream) as tiff:
        page: Any = tiff.pages.first
        plain = page.photometric == 1 and page.samplesperpixel == 1 and page.imagedepth == 1 and page.is_final
        if not plain or page.is_tiled or page.dtype not in (np.uint8, np.uint16) or page.ndim != 2:
            return None
        if page.bitspersample != 8 * page.dtype.itemsize or page.dataoffsets[0] + page.nbytes > size:
            return None
        kind = tiff.tiff
        directory = kind.tagnosize + kind.tagsize * len(page.tags)
        spans = [(_HEAD, kind.offsetsize if kind.is_bigtiff else 0), (page.offset, directory)]
        for tag in page.tags:
            beside = not page.offset <= tag.valueoffset < page.offset + directory
            if beside and tag.name in _SPREAD:
                spans.append((tag.valueoffset, tag.valuebytecount))
        known = []
        for place, count in spans:
            stream.seek(place)
            known.append((place, stream.read(count)))
        dtype = page.dtype.newbyteorder(tiff.byteorder)
        return _TiffLayout(tuple(known), int(page.dataoffsets[0]), page.shape, dtype)


def _pixels(stream: FileIO, layout: _TiffLayout) -> NDArray[Any] | None:
    out = np.empty(layout.shape, layout.dtype)
    rest = memoryview(out.reshape(-1).view(np.uint8))  # type: ignore[arg-type]  # which is a buffer
    stream.seek(layout.start)
    while rest:
        count = stream.readinto(rest)
        if not count:
            return None
        rest = rest[count:]
    return out if out.dtype.isnative else out.byteswap(inplace=True).view(out.dtype.newbyteorder("="))
