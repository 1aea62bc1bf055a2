"""From a lattice of blocks to the nodes of the physical grid.

Holes are filled by the thin plate that bends least, the whole lattice is smoothed by a thin plate (diagonal
under the cosine transform), and nodes are read from a cubic spline where their line of sight meets the
surface.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import scipy.fft
import scipy.sparse as sparse
from numba import njit
from numpy.typing import NDArray
from scipy.sparse.linalg import spsolve

Float = NDArray[Any]
Mask = NDArray[Any]

_REACH = 12.0  # blocks: so far from anything measured the plate says no more than a local mean
# window and smoother took from short waves before a field could say how short they are: more than they take
# from what is left
LOST = np.float32(1.6)
_STANDS_OUT = np.float32(5.0)  # times the median
_AROUND = 3.0  # blocks: about a window, and a third of the shortest waves


@dataclass(frozen=True)
class Lattice:
    """Block centres in a plane: apparent coordinates or pixels.

    Parameters
    ----------
    x0, y0 : float
        Position of block (0, 0).
    step : float
        Distance between blocks, in the unit of x0 and y0.
    shape : tuple of int
        Number of blocks (ny, nx).
    """

    x0: float
    y0: float
    step: float
    shape: tuple[int, int]

    @property
    def x(self) -> NDArray[Any]:
        """Block centres along x, (nx,)."""
        return self.x0 + self.step * np.arange(self.shape[1])

    @property
    def y(self) -> NDArray[Any]:
        """Block centres along y, (ny,)."""
        return self.y0 + self.step * np.arange(self.shape[0])


def bending_energy(region: Mask) -> sparse.csr_array:
    """Matrix of the thin plate's bending energy on a lattice.

    Parameters
    ----------
    region : ndarray of bool, (ny, nx)
        Blocks that belong to the plate; its edges are free.

    Returns
    -------
    csr_array, (ny nx, ny nx)
        Q with f Q f = sum f_xx^2 + 2 f_xy^2 + f_yy^2 over the second differences inside the region.
    """
    index = np.arange(region.size).reshape(region.shape)
    stencils = (
        ([index[:, :-2], index[:, 1:-1], index[:, 2:]], (1.0, -2.0, 1.0)),
        ([index[:-2], index[1:-1], index[2:]], (1.0, -2.0, 1.0)),
        (
            [index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]],
            np.sqrt(2.0) * np.array([1, -1, -1, 1]),
        ),
    )
    flat = region.ravel()
    total = sparse.csr_array((region.size, region.size))
    for places, weights in stencils:
        points = np.stack([p.ravel() for p in places], axis=1)
        points = points[flat[points].all(axis=1)]
        n, m = points.shape
        rows = np.repeat(np.arange(n), m)
        difference = sparse.csr_array((np.tile(weights, n), (rows, points.ravel())), shape=(n, region.size))
        total = total + difference.T @ difference
    return sparse.csr_array(total)


def push_pull(fields: Float, valid: Mask) -> Float:
    """Fill gaps from coarser and coarser means.

    Parameters
    ----------
    fields : ndarray of float32, (ny, nx, F)
        Values; those at gaps are not looked at.
    valid : ndarray of bool, (ny, nx)
        Where the values hold.

    Returns
    -------
    ndarray of float32, (ny, nx, F)
        The same with gaps filled; zero if nothing is valid.
    """
    weight: Float = valid.astype(np.float32)
    sums: Float = np.where(valid[..., None], fields, np.float32(0))
    levels = [(sums, weight)]
    while min(weight.shape) > 1 and not (weight > 0).all():
        size = ((weight.shape[1] + 1) // 2, (weight.shape[0] + 1) // 2)
        sums = cv2.resize(sums, size, interpolation=cv2.INTER_AREA).reshape(size[1], size[0], -1)
        weight = cv2.resize(weight, size, interpolation=cv2.INTER_AREA)
        levels.append((sums, weight))
    sums, weight = levels.pop()
    out = sums / np.maximum(weight, np.float32(1e-6))[..., None]
    while levels:
        sums, weight = levels.pop()
        coarse = cv2.resize(out, weight.shape[::-1], interpolation=cv2.INTER_LINEAR).reshape(sums.shape)
        # a coarse cell that is partly covered keeps the mean of its covered part
        mean = sums / np.maximum(weight, np.float32(1e-6))[..., None]
        out = np.where((weight > 0)[..., None], mean, coarse)
    return out


def fill(fields: Float, valid: Mask, wanted: Mask, energy: sparse.csr_array) -> Float:
    """Fill holes with the thin plate that passes through their rims.

    Parameters
    ----------
    fields : ndarray of float32, (ny, nx, F)
        Values; those at holes are not looked at.
    valid : ndarray of bool, (ny, nx)
        Where the values hold.
    wanted : ndarray of bool, (ny, nx)
        Blocks that are looked at later: holes there are filled by the plate, elsewhere by local means.
    energy : csr_array
        As given by `bending_energy`.

    Returns
    -------
    ndarray of float32, (ny, nx, F)
        The same without holes.

    Notes
    -----
    Minimises f Q f over the blocks of the hole, the others held.
    """
    out = push_pull(fields, valid)
    near = cv2.distanceTransform((~valid).astype(np.uint8), cv2.DIST_L2, 3) <= _REACH
    holes = np.flatnonzero(wanted & ~valid & near)
    if holes.size == 0 or not valid.any():
        return out
    flat = out.reshape(-1, out.shape[-1])
    known = flat.astype(np.float64)
    guess = known[holes]
    known[holes] = 0.0
    rows = energy[holes]
    # the faint pull to the local mean settles blocks that touch nothing
    faint = 1e-7
    matrix = rows[:, holes] + faint * sparse.eye_array(holes.size)
    right = faint * guess - rows @ known
    solved = spsolve(sparse.csc_array(matrix), right)
    flat[holes] = np.reshape(solved, guess.shape)
    return out


def levelled(std: Float, valid: Mask) -> Float:
    """Uncertainty as it is around each block, holes filled.

    Parameters
    ----------
    std : ndarray of float32, (ny, nx)
        Standard uncertainty of each block; those of holes are not looked at.
    valid : ndarray of bool, (ny, nx)
        Where it holds.

    Returns
    -------
    ndarray of float32, (ny, nx)
        Mean over the blocks around; never less than half the block's own.

    Notes
    -----
    The uncertainty of one block comes from few residuals, and what the window takes from a wave is nil where
    the wave passes through zero: neither says that the error is small there.
    """
    if not valid.any():
        return np.zeros_like(std)
    # a block at the edge of what is seen may stand out a hundredfold: that says nothing of its neighbours
    usual = np.float32(np.median(std[valid]))
    known = np.where(valid, np.minimum(std, _STANDS_OUT * usual), np.float32(0))
    total, weight = (
        cv2.GaussianBlur(f, (0, 0), _AROUND, borderType=cv2.BORDER_REFLECT)
        for f in (known, valid.astype(np.float32))
    )
    around = np.where(weight > 1e-3, total / np.maximum(weight, np.float32(1e-3)), usual)
    return np.where(valid, np.maximum(around, np.float32(0.5) * std), around)


def thin_plate(shape: tuple[int, int], smoothing: float) -> Float:
    """Response of the smoothing thin plate and of the spline prefilter to each cosine.

    Parameters
    ----------
    shape : tuple of int
        Lattice (ny, nx).
    smoothing : float
        Weight of the bending energy, block lengths to the fourth power; the plate halves waves of
        2 pi smoothing^(1/4) blocks.

    Returns
    -------
    ndarray of float32, (ny, nx)
        1 / ((1 + smoothing k^4) b_x b_y), b the sampled cubic B-spline.
    """
    ky, kx = (np.pi * np.arange(n) / n for n in shape)
    spline = ((2.0 + np.cos(ky)) / 3.0)[:, None] * ((2.0 + np.cos(kx)) / 3.0)
    return (1.0 / ((1.0 + smoothing * (ky[:, None] ** 2 + kx**2) ** 2) * spline)).astype(np.float32)


def coefficients(fields: Float, response: Float) -> Float:
    """Cubic-spline coefficients of the smoothed fields.

    Parameters
    ----------
    fields : ndarray of float32, (ny, nx, F)
        Values on the lattice, without gaps.
    response : ndarray of float32, (ny, nx)
        As given by `thin_plate`.

    Returns
    -------
    ndarray of float32, (ny, nx, F)
    """
    stack = np.ascontiguousarray(np.moveaxis(fields, -1, 0))
    waves = scipy.fft.dctn(stack, axes=(1, 2), norm="ortho", workers=1)
    waves *= response
    smooth = scipy.fft.idctn(waves, axes=(1, 2), norm="ortho", workers=1, overwrite_x=True)
    return np.ascontiguousarray(np.moveaxis(smooth, 0, -1), dtype=np.float32)


@njit(cache=True, inline="always")
def _weights(t):  # type: ignore[no-untyped-def]  # pragma: no cover
    s = np.float32(1.0) - t
    w0 = s * s * s * np.float32(1 / 6)
    w3 = t * t * t * np.float32(1 / 6)
    w1 = np.float32(2 / 3) - t * t + np.float32(3.0) * w3
    return w0, w1, np.float32(1.0) - w0 - w1 - w3, w3


@njit(cache=True, inline="always")
def _spline(c, f, i, j, wx, wy):  # type: ignore[no-untyped-def]  # pragma: no cover
    total = np.float32(0.0)
    for r in range(4):
        row = (
            wx[0] * c[j - 1 + r, i - 1, f]
            + wx[1] * c[j - 1 + r, i, f]
            + wx[2] * c[j - 1 + r, i + 1, f]
            + wx[3] * c[j - 1 + r, i + 2, f]
        )
        total += (wy[0] if r == 0 else wy[1] if r == 1 else wy[2] if r == 2 else wy[3]) * row
    return total


@njit(cache=True, inline="always")
def _place(p, n):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Block to the left and distance from it; kept one block inside the lattice."""
    p = min(max(p, 1.0), n - 2.001)
    i = int(p)
    return i, np.float32(p - i)


