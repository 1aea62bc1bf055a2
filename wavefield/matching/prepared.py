"""Preparation of an image for matching, done once for all its matches."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from wavefield.errors import FrameError
from wavefield.matching.matching_kernels import (
    BLOCK,
    PAD,
    gradient_moments,
    strain_moments,
    work_space,
)
from wavefield.matching.matching_settings import MatchSettings
from wavefield.matching.normalize import NormalizationCells, usable_share

FILL_SIGMA = 16.0  # px: width of the surroundings whose mean fills masked pixels
SATURATED_SIDE = 5  # px: of the smallest saturated patch
MIN_LEVEL_SIDE = 8 * BLOCK  # px: pyramid levels with a smaller side are left out
NO_MASK = np.empty((0, 0), np.uint8)


@dataclass(frozen=True)
class Level:
    """One pyramid level of a prepared image."""

    padded: np.ndarray  # (h + 2 PAD, w + 2 PAD): the image with replicated border
    # (h, w): 1 where all pixels of a block around the pixel may be used; (0, 0) where nothing is masked
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

    @cached_property
    def moments(self) -> np.ndarray:
        """(9, ny, nx) float32: the sums of `gradient_moments`, kept: an image may be matched to several."""
        out = np.empty((9, *self.blocks), np.float32)
        gradient_moments(self.padded, work_space(self.blocks[1]), out)
        return out

    @cached_property
    def strain(self) -> np.ndarray:
        """(8, ny, nx) float32: the sums of `strain_moments`, kept like `moments`."""
        out = np.empty((8, *self.blocks), np.float32)
        strain_moments(self.padded, work_space(self.blocks[1]), out)
        return out


@dataclass(frozen=True)
class PreparedImage:
    """A pyramid of an image, ready to be matched.

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


@dataclass(frozen=True)
class Mask:
    """The pixels that may be used, computed once for many images."""

    good: np.ndarray  # (h, w): 1 where a pixel may be used
    levels: tuple[np.ndarray, ...]  # (h, w): `Level.good` of each pyramid level, finest first
    share: np.ndarray  # (ny, nx): Share of usable pixels around the cells of the normalisation

    @staticmethod
    def of(good: np.ndarray, settings: MatchSettings) -> Mask:
        """The mask of pixels (h, w) that may be used."""
        usable = good = np.array(good, bool, order="C").view(np.uint8)
        levels = [_usable_blocks(good, 0)]
        for number in range(1, level_count(good.shape, settings.levels)):
            h, w = usable.shape[0] // 2, usable.shape[1] // 2
            part = cv2.resize(usable[: 2 * h, : 2 * w] * np.uint8(255), (w, h), interpolation=cv2.INTER_AREA)
            usable = (part > 250).astype(np.uint8)
            levels.append(_usable_blocks(usable, number))
        return Mask(good, tuple(levels), usable_share(good, settings.normalization or FILL_SIGMA))


