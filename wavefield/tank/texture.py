"""White noise painted on the surface, seen by ray casting."""

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from wavefield.compiled import compiled
from wavefield.rig import Camera
from wavefield.tank.basin import Snapshot

Array = NDArray[np.float64]


class Paint:
    """Band-limited white noise as a function of position: a cubic B-spline with random coefficients.

    With x, y, metres; mesh, metres.
    """

    def __init__(self, x: tuple[float, float], y: tuple[float, float], mesh: float, seed: int) -> None:
        count = [int(np.ceil((hi - lo) / mesh)) + 5 for lo, hi in (x, y)]
        rng = np.random.default_rng([seed, 5])
        self._coefficients = rng.standard_normal((count[1], count[0]), np.float32)
        # the mean of sum B^2 over a cell is 0.479 along each axis: unit variance
        self._coefficients /= np.float32(0.4794)
        self._x0, self._y0, self._mesh = x[0] - 2 * mesh, y[0] - 2 * mesh, mesh

    def __call__(self, x: Array, y: Array) -> NDArray[np.float32]:
        """Texture at points.

        With x, y, metres.
        """
        out = np.empty(x.size, np.float32)
        _spline(x.ravel(), y.ravel(), self._coefficients, self._x0, self._y0, self._mesh, out)
        return out.reshape(x.shape)


@compiled(fastmath=True)
def _spline(
    x: Array,
    y: Array,
    c: NDArray[np.float32],
    x0: float,
    y0: float,
    mesh: float,
    out: NDArray[np.float32],
) -> None:
    ny, nx = c.shape
    wx, wy = np.empty(4), np.empty(4)
    for p in range(x.size):
        rx, ry = (x[p] - x0) / mesh, (y[p] - y0) / mesh
        if not (abs(rx) < 1e7 and abs(ry) < 1e7):
            out[p] = 0.0
            continue
        jx, jy = int(np.floor(rx)), int(np.floor(ry))
        for w, t in ((wx, rx - jx), (wy, ry - jy)):
            w[0] = (1 - t) ** 3 / 6
            w[1] = (3 * t**3 - 6 * t**2 + 4) / 6
            w[2] = (-3 * t**3 + 3 * t**2 + 3 * t + 1) / 6
            w[3] = t**3 / 6
        total = 0.0
        for i in range(4):
            a = (jy - 1 + i) % (2 * ny)
            a = a if a < ny else 2 * ny - 1 - a
            row = 0.0
            for j in range(4):
                b = (jx - 1 + j) % (2 * nx)
                b = b if b < nx else 2 * nx - 1 - b
                row += wx[j] * c[a, b]
            total += wy[i] * row
        out[p] = total


def cast(camera: Camera, snapshot: Snapshot) -> tuple[Array, Array]:
    """Where the sight line of every pixel meets the water.

    Fixed point of z = Z(x_a + D z) with x_a the apparent position: first on every sixth pixel, then from a
    spline through these on every pixel, to a tenth of a micrometre.

    Returns x, y (row, column): Horizontal position, metres.
    """
    width, height = camera.size
    columns, rows = (np.append(np.arange(0, n - 1, 6.0), n - 1.0) for n in (width, height))
    coarse = _meet(camera, snapshot, columns, rows, np.zeros((rows.size, columns.size)))[2]
    start = np.zeros((height, width))
    if min(coarse.shape) > 3 and np.isfinite(coarse).all():
        start = RectBivariateSpline(rows, columns, coarse)(np.arange(height), np.arange(width))
    return _meet(camera, snapshot, np.arange(float(width)), np.arange(float(height)), start)[:2]


def _meet(
    camera: Camera, snapshot: Snapshot, columns: Array, rows: Array, z: Array
) -> tuple[Array, Array, Array]:
    xa, ya = camera.unproject(columns, rows[:, None])
    dx, dy = camera.sight_line(xa, ya)
    for _ in range(40):
        (new,) = snapshot(xa + dx * z, ya + dy * z)
        change, z = np.nanmax(np.abs(new - z), initial=0.0), new
        if change < 1e-7:
            break
    return xa + dx * z, ya + dy * z, z
