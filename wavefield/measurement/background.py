"""Beads apart from what lies below them: a floor, caustics, glare."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

_SURROUNDINGS = 4.0  # px: sigma of what is not a bead
_WIDTHS = 1.5, 8.0  # px: of beads at half their height
_NOISE = 1.0  # px: sigma that takes the noise of single pixels away
_SKEW = 0.3  # of the brightness: less is a texture
_SIDE = 3.0  # widths: what is larger is not a bead


def bead_width(image: NDArray[Any]) -> float:
    """Width of the beads' images at half their height, from the image's own correlation.

    Of the image less its surroundings (sigma 4 px). White noise adds to the correlation without shift alone,
    so the width follows from those for shifts of 1 and 2 px: a Gaussian bead of standard deviation s has
    exp(-r^2 / 4 s^2). The surroundings take some of a bead with them: widths of 2 to 7 px come out
    a tenth to a third too small. Beads make the brightness skew, a texture does not.

    With image (row, column).

    Examples
    --------
    >>> beads = np.random.default_rng(0).random((200, 200)) > 0.995
    >>> image = cv2.GaussianBlur(beads.astype(np.float32), (0, 0), 1.5)
    >>> round(bead_width(image), 1)  # of 3.5
    2.8
    """
    part = np.ascontiguousarray(image, np.float32)
    around = cv2.GaussianBlur(part, (0, 0), _SURROUNDINGS)
    if _skewness(cv2.GaussianBlur(part, (0, 0), _NOISE) - around) < _SKEW:
        return 0.0
    part = part - around
    part = np.clip(part, *np.percentile(part[::4, ::4], (1, 99.5)))
    part -= part.mean()
    one, two = (
        0.5 * float((part[:, k:] * part[:, :-k]).mean() + (part[k:] * part[:-k]).mean()) for k in (1, 2)
    )
    if one <= 0:
        return _WIDTHS[0]
    fall = max(np.log(one / max(two, 1e-6 * one)) / 3.0, 0.02)  # 1 / 4 s^2
    return float(np.clip(np.sqrt(8 * np.log(2.0)) * np.sqrt(0.25 / fall), *_WIDTHS))


def _skewness(part: NDArray[Any]) -> float:
    some = part[::2, ::2]
    some = some[np.isfinite(some)].astype(np.float64)
    if not some.size:
        return 0.0
    some -= some.mean()
    return float(np.mean(some**3) / max(np.mean(some**2) ** 1.5, 1e-30))


def above_floor(image: NDArray[Any], width: float) -> NDArray[Any]:
    """What is brighter than anything as large as three beads: a white top-hat.

    With image (row, column); width, px; returns (row, column).
    """
    if not width:
        return image
    side = int(np.ceil(_SIDE * width)) // 2 * 2 + 3
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    if image.dtype not in (np.uint8, np.uint16, np.float32):
        image = image.astype(np.float32)
    return np.asarray(cv2.morphologyEx(np.ascontiguousarray(image), cv2.MORPH_TOPHAT, kernel))
