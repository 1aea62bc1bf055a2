"""White noise painted on the surface, and where the sight line of each pixel meets the water."""

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import map_coordinates

from wavefield.rig import Camera
from wavefield.tank.basin import Snapshot

Array = NDArray[np.float64]


class Paint:
    """Band-limited white noise as a function of position: a cubic B-spline with random coefficients.
    On a rectangle x, y with grains of a mesh, metres; it is mirrored beyond.
    """

    def __init__(self, x: tuple[float, float], y: tuple[float, float], mesh: float, seed: int) -> None:
        count = [int(np.ceil((high - low) / mesh)) + 5 for low, high in (x, y)]
        rng = np.random.default_rng([seed, 5])
        self._coefficients = rng.standard_normal((count[1], count[0]), np.float32)
        # the mean of sum B^2 over a cell is 0.479 along each axis: unit variance
        self._coefficients /= np.float32(0.4794)
        self._x0, self._y0, self._mesh = x[0] - 2 * mesh, y[0] - 2 * mesh, mesh

    def __call__(self, x: Array, y: Array) -> NDArray[np.float32]:
        """Texture at points of any shape, metres."""
        places = np.nan_to_num([(y - self._y0) / self._mesh, (x - self._x0) / self._mesh])
        out = np.empty(np.shape(x), np.float32)
        map_coordinates(self._coefficients, places, out, order=3, mode="grid-mirror", prefilter=False)
        return out


def cast(camera: Camera, snapshot: Snapshot) -> tuple[Array, Array]:
    """Horizontal position x, y (row, column), m, where the sight line of every pixel meets the water.
    Fixed point of z = Z(x_a + D z) with x_a the apparent position, to a tenth of a micrometre.
    """
    width, height = camera.size
    # first on every sixth pixel, then from a spline through these on every pixel
    columns, rows = (np.append(np.arange(0, n - 1, 6.0), n - 1.0) for n in (width, height))
    coarse = _meet(camera, snapshot, columns, rows, np.zeros((rows.size, columns.size)))[2]
    start = np.zeros((height, width))
    if min(coarse.shape) > 3 and np.isfinite(coarse).all():
        start = RectBivariateSpline(rows, columns, coarse)(np.arange(height), np.arange(width))
    return _meet(camera, snapshot, np.arange(float(width)), np.arange(float(height)), start)[:2]


def _meet(
    camera: Camera, snapshot: Snapshot, columns: Array, rows: Array, z: Array
) -> tuple[Array, Array, Array]:
    """Positions x, y, z where sight lines meet the water, from a first guess of z."""
    xa, ya = camera.unproject(columns, rows[:, None])
    dx, dy = camera.sight_line(xa, ya)
    for _ in range(40):
        (new,) = snapshot(xa + dx * z, ya + dy * z)
        change, z = np.nanmax(np.abs(new - z), initial=0.0), new
        if change < 1e-7:
            break
    return xa + dx * z, ya + dy * z, z
