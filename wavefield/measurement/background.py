"""Separating beads from what is below them: a floor, caustics, glare."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

SURROUNDINGS_SIGMA_PX = 4.0
BEAD_WIDTHS_PX = 1.5, 8.0  # at half their height
NOISE_SIGMA_PX = 1.0  # of the blur that removes the noise of single pixels
MIN_SKEWNESS = 0.3  # of the brightness: less is a texture
MAX_SIZE_TO_WIDTH = 3.0  # of a bead


def bead_width(image: NDArray[Any]) -> float:
    """Width of the beads' images at half their height, from the image's own correlation.

    Of the image less its surroundings (sigma 4 px). White noise adds to the correlation without shift alone,
    so the width follows from those for shifts of 1 and 2 px: a Gaussian bead of standard deviation s has
    exp(-r^2 / 4 s^2). Subtracting the surroundings removes part of a bead: widths of 2 to 7 px come out a
    tenth to a third too small. Beads skew the distribution of brightness, a texture does not: its width is 0.

    Examples
    --------
    >>> beads = np.random.default_rng(0).random((200, 200)) > 0.995
    >>> image = cv2.GaussianBlur(beads.astype(np.float32), (0, 0), 1.5)
    >>> round(bead_width(image), 1)  # of 3.5
    2.8
    """
    part = np.ascontiguousarray(image, np.float32)
    # subtracting the surroundings removes part of a bead: hence the bias of the width
    around = cv2.GaussianBlur(part, (0, 0), SURROUNDINGS_SIGMA_PX)
    # beads skew the distribution of brightness, a texture does not
    if _skewness(cv2.GaussianBlur(part, (0, 0), NOISE_SIGMA_PX) - around) < MIN_SKEWNESS:
        return 0.0
    part = part - around
    part = np.clip(part, *np.percentile(part[::4, ::4], (1, 99.5)))
    part -= part.mean()
    # white noise adds to the correlation without shift alone: only shifts of 1 and 2 px are used
    one, two = (
        0.5 * float((part[:, k:] * part[:, :-k]).mean() + (part[k:] * part[:-k]).mean()) for k in (1, 2)
    )
    if one <= 0:
        return BEAD_WIDTHS_PX[0]
    fall = max(np.log(one / max(two, 1e-6 * one)) / 3.0, 0.02)  # 1 / 4 s^2
    return float(np.clip(np.sqrt(8 * np.log(2.0)) * np.sqrt(0.25 / fall), *BEAD_WIDTHS_PX))


def _skewness(part: NDArray[Any]) -> float:
    some = part[::2, ::2]
    some = some[np.isfinite(some)].astype(np.float64)
    if not some.size:
        return 0.0
    some -= some.mean()
    return float(np.mean(some**3) / max(np.mean(some**2) ** 1.5, 1e-30))


def above_floor(image: NDArray[Any], width: float) -> NDArray[Any]:
    """Brightness in excess of anything as large as three beads: a white top-hat."""
    if not width:
        return image
    side = int(np.ceil(MAX_SIZE_TO_WIDTH * width)) // 2 * 2 + 3
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    if image.dtype not in (np.uint8, np.uint16, np.float32):
        image = image.astype(np.float32)
    return np.asarray(cv2.morphologyEx(np.ascontiguousarray(image), cv2.MORPH_TOPHAT, kernel))
