"""Points of a target found in one image."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class TargetPoints:
    """Nodes of a plane target seen in one image.

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
    """

    node: NDArray[np.int64]
    pixel: NDArray[np.float64]
    std: NDArray[np.float64]
    size: tuple[int, int]
    notes: tuple[str, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.node)
