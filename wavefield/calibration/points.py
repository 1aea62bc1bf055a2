"""Points of a target found in one image."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class TargetPoints:
    """Nodes of a target seen in one image.

    Parameters
    ----------
    node : ndarray of int, (n, 2)
        Indices (i, j): the node lies at x = i * mesh, y = j * mesh on the target;
        right-handed seen from above.
    pixel : ndarray, (n, 2)
        Position (X, Y) = (column, row), px.
    std : ndarray, (n,)
        Standard uncertainty per axis, px.
    size : tuple of int
        Image (width, height), px.
    notes : tuple of str
        What a person should know (marks not found, partly out of view, ...).
    z : ndarray, (n,), optional
        Height of the nodes above the target's plane, metres, where they do not all lie in it.
    placed : bool
        Whether nodes and z are in the physical frame: the target was put where it is known to be, as one
        that is moved along z by a traverse.
    """

    node: NDArray[np.int64]
    pixel: NDArray[np.float64]
    std: NDArray[np.float64]
    size: tuple[int, int]
    notes: tuple[str, ...] = field(default=())
    z: NDArray[np.float64] | None = None
    placed: bool = False

    def __len__(self) -> int:
        return len(self.node)
