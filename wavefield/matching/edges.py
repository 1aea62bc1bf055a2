"""A smooth field with the slopes that another one has at the edges of its lattice.

A cosine series has no slope there: without such a field, long waves that cross an edge would ring far into
the lattice. A quadratic fitted to the whole lattice does not serve: errors on texture grow by half.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.matching.cosines import cosines

Float = NDArray[Any]

# blocks: width over which slopes are fitted, and length over which the field decays. Wide enough that the
# noise of a slope is small, and short against the lattice.
EDGE_REACH = 6
ALONG_EDGE_SIGMA = 3.0  # blocks: smoothing of the slopes along the edge, half of their fit across


def edge_field(field: Float) -> Float:
    """The smooth field with the edge slopes of a given one.

    Parameters
    ----------
    field : ndarray, (c, ny, nx)
        Fields without holes.

    Returns
    -------
    ndarray of float32, (c, ny, nx)
        Exponentials that decay from each edge, along x and then along y.
    """
    field = np.asarray(field, np.float32)
    out = _with_slopes_along_x(field)
    rest = np.ascontiguousarray(np.swapaxes(field - out, 1, 2))
    out += np.swapaxes(_with_slopes_along_x(rest), 1, 2)
    return out


def _with_slopes_along_x(field: Float) -> Float:
    """The field with the slopes at the first and the last column, smoothed along these."""
    fit, profile, smoother = _tables(*field.shape[1:])
    first, last = field[..., :EDGE_REACH] @ fit @ smoother, field[..., -EDGE_REACH:] @ fit @ smoother
    return np.asarray(last[..., None] * profile - first[..., None] * profile[::-1])


@lru_cache(maxsize=16)
def _tables(ny: int, nx: int) -> tuple[Float, Float, Float]:
    """Weights of a line's slope, profile (nx,) of slope 1 at the last column, smoother (ny, ny) along it."""
    t = np.arange(EDGE_REACH, dtype=np.float32) - np.float32((EDGE_REACH - 1) / 2)
    profile = EDGE_REACH * np.exp((np.arange(nx) + 0.5 - nx) / EDGE_REACH)
    modes = cosines(ny, ny)
    gain = np.exp(-0.5 * np.square(ALONG_EDGE_SIGMA * np.pi * np.arange(ny) / ny))
    return t / (t * t).sum(), profile.astype(np.float32), ((modes.T * gain) @ modes).astype(np.float32)
