"""Digital negatives: the sensor's own values in a TIFF, not the preview before them."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from wavefield.errors import FrameError
from wavefield.text import one_line

_MOSAIC, _LINEAR = 32803, 34892  # photometric interpretation


def read_dng(path: str | Path) -> NDArray[Any]:
    """Read the sensor's values of a digital negative as a grey image."""
    try:
        with tifffile.TiffFile(path) as tiff:
            raw = [page for page in _pages(tiff) if page.photometric in (_MOSAIC, _LINEAR)]
            if not raw:
                raise FrameError(f"{path} holds no sensor's values: convert it to TIFF")
            page = max(raw, key=lambda one: int(np.prod(one.shape)))
            image = np.asarray(page.asarray())
    except FrameError:
        raise
    except FileNotFoundError:
        raise FrameError(f"{path}: no such image") from None
    except Exception as error:  # of many kinds, by the damage
        words = one_line(error)
        if "imagecodecs" in words:
            raise FrameError(
                f"{path} is compressed: `pip install imagecodecs`, or save it uncompressed"
            ) from None
        raise FrameError(f"{path} is corrupt or truncated: {words}") from None
    if image.ndim == 3:
        return np.asarray(image[..., 0] if image.shape[2] < 3 else np.rint(image.mean(2)).astype(image.dtype))
    if page.photometric == _LINEAR:
        return image
    kernel = np.array([0.25, 0.5, 0.25], np.float32)
    smooth = cv2.sepFilter2D(image.astype(np.float32), -1, kernel, kernel, borderType=cv2.BORDER_REFLECT_101)
    return np.rint(smooth).astype(image.dtype)


def _pages(tiff: tifffile.TiffFile) -> Iterator[Any]:
    for page in tiff.pages:
        yield page
        yield from getattr(page, "pages", None) or ()
