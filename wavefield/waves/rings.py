"""Rings of |k|: area fractions of the cells of the k plane, for integrals over the direction of k."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import sparse

SUPERSAMPLING = 8  # parts of a cell along each axis: lattice error .23 % rms, against 7.7 % with whole cells
# squared correlation of the lines of a Hann window that are 0, 1 and 2 apart, for a flat spectrum
HANN_CORRELATION = 1.0, (2 / 3) ** 2, (1 / 6) ** 2


@dataclass(frozen=True, eq=False)
class Rings:
    """Rings of equal width in |k|, and the area fraction of each cell (ky, kx) in each ring."""

    k: np.ndarray  # centres, (rings,), rad/m
    dk: float  # width, rad/m
    coverage: np.ndarray  # fraction of each ring inside the sampled plane with its corners, (rings,)
    cells: np.ndarray  # independent cells of each ring under Hann windows, for an even spectrum, (rings,)
    # squared correlation between rings, (rings, rings); a sum with energy fractions p has
    # 1 / (p . overlap . p) independent cells
    overlap: np.ndarray
    # area fraction of each cell of the plane (in the order of numpy.fft) in each ring, (cells, rings)
    shares: sparse.csr_array
    # `shares` of the half plane kx >= 0 as the arrays of a CSR matrix, for `kernels.ring_powers`.
    start: np.ndarray
    ring: np.ndarray
    weight: np.ndarray
    spread: np.ndarray  # ``weight`` times the sum of correlations with the other cells of the ring


def wavenumbers(n: int, step: float) -> np.ndarray:
    """Return the wavenumbers of `n` nodes `step` metres apart, (n,), rad/m, in the order of numpy.fft."""
    return 2 * np.pi * np.fft.fftfreq(n, step)


def half_plane(ny: int, nx: int, dy: float, dx: float) -> np.ndarray:
    """Return |k| of the cells of the half plane kx >= 0, (ny * (nx // 2 + 1),), rad/m."""
    k: np.ndarray = np.hypot(wavenumbers(ny, dy)[:, None], wavenumbers(nx, dx)[: nx // 2 + 1])
    return k.ravel()


def mirror_weights(nx: int) -> np.ndarray:
    """Return weights (nx // 2 + 1,) that extend sums over kx >= 0 to sums over all wave vectors."""
    weights = np.full(nx // 2 + 1, 2.0)
    weights[0] = 1
    if nx % 2 == 0:
        weights[-1] = 1
    return weights


def _hann_overlap(n: int) -> sparse.csr_array:
    """Return the squared correlation (n, n) between Fourier coefficients of Hann-windowed white noise."""
    rows = np.arange(n)
    out = sparse.eye_array(n, format="csr") * HANN_CORRELATION[0]
    for shift, value in enumerate(HANN_CORRELATION[1:], start=1):
        for column in (rows + shift) % n, (rows - shift) % n:
            out = out + sparse.csr_array((np.full(n, value), (rows, column)), shape=(n, n))
    return out


@lru_cache(maxsize=8)
def rings(ny: int, nx: int, dy: float, dx: float) -> Rings:
    """Return the rings of |k| for ny x nx nodes with spacings dy and dx, m. A ring is as wide as a cell of
    the k plane. Cells are divided between rings by area, in 8 x 8 parts."""
    cell_y, cell_x = 2 * np.pi / (ny * dy), 2 * np.pi / (nx * dx)
    dk = max(cell_y, cell_x)
    part = (np.arange(SUPERSAMPLING) + 0.5) / SUPERSAMPLING - 0.5
    ky = (wavenumbers(ny, dy)[:, None] + part * cell_y).ravel()
    kx = (wavenumbers(nx, dx)[:, None] + part * cell_x).ravel()
    index = (np.hypot(ky[:, None], kx) / dk).astype(np.int64)
    count = int(index.max()) + 1
    parts = (ny, SUPERSAMPLING, nx, SUPERSAMPLING)
    cell = np.broadcast_to(np.arange(ny * nx).reshape(ny, 1, nx, 1), parts).ravel()
    value = np.full(cell.size, 1.0 / SUPERSAMPLING**2)
    shares = sparse.coo_array((value, (cell, index.ravel())), shape=(ny * nx, count)).tocsr()

    area = np.asarray(shares.sum(axis=0)).ravel()
    edges = np.arange(count + 1) * dk
    coverage = area * cell_y * cell_x / (np.pi * np.diff(edges**2))
    blurred = sparse.kron(_hann_overlap(ny), _hann_overlap(nx), format="csr") @ shares
    norm = np.maximum(area, 1e-300)
    overlap = (shares.T @ blurred).toarray() / np.outer(norm, norm)
    # a ring has at least one cell
    cells = np.maximum(1 / np.maximum(np.diag(overlap), 1e-300), 1.0)

    kept = (np.arange(ny)[:, None] * nx + np.arange(nx // 2 + 1)).ravel()
    half = shares[kept].tocsr()
    rows = np.repeat(np.arange(kept.size), np.diff(half.indptr))
    weight = half.data * np.tile(mirror_weights(nx), ny)[rows]
    near = np.asarray(blurred.tocsr()[kept[rows], half.indices]).ravel()
    return Rings(
        k=(np.arange(count) + 0.5) * dk,
        dk=dk,
        coverage=np.minimum(coverage, 1.0),
        cells=cells,
        overlap=overlap,
        shares=shares,
        start=half.indptr.astype(np.int64),
        ring=half.indices.astype(np.int64),
        weight=weight,
        spread=weight * near,
    )
