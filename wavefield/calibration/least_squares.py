"""Least squares with Huber's loss, and errors of the target as noise shared by all its views."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from wavefield.rig.lens import Array
from wavefield.robust import robust_std

MAX_ITERATIONS = 60
MANY = 150  # parameters: with more zeros are not multiplied
ROWS = 128  # of a Jacobian taken together then: they have one or two cameras and poses


class Whitener:
    """Residuals times C^(-1/2), C = I + target_std^2 B B^T: the errors of a node are shared by all its views.
    B is by_node (n, 2, 3): a node's offset, m, displaces its images by B in units of their uncertainty.
    """

    def __init__(self, node: NDArray[np.int64], by_node: Array, target_std: float):
        n, count = len(node), int(node.max()) + 1
        B = by_node.reshape(2 * n, 3) * target_std
        columns = 3 * np.repeat(node, 2)[:, None] + np.arange(3)
        self._B = sparse.csr_array(
            (B.ravel(), columns.ravel(), np.arange(0, 6 * n + 1, 3)), shape=(2 * n, 3 * count)
        )
        self._Bt = self._B.T.tocsr()
        # the same as solving for all offsets with a prior, at the cost of a fit without them
        inner = np.zeros((count, 3, 3))
        np.add.at(inner, np.repeat(node, 2), B[:, :, None] * B[:, None, :])
        size, axes = np.linalg.eigh(inner)
        size = np.maximum(size, 0.0)
        # C^(-1/2) = 1 - B Q B^T on the three directions that B spans
        root = np.sqrt(1.0 + size)
        self._half = _blocks((axes * (1.0 / (root * (1.0 + root)))[:, None, :]) @ axes.transpose(0, 2, 1))
        self._gain = target_std * _blocks((axes / (1.0 + size)[:, None, :]) @ axes.transpose(0, 2, 1))

    def __call__(self, rows: Array) -> Array:
        """Make residuals (2n,) or Jacobian rows (2n, p) independent."""
        independent: Array = rows - self._B @ (self._half @ (self._Bt @ rows))
        return independent

    def offsets(self, residual: Array) -> Array:
        """Most probable offsets of the nodes, (highest node + 1, 3), metres, from residuals (2n,)."""
        offsets: Array = (self._gain @ (self._Bt @ residual)).reshape(-1, 3)
        return offsets


def _blocks(matrices: Array) -> sparse.csr_array:
    """Block-diagonal matrix of 3 x 3 blocks."""
    n = len(matrices)
    columns = np.broadcast_to(3 * np.arange(n)[:, None, None] + np.arange(3), (n, 3, 3))
    return sparse.csr_array(
        (matrices.ravel(), columns.ravel(), np.arange(0, 9 * n + 1, 3)), shape=(3 * n, 3 * n)
    )


def huber(r: Array, limit: float) -> float:
    """Sum of squares, growing linearly beyond the limit."""
    size = np.abs(r)
    return float(np.sum(np.where(size <= limit, size * size, limit * (2.0 * size - limit))))


def normal_matrix(J: Array, weight: Array) -> Array:
    """J^T W J, (p, p), of rows in the order of cameras and poses."""
    if J.shape[1] <= MANY:
        return np.asarray(J.T @ (weight[:, None] * J) if (weight < 1.0).any() else J.T @ J)
    out = np.zeros((J.shape[1], J.shape[1]))
    for k in range(0, len(J), ROWS):
        part = J[k : k + ROWS]
        used = np.flatnonzero(part.any(axis=0))
        part = part[:, used]
        out[np.ix_(used, used)] += part.T @ (weight[k : k + ROWS, None] * part)
    return out


def minimise(
    residual: Callable[[Array], Array],
    with_jacobian: Callable[[Array], tuple[Array, Array]],
    x: Array,
    limit: float | None,
    tolerance: float,
) -> tuple[Array, float]:
    """Least squares with Huber's loss, by Levenberg and Marquardt: the minimum (p,), the limit of the loss.
    Without a limit it is four robust standard deviations of the residuals.
    """
    damping = 1e-4
    diagonal = np.zeros_like(x)
    scale = 0.0
    for _ in range(MAX_ITERATIONS):
        r, J = with_jacobian(x)
        scale = limit or max(4.0 * robust_std(r), 1e-9)
        cost = huber(r, scale)
        weight = np.minimum(1.0, scale / np.maximum(np.abs(r), 1e-300))
        gradient = J.T @ (weight * r)
        # p x p: `scipy.optimize.least_squares` decomposes J at each step, thirty times slower for thousands
        # of observations; the squared condition number costs steps, not accuracy: steps end with the gradient
        normal = normal_matrix(J, weight)
        diagonal = np.maximum(diagonal, np.sqrt(np.diag(normal)))
        d = np.where(diagonal > 0.0, diagonal, 1.0)
        scaled, slope = normal / np.outer(d, d), gradient / d
        while True:
            step = -np.linalg.solve(scaled + damping * np.eye(len(x)), slope)
            decrease = -(2.0 * slope @ step + step @ scaled @ step)
            if decrease <= tolerance * cost or cost < 1e-24 * len(r):
                return x + step / d if decrease > 0.0 else x, scale
            trial = residual(x + step / d)
            gain = (cost - huber(trial, scale)) / decrease
            if gain > 0.0 and np.isfinite(gain):
                x = x + step / d
                damping = max(damping * max(1.0 / 30.0, 1.0 - (2.0 * gain - 1.0) ** 3), 1e-12)
                break
            damping *= 10.0
            if damping > 1e8:
                return x, scale
    return x, scale
