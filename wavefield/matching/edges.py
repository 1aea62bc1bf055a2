"""Slopes that a field has at the edges of its lattice, which cosines cannot have."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.matching.cosines import cosines

F = np.float32
Float = NDArray[Any]
Profiles = tuple[Float, Float]
Slopes = tuple[Float, Float, Float, Float]

REACH = 6.0  # blocks: reach of a slope at the edge, and width over which it is taken
_ALONG = 3.0  # blocks along the edge over which it is smoothed


class Edge:
    """A smooth field with the slopes that a field has at the edges of its lattice.

    With shape (int, int).
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        near = int(REACH)
        t = np.arange(near, dtype=np.float32) - F((near - 1) / 2)
        self.slope = t / (t * t).sum()
        self.near = near
        along_y, along_x = (
            (REACH * np.exp((np.arange(n) + 0.5 - n) / REACH)).astype(np.float32) for n in shape
        )
        self.profiles: Profiles = along_y, along_x
        self.smooth_y, self.smooth_x = (_smoother(n) for n in shape)

    def slopes(self, field: Float) -> Slopes:
        """Slopes of fields (c, ny, nx) at the first and last column (c, ny), the first and last row (c, nx).

        Those of the rows are what the columns' leave.
        """
        near, (ny, nx) = self.near, field.shape[-2:]
        left = field[..., :near] @ self.slope @ self.smooth_y
        right = field[..., nx - near :] @ self.slope @ self.smooth_y
        out = _along_x(left, right, self.profiles[1])
        first, last = field[:, :near] - out[:, :near], field[:, ny - near :] - out[:, ny - near :]
        low = np.einsum("cyx,y->cx", first, self.slope) @ self.smooth_x
        high = np.einsum("cyx,y->cx", last, self.slope) @ self.smooth_x
        return left, right, low, high

    def field(self, slopes: Slopes, profiles: Profiles | None = None) -> Float:
        """The smooth field (c, ny, nx) with these slopes, or that part of it whose profiles are given."""
        along_y, along_x = profiles or self.profiles
        left, right, low, high = slopes
        out = _along_x(left, right, along_x)
        out += high[:, None] * along_y[:, None]
        out -= low[:, None] * along_y[::-1, None]
        return out

    def beyond(self, counts: tuple[int, int], gains: Profiles) -> Profiles:
        """Profiles of what the first so many cosines along y and x leave of the smooth field.

        However smooth inside, with a slope at its edge it has waves of all lengths.

        With counts (int, int); gains (ny,); returns (ny,): For `field`..
        """
        out = []
        for profile, count, gain in zip(self.profiles, counts, gains, strict=True):
            modes = cosines(profile.size, profile.size)
            waves = modes @ profile * gain
            waves[:count] = 0.0
            out.append((waves @ modes).astype(np.float32))
        return out[0], out[1]


def _along_x(left: Float, right: Float, profile: Float) -> Float:
    out: Float = right[..., None] * profile - left[..., None] * profile[::-1]
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
    edge = Edge((field.shape[1], field.shape[2]))
    return edge.field(edge.slopes(field))
