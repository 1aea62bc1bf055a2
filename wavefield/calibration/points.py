"""Points of a target found in one image, and the array types of this room."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]  # (row, column), 255 where brightest
Nodes = NDArray[np.int64]  # (n, 2): indices (i, j) of a target's nodes
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class TargetPoints:
    """Nodes of a target found in one image.

    Parameters
    ----------
    node : ndarray of int, (n, 2)
        Indices (i, j): the node is at x = i * mesh, y = j * mesh on the target;
        right-handed seen from above. Of free points x and y in units of the mesh, not whole numbers.
    pixel : ndarray, (n, 2)
        Position (X, Y) = (column, row), px.
    std : ndarray, (n,)
        Standard uncertainty per axis, px.
    size : tuple of int
        Image (width, height), px.
    notes : tuple of str
        Remarks for the user (marks not found, partly out of view, ...).
    z : ndarray, (n,), optional
        Height of the nodes above the target's plane, metres, where they are not all on it.
    placed : bool
        Whether nodes and z are in the physical frame, as for a target that a traverse moves along z.
    """

    node: Nodes
    pixel: NDArray[np.float64]
    std: NDArray[np.float64]
    size: tuple[int, int]
    notes: tuple[str, ...] = field(default=())
    z: NDArray[np.float64] | None = None
    placed: bool = False

    def __len__(self) -> int:
        return len(self.node)
