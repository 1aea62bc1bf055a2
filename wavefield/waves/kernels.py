"""Inner loops of the spectral estimators, on plain arrays.

Layout: the spatial transform of a piece of a record is held as (cells, steps), cells being ky x kx with
kx >= 0, so that the transform in time and the sums over rings run along contiguous memory.
"""

import numba
import numpy as np

_fast = numba.njit(nogil=True, cache=True)
# sums may be taken in any order, always the same one for the same shape
_loose = numba.njit(nogil=True, cache=True, fastmath={"reassoc", "contract", "nsz"})


@_loose
def join(first, second, window, out):
    """Put two halves of a segment together, take off mean and trend in time, and window.

    Parameters
    ----------
    first, second : ndarray, complex, (cells, n / 2)
        The halves.
    window : ndarray, (n,)
        Window in time, in the precision of the halves.
    out : ndarray, complex, (cells, n)
        Receives the result.
    """
    cells, half = first.shape
    n = 2 * half
    middle = (n - 1) / 2
    norm = n * (n * n - 1) / 12  # sum of (i - middle)^2
    real = window.dtype.type
    for c in range(cells):
        a = first[c]
        b = second[c]
        o = out[c]
        # sums in double precision, real and imaginary parts apart: this way they vectorise
        sum_r = 0.0
        sum_i = 0.0
        moment_r = 0.0
        moment_i = 0.0
        for i in range(half):
            p = i - middle
            q = p + half
            ar = np.float64(a[i].real)
            ai = np.float64(a[i].imag)
            br = np.float64(b[i].real)
            bi = np.float64(b[i].imag)
            sum_r += ar + br
            sum_i += ai + bi
            moment_r += p * ar + q * br
            moment_i += p * ai + q * bi
        slope_r = real(moment_r / norm)
        slope_i = real(moment_i / norm)
        first_r = real(sum_r / n - middle * moment_r / norm)
        first_i = real(sum_i / n - middle * moment_i / norm)
        for i in range(half):
            t = real(i)
            w = window[i]
            o[i] = complex((a[i].real - first_r - slope_r * t) * w, (a[i].imag - first_i - slope_i * t) * w)
        for i in range(half):
            t = real(i + half)
            w = window[i + half]
            o[i + half] = complex(
                (b[i].real - first_r - slope_r * t) * w, (b[i].imag - first_i - slope_i * t) * w
            )


@_fast
def frames(z_first, z_second, rate_first, rate_second, dt, first, second):
    """Elevation at the first frame of each step of a segment, from mid-time elevation and rate of rise.

    Parameters
    ----------
    z_first, z_second, rate_first, rate_second : ndarray, (cells, n / 2)
        Mid-time elevation and rate of rise of the two halves, or their spatial transforms.
    dt : float
        Time between frames, in the precision of the fields.
    first, second : ndarray, (cells, n / 2)
        Receive the elevation half a step before each mid-time.

    Notes
    -----
    z_0 = z + (dt / 16)(z_t after - z_t before) - (dt / 2) z_t, exact for z = (9 (z_0 + z_1) - z_-1 - z_2) /
    16. The first and last step follow from their neighbour by z_t alone: what lies outside the segment is not
    needed, and the mid-time z at the ends of a record, which had no fourth frame, is not used.
    """
    cells, half = z_first.shape
    slope = dt / 16
    rise = dt / 2
    for c in range(cells):
        z = z_first[c]
        r = rate_first[c]
        o = first[c]
        for i in range(1, half - 1):
            o[i] = z[i] + slope * (r[i + 1] - r[i - 1]) - rise * r[i]
        o[half - 1] = z[half - 1] + slope * (rate_second[c, 0] - r[half - 2]) - rise * r[half - 1]
        o[0] = o[1] - dt * r[0]
        z = z_second[c]
        q = rate_second[c]
        o = second[c]
        o[0] = z[0] + slope * (q[1] - r[half - 1]) - rise * q[0]
        for i in range(1, half - 1):
            o[i] = z[i] + slope * (q[i + 1] - q[i - 1]) - rise * q[i]
        o[half - 1] = o[half - 2] + dt * q[half - 2]


