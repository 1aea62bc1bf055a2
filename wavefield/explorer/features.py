"""What one image says of its lamp, its lens and its beads, as numbers."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.robust import PER_MEDIAN

_CELL = 16  # px: cells of which each should hold a bead
_FULL = (255, 1023, 4095, 16383, 65535)  # what 8, 10, 12, 14, 16 bits reach
_BROAD = 31  # px: what is broader is no bead


@dataclass(frozen=True)
class Features:
    """What one frame shows."""

    dark: float  # Grey levels below which 0.1 %, 50 % and 99.9 % of the pixels lie
    background: float
    peak: float
    saturated: float  # Fraction of pixels as bright as the camera can say
    cells: float  # Fraction of cells of 16 px that hold something bright
    size: float  # Standard deviation of the images of beads, px; NaN where there are none


def features(image: NDArray[Any]) -> Features:
    """Look at a frame.

    With image (row, column).
    """
    sample = image[::3, ::3]
    dark, background, peak = (float(v) for v in np.percentile(sample, [0.1, 50.0, 99.9]))
    top = next((full for full in _FULL if image.max() <= full), float(image.max()))
    if image.dtype.kind == "f":
        top = float(image.max()) or 1.0
    saturated = float(np.mean(sample >= top)) if peak > 0.5 * top else 0.0
    rows = image[::3].astype(np.float32)
    noise = PER_MEDIAN / np.sqrt(2.0) * float(np.median(np.abs(np.diff(rows, axis=1)))) + 0.5
    h, w = (n - n % _CELL for n in image.shape)
    cells = image[:h, :w].reshape(h // _CELL, _CELL, w // _CELL, _CELL).max(axis=(1, 3))
    held = float(np.mean(cells.astype(np.float32) - background > 5.5 * noise))
    return Features(dark, background, peak, saturated, held, bead_size(image) if held > 0.02 else np.nan)


def bead_size(image: NDArray[Any]) -> float:
    """Standard deviation of the images of beads, from how quickly an image forgets itself.

    Gaussian beads of standard deviation s correlate with themselves d pixels on by exp(-d^2 / (4 s^2)), so
    that s^2 = 3 / (4 ln(r(1) / r(2))); the noise of pixels, which is alone at d = 0, drops out.

    With image (row, column).
    """
    part = image[: 1 + min(image.shape[0], 1024), : 1 + min(image.shape[1], 1024)].astype(np.float32)
    part = part - cv2.blur(part, (_BROAD, _BROAD))  # lamps are uneven
    sizes = []
    for a in (part, part.T):
        one, two = float(np.mean(a[1:] * a[:-1])), float(np.mean(a[2:] * a[:-2]))
        if two > 0 and one > two:
            sizes.append(np.sqrt(0.75 / np.log(one / two)))
    return float(np.mean(sizes)) if sizes else float("nan")