@njit(cache=True, error_model="numpy")
def _read_surface(c, x, y, x0, y0, step, cx, cy, cz, out, p, q):  # type: ignore[no-untyped-def]  # pragma: no cover
    ny, nx, fields = c.shape
    for k in range(x.size):
        z = 0.0
        xa, ya = x[k], y[k]
        i, j = 1, 1
        wx = wy = _weights(np.float32(0.0))
        for _ in range(30):
            i, t = _place((xa - x0) / step, nx)
            j, s = _place((ya - y0) / step, ny)
            wx, wy = _weights(t), _weights(s)
            z = float(_spline(c, 0, i, j, wx, wy))
            shrink = 1.0 / (1.0 - z / cz)
            xn, yn = cx + (x[k] - cx) * shrink, cy + (y[k] - cy) * shrink
            move = abs(xn - xa) + abs(yn - ya)
            xa, ya = xn, yn
            if move < 1e-3 * step:
                break
        i, t = _place((xa - x0) / step, nx)
        j, s = _place((ya - y0) / step, ny)
        wx, wy = _weights(t), _weights(s)
        for f in range(fields):
            out[f, k] = _spline(c, f, i, j, wx, wy)
        p[k] = min(i + int(t + 0.5), nx - 1)
        q[k] = min(j + int(s + 0.5), ny - 1)


