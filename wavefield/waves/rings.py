"""Integration over the angle of the wave vector: shares of the cells of the k plane in rings of |k|."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import sparse

SUPERSAMPLING = 8  # per axis: lattice error .23 % rms instead of 7.7 % with whole cells


@dataclass(frozen=True, eq=False)
class Rings:
    """Rings of the k plane of one rectangle of nodes."""

    k: np.ndarray  # (rings,): Centres, rad/m
    dk: float  # Width, rad/m
    coverage: np.ndarray  # (rings,): Share of each ring inside the sampled plane, corners included
    # (rings,): Independent cells of each ring under Hann windows in space, for energy spread evenly over it
    cells: np.ndarray
    # (rings, rings): Squared correlation between the means of rings, so that 1 / (p . overlap . p) is the
    # number of independent cells of a sum with shares p
    overlap: np.ndarray
    # (ny * nx, rings): Share of the area of each cell of the full plane (numpy's order) in each ring
    shares: sparse.csr_array
    start: np.ndarray  # The same for the half plane kx >= 0, as `kernels.ring_powers` takes it
    ring: np.ndarray
    weight: np.ndarray
    # As ``weight``, times the ring's part of the cells correlated with it: for the squared power
    spread: np.ndarray


def wavenumbers(n: int, step: float) -> np.ndarray:
    """Wavenumbers of `n` nodes `step` apart in numpy's order, (n,), rad/m."""
    return 2 * np.pi * np.fft.fftfreq(n, step)


def half_plane(ny: int, nx: int, dy: float, dx: float) -> np.ndarray:
    """Wavenumbers |k| of the cells of the half plane kx >= 0, (ny * (nx // 2 + 1),), rad/m."""
    k: np.ndarray = np.hypot(wavenumbers(ny, dy)[:, None], wavenumbers(nx, dx)[: nx // 2 + 1])
    return k.ravel()


def mirror_weights(nx: int) -> np.ndarray:
    """How often each column kx >= 0 of a real field's transform counts in the full plane, (nx // 2 + 1,)."""
    weights = np.full(nx // 2 + 1, 2.0)
    weights[0] = 1
    if nx % 2 == 0:
        weights[-1] = 1
    return weights


def _hann_overlap(n: int) -> sparse.csr_array:
    # squared correlation of neighbouring lines of a Hann-windowed transform: 1, (2/3)^2, (1/6)^2
    out = sparse.csr_array((n, n))
    rows = np.arange(n)
    for shift, value in ((0, 1.0), (1, 4 / 9), (-1, 4 / 9), (2, 1 / 36), (-2, 1 / 36)):
        out = out + sparse.csr_array((np.full(n, value), (rows, (rows + shift) % n)), shape=(n, n))
    return out


@lru_cache(maxsize=8)
def rings(ny: int, nx: int, dy: float, dx: float) -> Rings:
    """Cut the k plane into rings as wide as its cells; the corners beyond the Nyquist wavenumber are kept.
    Every cell is split into 8 x 8 parts, each in the ring of its centre: energy is conserved to rounding.
    """
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
    # a ring smaller than a cell still holds one cell
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
