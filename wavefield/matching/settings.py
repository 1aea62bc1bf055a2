"""Settings of `match` and the displacement that it returns."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntFlag
from typing import Any

import numpy as np

from wavefield.config_files import CHECKED
from wavefield.matching.kernels import BLOCK

Range = tuple[float, float]


@dataclass(frozen=True)
class MatchSettings:
    """Settings for matching two images. Start from a preset: `MatchSettings.piv()` or `.stereo()`.

    Parameters
    ----------
    iterations : tuple of int
        Gauss-Newton steps on each pyramid level, coarsest first.
    window : float
        Side of a square with the area of the Gaussian window, px of each level.
    smoother_sigma : float
        Standard deviation, in blocks, of the Gaussian G in the smoother 1 - (1 - G)^4 on the finest level; 0
        turns the smoother off.
    coarse_smoother_sigma : float
        The same on the coarser levels, in blocks.
    normalization : float
        Standard deviation of the Gaussian window that normalises brightness locally, px.
    search_x, search_y : (float, float) or None
        Smallest and largest displacement to search, px of the image; None for no search.
    search_window : float
        Side of a square with the area of the Gaussian window in this search, px of the coarsest level.
    min_correlation : float
        Blocks with a lower normalised correlation are invalid.
    min_gradient_energy : float
        Blocks with a lower gradient energy (mean squared brightness gradient) than this fraction of the
        image's median are invalid.
    max_deviation : float
        Blocks that differ by more than this, px, from the median of 5 x 5 blocks get the median instead;
        blocks to which this happens in the last step are invalid.
    """

    __pydantic_config__ = CHECKED

    iterations: tuple[int, ...] = (6, 4, 4)
    window: float = 32.0
    smoother_sigma: float = 2.5
    coarse_smoother_sigma: float = 2.0
    normalization: float = 16.0
    search_x: Range | None = (-16.0, 16.0)
    search_y: Range | None = (-16.0, 16.0)
    search_window: float = 20.0
    min_correlation: float = 0.3
    min_gradient_energy: float = 0.05
    max_deviation: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "iterations", tuple(int(n) for n in self.iterations))
        if not self.iterations or min(self.iterations) < 0 or self.iterations[-1] < 1:
            raise ValueError("iterations: give one count per level, coarsest first, the last at least 1")
        for name in ("window", "search_window", "max_deviation", "normalization"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be above 0, not {getattr(self, name)}")
        for name in ("smoother_sigma", "coarse_smoother_sigma", "min_gradient_energy"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name} must be 0 or more, not {getattr(self, name)}")
        if (self.search_x is None) != (self.search_y is None):
            raise ValueError("give both search_x and search_y, or neither")
        for name in ("search_x", "search_y"):
            limits = getattr(self, name)
            if limits is None:
                continue
            if len(limits) != 2 or not limits[0] <= limits[1]:
                raise ValueError(f"{name}: give (smallest, largest) displacement in px, not {limits}")
            object.__setattr__(self, name, (float(limits[0]), float(limits[1])))

    @property
    def levels(self) -> int:
        """Largest number of pyramid levels; small images have fewer."""
        return len(self.iterations)

    @classmethod
    def piv(cls, **changes: Any) -> MatchSettings:
        """Return settings to match successive frames of one camera: the defaults, with these `changes`."""
        return replace(cls(), **changes)

    @classmethod
    def stereo(cls, **changes: Any) -> MatchSettings:
        """Return settings to match frames of two cameras (large, smooth parallax), with these `changes`."""
        return replace(
            cls(
                iterations=(3, 3, 3, 3),
                window=26.0,
                smoother_sigma=2.4,
                coarse_smoother_sigma=2.4,
                normalization=13.0,
                search_x=(-48.0, 48.0),
                search_y=(-8.0, 8.0),
                search_window=32.0,
            ),
            **changes,
        )


class Reason(IntFlag):
    """Reasons why a block is not valid; `Displacement.reason` has one bit for each."""

    VALID = 0
    MASKED = 1  # masked, saturated or NaN pixels in the block in a, or at its position in b
    EDGE = 2  # the block moves out of image b
    TEXTURE = 4  # uniform area: the gradients are too weak to match
    CORRELATION = 8  # the normalised correlation is below `min_correlation`
    NEIGHBOURS = 16  # farther than `max_deviation` from the median of the neighbours
    RANGE = 32  # the displacement lies outside the search range


@dataclass(frozen=True)
class Displacement:
    """Displacement from image a to image b on a lattice of blocks: b(x + u, y + v) matches a(x, y).

    Parameters
    ----------
    u, v : (ny, nx) float32
        Displacement along columns and along rows (down), px.
    correlation : (ny, nx) float32
        Normalised correlation of the block's window, -1 to 1.
    reason : (ny, nx) uint8
        Bits of `Reason`; 0 where valid.
    settings : MatchSettings
        The settings of this match.
    score : (2, ny, nx) float32
        Sums over every block of gx r and gy r, with gx, gy the gradients of image a and r = a - b the
        residual at this displacement.
    hessian : (3, ny, nx) float32
        Sums over every block of gx gx, gx gy, gy gy, times the fraction of the gradient energy that both
        images share.
    """

    u: np.ndarray
    v: np.ndarray
    correlation: np.ndarray
    reason: np.ndarray
    settings: MatchSettings
    score: np.ndarray
    hessian: np.ndarray

    @property
    def x(self) -> np.ndarray:
        """Columns of the block centres in image a, (nx,), px; pixel centres are at 0, 1, 2, ..."""
        return np.arange(self.u.shape[1]) * float(BLOCK) + (BLOCK - 1) / 2

    @property
    def y(self) -> np.ndarray:
        """Rows of the block centres in image a, (ny,), px; pixel centres are at 0, 1, 2, ..."""
        return np.arange(self.u.shape[0]) * float(BLOCK) + (BLOCK - 1) / 2

    @property
    def valid(self) -> np.ndarray:
        """Mask (ny, nx), True for blocks with a valid displacement."""
        return np.asarray(self.reason == 0)
