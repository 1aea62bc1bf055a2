"""Result of a match."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntFlag
from functools import cached_property

import numpy as np

from wavefield.matching.block_lattice import sample
from wavefield.matching.matching_settings import MatchSettings
from wavefield.matching.uncertainty import std_from_influence


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
    influence_u, influence_v : (ny, nx) float32
        Contribution of the block's own residual to the displacement of its window, px; `u_std` and `v_std`
        follow from them.
    gain : float
        Fraction of the distance to the solution that one step covers: less than 1 where noise or unmatched
        particles increase the gradients. See `transfer_kernel`.
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
    influence_u: np.ndarray
    influence_v: np.ndarray
    gain: float
    settings: MatchSettings
    score: np.ndarray
    hessian: np.ndarray

    @property
    def valid(self) -> np.ndarray:
        """(ny, nx) bool: blocks whose displacement is valid."""
        out: np.ndarray = self.reason == 0
        return out

    @cached_property
    def u_std(self) -> np.ndarray:
        """(ny, nx) float32: standard uncertainty of u, px; infinite where not valid."""
        return self._std(self.influence_u, self.u)

    @cached_property
    def v_std(self) -> np.ndarray:
        """(ny, nx) float32: standard uncertainty of v, px; infinite where not valid."""
        return self._std(self.influence_v, self.v)

    def _std(self, influence: np.ndarray, field: np.ndarray) -> np.ndarray:
        std = std_from_influence(influence, self.settings, field=field, gain=self._step_gain())
        return np.where(self.valid, std, np.float32(np.inf))

    def _step_gain(self) -> float:
        return min(1.0, self.gain * self.settings.relaxation)

    def at_midpoint(self) -> Displacement:
        """The displacement whose path has its middle at the lattice, instead of its start.

        Returns
        -------
        Displacement
            On the same lattice.

        Notes
        -----
        d_mid(x) = d(x - d_mid(x) / 2), solved as a fixed point.
        """
        step = self.x[1] - self.x[0] if len(self.x) > 1 else 1.0
        column, row = np.meshgrid(np.arange(len(self.x)), np.arange(len(self.y)))
        u, v = self.u, self.v
        for _ in range(6):
            cx, cy = column - u / (2 * step), row - v / (2 * step)
            u, v = sample(self.u, cx, cy), sample(self.v, cx, cy)
        nearest = (
            np.clip(np.rint(cy), 0, len(self.y) - 1).astype(np.intp),
            np.clip(np.rint(cx), 0, len(self.x) - 1).astype(np.intp),
        )
        return replace(
            self,
            u=u,
            v=v,
            correlation=self.correlation[nearest],
            reason=self.reason[nearest],
            influence_u=self.influence_u[nearest],
            influence_v=self.influence_v[nearest],
            score=self.score[:, *nearest],
            hessian=self.hessian[:, *nearest],
        )
