"""Preparation of an image, once for all matches in which it takes part: mask, local normalisation, pyramid.

Local normalisation gives every part of the image zero mean and unit variance, within a Gaussian window with
the standard deviation `MatchSettings.normalization`, px. Means over this window are computed from sums over
small square *cells* of pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import cv2
import numpy as np

from wavefield.compiled import compiled
from wavefield.errors import FrameError
from wavefield.matching.kernels import (
    BLOCK,
    PAD,
    bead_blocks,
    bead_hessians,
    gradient_moments,
    strain_moments,
    work_space,
)
from wavefield.matching.settings import MatchSettings

F = np.float32

MIN_LEVEL_SIDE = 8 * BLOCK  # px: the pyramid ends before a level with a smaller side
MAX_CELL_SIDE = 8  # px: largest side of a cell
# lower bound of the local standard deviation over its median: fainter parts are not amplified further
MIN_RELATIVE_CONTRAST = F(0.05)
MIN_USABLE_SHARE = F(1e-3)  # lower bound of the usable fraction around a cell, which divides its sums
NOISE_BLUR_PX = 1.0  # standard deviation of the Gaussian that removes the noise of single pixels
NO_MASK = np.empty((0, 0), np.uint8)

# of fast-math only fused multiply-adds: NaN and infinity must propagate into the sums
njit = compiled(fastmath={"contract"}, error_model="numpy")


@dataclass(frozen=True)
class Level:
    """One pyramid level of a prepared image; sums over its blocks are computed when first needed."""

    padded: np.ndarray  # (h + 2 PAD, w + 2 PAD): the image with replicated border
    # (h, w): 1 where all pixels of a block around this pixel are usable; shape (0, 0) if nothing is masked
    good: np.ndarray

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the image on this level, px."""
        return self.padded.shape[0] - 2 * PAD, self.padded.shape[1] - 2 * PAD

    @property
    def blocks(self) -> tuple[int, int]:
        """Number of rows and columns of blocks, (ny, nx)."""
        return self.shape[0] // BLOCK, self.shape[1] // BLOCK

    @property
    def image(self) -> np.ndarray:
        """(h, w) float32: the image without its border."""
        return self.padded[PAD:-PAD, PAD:-PAD]

    @cached_property
    def moments(self) -> np.ndarray:
        """Sums over blocks from `gradient_moments`, (9, ny, nx) float32; computed once per image."""
        out = np.empty((9, *self.blocks), np.float32)
        gradient_moments(self.padded, work_space(self.blocks[1]), out)
        return out

    @cached_property
    def strain(self) -> np.ndarray:
        """Sums over blocks from `strain_moments`, (8, ny, nx) float32; computed once per image."""
        out = np.empty((8, *self.blocks), np.float32)
        strain_moments(self.padded, work_space(self.blocks[1]), out)
        return out

    @cached_property
    def beads(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the block of the bead at each pixel, (h, w), and Hessians summed over beads, (3, ny, nx).
        A bead belongs to the block with its brightest point; blocks are numbered row by row."""
        ny, nx = self.blocks
        h, w = ny * BLOCK, nx * BLOCK
        smooth = cv2.GaussianBlur(self.padded, (0, 0), NOISE_BLUR_PX)
        smooth[PAD - 1] = smooth[PAD + h] = smooth[:, PAD - 1] = smooth[:, PAD + w] = -np.inf
        block, hessian = np.empty((h, w), np.int32), np.empty((ny * nx, 3), np.float32)
        bead_blocks(smooth, block)
        bead_hessians(self.padded, block, work_space(nx), hessian)
        return block, np.ascontiguousarray(hessian.T).reshape(3, ny, nx)


@dataclass(frozen=True)
class PreparedImage:
    """An image pyramid, ready to be matched.

    Parameters
    ----------
    levels : tuple of Level
        The levels of the pyramid, finest first.
    normalization : float
        Width of the normalisation window that was used, px (`MatchSettings.normalization`).
    """

    levels: tuple[Level, ...]
    normalization: float

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the image, px."""
        return self.levels[0].shape


@dataclass(frozen=True)
class Mask:
    """Mask of usable pixels, prepared for matching; images with the same mask can share one instance."""

    good: np.ndarray  # (h, w): 1 where a pixel is usable
    levels: tuple[np.ndarray, ...]  # (h, w): `Level.good` of each pyramid level, finest first
    share: np.ndarray  # (ny, nx): fraction of usable pixels around each cell of the normalisation

    @staticmethod
    def of(good: np.ndarray, settings: MatchSettings) -> Mask:
        """Make a mask for matching with these settings; `good` (h, w) is True for usable pixels."""
        usable = good = np.array(good, bool, order="C").view(np.uint8)
        levels = [_usable_blocks(good, 0)]
        for number in range(1, level_count(good.shape, settings.levels)):
            h, w = usable.shape[0] // 2, usable.shape[1] // 2
            part = cv2.resize(usable[: 2 * h, : 2 * w] * np.uint8(255), (w, h), interpolation=cv2.INTER_AREA)
            usable = (part > 250).astype(np.uint8)
            levels.append(_usable_blocks(usable, number))
        share = NormalizationCells(good, settings.normalization).local(0)
        return Mask(good, tuple(levels), np.maximum(share, MIN_USABLE_SHARE))


def prepare(
    image: np.ndarray, settings: MatchSettings, mask: np.ndarray | Mask | None = None
) -> PreparedImage:
    """Prepare an image for matching.

    Parameters
    ----------
    image : (h, w) uint8, uint16, float32 or other real type
        The image. Pixels that are not finite, and uniform patches at the image's largest value (saturation),
        are masked.
    settings : MatchSettings
        Gives the number of pyramid levels and the width of the normalisation.
    mask : (h, w) bool, or Mask, optional
        True where pixels are usable. If many images share a mask, make it once by `Mask.of`.

    Returns
    -------
    PreparedImage

    Raises
    ------
    FrameError
        If the image is not a grey image of at least 20 x 20 px, or the mask has another shape.
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
    padded = np.empty((h + 2 * PAD, w + 2 * PAD), np.float32)
    mask = _normalize(image, mask, settings, padded)
    levels: list[Level] = []
    for number in range(level_count(image.shape, settings.levels)):
        if number:
            even = levels[-1].image[: h // 2 * 2, : w // 2 * 2]
            h, w = h // 2, w // 2
            padded = np.empty((h + 2 * PAD, w + 2 * PAD), np.float32)
            cv2.resize(even, (w, h), dst=padded[PAD:-PAD, PAD:-PAD], interpolation=cv2.INTER_AREA)
        # the border repeats the nearest pixels of the image
        padded[PAD:-PAD, :PAD] = padded[PAD:-PAD, PAD : PAD + 1]
        padded[PAD:-PAD, -PAD:] = padded[PAD:-PAD, -PAD - 1 : -PAD]
        padded[:PAD] = padded[PAD]
        padded[-PAD:] = padded[-PAD - 1]
        levels.append(Level(padded, NO_MASK if mask is None else mask.levels[number]))
    return PreparedImage(tuple(levels), settings.normalization)


def level_count(shape: tuple[int, ...], levels: int) -> int:
    """Return the number of pyramid levels, at most `levels`, for an image of `shape` (h, w).
    The coarsest level is at least 40 px wide and high, or the image has only one level."""
    side = min(shape)
    while levels > 1 and side >> (levels - 1) < MIN_LEVEL_SIDE:
        levels -= 1
    return levels


def _normalize(
    image: np.ndarray, mask: Mask | None, settings: MatchSettings, padded: np.ndarray
) -> Mask | None:
    """Write the normalised image into `padded`, inside its border; return the mask extended by bad pixels.
    Bad pixels are saturated or not finite. The mask is None if all pixels are usable."""
    width = settings.normalization
    cells = NormalizationCells(image, width, None if mask is None else mask.good)
    if not cells.finite and not (finite := np.isfinite(image)).all():
        mask = _excluding(~finite, mask, settings)
        cells = NormalizationCells(image, width, mask.good)
    if (saturated := _saturated(image, cells.largest, cells.brightest)) is not None:
        mask = _excluding(saturated, mask, settings)
        cells = NormalizationCells(image, width, mask.good)
    cells.normalized(None if mask is None else mask.share, padded)
    return mask


def _excluding(bad: np.ndarray, mask: Mask | None, settings: MatchSettings) -> Mask:
    """Return `mask` (None: all pixels usable) with the pixels where `bad` (h, w) is True made unusable."""
    return Mask.of(~bad if mask is None else (mask.good != 0) & ~bad, settings)


def _saturated(image: np.ndarray, largest: float, columns: np.ndarray) -> np.ndarray | None:
    """Return a mask (h, w), True in uniform patches of at least 5 x 5 px at the `largest` value.
    It is None if there is no such patch. `columns` are the numbers of the columns that contain the value."""
    # every patch contains one pixel of a grid whose step is the side of the smallest patch
    columns = columns[columns % BLOCK == BLOCK - 1]
    if largest <= 0 or not (image[BLOCK - 1 :: BLOCK, columns] == largest).any():
        return None
    bright = cv2.inRange(image, largest, largest)
    patch = np.ones((BLOCK, BLOCK), np.uint8)
    middles = cv2.erode(bright, patch)
    return cv2.dilate(middles, patch) > 0 if cv2.countNonZero(middles) else None


def _usable_blocks(good: np.ndarray, level: int) -> np.ndarray:
    """Return an array (h, w), 1 for pixels around which a whole block is usable, else 0.
    On level 0, a margin of two pixels around the block must be usable as well."""
    side = BLOCK + 4 if level == 0 else BLOCK
    return cv2.erode(good, np.ones((side, side), np.uint8), borderType=cv2.BORDER_REPLICATE)


# Normalisation sums over the cells, then interpolates mean and scale between them. Loops run along rows.


@njit
def _fold(row: np.ndarray, count: int, side: int, out: np.ndarray) -> None:
    """Write sums of groups of `side` neighbouring elements, among the first `count` of a row, to `out`.
    The last sum includes the elements that are left over."""
    n = len(out)
    if side == 8:  # the usual side, in a form that vectorises
        for i in range(n):
            left = (row[8 * i] + row[8 * i + 1]) + (row[8 * i + 2] + row[8 * i + 3])
            out[i] = left + ((row[8 * i + 4] + row[8 * i + 5]) + (row[8 * i + 6] + row[8 * i + 7]))
    else:
        for i in range(n):
            total = row[i * side]
            for k in range(1, side):
                total += row[i * side + k]
            out[i] = total
    for x in range(n * side, count):
        out[n - 1] += row[x]


@njit
def _add_row(row: np.ndarray, usable: np.ndarray, s: np.ndarray, t: np.ndarray, top: np.ndarray) -> None:
    """Add a row of pixels to the column sums s, their squares to t, and update the column maxima `top`.
    Pixels with `usable` 0 count as 0."""
    for x in range(len(row)):
        v = F(row[x]) if usable[x] != 0 else F(0)
        s[x] += v
        t[x] += v * v
        top[x] = max(top[x], v)


@njit
def _cell_sums(image: np.ndarray, usable: np.ndarray, side: int, rows: np.ndarray, out: np.ndarray) -> None:
    """Write sums of pixels, then of squared pixels, over cells of `side` x `side` px to out (2, ny, nx).
    rows[2] receives the largest pixel of each column. Pixels with `usable` 0 count as 0."""
    h, w = image.shape
    ny = out.shape[1]
    s, t, top = rows[0], rows[1], rows[2]
    top[:] = F(0)
    for j in range(ny):
        s[:] = F(0)
        t[:] = F(0)
        for y in range(j * side, j * side + side if j < ny - 1 else h):
            _add_row(image[y], usable[y], s, t, top)
        _fold(s, w, side, out[0, j])
        _fold(t, w, side, out[1, j])


@njit
def _normalize_row(
    row: np.ndarray,
    usable: np.ndarray,
    m0: np.ndarray,
    m1: np.ndarray,
    s0: np.ndarray,
    s1: np.ndarray,
    t: np.float32,
    out: np.ndarray,
) -> None:
    """Write (row - mean) * scale to `out`, and 0 where `usable` is 0.
    Mean and scale lie between two rows of cells: m0 and s0 for t = 0, m1 and s1 for t = 1."""
    for x in range(len(row)):
        mean = m0[x] + t * (m1[x] - m0[x])
        scale = s0[x] + t * (s1[x] - s0[x])
        out[x] = (F(row[x]) - mean) * scale if usable[x] != 0 else F(0)


@njit
def _normalize_image(
    image: np.ndarray, usable: np.ndarray, mean: np.ndarray, scale: np.ndarray, side: int, out: np.ndarray
) -> None:
    """Write (image - mean) * scale inside the border of `out`; pixels with `usable` 0 become 0.
    `mean` and `scale` (ny, w) are given for each row of cells of `side` px, at every pixel column."""
    ny, (h, w) = len(mean), image.shape
    border = (len(out) - h) // 2
    for y in range(h):
        place = min(max((F(y) + F(0.5)) / F(side) - F(0.5), F(0)), F(ny - 1))
        j = int(place)
        k = min(j + 1, ny - 1)
        to = out[border + y][border : border + w]  # contiguous for numba, unlike a row of a sliced array
        _normalize_row(image[y], usable[y], mean[j], mean[k], scale[j], scale[k], place - F(j), to)


class NormalizationCells:
    """Sums over square cells of an image (h, w), for local means in a Gaussian window of `width` px.
    `largest` is the largest pixel, `brightest` the numbers of the columns that contain it; `finite` is False
    if any pixel is not finite. `usable` (h, w) is 1 for pixels that count; None: all."""

    def __init__(self, image: np.ndarray, width: float, usable: np.ndarray | None = None) -> None:
        self.image, self.width = np.ascontiguousarray(image), max(width, 1.0)
        self.usable = _all_usable(self.image.shape) if usable is None else usable
        h, w = self.image.shape
        self.side = _side(h, w, self.width)
        self.sums = np.empty((2, h // self.side, w // self.side), F)
        rows = np.empty((3, w + (48 - w) % 256), F)  # never a multiple of a page apart: see `work_space`
        _cell_sums(self.image, self.usable, self.side, rows, self.sums)
        top = rows[2, :w]
        self.largest = float(top.max())
        self.brightest = np.flatnonzero(top == self.largest)
        self.finite = bool(np.isfinite(self.sums[0].sum()))

    def local(self, number: int) -> np.ndarray:
        """Return the window mean of pixels (`number` 0) or squared pixels (1) at each cell, (ny, nx)."""
        mean = self.sums[number] * _inverse_area(self.image.shape, self.side)
        # subtract the blur that is there already: 1/12 by averaging over cells, 1/6 by linear interpolation
        sigma = np.sqrt((self.width / self.side) ** 2 - 0.25)
        return np.asarray(cv2.GaussianBlur(mean, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE))

    def normalized(self, share: np.ndarray | None, out: np.ndarray) -> None:
        """Write the normalised image inside the border of `out`.
        `share` (ny, nx) is the usable fraction of pixels around each cell; None if all are usable."""
        mean, square = self.local(0), self.local(1)
        if share is not None:
            mean /= share
            square /= share
        std = np.sqrt(np.maximum(square - mean * mean, 0))
        # every fourth cell suffices for a median
        every_second = std[::2, ::2]
        if share is not None:
            every_second = every_second[share[::2, ::2] > 0.5]
        typical = F(np.median(every_second)) if every_second.size else F(0)
        scale = F(1) / np.maximum(std, max(MIN_RELATIVE_CONTRAST * typical, F(1e-6)))
        _normalize_image(self.image, self.usable, self._spread(mean), self._spread(scale), self.side, out)

    def _spread(self, field: np.ndarray) -> np.ndarray:
        """Return values at cells (ny, nx), interpolated along x to every pixel column, (ny, w)."""
        if self.side == 1:
            return field
        ny, nx = field.shape
        out = np.empty((ny, self.image.shape[1]), F)
        n = nx * self.side
        cv2.resize(field, (n, ny), dst=out[:, :n], interpolation=cv2.INTER_LINEAR)
        out[:, n:] = out[:, n - 1 : n]
        return out


def _side(h: int, w: int, width: float) -> int:
    """Return the side of the cells, px: 8, 4, 2 or 1, at most `width` and an eighth of h and of w."""
    side = MAX_CELL_SIDE
    while side > 1 and (width < side or min(h, w) < 8 * side):
        side //= 2
    return side


@lru_cache(maxsize=8)
def _all_usable(shape: tuple[int, int]) -> np.ndarray:
    """Return the mask (h, w) of an image whose pixels are all usable: 1 everywhere."""
    return np.ones(shape, np.uint8)


@lru_cache(maxsize=16)
def _inverse_area(shape: tuple[int, int], side: int) -> np.ndarray:
    """Return the reciprocal of the number of pixels in each cell, (ny, nx), of an image of this shape."""
    counts = []
    for n in shape:
        count = np.full(n // side, side, F)
        count[-1] += n % side
        counts.append(count)
    return F(1) / (counts[0][:, None] * counts[1])