@_fast
def ring_powers(f, start, ring, weight, spread, out):
    """Add power and squared power of every cell to its rings, +-omega folded: k points where the wave goes.

    Parameters
    ----------
    f : ndarray, complex, (cells, n)
        Transform in space and time; numpy's signs.
    start : ndarray, int, (cells + 1,)
        Where the rings of each cell begin in ``ring`` and ``weight``.
    ring : ndarray, int
        Index of the ring.
    weight : ndarray, float
        Share of the cell in the ring, doubled where the cell stands for its mirror image as well.
    spread : ndarray, float
        The same for the squared power.
    out : ndarray, float64, (2, rings, n // 2 + 1)
        Sums of the power and of its square to add to.
    """
    cells, n = f.shape
    half = n // 2
    power = np.empty(half + 1)
    square = np.empty(half + 1)
    for c in range(cells):
        row = f[c]
        power[0] = row[0].real ** 2 + row[0].imag ** 2
        square[0] = power[0] ** 2
        for j in range(1, half):
            a = row[n - j].real ** 2 + row[n - j].imag ** 2
            b = row[j].real ** 2 + row[j].imag ** 2
            power[j] = a + b
            square[j] = a * a + b * b
        power[half] = row[half].real ** 2 + row[half].imag ** 2
        square[half] = power[half] ** 2
        for s in range(start[c], start[c + 1]):
            r = ring[s]
            g = weight[s]
            h = spread[s]
            for j in range(half + 1):
                out[0, r, j] += g * power[j]
                out[1, r, j] += h * square[j]


@_fast
def ring_crosses(f, g, start, ring, weight, out):
    """As `ring_powers`, for conj(f) g; ``out`` is complex.

    The phase is that of waves exp(i (k . x - omega t)), omega > 0.
    """
    cells, n = f.shape
    half = n // 2
    cross = np.empty(half + 1, np.complex128)
    for c in range(cells):
        a = f[c]
        b = g[c]
        cross[0] = (np.conj(a[0]) * b[0]).real
        for j in range(1, half):
            cross[j] = np.conj(a[n - j]) * b[n - j] + a[j] * np.conj(b[j])
        cross[half] = (np.conj(a[half]) * b[half]).real
        for s in range(start[c], start[c + 1]):
            r = ring[s]
            h = weight[s]
            for j in range(half + 1):
                out[r, j] += h * cross[j]


@_fast
def add_powers(f, out):
    """Add |f|^2.

    Parameters
    ----------
    f : ndarray, complex, (cells, n)
        Transform.
    out : ndarray, float, (cells, n)
        Sums to add to.
    """
    for c in range(f.shape[0]):
        for j in range(f.shape[1]):
            out[c, j] += f[c, j].real ** 2 + f[c, j].imag ** 2


@_fast
def gradient(z, dy, dx, z_y, z_x):
    """Gradient of each step by central differences of sixth order, of lower order at the edges.

    Parameters
    ----------
    z : ndarray, (steps, y, x)
        Field; at least 3 nodes along each axis.
    dy, dx : float
        Distance between nodes.
    z_y, z_x : ndarray, (steps, y, x)
        Receive the derivatives.
    """
    steps, ny, nx = z.shape
    for t in range(steps):
        for i in range(ny):
            for j in range(nx):
                room = min(j, nx - 1 - j)
                if room >= 3:
                    d = (
                        45.0 * (z[t, i, j + 1] - z[t, i, j - 1])
                        - 9.0 * (z[t, i, j + 2] - z[t, i, j - 2])
                        + (z[t, i, j + 3] - z[t, i, j - 3])
                    ) / 60.0
                elif room == 2:
                    d = (8.0 * (z[t, i, j + 1] - z[t, i, j - 1]) - (z[t, i, j + 2] - z[t, i, j - 2])) / 12.0
                elif room == 1:
                    d = (z[t, i, j + 1] - z[t, i, j - 1]) / 2.0
                elif j == 0:
                    d = (-3.0 * z[t, i, 0] + 4.0 * z[t, i, 1] - z[t, i, 2]) / 2.0
                else:
                    d = (3.0 * z[t, i, j] - 4.0 * z[t, i, j - 1] + z[t, i, j - 2]) / 2.0
                z_x[t, i, j] = d / dx
                room = min(i, ny - 1 - i)
                if room >= 3:
                    d = (
                        45.0 * (z[t, i + 1, j] - z[t, i - 1, j])
                        - 9.0 * (z[t, i + 2, j] - z[t, i - 2, j])
                        + (z[t, i + 3, j] - z[t, i - 3, j])
                    ) / 60.0
                elif room == 2:
                    d = (8.0 * (z[t, i + 1, j] - z[t, i - 1, j]) - (z[t, i + 2, j] - z[t, i - 2, j])) / 12.0
                elif room == 1:
                    d = (z[t, i + 1, j] - z[t, i - 1, j]) / 2.0
                elif i == 0:
                    d = (-3.0 * z[t, 0, j] + 4.0 * z[t, 1, j] - z[t, 2, j]) / 2.0
                else:
                    d = (3.0 * z[t, i, j] - 4.0 * z[t, i - 1, j] + z[t, i - 2, j]) / 2.0
                z_y[t, i, j] = d / dy