def prepare(
    image: np.ndarray, settings: MatchSettings, mask: np.ndarray | Mask | None = None
) -> PreparedImage:
    """Prepare an image for matching.

    Parameters
    ----------
    image : (h, w) uint8, uint16, float32 or other real type
        The image; pixels that are not finite, and flat patches at the image's largest value
        (saturation), are left out.
    settings : MatchSettings
        Uses the number of levels and the normalisation.
    mask : (h, w) bool, or Mask, optional
        True where pixels may be used; make a Mask, for these settings, of one that many images share.

    Returns
    -------
    PreparedImage

    Raises
    ------
    FrameError
        If the image is not a grey image of at least 20 x 20 px, or the mask has another shape.

    Examples
    --------
    >>> import numpy as np
    >>> image = np.random.default_rng(0).integers(0, 255, (120, 160), dtype=np.uint8)
    >>> prepare(image, MatchSettings.piv()).shape
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
    if mask is not None:
        shape = mask.good.shape if isinstance(mask, Mask) else np.shape(mask)
        if shape != image.shape:
            raise FrameError(f"the mask is {shape} but the image is {image.shape}: make them the same")
        if not isinstance(mask, Mask):
            mask = None if np.all(mask) else Mask.of(mask, settings)
    if image.dtype not in (np.uint8, np.uint16, np.float32):
        image = image.astype(np.float32)
    h, w = image.shape
    padded = _padded(h, w)
    mask = _normalize(image, mask, settings, padded)
    levels: list[Level] = []
    for number in range(level_count(image.shape, settings.levels)):
        if number:
            even = levels[-1].image[: h // 2 * 2, : w // 2 * 2]
            h, w = h // 2, w // 2
            padded = _padded(h, w)
            cv2.resize(even, (w, h), dst=padded[PAD:-PAD, PAD:-PAD], interpolation=cv2.INTER_AREA)
        _replicate_border(padded)
        levels.append(Level(padded, NO_MASK if mask is None else mask.levels[number]))
    return PreparedImage(tuple(levels), settings.normalization)


def level_count(shape: tuple[int, ...], levels: int) -> int:
    """Number of pyramid levels of an image of this shape, at most `levels`."""
    side = min(shape)
    while levels > 1 and side >> (levels - 1) < MIN_LEVEL_SIDE:
        levels -= 1
    return levels


def _normalize(
    image: np.ndarray, mask: Mask | None, settings: MatchSettings, padded: np.ndarray
) -> Mask | None:
    """Write the normalised image inside its border; return the mask without what is not usable in it."""
    width = settings.normalization or FILL_SIGMA
    cells = NormalizationCells(image, width, None if mask is None else mask.good)
    if not cells.finite and not (finite := np.isfinite(image)).all():
        mask = _excluding(~finite, mask, settings)
        cells = NormalizationCells(image, width, mask.good)
    if (saturated := _saturated(image, cells.largest, cells.brightest)) is not None:
        mask = _excluding(saturated, mask, settings)
        cells = NormalizationCells(image, width, mask.good)
    if settings.normalization > 0:
        cells.normalized(None if mask is None else mask.share, padded)
    elif mask is not None:
        cells.filled(mask.share, padded[PAD:-PAD, PAD:-PAD])
    else:
        np.copyto(padded[PAD:-PAD, PAD:-PAD], image, casting="unsafe")
    return mask


def _excluding(bad: np.ndarray, mask: Mask | None, settings: MatchSettings) -> Mask:
    return Mask.of(~bad if mask is None else (mask.good != 0) & ~bad, settings)


def _saturated(image: np.ndarray, largest: float, columns: np.ndarray) -> np.ndarray | None:
    """(h, w) bool, True in patches at the largest value, which is in these columns; None without any."""
    # every patch holds one pixel of a grid as wide as the patch
    columns = columns[columns % SATURATED_SIDE == SATURATED_SIDE - 1]
    if largest <= 0 or not (image[SATURATED_SIDE - 1 :: SATURATED_SIDE, columns] == largest).any():
        return None
    bright = cv2.inRange(image, largest, largest)
    patch = np.ones((SATURATED_SIDE, SATURATED_SIDE), np.uint8)
    middles = cv2.erode(bright, patch)
    return cv2.dilate(middles, patch) > 0 if cv2.countNonZero(middles) else None


def _padded(h: int, w: int) -> np.ndarray:
    return np.empty((h + 2 * PAD, w + 2 * PAD), np.float32)


def _usable_blocks(good: np.ndarray, level: int) -> np.ndarray:
    """1 where the block around a pixel, and at the finest level the reach of its spline, is good."""
    side = BLOCK + 4 if level == 0 else BLOCK
    return cv2.erode(good, np.ones((side, side), np.uint8), borderType=cv2.BORDER_REPLICATE)


def _replicate_border(padded: np.ndarray) -> None:
    padded[PAD:-PAD, :PAD] = padded[PAD:-PAD, PAD : PAD + 1]
    padded[PAD:-PAD, -PAD:] = padded[PAD:-PAD, -PAD - 1 : -PAD]
    padded[:PAD] = padded[PAD]
    padded[-PAD:] = padded[-PAD - 1]
