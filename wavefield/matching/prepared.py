"""Preparation of an image for matching, done once for all its matches: mask, local normalisation, pyramid."""

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

SATURATED_SIDE = 5  # px: of the smallest saturated patch
MIN_LEVEL_SIDE = 8 * BLOCK  # px: pyramid levels with a smaller side are left out
MAX_CELL_SIDE = 8  # px: side of the cells
MIN_RELATIVE_CONTRAST = F(0.05)  # of the image's median local standard deviation: less is not amplified
MIN_USABLE_SHARE = F(1e-3)  # of the pixels around a cell
BEAD_SMOOTHING = 1.0  # px: beads' tops are found in the image smoothed by this; noise has tops of its own
NO_MASK = np.empty((0, 0), np.uint8)

# pixels that are not finite must reach the sums as they are: no fast-math but fused multiply-adds
njit = compiled(fastmath={"contract"}, error_model="numpy")


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
        """Sums of `gradient_moments`, (9, ny, nx) float32; kept, as an image may be matched several times."""
        out = np.empty((9, *self.blocks), np.float32)
        gradient_moments(self.padded, work_space(self.blocks[1]), out)
        return out

    @cached_property
    def strain(self) -> np.ndarray:
        """(8, ny, nx) float32: the sums of `strain_moments`, kept like `moments`."""
        out = np.empty((8, *self.blocks), np.float32)
        strain_moments(self.padded, work_space(self.blocks[1]), out)
        return out

    @cached_property
    def beads(self) -> tuple[np.ndarray, np.ndarray]:
        """Assignment of pixels to blocks by whole beads, (h, w), and the blocks' Hessians, (3, ny, nx)."""
        ny, nx = self.blocks
        h, w = ny * BLOCK, nx * BLOCK
        smooth = cv2.GaussianBlur(self.padded, (0, 0), BEAD_SMOOTHING)
        smooth[PAD - 1] = smooth[PAD + h] = smooth[:, PAD - 1] = smooth[:, PAD + w] = -np.inf
        block, hessian = np.empty((h, w), np.int32), np.empty((ny * nx, 3), np.float32)
        bead_blocks(smooth, block)
        bead_hessians(self.padded, block, work_space(nx), hessian)
        return block, np.ascontiguousarray(hessian.T).reshape(3, ny, nx)


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
        return Mask(good, tuple(levels), usable_share(good, settings.normalization))


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
    """Write the normalised image inside its border; return the mask without invalid and saturated pixels."""
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
    return Mask.of(~bad if mask is None else (mask.good != 0) & ~bad, settings)


def _saturated(image: np.ndarray, largest: float, columns: np.ndarray) -> np.ndarray | None:
    """Patches that reach the largest value of these columns, (h, w) bool; None without any."""
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
    """1 where the block around a pixel is usable, on the finest level with the reach of the spline."""
    side = BLOCK + 4 if level == 0 else BLOCK
    return cv2.erode(good, np.ones((side, side), np.uint8), borderType=cv2.BORDER_REPLICATE)


def _replicate_border(padded: np.ndarray) -> None:
    padded[PAD:-PAD, :PAD] = padded[PAD:-PAD, PAD : PAD + 1]
    padded[PAD:-PAD, -PAD:] = padded[PAD:-PAD, -PAD - 1 : -PAD]
    padded[:PAD] = padded[PAD]
    padded[-PAD:] = padded[-PAD - 1]


# Local normalisation to zero mean and unit variance in two passes: sums over square cells, then the image
# with mean and scale interpolated between the cells. As in `kernels`, loops run along rows.


@njit
def _fold(row: np.ndarray, count: int, side: int, out: np.ndarray) -> None:
    """Sum groups of `side` neighbours among the first `count` elements of `row`; the last group takes the
    rest.
    """
    n = len(out)
    if side == 8:  # the usual one: a loop that becomes vector code
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
def _add_row(row: np.ndarray, s: np.ndarray, t: np.ndarray, top: np.ndarray) -> None:
    for x in range(len(row)):
        v = F(row[x])
        s[x] += v
        t[x] += v * v
        top[x] = max(top[x], v)


@njit
def _add_masked_row(
    row: np.ndarray, usable: np.ndarray, s: np.ndarray, t: np.ndarray, top: np.ndarray
) -> None:
    for x in range(len(row)):
        v = F(row[x]) if usable[x] != 0 else F(0)
        s[x] += v
        t[x] += v * v
        top[x] = max(top[x], v)


@njit
def _cell_sums(image: np.ndarray, usable: np.ndarray, side: int, rows: np.ndarray, out: np.ndarray) -> None:
    h, w = image.shape
    ny = out.shape[1]
    s, t, top = rows[0], rows[1], rows[2]
    top[:] = F(0)
    for j in range(ny):
        s[:] = F(0)
        t[:] = F(0)
        for y in range(j * side, j * side + side if j < ny - 1 else h):
            if usable.size > 0:
                _add_masked_row(image[y], usable[y], s, t, top)
            else:
                _add_row(image[y], s, t, top)
        _fold(s, w, side, out[0, j])
        _fold(t, w, side, out[1, j])


