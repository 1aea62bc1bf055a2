"""Result of a match."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag

import numpy as np

from wavefield.matching.matching_settings import MatchSettings


class Reason(IntFlag):
    """Why a block is not valid: bits of `Displacement.reason`."""

    VALID = 0
    MASKED = 1  # masked, saturated or NaN pixels in the block in a, or at its position in b
    EDGE = 2  # the block leaves image b
    TEXTURE = 4  # uniform area: gradients too weak to match
    CORRELATION = 8  # the correlation of the two patches is too low
    NEIGHBOURS = 16  # far from the median of the neighbours
    RANGE = 32  # no maximum inside the search range


@dataclass(frozen=True)
class Evaluation:
    """The blocks of two images at a given displacement.

    Parameters
    ----------
    score, hessian : (2, ny, nx) and (3, ny, nx) float32
        As of a `Displacement`.
    correlation : (ny, nx) float32
        Normalised correlation of the block's window, -1 to 1.
    reason : (ny, nx) uint8
        Bits of `Reason`; 0 where valid.
    """

    score: np.ndarray
    hessian: np.ndarray
    correlation: np.ndarray
    reason: np.ndarray

    @property
    def valid(self) -> np.ndarray:
        """(ny, nx) bool: blocks that match."""
        out: np.ndarray = self.reason == 0
        return out


@dataclass(frozen=True)
class Displacement:
    """Displacement on a lattice of blocks: b(x + u, y + v) matches a(x, y).

    Parameters
    ----------
    x, y : (nx,), (ny,) float64
        Block centres in pixels of a: 0-based, pixel centres at integers.
    u, v : (ny, nx) float32
        Displacement along columns and along rows (down), px.
    correlation : (ny, nx) float32
        Normalised correlation of the block's window, -1 to 1.
    reason : (ny, nx) uint8
        Bits of `Reason`; 0 where valid.
    settings : MatchSettings
        The settings used.
    score : (2, ny, nx) float32
        Score of every block for u and v: sums of gx r and gy r, with r the residual between the images. Zero
        where the displacement minimizes the block's own residual.
    hessian : (3, ny, nx) float32
        Sums of gx gx, gx gy, gy gy of the gradients that the two images have in common. The inverse times the
        score is the block's own correction of the displacement.
    """

    x: np.ndarray
    y: np.ndarray
    u: np.ndarray
    v: np.ndarray
    correlation: np.ndarray
    reason: np.ndarray
    settings: MatchSettings
    score: np.ndarray
    hessian: np.ndarray

    @property
    def valid(self) -> np.ndarray:
        """(ny, nx) bool: blocks whose displacement is valid."""
        out: np.ndarray = self.reason == 0
        return out
