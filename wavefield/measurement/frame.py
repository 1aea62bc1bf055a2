"""One frame of one camera before matching: whether it is usable, and making beads equally bright."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.compiled import compiled
from wavefield.images import made_even
from wavefield.measurement.background import above_floor, bead_width
from wavefield.measurement.rectify import bin_pixels

KNEE_TO_CONTRAST = 0.5  # above the background; below, the logarithm is nearly linear
LEVEL_QUANTILES = 0.01, 0.5, 0.99
BETWEEN_CAMERAS, IN_TIME = 1.5, 0.6  # `sharpened` for the surface and for displacements
GREY_LEVELS_PER_E = 5000.0  # log(65535) still fits 16 bits


def usable(image: NDArray[Any] | None, size: tuple[int, int]) -> bool:
    """Whether a frame has the size of its camera (width, height), numbers and contrast."""
    if image is None or np.ndim(image) != 2 or image.shape != (size[1], size[0]):
        return False
    if image.dtype.kind not in "uif":
        return False
    low, _, high = _levels(image)
    return high > low


def ready(
    image: NDArray[Any], count: int, width: float | None = None, covered: NDArray[np.bool_] | None = None
) -> NDArray[Any]:
    """A usable frame as it is matched: the floor subtracted, brightness evened out, pixels binned.
    The width of its beads, px, is found if None; covered pixels do not count.
    """
    if covered is not None:
        image = made_even(image, covered)
    width = bead_width(image) if width is None else width
    if width:
        image = above_floor(image, width)
        low, half, _ = _levels(image, covered)
        # beads are brighter than the median: a black level above it suppresses grains of a floor and noise
        return bin_pixels(even_out(image, half + (half - low), covered), count)
    return bin_pixels(even_out(image, covered=covered), count)


def sharpened(image: NDArray[Any], amount: float) -> NDArray[np.float32]:
    """An image with its short waves raised, so that beads do not reach into each other.
    Where one does, brightness that differs between cameras pulls at the match, with the spectrum of beads.
    """
    kernel = np.array([-amount, 1.0 + 2.0 * amount, -amount], np.float32)
    part = np.ascontiguousarray(image, np.float32)
    return np.asarray(cv2.sepFilter2D(part, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_REPLICATE))


def even_out(
    image: NDArray[Any], black: float | None = None, covered: NDArray[np.bool_] | None = None
) -> NDArray[Any]:
    """Logarithm of the brightness above the black level B: log(1 + (I - B) / (0.5 (I_99 - B))).
    Beads bright in one camera would pull the match; factors become additions, and gain and offset drop out.
    """
    low, _, high = _levels(image, covered)
    low = low if black is None else black
    knee = max(KNEE_TO_CONTRAST * (high - low), 1e-6 * max(abs(low), abs(high), 1e-30))
    if image.dtype in (np.uint8, np.uint16):
        grey = np.arange(256 if image.dtype == np.uint8 else 65536, dtype=np.float64)
        table = np.rint(GREY_LEVELS_PER_E * np.log1p(np.maximum(grey - low, 0.0) / knee))
        table = np.minimum(table, 65535.0).astype(np.uint16)
        image = np.ascontiguousarray(image)
        if image.dtype == np.uint8:
            return cv2.LUT(image, table)
        out = np.empty(image.shape, np.uint16)
        _table_value(image, table, out)
        return out
    above = np.maximum(image.astype(np.float32) - np.float32(low), np.float32(0.0))
    result: NDArray[Any] = np.float32(GREY_LEVELS_PER_E) * np.log(np.float32(1.0) + above / np.float32(knee))
    return result


@compiled()
def _table_value(image: NDArray[Any], table: NDArray[Any], out: NDArray[Any]) -> None:
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            out[y, x] = table[image[y, x]]


def _levels(image: NDArray[Any], covered: NDArray[np.bool_] | None = None) -> tuple[float, float, float]:
    """Brightness at 1, 50 and 99 % of a sample of the image; all equal if the image is too small."""
    sample = image[3::8, 3::8].ravel()
    if covered is not None:
        sample = sample[~covered[3::8, 3::8].ravel()]
    if image.dtype in (np.uint8, np.uint16):
        counts = np.bincount(sample)  # many times faster than sorting
        grey = np.flatnonzero(counts)
        counts = counts[grey]
    else:
        sample = sample.astype(np.float32)
        sample = sample[np.isfinite(sample)]
        if 2 * sample.size < image.size // 64:
            return 0.0, 0.0, 0.0
        grey, counts = np.unique(sample, return_counts=True)
    if not sample.size:
        return 0.0, 0.0, 0.0
    # between grey levels: whole ones, far apart where 8 bit are dark, would jump from frame to frame
    rank = np.cumsum(counts) - 0.5 * counts
    low, half, high = np.interp(sample.size * np.array(LEVEL_QUANTILES), rank, grey)
    return float(low), float(half), float(high)