@njit
def _normalize_row(
    row: np.ndarray,
    m0: np.ndarray,
    m1: np.ndarray,
    s0: np.ndarray,
    s1: np.ndarray,
    t: np.float32,
    out: np.ndarray,
) -> None:
    for x in range(len(row)):
        mean = m0[x] + t * (m1[x] - m0[x])
        scale = s0[x] + t * (s1[x] - s0[x])
        out[x] = (F(row[x]) - mean) * scale


@njit
def _clear_row(usable: np.ndarray, out: np.ndarray) -> None:
    for x in range(len(out)):
        out[x] = out[x] if usable[x] != 0 else F(0)


@njit
def _normalize_image(
    image: np.ndarray, usable: np.ndarray, mean: np.ndarray, scale: np.ndarray, side: int, out: np.ndarray
) -> None:
    ny, (h, w) = len(mean), image.shape
    border = (len(out) - h) // 2
    for y in range(h):
        place = min(max((F(y) + F(0.5)) / F(side) - F(0.5), F(0)), F(ny - 1))
        j = int(place)
        k = min(j + 1, ny - 1)
        to = out[border + y][border : border + w]  # contiguous, which rows of a cut array are not
        _normalize_row(image[y], mean[j], mean[k], scale[j], scale[k], place - F(j), to)
        if usable.size > 0:
            _clear_row(usable[y], to)


class NormalizationCells:
    """Sums over square cells of an image (h, w), for means over surroundings of a given width, px."""

    def __init__(self, image: np.ndarray, width: float, usable: np.ndarray | None = None) -> None:
        self.image, self.width = np.ascontiguousarray(image), max(width, 1.0)
        self.usable = NO_MASK if usable is None else usable
        h, w = self.image.shape
        self.side = _side(h, w, self.width)
        self.sums = np.empty((2, h // self.side, w // self.side), F)
        rows = np.empty((3, w + (48 - w) % 256), F)  # never a page apart, as in `work_space`
        _cell_sums(self.image, self.usable, self.side, rows, self.sums)
        top = rows[2, :w]
        self.largest = float(top.max())
        self.brightest = np.flatnonzero(top == self.largest)
        self.finite = bool(np.isfinite(self.sums[0].sum()))

    def local(self, number: int) -> np.ndarray:
        """(ny, nx) float32: values (0) or squares (1) of usable pixels, averaged over the surroundings."""
        mean = self.sums[number] * _inverse_area(self.image.shape, self.side)
        # averages over cells (variance 1/12), read linearly between them (1/6), are blurred already
        sigma = np.sqrt((self.width / self.side) ** 2 - 0.25)
        out: np.ndarray = cv2.GaussianBlur(mean, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
        return out

    def normalized(self, share: np.ndarray | None, out: np.ndarray) -> None:
        """Write the normalised image, inside any border of `out`; pixels that are not usable become 0."""
        mean, square = self.local(0), self.local(1)
        if share is not None:
            mean /= share
            square /= share
        std = np.sqrt(np.maximum(square - mean * mean, 0))
        # one cell of four is enough for the median
        every_second = std[::2, ::2]
        if share is not None:
            every_second = every_second[share[::2, ::2] > 0.5]
        typical = F(np.median(every_second)) if every_second.size else F(0)
        scale = F(1) / np.maximum(std, max(MIN_RELATIVE_CONTRAST * typical, F(1e-6)))
        _normalize_image(self.image, self.usable, self._spread(mean), self._spread(scale), self.side, out)

    def _spread(self, field: np.ndarray) -> np.ndarray:
        """(ny, w) float32: a field of cells interpolated along its rows."""
        if self.side == 1:
            return field
        ny, nx = field.shape
        out = np.empty((ny, self.image.shape[1]), F)
        n = nx * self.side
        cv2.resize(field, (n, ny), dst=out[:, :n], interpolation=cv2.INTER_LINEAR)
        out[:, n:] = out[:, n - 1 : n]
        return out


def usable_share(usable: np.ndarray, width: float) -> np.ndarray:
    """Fraction of usable pixels around each cell, (ny, nx) float32, never exactly 0."""
    out: np.ndarray = np.maximum(NormalizationCells(usable, width).local(0), MIN_USABLE_SHARE)
    return out


def _side(h: int, w: int, width: float) -> int:
    """Side of the cells, px: small compared with the width and the image."""
    side = MAX_CELL_SIDE
    while side > 1 and (width < side or min(h, w) < 8 * side):
        side //= 2
    return side


@lru_cache(maxsize=16)
def _inverse_area(shape: tuple[int, int], side: int) -> np.ndarray:
    """(ny, nx) float32: one over the number of pixels of each cell."""
    counts = []
    for n in shape:
        count = np.full(n // side, side, F)
        count[-1] += n % side
        counts.append(count)
    return F(1) / (counts[0][:, None] * counts[1])