def read_surface(
    spline: Float, lattice: Lattice, centre: NDArray, x: NDArray, y: NDArray
) -> tuple[Float, NDArray[np.int64]]:
    """Fields at physical positions, from a lattice in a camera's apparent coordinates.

    Parameters
    ----------
    spline : ndarray of float32, (ny, nx, F)
        `coefficients`; field 0 is the elevation in metres.
    lattice : Lattice
        Block centres in apparent coordinates, metres.
    centre : ndarray, (3,)
        Centre of that camera, metres.
    x, y : ndarray, shape S
        Wanted positions, metres.

    Returns
    -------
    values : ndarray of float32, (F,) + S
        The fields at (x, y).
    block : ndarray of int, S
        Flat index of the block nearest to each.

    Notes
    -----
    Solves x = x_a + D_a(x_a) z(x_a) by fixed point: with straight rays, x_a = c + (x - c) / (1 - z / c_z).
    """
    nodes = np.broadcast_shapes(np.shape(x), np.shape(y))
    xs, ys = (np.ascontiguousarray(np.broadcast_to(v, nodes), dtype=np.float64).ravel() for v in (x, y))
    out = np.empty((spline.shape[2], xs.size), np.float32)
    p, q = np.empty(xs.size, np.int64), np.empty(xs.size, np.int64)
    cx, cy, cz = (float(c) for c in centre)
    _read_surface(spline, xs, ys, lattice.x0, lattice.y0, lattice.step, cx, cy, cz, out, p, q)
    return out.reshape(-1, *nodes), (q * lattice.shape[1] + p).reshape(nodes)


