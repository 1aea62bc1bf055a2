"""Cosine transforms on a lattice of blocks, by parity.

A cosine is even or odd about the middle of its lattice, so a quarter of the lattice determines each of the
four combinations of parities; transforming these separately halves the cost. Coefficients *by parity* are
(2, my / 2, 2, c, mx / 2), the parities along y and x each before their index; *quarters* are
(2, hy, 2, c, hx) with hy = ceil(ny / 2).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.compiled import compiled

Float = NDArray[Any]

F = np.float32

# sums may be reordered by the compiler, but in the same way on every call
njit = compiled(error_model="numpy", fastmath={"contract", "reassoc"})


def cosines(n: int, count: int) -> NDArray[np.float64]:
    """The first orthonormal cosines on n blocks, (count, n)."""
    phase = np.pi * np.arange(count)[:, None] * (np.arange(n) + 0.5) / n
    out: NDArray[np.float64] = np.cos(phase) * np.sqrt(2.0 / n)
    out[0] /= np.sqrt(2.0)
    return out


class Cosines:
    """Transforms between fields on a lattice and the coefficients of their first cosines.

    Examples
    --------
    >>> waves = np.zeros((1, 4, 6), np.float32)
    >>> waves[0, 1, 2] = 1.0
    >>> transforms = Cosines((7, 10), (4, 6))
    >>> bool(np.allclose(transforms.waves(transforms.field(waves)), waves, atol=1e-6))
    True
    """

    def __init__(self, lattice: tuple[int, int], shape: tuple[int, int]) -> None:
        self.lattice, self.shape = lattice, shape
        self._half = (lattice[0] + 1) // 2, (lattice[1] + 1) // 2
        rows, columns = (
            cosines(n, m).astype(F)[:, :h] for n, m, h in zip(lattice, shape, self._half, strict=True)
        )
        # (2, my / 2, hy) and its transpose; (2, mx / 2, hx) and its transpose
        self._rows, self._columns = (np.ascontiguousarray([c[::2], c[1::2]]) for c in (rows, columns))
        self._rows_t, self._columns_t = (
            np.ascontiguousarray(c.transpose(0, 2, 1)) for c in (self._rows, self._columns)
        )

    def waves(self, field: Float) -> Float:
        """Coefficients (c, my, mx) of a field (c, ny, nx)."""
        return self.merge_parities(self.coefficients_of(self.quarters(field)))

    def field(self, waves: Float) -> Float:
        """Field (c, ny, nx) of coefficients (c, my, mx)."""
        ny, nx = self.lattice
        quarters = self.quarters_of(self.split_parities(waves))
        out = np.empty((len(waves), ny, nx), F)
        _unfold(quarters, out)
        return out

    def split_parities(self, waves: Float) -> Float:
        """Coefficients (c, my, mx) by parity."""
        c, (my, mx) = len(waves), self.shape
        parts = waves.reshape(c, my // 2, 2, mx // 2, 2).transpose(2, 1, 4, 0, 3)
        return np.ascontiguousarray(parts, F)

    def merge_parities(self, by_parity: Float) -> Float:
        """Coefficients (c, my, mx) from those by parity."""
        c = by_parity.shape[3]
        return np.ascontiguousarray(by_parity.transpose(3, 1, 0, 4, 2)).reshape(c, *self.shape)

    def quarters(self, field: Float) -> Float:
        """Quarters of a field (c, ny, nx): its even and odd parts."""
        hy, hx = self._half
        out = np.empty((2, hy, 2, len(field), hx), F)
        _fold(np.ascontiguousarray(field, F), out)
        return out

    def mirrored(self, field: Float) -> Float:
        """A field (c, ny, nx) at the four mirrored positions, (2, 2, c, hy, hx)."""
        (ny, nx), (hy, hx) = self.lattice, self._half
        # the middle of an odd number of blocks is its own mirror image and is counted once
        out = np.zeros((2, 2, len(field), hy, hx), F)
        out[0, 0] = field[:, :hy, :hx]
        out[0, 1, ..., : nx - hx] = field[:, :hy, : hx - 1 : -1]
        out[1, 0, :, : ny - hy] = field[:, : hy - 1 : -1, :hx]
        out[1, 1, :, : ny - hy, : nx - hx] = field[:, : hy - 1 : -1, : hx - 1 : -1]
        return out

    def quarters_of(self, by_parity: Float) -> Float:
        """Quarters from coefficients by parity."""
        _, my, _, c, mx = by_parity.shape
        hy, hx = self._half
        # rows in the middle: modes along y are the smaller part of their cosines
        part = np.empty((2 * my, 2, c, hx), F)
        flat = by_parity.reshape(2 * my, 2, c, mx)
        for parity in range(2):
            for n in range(c):
                np.matmul(flat[:, parity, n], self._columns[parity], out=part[:, parity, n])
        out: Float = np.matmul(self._rows_t, part.reshape(2, my, 2 * c * hx))
        return out.reshape(2, hy, 2, c, hx)

    def coefficients_of(self, quarters: Float) -> Float:
        """Coefficients by parity from quarters."""
        _, hy, _, c, hx = quarters.shape
        my, mx = self.shape[0] // 2, self.shape[1] // 2
        part = np.matmul(self._rows, quarters.reshape(2, hy, 2 * c * hx)).reshape(2 * my, 2, c, hx)
        out = np.empty((2 * my, 2, c, mx), F)
        for parity in range(2):
            for n in range(c):
                np.matmul(part[:, parity, n], self._columns_t[parity], out=out[:, parity, n])
        return out.reshape(2, my, 2, c, mx)


@njit
def _fold(field: Float, out: Float) -> None:
    _, hy, _, c, hx = out.shape
    _, ny, nx = field.shape
    for n in range(c):
        for j in range(hy):
            up, down = field[n, j], field[n, ny - 1 - j]
            once = F(1) if j < ny - hy else F(0)  # the middle of an odd number of rows
            ee, eo, oe, oo = out[0, j, 0, n], out[0, j, 1, n], out[1, j, 0, n], out[1, j, 1, n]
            for i in range(nx - hx):
                p, q = up[i], up[nx - 1 - i]
                r, s = once * down[i], once * down[nx - 1 - i]
                ee[i], eo[i] = (p + r) + (q + s), (p + r) - (q + s)
                oe[i], oo[i] = (p - r) + (q - s), (p - r) - (q - s)
            for i in range(nx - hx, hx):
                p, r = up[i], once * down[i]
                ee[i] = eo[i] = p + r
                oe[i] = oo[i] = p - r


@njit
def _unfold(quarters: Float, out: Float) -> None:
    _, hy, _, c, hx = quarters.shape
    _, ny, nx = out.shape
    for n in range(c):
        for j in range(hy):
            up, down = out[n, j], out[n, ny - 1 - j]
            ee, eo, oe, oo = (
                quarters[0, j, 0, n],
                quarters[0, j, 1, n],
                quarters[1, j, 0, n],
                quarters[1, j, 1, n],
            )
            for i in range(hx):
                p, q, r, s = ee[i] + oe[i], eo[i] + oo[i], ee[i] - oe[i], eo[i] - oo[i]
                up[i], down[i] = p + q, r + s
                up[nx - 1 - i], down[nx - 1 - i] = p - q, r - s


@njit
def multiply(a: Float, quarters: Float) -> None:
    """Multiply a field, given as quarters (2, hy, 2, 1 or 2, hx), by A (2, 2, 1 or 3, hy, hx), in place."""
    _, hy, _, c, _ = quarters.shape
    for j in range(hy):
        top, bottom = quarters[0, j], quarters[1, j]
        if c == 1:
            _multiply_one(a[0, 0, 0, j], a[0, 1, 0, j], a[1, 0, 0, j], a[1, 1, 0, j], top, bottom)
        else:
            _multiply_two(a[0, 0, :, j], a[0, 1, :, j], a[1, 0, :, j], a[1, 1, :, j], top, bottom)


@njit
def _four_places(ee: F, eo: F, oe: F, oo: F) -> tuple[F, F, F, F]:
    """Values at the four mirrored positions from the four parities, and back but for a factor."""
    p, q, r, s = ee + oe, eo + oo, ee - oe, eo - oo
    return p + q, p - q, r + s, r - s


@njit
def _multiply_one(a0: Float, a1: Float, a2: Float, a3: Float, top: Float, bottom: Float) -> None:
    ee, eo, oe, oo = top[0, 0], top[1, 0], bottom[0, 0], bottom[1, 0]
    for i in range(len(a0)):
        f0, f1, f2, f3 = _four_places(ee[i], eo[i], oe[i], oo[i])
        f0, f1, f2, f3 = a0[i] * f0, a1[i] * f1, a2[i] * f2, a3[i] * f3
        ee[i], eo[i] = (f0 + f2) + (f1 + f3), (f0 + f2) - (f1 + f3)
        oe[i], oo[i] = (f0 - f2) + (f1 - f3), (f0 - f2) - (f1 - f3)


@njit
def _multiply_two(a0: Float, a1: Float, a2: Float, a3: Float, top: Float, bottom: Float) -> None:
    ue, uo, pe, po = top[0, 0], top[1, 0], bottom[0, 0], bottom[1, 0]
    ve, vo, qe, qo = top[0, 1], top[1, 1], bottom[0, 1], bottom[1, 1]
    x0, x1, x2, x3 = a0[0], a1[0], a2[0], a3[0]
    m0, m1, m2, m3 = a0[1], a1[1], a2[1], a3[1]
    y0, y1, y2, y3 = a0[2], a1[2], a2[2], a3[2]
    for i in range(len(x0)):
        u0, u1, u2, u3 = _four_places(ue[i], uo[i], pe[i], po[i])
        v0, v1, v2, v3 = _four_places(ve[i], vo[i], qe[i], qo[i])
        f0, f1, f2, f3 = (
            x0[i] * u0 + m0[i] * v0,
            x1[i] * u1 + m1[i] * v1,
            x2[i] * u2 + m2[i] * v2,
            x3[i] * u3 + m3[i] * v3,
        )
        g0, g1, g2, g3 = (
            m0[i] * u0 + y0[i] * v0,
            m1[i] * u1 + y1[i] * v1,
            m2[i] * u2 + y2[i] * v2,
            m3[i] * u3 + y3[i] * v3,
        )
        ue[i], uo[i] = (f0 + f2) + (f1 + f3), (f0 + f2) - (f1 + f3)
        pe[i], po[i] = (f0 - f2) + (f1 - f3), (f0 - f2) - (f1 - f3)
        ve[i], vo[i] = (g0 + g2) + (g1 + g3), (g0 + g2) - (g1 + g3)
        qe[i], qo[i] = (g0 - g2) + (g1 - g3), (g0 - g2) - (g1 - g3)
