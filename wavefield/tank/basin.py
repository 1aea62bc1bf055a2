"""A rectangle of the sea where fields are read quickly at very many points.

The sum over waves is done on a regular lattice (matrix products) whose values a compact kernel spreads;
dividing each wave by the kernel's transform makes the interpolation spectrally accurate (a non-uniform
Fourier transform): the error is below 1e-6 of the field's amplitude.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wavefield.compiled import compiled
from wavefield.tank.sea import Sea

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

KERNEL_WIDTH = 8  # lattice points under the kernel along each axis
# of the kernel exp(beta (sqrt(1 - s^2) - 1)), for a lattice twice as fine as Nyquist's
KERNEL_BETA = 2.30 * KERNEL_WIDTH
MAX_SNAPSHOTS = 24  # remembered
MAX_STEP = 0.04  # m, of the lattice where the sea has no short waves,
MIN_STEPS = 300  # or this part of a large basin


def _kernel(r: Array) -> Array:
    """Kernel at r lattice steps from its centre."""
    s = 2.0 * r / KERNEL_WIDTH
    return np.exp(KERNEL_BETA * (np.sqrt(np.maximum(1.0 - s * s, 0.0)) - 1.0)) * (np.abs(s) < 1)


def _transform(phase: Array) -> Array:
    """Fourier transform of the kernel at phases per lattice step, by Gauss-Legendre quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(60)
    r = nodes * KERNEL_WIDTH / 2
    return np.cos(np.outer(phase, r)) @ (weights * _kernel(r)) * KERNEL_WIDTH / 2


def _waves(a: ArrayLike, b: ArrayLike) -> Complex:
    return np.exp(1j * np.multiply.outer(a, b))


class Basin:
    """A rectangle of a sea with limits x and y, metres."""

    def __init__(self, sea: Sea, x: tuple[float, float], y: tuple[float, float]) -> None:
        self.sea, self.x, self.y = sea, x, y
        extent = max(x[1] - x[0], y[1] - y[0])
        step = min(sea.shortest / 4.0, max(MAX_STEP, extent / MIN_STEPS))
        margin = KERNEL_WIDTH // 2
        self._step = step
        # following beads needs the same instants again and again
        self._recent = lru_cache(MAX_SNAPSHOTS)(self._snapshot)
        self._origin = (x[0] - margin * step, y[0] - margin * step)
        count = [int(np.ceil((hi - lo) / step)) + 2 * margin + 1 for lo, hi in (x, y)]
        kx, ky = sea.axes
        gx, gy = (origin + step * np.arange(n) for origin, n in zip(self._origin, count, strict=True))
        self._ex = _waves(kx, gx) / _transform(kx * step)[:, None]
        self._ey = _waves(gy, ky) / _transform(ky * step)

    def snapshot(self, time: float, names: Sequence[str] = ("z",)) -> "Snapshot":
        """The sea at one time, s: any of z, z_x, z_y, z_t, u, v (w is a product: make it from these)."""
        return self._recent(round(time, 12), tuple(names))

    def _snapshot(self, time: float, names: tuple[str, ...]) -> "Snapshot":
        values = self.sea.sums(self._ex, self._ey, time, names)
        offset = [self.sea.current["uv".index(name)] if name in ("u", "v") else 0.0 for name in names]
        stacked = np.stack([values[name] for name in names])
        return Snapshot(stacked, np.array(offset), self._origin, self._step)


class Snapshot:
    """Fields at one instant, as a function of position; made by `Basin.snapshot`."""

    def __init__(self, values: Array, offset: Array, origin: tuple[float, float], step: float) -> None:
        self._values, self._offset, self._origin, self._step = values, offset, origin, step

    def __call__(self, x: Array, y: Array) -> Array:
        """Fields at points of any shape, (names, ...), in metres, slopes or m/s; NaN outside the basin."""
        out = np.empty((self._values.shape[0], x.size))
        _gather(x.ravel(), y.ravel(), self._values, *self._origin, self._step, out)
        return (out + self._offset[:, None]).reshape(-1, *x.shape)


@compiled(fastmath=True)
def _gather(x: Array, y: Array, values: Array, x0: float, y0: float, step: float, out: Array) -> None:
    # constants of the module, so that the loops are unrolled; compiled code is renewed when they change
    nf, ny, nx = values.shape
    wx, wy = np.empty(KERNEL_WIDTH), np.empty(KERNEL_WIDTH)
    for p in range(x.size):
        rx, ry = (x[p] - x0) / step, (y[p] - y0) / step
        jx, jy = int(np.floor(rx)) - KERNEL_WIDTH // 2 + 1, int(np.floor(ry)) - KERNEL_WIDTH // 2 + 1
        if jx < 0 or jy < 0 or jx + KERNEL_WIDTH > nx or jy + KERNEL_WIDTH > ny:
            out[:, p] = np.nan
            continue
        for g in range(KERNEL_WIDTH):
            sx, sy = 2.0 * (rx - jx - g) / KERNEL_WIDTH, 2.0 * (ry - jy - g) / KERNEL_WIDTH
            wx[g] = np.exp(KERNEL_BETA * (np.sqrt(max(1.0 - sx * sx, 0.0)) - 1.0))
            wy[g] = np.exp(KERNEL_BETA * (np.sqrt(max(1.0 - sy * sy, 0.0)) - 1.0))
        for f in range(nf):
            total = 0.0
            for i in range(KERNEL_WIDTH):
                row = 0.0
                for j in range(KERNEL_WIDTH):
                    row += wx[j] * values[f, jy + i, jx + j]
                total += wy[i] * row
            out[f, p] = total
