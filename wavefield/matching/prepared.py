"""What one image needs before it can be matched, done once however many times it is used."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from wavefield.errors import FrameError
from wavefield.matching.kernels import BLOCK, PAD
from wavefield.matching.settings import Settings

_COARSE = 8  # local means and variances are taken on an image at most this many times smaller
_UNIFORM = 0.05  # of the image's median local standard deviation: less contrast is not amplified
_SMALLEST = 8 * BLOCK  # px: pyramid levels with a smaller side are left out
_NO_MASK = np.empty((0, 0), np.uint8)


@dataclass(frozen=True)
class Level:
    """One pyramid level of a prepared image.

    Parameters
    ----------
    padded : (h + 2 PAD, w + 2 PAD) float32
        The image with replicated border.
    good : (h, w) uint8
        1 where all pixels of a block around the pixel may be used; (0, 0) where nothing is masked.
    """

    padded: np.ndarray
    good: np.ndarray

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width, px."""
        return self.padded.shape[0] - 2 * PAD, self.padded.shape[1] - 2 * PAD

    @property
    def blocks(self) -> tuple[int, int]:
        """Rows and columns of blocks."""
        return self.shape[0] // BLOCK, self.shape[1] // BLOCK

    @property
    def image(self) -> np.ndarray:
        """(h, w) float32: the image without its border."""
        return self.padded[PAD:-PAD, PAD:-PAD]


