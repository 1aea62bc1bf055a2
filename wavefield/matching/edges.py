"""Slopes that a field has at the edges of its lattice, which cosines cannot have."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.matching.cosines import cosines

F = np.float32
Float = NDArray[Any]

REACH = 6.0  # blocks: reach of a slope at the edge, and width over which it is taken
_ALONG = 3.0  # blocks along the edge over which it is smoothed


class Edge:
    """A smooth field with the slopes that a field has at the edges of its lattice.

    Parameters
    ----------
    shape : (int, int)
        Of the lattice, (ny, nx).
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        near = int(REACH)
        t = np.arange(near, dtype=np.float32) - F((near - 1) / 2)
        self.slope = t / (t * t).sum()
        self.near = near
        self.grow_y, self.grow_x = (
            (REACH * np.exp((np.arange(n) + 0.5 - n) / REACH)).astype(np.float32) for n in shape
        )
        self.smooth_y, self.smooth_x = (_smoother(n) for n in shape)

    def __call__(self, field: Float) -> Float:
        """As `edge_slopes`, of fields (c, ny, nx) of this lattice."""
        near, (ny, nx) = self.near, field.shape[-2:]
        low = field[..., :near] @ self.slope @ self.smooth_y
        high = field[..., nx - near :] @ self.slope @ self.smooth_y
        out: Float = high[..., None] * self.grow_x - low[..., None] * self.grow_x[::-1]
        first, last = field[:, :near] - out[:, :near], field[:, ny - near :] - out[:, ny - near :]
        low = np.einsum("cyx,y->cx", first, self.slope) @ self.smooth_x
        high = np.einsum("cyx,y->cx", last, self.slope) @ self.smooth_x
        out += high[:, None] * self.grow_y[:, None]
        out -= low[:, None] * self.grow_y[::-1, None]
        return out


def _smoother(n: int) -> Float:
    modes = cosines(n, n)
    gain = np.exp(-0.5 * np.square(_ALONG * np.pi * np.arange(n) / n))
    out: Float = ((modes.T * gain) @ modes).astype(np.float32)
    return out


def edge_slopes(field: Float) -> Float:
    """A smooth field (c, ny, nx) with the edge slopes of a given one.

    Parameters
    ----------
    field : ndarray, (c, ny, nx)
        Without holes.

    Returns
    -------
    ndarray of float32, (c, ny, nx)
    """
    field = np.asarray(field, np.float32)
    return Edge((field.shape[1], field.shape[2]))(field)
