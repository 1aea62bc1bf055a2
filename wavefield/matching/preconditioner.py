"""Preconditioner of the MAP field: the exact coupling of its strongest modes, a diagonal for the others."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from wavefield.compiled import compiled

Float = NDArray[Any]
Factor = tuple[Float, Float]

F = np.float32
EXACT_MODES = 300  # modes of the highest signal over noise that are solved exactly

njit = compiled(error_model="numpy")
# sums may be reordered by the compiler, but in the same way on every call
reassociating = compiled(error_model="numpy", fastmath={"contract", "reassoc"})


class Preconditioner:
    """Tables of the exact block, the same for all components of a field on a lattice (ny, nx).
    ratio, inverse and foot (my, mx): signal over noise, inverse spectrum and footprint of the modes.
    """

    def __init__(self, lattice: tuple[int, int], ratio: Float, inverse: Float, foot: Float) -> None:
        count = min(EXACT_MODES, ratio.size)
        order = np.sort(np.argsort(-ratio.ravel(), kind="stable")[:count])
        self._iy, self._ix = (i.astype(np.int64) for i in np.divmod(order, ratio.shape[1]))
        sums = []
        for n, i in zip(lattice, (self._iy, self._ix), strict=True):
            m = np.arange(2 * int(i.max()) + 1)[:, None]
            sums.append(np.cos(np.pi * m * (np.arange(n) + 0.5) / n).astype(np.float32))
        self._sum_rows, self._sum_columns = sums[0], np.ascontiguousarray(sums[1].T)
        norm = 0.5 * foot.ravel()[order].astype(np.float64)
        for n, i in zip(lattice, (self._iy, self._ix), strict=True):
            norm *= np.where(i == 0, np.sqrt(1.0 / n), np.sqrt(2.0 / n))
        self._norm = norm.astype(np.float32)
        self._own_inverse = inverse.ravel()[order].astype(np.float32)
        self._square = np.square(foot.ravel()[order])
        half = ratio.shape[1] // 2  # positions among the coefficients by parity
        line = (self._iy % 2 * (ratio.shape[0] // 2) + self._iy // 2) * 2 + self._ix % 2
        self._positions = {c: (line * c + np.arange(c)[:, None]) * half + self._ix // 2 for c in (1, 2)}

    def factor(self, information: Float) -> Factor:
        """Cholesky factor of the exact block and its scale for an information (ny, nx)."""
        table = self._sum_rows @ information @ self._sum_columns
        scale = 1.0 / np.sqrt(self._own_inverse + self._square * F(information.mean()))
        count = self._norm.size
        matrix = np.zeros((count, count), np.float32)
        _assemble(table, self._iy, self._ix, self._norm * scale, self._own_inverse * scale * scale, matrix)
        lower, failed = scipy.linalg.lapack.spotrf(matrix.T, lower=0, clean=0, overwrite_a=1)
        if failed:  # by rounding: scaled as it is, its diagonal is about 1
            lower = np.eye(count, dtype=np.float32, order="F")
        return lower, scale.astype(np.float32)

    def apply(self, residual: Float, diagonal: Float, factor: Factor, out: Float) -> float:
        """Write the next step; return its product with the residual."""
        lower, scale = factor
        positions = self._positions[residual.shape[3]]
        gathered = np.empty(positions.shape, F)
        _gather(residual.ravel(), positions, scale, gathered)
        exact, _ = scipy.linalg.lapack.spotrs(lower, gathered.T, lower=0, overwrite_b=1)
        return float(
            _preconditioned(diagonal.ravel(), residual.ravel(), exact.T, positions, scale, out.ravel())
        )


@reassociating
def _gather(residual: Float, positions: Float, scale: Float, out: Float) -> None:
    for n in range(len(positions)):
        for k in range(len(scale)):
            out[n, k] = residual[positions[n, k]] * scale[k]


@reassociating
def _preconditioned(
    diagonal: Float, residual: Float, exact: Float, positions: Float, scale: Float, out: Float
) -> F:
    """Write the preconditioned residual, diagonal and exact part; return its product with the residual."""
    for i in range(len(out)):
        out[i] = diagonal[i] * residual[i]
    for n in range(len(positions)):
        for k in range(len(scale)):
            out[positions[n, k]] = exact[n, k] * scale[k]
    total = F(0)
    for i in range(len(out)):
        total += residual[i] * out[i]
    return total


@njit
def _assemble(table: Float, iy: Float, ix: Float, norm: Float, own: Float, out: Float) -> None:
    """Lower triangle of F A F + 1/S among some modes, scaled: products of cosines are sums of cosines."""
    for p in range(iy.size):
        for q in range(p + 1):
            y0, y1 = abs(iy[p] - iy[q]), iy[p] + iy[q]
            x0, x1 = abs(ix[p] - ix[q]), ix[p] + ix[q]
            total = table[y0, x0] + table[y0, x1] + table[y1, x0] + table[y1, x1]
            out[p, q] = norm[p] * norm[q] * total
        out[p, p] += own[p]
