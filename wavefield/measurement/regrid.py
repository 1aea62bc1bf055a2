"""From a lattice of blocks to nodes: cubic splines, read where sight lines meet the surface."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from wavefield.compiled import compiled

Float = NDArray[Any]
Mask = NDArray[Any]
Weights = tuple[np.float32, np.float32, np.float32, np.float32]  # of four blocks in a row


@dataclass(frozen=True)
class BlockLattice:
    """Block centres in a plane: apparent coordinates or pixels."""

    x0: float  # Position of block (0, 0)
    y0: float
    step: float  # Distance between blocks, in the unit of x0 and y0
    shape: tuple[int, int]  # Number of blocks (ny, nx)

    @property
    def x(self) -> NDArray[Any]:
        """Block centres along x, (nx,)."""
        return self.x0 + self.step * np.arange(self.shape[1])

    @property
    def y(self) -> NDArray[Any]:
        """Block centres along y, (ny,)."""
        return self.y0 + self.step * np.arange(self.shape[0])


@compiled()
def _pull(fields: Float, weight: Float, sums: Float, total: Float) -> None:
    """Add up squares of two by two, blocks without weight left out."""
    sums[:] = 0
    total[:] = 0
    for j in range(weight.shape[0]):
        for i in range(weight.shape[1]):
            if weight[j, i] > 0:
                total[j // 2, i // 2] += weight[j, i]
                for f in range(fields.shape[2]):
                    sums[j // 2, i // 2, f] += fields[j, i, f]


@compiled()
def _push(coarse: Float, sums: Float, weight: Float, out: Float) -> None:
    """Mean of each block, or where it has no weight the coarser means read between their centres."""
    quarter = np.float32(0.25)
    for j in range(weight.shape[0]):
        for i in range(weight.shape[1]):
            if weight[j, i] > 0:
                for f in range(sums.shape[2]):
                    out[j, i, f] = sums[j, i, f] / weight[j, i]
            else:
                # a quarter of a coarse block to either side of its centre
                r, c = j // 2, i // 2
                r2 = min(max(r + 2 * (j % 2) - 1, 0), coarse.shape[0] - 1)
                c2 = min(max(c + 2 * (i % 2) - 1, 0), coarse.shape[1] - 1)
                for f in range(sums.shape[2]):
                    near = coarse[r, c, f] + quarter * (coarse[r, c2, f] - coarse[r, c, f])
                    far = coarse[r2, c, f] + quarter * (coarse[r2, c2, f] - coarse[r2, c, f])
                    out[j, i, f] = near + quarter * (far - near)


def push_pull(fields: Float, valid: Mask) -> Float:
    """Fields (ny, nx, F) with the gaps of valid (ny, nx) filled from coarser and coarser means."""
    levels: list[tuple[Float, Float]] = [(fields, valid.astype(np.float32))]
    while min(levels[-1][1].shape) > 1 and not levels[-1][1].all():
        ny, nx = ((n + 1) // 2 for n in levels[-1][1].shape)
        sums, total = np.empty((ny, nx, fields.shape[2]), np.float32), np.empty((ny, nx), np.float32)
        _pull(*levels[-1], sums, total)
        levels.append((sums, total))
    out: Float = np.zeros((1, 1, fields.shape[2]), np.float32)
    for sums, total in reversed(levels):
        coarse, out = out, np.empty(sums.shape, np.float32)
        _push(coarse, sums, total, out)
    return out


def thin_plate(shape: tuple[int, int], smoothing: float) -> Float:
    """Gain of the smoothing thin plate and of the spline prefilter for each cosine, (ny, nx).
    1 / ((1 + smoothing k^4) b_x b_y), with b the sampled cubic B-spline.
    """
    ky, kx = (np.pi * np.arange(n) / n for n in shape)
    spline = ((2.0 + np.cos(ky)) / 3.0)[:, None] * ((2.0 + np.cos(kx)) / 3.0)
    return (1.0 / ((1.0 + smoothing * (ky[:, None] ** 2 + kx**2) ** 2) * spline)).astype(np.float32)


def interpolation_gain(q: Float) -> Float:
    """Gain of reading a field between its blocks from a cubic spline; q along one axis, rad per block."""
    spline = np.sinc(q / (2 * np.pi)) ** 4 * 3.0 / (2.0 + np.cos(q))
    return np.where(np.abs(q) < np.pi, spline, 0.0)


def coefficients(fields: Float) -> Float:
    """Cubic-spline coefficients of fields (ny, nx, F)."""
    stack = np.ascontiguousarray(np.moveaxis(fields, -1, 0))
    waves = scipy.fft.dctn(stack, axes=(1, 2), norm="ortho", workers=1)
    waves *= thin_plate(stack.shape[1:], 0.0)
    smooth = scipy.fft.idctn(waves, axes=(1, 2), norm="ortho", workers=1, overwrite_x=True)
    return np.ascontiguousarray(np.moveaxis(smooth, 0, -1), dtype=np.float32)


@compiled(error_model="numpy", fastmath={"contract"})
def spline_weights(t: np.float32) -> Weights:
    """Weights of four blocks for a fraction t of the way from the second to the third."""
    s = np.float32(1.0) - t
    w0 = s * s * s * np.float32(1 / 6)
    w3 = t * t * t * np.float32(1 / 6)
    w1 = np.float32(2 / 3) - t * t + np.float32(3.0) * w3
    return w0, w1, np.float32(1.0) - w0 - w1 - w3, w3


@compiled(error_model="numpy", fastmath={"contract"})
def spline_slopes(t: np.float32) -> Weights:
    """Derivatives of `spline_weights`."""
    s = np.float32(1.0) - t
    w0, w3 = np.float32(-0.5) * s * s, np.float32(0.5) * t * t
    w1 = np.float32(3.0) * w3 - np.float32(2.0) * t
    return w0, w1, -w0 - w1 - w3, w3


@compiled(error_model="numpy", fastmath={"contract"})
def spline_line(c: Float, k: np.uintp, step: np.uintp, w: Weights) -> np.float32:
    """Four neighbours along x from element k on; unsigned indices are not checked for a minus."""
    out: np.float32 = (
        w[0] * c[k] + w[1] * c[k + step] + w[2] * c[k + step + step] + w[3] * c[k + step + step + step]
    )
    return out


@compiled(error_model="numpy", fastmath={"contract"})
def spline_at(c: Float, k: np.uintp, step: np.uintp, down: np.uintp, wx: Weights, wy: Weights) -> np.float32:
    """One field: element k is the first of four by four."""
    return (
        wy[0] * spline_line(c, k, step, wx)
        + wy[1] * spline_line(c, k + down, step, wx)
        + wy[2] * spline_line(c, k + down + down, step, wx)
        + wy[3] * spline_line(c, k + down + down + down, step, wx)
    )


@compiled(error_model="numpy", fastmath={"contract"})
def place_of(p: float, n: int) -> tuple[int, np.float32]:
    """Block to the left and distance from it; kept one block inside the lattice, even of a NaN."""
    lowest, highest = np.float32(1.0), np.float32(n) - np.float32(2.001)
    q = min(max(np.float32(p), lowest), highest)
    i: Any = np.int32(max(lowest, q))  # of two, `max` returns the first beside a NaN
    return i, q - np.float32(i)


@compiled(error_model="numpy", fastmath={"contract"})
def _read_surface(
    c: Float,
    shape: tuple[int, int, int],
    x: Float,
    y: Float,
    lattice: tuple[float, float, float],
    centre: tuple[float, float, float],
    out: Float,
    p: NDArray[np.int64],
    q: NDArray[np.int64],
) -> None:
    """Fill out (F, n), and block indices p along x and q along y (n,)."""
    ny, nx, fields = shape
    x0, y0, step = lattice
    cx, cy, cz = centre
    across = 1.0 / step
    step_x, step_y = np.uintp(fields), np.uintp(nx * fields)
    shrink = 1.0
    for k in range(x.size):
        # the node before is a good guess
        xa, ya = cx + (x[k] - cx) * shrink, cy + (y[k] - cy) * shrink
        i, j = 1, 1
        t = s = np.float32(0.0)
        wx = wy = spline_weights(t)
        first = np.uintp(0)
        z = 0.0
        for _ in range(30):
            i, t = place_of((xa - x0) * across, nx)
            j, s = place_of((ya - y0) * across, ny)
            wx, wy = spline_weights(t), spline_weights(s)
            first = np.uintp(((j - 1) * nx + i - 1) * fields)
            z = float(spline_at(c, first, step_x, step_y, wx, wy))
            shrink = 1.0 / (1.0 - z / cz)
            xn, yn = cx + (x[k] - cx) * shrink, cy + (y[k] - cy) * shrink
            move = abs(xn - xa) + abs(yn - ya)
            xa, ya = xn, yn
            if move < 8e-4 * step:  # what is left is the slope of the sight line times that of z of it
                break
        out[0, k] = z
        for f in range(1, fields):
            out[f, k] = spline_at(c, first + np.uintp(f), step_x, step_y, wx, wy)
        p[k] = min(i + int(t + 0.5), nx - 1)
        q[k] = min(j + int(s + 0.5), ny - 1)


def read_surface(
    spline: Float, lattice: BlockLattice, centre: NDArray[Any], x: NDArray[Any], y: NDArray[Any]
) -> tuple[Float, NDArray[np.int64]]:
    """Fields (F, ...) at physical positions x, y, metres, of a spline (ny, nx, F), and indices of the blocks.
    Solves x = x_a + D_a(x_a) z(x_a) by fixed point: with straight rays x_a = c + (x - c) / (1 - z / c_z).
    """
    nodes = np.broadcast_shapes(np.shape(x), np.shape(y))
    xs, ys = (np.ascontiguousarray(np.broadcast_to(v, nodes), dtype=np.float64).ravel() for v in (x, y))
    out = np.empty((spline.shape[2], xs.size), np.float32)
    p, q = np.empty(xs.size, np.int64), np.empty(xs.size, np.int64)
    place, camera = (
        (lattice.x0, lattice.y0, lattice.step),
        (float(centre[0]), float(centre[1]), float(centre[2])),
    )
    _read_surface(spline.ravel(), spline.shape, xs, ys, place, camera, out, p, q)
    return out.reshape(-1, *nodes), (q * lattice.shape[1] + p).reshape(nodes)