@dataclass(frozen=True)
class Prepared:
    """An image ready to be matched: its pyramid, finest level first.

    Parameters
    ----------
    levels : tuple of Level
        Finest first.
    normalization : float
        That of the settings it was prepared with.
    """

    levels: tuple[Level, ...]
    normalization: float

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the image, px."""
        return self.levels[0].shape


def prepare(image: np.ndarray, settings: Settings, mask: np.ndarray | None = None) -> Prepared:
    """Prepare an image for matching.

    Parameters
    ----------
    image : (h, w) uint8, uint16, float32 or other real type
        The image; pixels that are not finite, and flat patches at the image's largest value
        (saturation), are left out.
    settings : Settings
        Uses the number of levels and the normalisation.
    mask : (h, w) bool, optional
        True where pixels may be used.

    Returns
    -------
    Prepared

    Raises
    ------
    FrameError
        If the image is not a grey image of at least 20 x 20 px, or the mask has another shape.

    Examples
    --------
    >>> import numpy as np
    >>> image = np.random.default_rng(0).integers(0, 255, (120, 160), dtype=np.uint8)
    >>> prepare(image, Settings.piv()).shape
    (120, 160)
    """
    image = np.asarray(image)
    if image.ndim != 2 or min(image.shape) < 4 * BLOCK:
        raise FrameError(
            f"an image of shape {image.shape} cannot be matched: it must be grey and at least "
            f"{4 * BLOCK} px wide and high"
        )
    if not (np.issubdtype(image.dtype, np.floating) or np.issubdtype(image.dtype, np.integer)):
        raise FrameError(f"an image of {image.dtype} cannot be matched: give whole or real numbers")
    if mask is not None and np.shape(mask) != image.shape:
        raise FrameError(f"the mask is {np.shape(mask)} but the image is {image.shape}: make them the same")
    if image.dtype not in (np.uint8, np.uint16, np.float32):
        image = image.astype(np.float32)
    good = _usable(image, mask)
    h, w = image.shape
    padded = np.empty((h + 2 * PAD, w + 2 * PAD), np.float32)
    inner = padded[PAD:-PAD, PAD:-PAD]
    np.copyto(inner, image, casting="unsafe")
    if settings.normalization > 0 or good is not None:
        _normalize(inner, good, settings.normalization)
    levels: list[Level] = []
    for number in range(depth(image.shape, settings.levels)):
        if number:
            even = levels[-1].image[: h // 2 * 2, : w // 2 * 2]
            h, w = h // 2, w // 2
            padded = np.empty((h + 2 * PAD, w + 2 * PAD), np.float32)
            padded[PAD:-PAD, PAD:-PAD] = cv2.resize(even, (w, h), interpolation=cv2.INTER_AREA)
            if good is not None:
                share = cv2.resize(
                    good[: 2 * h, : 2 * w] * np.uint8(255), (w, h), interpolation=cv2.INTER_AREA
                )
                good = (share > 250).astype(np.uint8)
        _replicate_border(padded)
        levels.append(Level(padded, _NO_MASK if good is None else _whole_blocks(good, number)))
    return Prepared(tuple(levels), settings.normalization)


def depth(shape: tuple[int, ...], levels: int) -> int:
    """Number of pyramid levels, at most `levels`, that an image of this shape is good for."""
    side = min(shape)
    while levels > 1 and side >> (levels - 1) < _SMALLEST:
        levels -= 1
    return levels


def _usable(image: np.ndarray, mask: np.ndarray | None) -> np.ndarray | None:
    """(h, w) uint8, 1 where pixels may be used; None where all may."""
    good = None if mask is None or np.all(mask) else np.asarray(mask, bool)
    if np.issubdtype(image.dtype, np.floating):
        finite = np.isfinite(image)
        if not finite.all():
            good = finite if good is None else good & finite
    largest = image.max() if good is None else np.max(image, where=good, initial=0)
    if largest > 0:
        bright = cv2.inRange(image, float(largest), float(largest)) // 255
        flat = cv2.morphologyEx(bright, cv2.MORPH_OPEN, np.ones((5, 5), np.uint8))
        if cv2.countNonZero(flat):
            good = flat == 0 if good is None else good & (flat == 0)
    return None if good is None else good.astype(np.uint8)


def _whole_blocks(good: np.ndarray, level: int) -> np.ndarray:
    """1 where the block around a pixel, and at the finest level the reach of its spline, is good."""
    side = BLOCK + 4 if level == 0 else BLOCK
    return cv2.erode(good, np.ones((side, side), np.uint8), borderType=cv2.BORDER_REPLICATE)


def _replicate_border(padded: np.ndarray) -> None:
    padded[PAD:-PAD, :PAD] = padded[PAD:-PAD, PAD : PAD + 1]
    padded[PAD:-PAD, -PAD:] = padded[PAD:-PAD, -PAD - 1 : -PAD]
    padded[:PAD] = padded[PAD]
    padded[-PAD:] = padded[-PAD - 1]


def _normalize(image: np.ndarray, good: np.ndarray | None, sigma: float) -> None:
    """Local normalisation, in place: zero mean, unit variance; masked pixels become 0.

    With sigma 0 only masked pixels change: they get the mean of their surroundings.
    """
    h, w = image.shape
    width = max(sigma if sigma > 0 else 16.0, 1.0)
    q = _COARSE
    while q > 1 and (width < 2 * q or min(h, w) < 8 * q):
        q //= 2
    size = (w // q, h // q)

    spare = np.empty((h, w), np.float32)

    def local(values: np.ndarray) -> np.ndarray:
        small = cv2.resize(values, size, interpolation=cv2.INTER_AREA)
        return cv2.GaussianBlur(small, (0, 0), width / q, borderType=cv2.BORDER_REPLICATE)

    def full(values: np.ndarray) -> np.ndarray:
        return cv2.resize(values, (w, h), dst=spare, interpolation=cv2.INTER_LINEAR)

    share = None
    if good is not None:
        image[good == 0] = 0
        share = np.maximum(local(good.astype(np.float32)), np.float32(1e-3))
    mean = local(image)
    if share is not None:
        mean /= share
    if sigma == 0:
        assert good is not None
        np.copyto(image, full(mean), where=good == 0)
        return
    square = local(cv2.multiply(image, image, dst=spare))
    if share is not None:
        square /= share
    std = np.sqrt(np.maximum(square - mean * mean, 0))
    seen = std if share is None else std[share > 0.5]
    typical = float(np.median(seen)) if seen.size else 0.0
    scale = 1 / np.maximum(std, np.float32(max(_UNIFORM * typical, 1e-6)))
    cv2.subtract(image, full(mean), dst=image)
    cv2.multiply(image, full(scale), dst=image)
    if good is not None:
        image *= good