@njit(cache=True, error_model="numpy")
def _read_anchored(c, x, y, x0, y0, step, steps, out, p, q):  # type: ignore[no-untyped-def]  # pragma: no cover
    ny, nx, fields = c.shape
    for k in range(x.size):
        xa, ya = x[k], y[k]
        if not (np.isfinite(xa) and np.isfinite(ya)):
            for f in range(fields):
                out[f, k] = np.nan
            p[k] = q[k] = 0
            continue
        for _ in range(steps):
            i, t = _place((xa - x0) / step, nx)
            j, s = _place((ya - y0) / step, ny)
            wx, wy = _weights(t), _weights(s)
            xa = x[k] - 0.5 * _spline(c, 0, i, j, wx, wy)
            ya = y[k] - 0.5 * _spline(c, 1, i, j, wx, wy)
        i, t = _place((xa - x0) / step, nx)
        j, s = _place((ya - y0) / step, ny)
        wx, wy = _weights(t), _weights(s)
        for f in range(fields):
            out[f, k] = _spline(c, f, i, j, wx, wy)
        p[k] = min(i + int(t + 0.5), nx - 1)
        q[k] = min(j + int(s + 0.5), ny - 1)


def read_anchored(
    spline: Float, lattice: Lattice, X: NDArray, Y: NDArray, steps: int = 2
) -> tuple[Float, NDArray[np.int64]]:
    """Displacement of the patches whose paths have their mid-points at given pixels.

    Parameters
    ----------
    spline : ndarray of float32, (ny, nx, F)
        `coefficients`; fields 0 and 1 are the displacement (u, v), px, at the place of departure.
    lattice : Lattice
        Block centres, px.
    X, Y : ndarray, shape S
        Mid-points, px; NaN gives NaN.
    steps : int, default 2
        Fixed-point steps; 0 reads at the place of departure.

    Returns
    -------
    values : ndarray of float32, (F,) + S
        The fields, read at X - d/2.
    block : ndarray of int, S
        Flat index of the block nearest to each.
    """
    nodes = np.shape(X)
    xs, ys = (np.ascontiguousarray(v, dtype=np.float64).ravel() for v in (X, Y))
    out = np.empty((spline.shape[2], xs.size), np.float32)
    p, q = np.empty(xs.size, np.int64), np.empty(xs.size, np.int64)
    _read_anchored(spline, xs, ys, lattice.x0, lattice.y0, lattice.step, steps, out, p, q)
    return out.reshape(-1, *nodes), (q * lattice.shape[1] + p).reshape(nodes)
