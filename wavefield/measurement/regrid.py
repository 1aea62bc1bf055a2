"""From blocks to nodes: fill holes, fit cubic splines, read these where sight lines meet the surface."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.compiled import compiled

Float = NDArray[Any]
Mask = NDArray[Any]
# blocks: largest correction in the last iteration for an elevation, after which a tenth of it is left
READING_TOLERANCE = 2e-3
Weights = tuple[np.float32, np.float32, np.float32, np.float32]  # spline weights of four blocks in a row


@dataclass(frozen=True)
class BlockLattice:
    """Regular lattice of block centres in a plane, in metres or pixels."""

    x0: float  # position of block (0, 0)
    y0: float
    step: float  # distance between blocks, in the unit of x0 and y0
    shape: tuple[int, int]  # number of blocks (ny, nx)

    @property
    def x(self) -> NDArray[Any]:
        """x of the block centres, (nx,), in the unit of x0."""
        return self.x0 + self.step * np.arange(self.shape[1])

    @property
    def y(self) -> NDArray[Any]:
        """y of the block centres, (ny,), in the unit of y0."""
        return self.y0 + self.step * np.arange(self.shape[0])


def push_pull(fields: Float, valid: Mask) -> Float:
    """Fill fields (F, ny, nx) where not `valid`, by averages over squares as large as needed."""
    # sums over squares of 1, 2, 4, ... blocks; the last plane is the number of valid blocks
    level = np.concatenate([np.where(valid, fields, 0), valid[None]]).astype(np.float32)
    levels = [level]
    while min(level.shape[1:]) > 1 and not level[-1].all():
        ny, nx = level.shape[1:]
        if ny % 2 or nx % 2:
            level = np.pad(level, [(0, 0), (0, ny % 2), (0, nx % 2)])
        upper, lower = level[:, ::2], level[:, 1::2]
        level = ((upper[..., ::2] + upper[..., 1::2]) + lower[..., ::2]) + lower[..., 1::2]
        levels.append(level)
    means = [level[:-1] / np.maximum(level[-1], np.float32(1)) for level in levels]
    out: Float = means.pop()
    for mean, level in zip(reversed(means), reversed(levels[:-1])):
        out = np.where(level[-1] > 0, mean, _doubled(out, level.shape))
    # components side by side in memory: the rounding of later sums depends on it
    return np.moveaxis(np.stack(list(out), axis=-1), -1, 0)


def _doubled(coarse: Float, shape: tuple[int, ...]) -> Float:
    """Interpolate fields (F, my, mx) to a lattice of about twice as many blocks, (F, ny, nx) = `shape`."""
    for axis in (2, 1):
        # the centre of a block lies a quarter of a coarse block away from that of its coarse block
        block = np.arange(shape[axis])
        near = block // 2
        far = np.clip(near + 2 * (block % 2) - 1, 0, coarse.shape[axis] - 1)
        start = coarse.take(near, axis)
        coarse = start + np.float32(0.25) * (coarse.take(far, axis) - start)
    return coarse


def spline_prefilter(shape: tuple[int, int]) -> Float:
    """Return the factors (ny, nx) that turn cosine coefficients of a field into those of its cubic spline."""
    ky, kx = (np.pi * np.arange(n) / n for n in shape)
    spline = ((2.0 + np.cos(ky)) / 3.0)[:, None] * ((2.0 + np.cos(kx)) / 3.0)
    return (1.0 / spline).astype(np.float32)


def interpolation_gain(q: Float) -> Float:
    """Return the mean amplitude gain of cubic-spline interpolation between blocks, for wavenumbers q.
    q, rad per block, is along one axis; from pi on, the gain is 0."""
    spline = np.sinc(q / (2 * np.pi)) ** 4 * 3.0 / (2.0 + np.cos(q))
    return np.where(np.abs(q) < np.pi, spline, 0.0)


def local_coefficients(fields: Float) -> Float:
    """Return the cubic-spline coefficients (ny, nx, F) of fields (F, ny, nx), accurate to 1e-3.
    They come from a filter of 15 blocks."""
    pole = np.sqrt(3.0) - 2.0
    kernel = np.sqrt(3.0) * pole ** np.abs(np.arange(-7.0, 8.0))
    reflected = {"kernelX": kernel, "kernelY": kernel, "borderType": cv2.BORDER_REFLECT}
    return np.stack([cv2.sepFilter2D(one, -1, **reflected) for one in fields], axis=-1)


@compiled(error_model="numpy", fastmath={"contract"})
def spline_weights(t: np.float32) -> Weights:
    """Return cubic B-spline weights of four blocks, a fraction t of the way from the second to the third."""
    s = np.float32(1.0) - t
    w0 = s * s * s * np.float32(1 / 6)
    w3 = t * t * t * np.float32(1 / 6)
    w1 = np.float32(2 / 3) - t * t + np.float32(3.0) * w3
    return w0, w1, np.float32(1.0) - w0 - w1 - w3, w3


@compiled(error_model="numpy", fastmath={"contract"})
def spline_slopes(t: np.float32) -> Weights:
    """Return the derivatives, per block, of the four `spline_weights` with respect to t."""
    s = np.float32(1.0) - t
    w0, w3 = np.float32(-0.5) * s * s, np.float32(0.5) * t * t
    w1 = np.float32(3.0) * w3 - np.float32(2.0) * t
    return w0, w1, -w0 - w1 - w3, w3


@compiled(error_model="numpy", fastmath={"contract"})
def spline_line(c: Float, k: np.uintp, step: np.uintp, w: Weights) -> np.float32:
    """Return the sum of four elements of c, weighted by w; indices start at k and increase by `step`.
    Unsigned indices save numba a check of their sign."""
    out: np.float32 = (
        w[0] * c[k] + w[1] * c[k + step] + w[2] * c[k + step + step] + w[3] * c[k + step + step + step]
    )
    return out


@compiled(error_model="numpy", fastmath={"contract"})
def spline_at(c: Float, k: np.uintp, step: np.uintp, down: np.uintp, wx: Weights, wy: Weights) -> np.float32:
    """Return the value of a spline from 4 x 4 of its coefficients c (flat), the first of them at index k.
    `step` and `down` are the distances in c between neighbours along x and y, with the weights wx and wy."""
    return (
        wy[0] * spline_line(c, k, step, wx)
        + wy[1] * spline_line(c, k + down, step, wx)
        + wy[2] * spline_line(c, k + down + down, step, wx)
        + wy[3] * spline_line(c, k + down + down + down, step, wx)
    )


@compiled(error_model="numpy", fastmath={"contract"})
def place_of(p: float, n: int) -> tuple[int, np.float32]:
    """Split a position p, in blocks of a lattice of n, into a block number and a fraction, 0 to 1.
    Positions are first limited to at least one block from each end."""
    lowest, highest = np.float32(1.0), np.float32(n) - np.float32(2.001)
    q = min(max(np.float32(p), lowest), highest)
    i: Any = np.int32(max(lowest, q))  # max(lowest, NaN) is lowest
    return i, q - np.float32(i)


@compiled(error_model="numpy", fastmath={"contract"})
def _read_along_lines(
    c: Float,
    shape: tuple[int, int],
    x: Float,
    y: Float,
    lattice: tuple[float, float, float],
    centre: tuple[float, float, float],
    height: Float,
    out: Float,
) -> None:
    """Write to out (n,) the spline where sight lines from `centre` through (x, y, height) meet z = 0.
    c (flat) are spline coefficients on a lattice of `shape` (ny, nx); `lattice` is x0, y0 and 1 / step."""
    x0, y0, across = lattice
    cx, cy, cz = centre
    ny, nx = shape
    down = np.uintp(nx)
    for k in range(len(out)):
        shrink = 1.0 / (1.0 - np.float64(height[k]) / cz)
        i, t = place_of((cx + (x[k] - cx) * shrink - x0) * across, nx)
        j, s = place_of((cy + (y[k] - cy) * shrink - y0) * across, ny)
        first = np.uintp((j - 1) * nx + i - 1)
        out[k] = spline_at(c, first, np.uintp(1), down, spline_weights(t), spline_weights(s))


@compiled(error_model="numpy", fastmath={"contract"})
def _read_surface(
    c: Float,
    shape: tuple[int, int],
    x: Float,
    y: Float,
    lattice: tuple[float, float, float],
    centre: tuple[float, float, float],
    tolerance: np.float32,
    out: Float,
) -> None:
    """Do the work of `read_surface` with flat coefficients c; write elevations to out (rows, n).
    `lattice` is x0, y0 and 1 / step of the lattice of `shape`. The loops along rows are vectorised."""
    n = x.shape[1]
    before, height, found = np.zeros(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32)
    half = np.float32(0.5)
    for row in range(len(x)):  # the previous row is the first guess
        _read_along_lines(c, shape, x[row], y[row], lattice, centre, before, height)
        for _ in range(30):
            _read_along_lines(c, shape, x[row], y[row], lattice, centre, height, found)
            largest = np.float32(0)
            for k in range(n):  # secant method: `slope` is that of the surface along the sight line
                change, rest = height[k] - before[k], found[k] - height[k]
                slope = min(max(rest / change if change != 0 else np.float32(0), -half), half)
                more = rest * slope / (np.float32(1) - slope)
                largest = max(largest, abs(rest))
                before[k], height[k] = height[k], found[k] + more
            if largest < tolerance:
                break
        out[row] = height
        before[:] = height


def read_surface(
    spline: Float, lattice: BlockLattice, centre: NDArray[Any], x: NDArray[Any], y: NDArray[Any]
) -> Float:
    """Return the elevation (ny, nx), m, at points x, y on the water, from a `spline` in apparent positions.
    The apparent position of a point is where the sight line from the camera at c = `centre` meets z = 0. For
    the spline z_a, the equation z = z_a(x_a) with x_a = c + (x - c) / (1 - z / c_z) is solved for z."""
    out = np.empty(x.shape, np.float32)
    place = lattice.x0, lattice.y0, 1.0 / lattice.step
    camera = float(centre[0]), float(centre[1]), float(centre[2])
    tolerance = np.float32(READING_TOLERANCE * lattice.step)
    _read_surface(spline.ravel(), lattice.shape, x, y, place, camera, tolerance, out)
    return out


def blocks_below(
    lattice: BlockLattice, centre: NDArray[Any], x: Float, y: Float, z: Float
) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return a tuple: flat index of the block in which a camera sees each point; mask, True on the lattice.
    Points x, y, z (ny, nx) and the camera's `centre` are in metres. The outermost blocks are replaced by
    their inner neighbours."""
    shrink = 1.0 / (1.0 - z / centre[2])
    row, column = (
        (c + (at - c) * shrink - first) / lattice.step
        for c, at, first in zip(centre[1::-1], (y, x), (lattice.y0, lattice.x0))
    )
    ny, nx = lattice.shape
    inside = (row >= 0) & (row <= ny - 1) & (column >= 0) & (column <= nx - 1)
    row, column = (
        np.clip(np.rint(v), 1, n - 2).astype(np.intp) for v, n in zip((row, column), lattice.shape)
    )
    return np.asarray(row * nx + column), np.asarray(inside)
