"""Compiled inner loops of the spectral estimators, on plain arrays; results are written to ``out``.

Spatial transforms have one value per step and cell (wave vector with kx >= 0). Fourier transforms in time are
(cells, n). ``start``, ``ring``, ``weight`` and ``spread`` are those of `Rings`. For vectorisation, loops have
no branches, contiguous memory, and unsigned indices where they run backwards.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.compiled import compiled

Array = NDArray[Any]

_fast = compiled()
# the compiler may reorder sums, in the same way for equal shapes
_loose = compiled(fastmath={"reassoc", "contract", "nsz"})
# as above, but products are rounded before they are subtracted, so that conj(f) f is real
_rounded = compiled(fastmath={"reassoc", "nsz"})
_TILE = 8  # steps transposed at once: a cache line of 64 bytes


@_loose
def join(first: Array, second: Array, window: Array, out: Array) -> None:
    """Write a segment, detrended and multiplied by ``window`` (n,), to ``out`` (cells, 2 n). ``first`` and
    ``second`` are its halves (n / 2, 2 cells). In these arrays, real and imaginary parts alternate."""
    half, columns = first.shape
    n = 2 * half
    middle = (n - 1) / 2
    norm = n * (n * n - 1) / 12  # sum of (i - middle)^2
    real = window.dtype.type
    total = np.zeros(columns)
    moment = np.zeros(columns)
    for i in range(half):
        a = first[i]
        b = second[i]
        p = i - middle
        q = p + half
        for c in range(columns):
            total[c] += np.float64(a[c]) + np.float64(b[c])
            moment[c] += p * np.float64(a[c]) + q * np.float64(b[c])
    slope = np.empty(columns, window.dtype)
    start = np.empty(columns, window.dtype)
    for c in range(columns):
        slope[c] = moment[c] / norm
        start[c] = total[c] / n - middle * moment[c] / norm
    tile = np.empty((_TILE, columns), window.dtype)
    for begin in range(0, n, _TILE):
        some = min(_TILE, n - begin)
        for k in range(some):
            i = begin + k
            row = first[i] if i < half else second[i - half]
            t = real(i)
            w = window[i]
            to = tile[k]
            for c in range(columns):
                to[c] = (row[c] - start[c] - slope[c] * t) * w
        for c in range(columns // 2):
            to = out[c]
            for k in range(some):
                to[2 * (begin + k)] = tile[k, 2 * c]
                to[2 * (begin + k) + 1] = tile[k, 2 * c + 1]


@_loose
def _add_row(row: Array, factor: float, out: Array) -> None:
    for j in range(row.size):
        out[j] += factor * row[j]


@_loose
def ring_powers(f: Array, start: Array, ring: Array, weight: Array, spread: Array, out: Array) -> None:
    """Add sums over rings of |f|^2 and |f|^4, for transforms f (cells, n), to ``out`` (2, rings, n // 2 + 1).
    ``weight`` and ``spread`` weight the cells in |f|^2 and |f|^4. Values at omega and -omega are added."""
    cells, n = f.shape
    half = n // 2
    power = np.empty(n, f.real.dtype)
    folded = np.empty(half + 1)
    square = np.empty(half + 1)
    for c in range(cells):
        line = f[c]
        for j in range(n):
            power[j] = line[j].real ** 2 + line[j].imag ** 2
        folded[0] = power[0]
        square[0] = folded[0] ** 2
        for j in range(1, half):
            a = np.float64(power[j])
            b = np.float64(power[np.uint64(n - j)])
            folded[j] = a + b
            square[j] = a * a + b * b
        folded[half] = power[half]
        square[half] = folded[half] ** 2
        for s in range(start[c], start[c + 1]):
            _add_row(folded, weight[s], out[0, ring[s]])
            _add_row(square, spread[s], out[1, ring[s]])


@_rounded
def ring_cross_spectra(f: Array, g: Array, start: Array, ring: Array, weight: Array, out: Array) -> None:
    """Add sums over rings of conj(f) g, for Fourier transforms (cells, n), to ``out`` (2, rings, n // 2 + 1).
    ``out`` holds real and imaginary parts, for waves exp(i (k . x - omega t))."""
    cells, n = f.shape
    half = n // 2
    real = np.empty(n, f.real.dtype)
    imag = np.empty(n, f.real.dtype)
    even = np.empty(half + 1)
    odd = np.zeros(half + 1)
    for c in range(cells):
        a = f[c]
        b = g[c]
        for j in range(n):
            real[j] = a[j].real * b[j].real + a[j].imag * b[j].imag
            imag[j] = a[j].real * b[j].imag - a[j].imag * b[j].real
        even[0] = real[0]
        for j in range(1, half):
            even[j] = np.float64(real[j]) + np.float64(real[np.uint64(n - j)])
            odd[j] = np.float64(imag[np.uint64(n - j)]) - np.float64(imag[j])
        even[half] = real[half]
        for s in range(start[c], start[c + 1]):
            _add_row(even, weight[s], out[0, ring[s]])
            _add_row(odd, weight[s], out[1, ring[s]])


@_loose
def ring_squares(f: Array, g: Array, start: Array, ring: Array, spread: Array, out: Array) -> None:
    """Add sums over rings of |f|^2 |g|^2, for transforms (cells, n), to ``out`` (rings, n // 2 + 1)."""
    cells, n = f.shape
    half = n // 2
    power = np.empty(n)
    square = np.empty(half + 1)
    for c in range(cells):
        a = f[c]
        b = g[c]
        for j in range(n):
            p = np.float64(a[j].real) ** 2 + np.float64(a[j].imag) ** 2
            power[j] = p * (np.float64(b[j].real) ** 2 + np.float64(b[j].imag) ** 2)
        square[0] = power[0]
        for j in range(1, half):
            square[j] = power[j] + power[np.uint64(n - j)]
        square[half] = power[half]
        for s in range(start[c], start[c + 1]):
            _add_row(square, spread[s], out[ring[s]])


@_loose
def add_powers(f: Array, out: Array) -> None:
    """Add |f|^2 to ``out``, both (cells, n)."""
    for c in range(f.shape[0]):
        line = f[c]
        to = out[c]
        for j in range(line.size):
            to[j] += line[j].real ** 2 + line[j].imag ** 2


@_rounded
def add_products(f: Array, g: Array, real: Array, imaginary: Array, out: Array) -> None:
    """Add ``real`` Re(conj(f) g) + ``imaginary`` Im(conj(f) g), with factors (n,), to ``out`` (cells, n)."""
    for c in range(f.shape[0]):
        a = f[c]
        b = g[c]
        to = out[c]
        for j in range(a.size):
            to[j] += real[j] * (a[j].real * b[j].real + a[j].imag * b[j].imag)
            to[j] += imaginary[j] * (a[j].real * b[j].imag - a[j].imag * b[j].real)


@_fast
def _along(z: Array, factor: float, out: Array) -> None:
    """Write the derivative of z (n,) to ``out`` (n,), by central differences of up to sixth order.
    ``factor`` is 1 over the node spacing."""
    n = z.size
    if n > 6:
        a, b, c, d, e, f = z[4:], z[2:], z[5:], z[1:], z[6:], z
        to = out[3:]
        for j in range(n - 6):
            to[j] = (45.0 * (a[j] - b[j]) - 9.0 * (c[j] - d[j]) + (e[j] - f[j])) * (factor / 60.0)
    for k in range(min(6, n)):
        j = k if k < 3 else n - 1 - (k - 3)
        room = min(j, n - 1 - j)
        if room >= 3:
            continue
        if room == 2:
            slope = (8.0 * (z[j + 1] - z[j - 1]) - (z[j + 2] - z[j - 2])) / 12.0
        elif room == 1:
            slope = (z[j + 1] - z[j - 1]) / 2.0
        elif j == 0:
            slope = (-3.0 * z[0] + 4.0 * z[1] - z[2]) / 2.0
        else:
            slope = (3.0 * z[j] - 4.0 * z[j - 1] + z[j - 2]) / 2.0
        out[j] = slope * factor


@_fast
def _across(z: Array, i: int, factor: float, out: Array) -> None:
    """Write dz/dy at row i of z (y, x) to ``out`` (x,), as `_along` does; ``factor`` is 1 / dy."""
    ny, nx = z.shape
    room = min(i, ny - 1 - i)
    if room >= 3:
        a, b, c, d, e, f = z[i + 1], z[i - 1], z[i + 2], z[i - 2], z[i + 3], z[i - 3]
        for j in range(nx):
            out[j] = (45.0 * (a[j] - b[j]) - 9.0 * (c[j] - d[j]) + (e[j] - f[j])) * (factor / 60.0)
    elif room == 2:
        a, b, c, d = z[i + 1], z[i - 1], z[i + 2], z[i - 2]
        for j in range(nx):
            out[j] = (8.0 * (a[j] - b[j]) - (c[j] - d[j])) / 12.0 * factor
    elif room == 1:
        a, b = z[i + 1], z[i - 1]
        for j in range(nx):
            out[j] = (a[j] - b[j]) / 2.0 * factor
    elif i == 0:
        a, b, c = z[0], z[1], z[2]
        for j in range(nx):
            out[j] = (-3.0 * a[j] + 4.0 * b[j] - c[j]) / 2.0 * factor
    else:
        a, b, c = z[i], z[i - 1], z[i - 2]
        for j in range(nx):
            out[j] = (3.0 * a[j] - 4.0 * b[j] + c[j]) / 2.0 * factor


@_fast
def gradient(z: Array, dy: float, dx: float, z_y: Array, z_x: Array) -> None:
    """Write dz/dy and dz/dx of z (steps, y, x) to ``z_y`` and ``z_x``, of the same shape."""
    for t in range(z.shape[0]):
        for i in range(z.shape[1]):
            _along(z[t, i], 1 / dx, z_x[t, i])
            _across(z[t], i, 1 / dy, z_y[t, i])


@_loose
def node_powers(values: Array, mean: float, low: float, per_unit: float, sums: Array, counts: Array) -> None:
    """Add (value - ``mean``)^p, p = 1 to 4, of values (steps, nodes) to ``sums`` (4, nodes). Also add the
    values to the histogram ``counts``, which has ``per_unit`` bins per unit from ``low`` on."""
    last = counts.size - 1
    for r in range(values.shape[0]):
        for i in range(values.shape[1]):
            value = np.float64(values[r, i])
            d = value - mean
            q = d * d
            sums[0, i] += d
            sums[1, i] += q
            sums[2, i] += q * d
            sums[3, i] += q * q
        for i in range(values.shape[1]):
            place = (np.float64(values[r, i]) - low) * per_unit + 1
            counts[int(min(max(place, 0.0), last))] += 1


@_loose
def spread_waves(first: Array, weights: Array, power: Array, out: Array) -> None:
    """Add the power of each wave, spread over neighbouring cells, to the spectrum ``out`` (lines, ny, nx). On
    each axis, ``first`` (3, waves) is its first cell; ``weights`` (3, waves, cells) are its fractions."""
    lines, ny, nx = out.shape
    near = weights.shape[2]
    columns = np.empty(near, np.int64)
    for p in range(power.size):
        for c in range(near):
            columns[c] = (first[2, p] + c) % nx
        for b in range(near):
            j = (first[1, p] + b) % ny
            for a in range(near):
                i = first[0, p] + a
                if 0 <= i < lines:
                    part = power[p] * weights[0, p, a] * weights[1, p, b]
                    for c in range(near):
                        out[i, j, columns[c]] += part * weights[2, p, c]
