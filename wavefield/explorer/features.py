"""Brightness, saturation, seeding and bead size of one frame, as numbers."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.robust import PER_MEDIAN

_CELL_PX = 16  # each such cell should contain a bead
_FULL_SCALES = (255, 1023, 4095, 16383, 65535)  # of 8, 10, 12, 14, 16 bits
_BACKGROUND_PX = 31  # wider structures are not beads
_BEAD_SIZE_PX = 1024  # size of the part in which the beads are measured
_MIN_CELLS = 0.02  # with beads, for a bead size
_BRIGHT = 5.5  # standard deviations of the noise above the background
Image = NDArray[Any]


@dataclass(frozen=True)
class FrameFeatures:
    """Features of one frame."""

    dark: float  # grey levels below which 0.1 %, 50 % and 99.9 % of the pixels are
    background: float
    peak: float
    saturated: float  # fraction of pixels at the full scale
    cells: float  # fraction of cells of 16 px with something bright
    bead_size: float  # standard deviation of the images of beads, px; NaN without beads


def frame_features(image: Image) -> FrameFeatures:
    """Features of a frame (row, column)."""
    sample = image[::3, ::3]
    dark, background, peak = (float(v) for v in np.percentile(sample, [0.1, 50.0, 99.9]))
    brightest = float(image.max())
    full_scale = next((full for full in _FULL_SCALES if brightest <= full), brightest)
    if image.dtype.kind == "f":
        full_scale = brightest or 1.0
    saturated = float(np.mean(sample >= full_scale)) if peak > 0.5 * full_scale else 0.0
    rows = image[::3].astype(np.float32)
    noise = PER_MEDIAN / np.sqrt(2.0) * float(np.median(np.abs(np.diff(rows, axis=1)))) + 0.5
    h, w = (n - n % _CELL_PX for n in image.shape)
    cells = image[:h, :w].reshape(h // _CELL_PX, _CELL_PX, w // _CELL_PX, _CELL_PX).max(axis=(1, 3))
    seeded = float(np.mean(cells.astype(np.float32) - background > _BRIGHT * noise))
    size = bead_size(image) if seeded > _MIN_CELLS else np.nan
    return FrameFeatures(dark, background, peak, saturated, seeded, size)


def bead_size(image: Image) -> float:
    """Standard deviation of the images of beads in a frame (row, column), px, from its autocorrelation.
    Gaussian beads correlate as r(d) ~ exp(-d^2 / (4 s^2)), so that s^2 = 3 / (4 ln(r(1) / r(2))).
    """
    part = image[: _BEAD_SIZE_PX + 1, : _BEAD_SIZE_PX + 1].astype(np.float32)
    part = part - cv2.blur(part, (_BACKGROUND_PX, _BACKGROUND_PX))  # uneven light
    sizes = []
    for a in (part, part.T):
        # the noise of pixels enters r(0) only
        r1, r2 = float(np.mean(a[1:] * a[:-1])), float(np.mean(a[2:] * a[:-2]))
        if r1 > r2 > 0:
            sizes.append(np.sqrt(0.75 / np.log(r1 / r2)))
    return float(np.mean(sizes)) if sizes else float("nan")
