"""Read images of LaVision's DaVis (`.im7` buffers) by LaVision's own package, if it is installed."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.errors import FrameError
from wavefield.text import one_line

_HEAD = struct.Struct("<hhhh4i")  # version, packing, kind, sparse; columns, rows, depth, frames
MAX_COMPRESSION = 2000  # pixels per byte of a file; zlib does not compress more


def read_buffer(path: str | Path, frame: int | None = None) -> NDArray[Any]:
    """Return one image of a DaVis file (.im7), (row, column), in counts, by LaVision's package lvpyio.
    `frame` is the index of the image, from 0; None is for a file of one image. FrameError if that fails."""
    path = Path(path)
    try:
        import lvpyio
    except ImportError:
        raise FrameError(
            f"{path} is an image of DaVis: `pip install lvpyio` to read it, or export TIFF from DaVis"
        ) from None
    count = count_frames(path)
    if frame is None and count > 1:
        raise FrameError(f"{path} has {count} images: name the set and one of them, as in run.set/0")
    frame = frame or 0
    if not 0 <= frame < count:
        raise FrameError(f"{path} has {count} images: there is no image {frame}")
    try:
        return np.asarray(lvpyio.read_buffer(str(path))[frame].components["PIXEL"].planes[0])
    except Exception as error:  # damage raises errors of many kinds
        words = one_line(error).rstrip("!.")
        raise FrameError(f"{path} is damaged or truncated ({words}); copy it again") from None


def count_frames(path: Path) -> int:
    """Return the number of images in an .im7 file; FrameError if the file or its header is damaged.
    The header is checked here because LaVision's reader may hang on a damaged one."""
    try:
        size = path.stat().st_size
        with path.open("rb") as stream:
            head = stream.read(_HEAD.size)
    except FileNotFoundError:
        raise FrameError(f"{path}: no such image") from None
    except OSError as error:
        raise FrameError(f"{path} cannot be read: {error.strerror}") from None
    if len(head) < _HEAD.size:
        raise FrameError(f"{path} is empty or truncated; copy it again")
    columns, rows, depth, frames = (int(number) for number in _HEAD.unpack(head)[4:])
    sound = 0 < columns <= 65536 and 0 < rows <= 65536 and depth == 1 and 0 < frames <= 1000
    if not sound or columns * rows * frames > MAX_COMPRESSION * size:
        raise FrameError(f"{path} is not an image of DaVis, or its header is damaged; copy it again")
    return frames
