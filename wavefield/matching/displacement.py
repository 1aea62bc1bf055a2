"""What matching gives back."""

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
    MASKED = 1  # masked, saturated or not-a-number pixels in a or where it went in b
    EDGE = 2  # the block went out of image b
    TEXTURE = 4  # nothing to match: uniform area
    CORRELATION = 8  # the two patches do not look alike
    NEIGHBOURS = 16  # far from the median of the neighbours
    RANGE = 32  # no maximum inside the search range


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
        What the block alone would add to the displacement if its window looked like it, px: the
        uncertainty is made of these, and combined measurements (stereo) combine them before squaring.
    gain : float
        Share of the way to the solution that a step goes: less than 1 where noise or unmatched particles
        swell the gradients. See `transfer_kernel`.
    settings : Settings
        The settings used.
    score : (2, ny, nx) float32
        What every block alone says about u and v here: sums of gx r and gy r, with r what is left between the
        images. Zero where the block is content.
    hessian : (3, ny, nx) float32
        How firmly it says so: sums of gx gx, gx gy, gy gy of what the two images share; the block alone would
        move by the inverse of it times the score.
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
        """(ny, nx) bool: blocks to be trusted."""
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
