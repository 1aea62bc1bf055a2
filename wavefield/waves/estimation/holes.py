"""Values for missing nodes: the smoothest surface through those around them, and its error."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse import linalg

Array = NDArray[Any]

# second differences along x, along y and across, whose squares a thin plate's bending energy sums
_STENCILS = (
    (((0, -1), 1.0), ((0, 0), -2.0), ((0, 1), 1.0)),
    (((-1, 0), 1.0), ((0, 0), -2.0), ((1, 0), 1.0)),
    (((0, 0), 2**0.5), ((0, 1), -(2**0.5)), ((1, 0), -(2**0.5)), ((1, 1), 2**0.5)),
)


def smoothest(field: Array, hole: NDArray[np.bool_]) -> Array:
    """Values of the missing nodes (hole.sum(),) of a field (ny, nx): least squares of second differences.

    A thin plate through the nodes around a hole: waves of length L leave (2 pi r / L)^4 / 64 of their
    amplitude in the middle of one of radius r, while the nearest node leaves 2 pi r / L.
    """
    number = np.full(hole.shape, -1)
    number[hole] = np.arange(hole.sum())
    known = np.where(hole, 0.0, field)
    level = float(known[~hole].mean()) if not hole.all() else 0.0
    known = np.where(hole, 0.0, known - level)
    rows, columns, weights, right = [], [], [], []
    count = 0
    for stencil in _STENCILS:
        offsets = np.array([offset for offset, _ in stencil])
        low, high = -offsets.min(axis=0), offsets.max(axis=0)
        ny, nx = (n - a - b for n, a, b in zip(hole.shape, low, high))
        views = [
            (slice(low[0] + dy, low[0] + dy + ny), slice(low[1] + dx, low[1] + dx + nx)) for dy, dx in offsets
        ]
        touched = np.logical_or.reduce([hole[view] for view in views])
        equation = count + np.arange(touched.sum())
        constant = np.zeros(equation.size)
        for view, (_, weight) in zip(views, stencil):
            unknown = number[view][touched]
            inside = unknown >= 0
            rows.append(equation[inside])
            columns.append(unknown[inside])
            weights.append(np.full(inside.sum(), weight))
            constant += weight * known[view][touched]
        right.append(-constant)
        count += equation.size
    entries = np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))
    matrix = sparse.csc_array(entries, shape=(count, int(hole.sum())))
    normal = (matrix.T @ matrix).tocsc()
    return np.asarray(linalg.spsolve(normal, matrix.T @ np.concatenate(right)) + level)