@_fast
def histogram(values, mean, std, reach, counts):
    """Count values in equal bins of (value - mean) / std from -reach to reach; the rest is left out.

    Parameters
    ----------
    values : ndarray, (n,)
        Any numbers; NaN is left out.
    mean, std, reach : float
        Scale of the bins.
    counts : ndarray, int64, (bins,)
        Counts to add to.
    """
    bins = counts.size
    scale = bins / (2.0 * reach * std)
    origin = mean - reach * std
    for i in range(values.size):
        place = (values[i] - origin) * scale
        if 0.0 <= place < bins:
            counts[int(place)] += 1


@_fast
def moments(values, mean, sums):
    """Add the first four powers of (value - mean) to ``sums`` (5,), the first entry being the count.

    Rows are summed one by one, so that single values do not drown in a long sum.

    Parameters
    ----------
    values : ndarray, (rows, n)
        Finite numbers.
    mean : float
        A first guess of the mean: it keeps the sums well conditioned.
    sums : ndarray, float64, (5,)
        Sums to add to.
    """
    for r in range(values.shape[0]):
        s1 = 0.0
        s2 = 0.0
        s3 = 0.0
        s4 = 0.0
        for i in range(values.shape[1]):
            d = values[r, i] - mean
            q = d * d
            s1 += d
            s2 += q
            s3 += q * d
            s4 += q * q
        sums[0] += values.shape[1]
        sums[1] += s1
        sums[2] += s2
        sums[3] += s3
        sums[4] += s4


@_fast
def _lagrange(fraction, weights):
    # weights of the nodes -(m/2 - 1) .. m/2 for a point at `fraction` in [0, 1)
    m = weights.size
    first = -(m // 2 - 1)
    for i in range(m):
        w = 1.0
        for j in range(m):
            if j != i:
                w *= (fraction - (first + j)) / (i - j)
        weights[i] = w


@_fast
def sample(field, row, column, out, points):
    """Interpolate a field between its nodes by Lagrange polynomials; NaN where the stencil runs out.

    Parameters
    ----------
    field : ndarray, (y, x)
        Values at nodes.
    row, column : ndarray, (n,)
        Positions in nodes.
    out : ndarray, (n,)
        Receives the values.
    points : int
        Nodes of the stencil along each axis, even.
    """
    ny, nx = field.shape
    wy = np.empty(points)
    wx = np.empty(points)
    back = points // 2 - 1
    for p in range(row.size):
        i0 = int(np.floor(row[p]))
        j0 = int(np.floor(column[p]))
        if i0 - back < 0 or j0 - back < 0 or i0 + points - back > ny or j0 + points - back > nx:
            out[p] = np.nan
            continue
        _lagrange(row[p] - i0, wy)
        _lagrange(column[p] - j0, wx)
        total = 0.0
        for a in range(points):
            line = 0.0
            for b in range(points):
                line += wx[b] * field[i0 - back + a, j0 - back + b]
            total += wy[a] * line
        out[p] = total
