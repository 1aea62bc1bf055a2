"""The inner loops: everything that touches pixels.

What lets LLVM turn these plain loops into vector code, and must be kept:

* loops are long and flat (50 trips and more), even where that computes a few values nobody needs;
* all that one block needs lies in ONE flat scratch array at constant offsets, so nothing can overlap;
* taps travel as tuples and stay in registers; blocks are moved eight neighbours at a time;
* the constants below are literals: numba's cache bakes them in and would not notice a change elsewhere.

`tests/matching/test_kernels.py` looks into the machine code for vector multiplies.
"""

from typing import Any

import numba as nb
import numpy as np

F = np.float32

BLOCK = 5  # side of a block, px: the step of the lattice
TAPS = 6  # of the quintic B-spline
SIDE = 10  # BLOCK + TAPS - 1: side of the patch of b that one block needs
FLAT = 50  # BLOCK * SIDE: one filtered patch, its SIDE - BLOCK last columns being garbage
MID = F(2.0)  # (BLOCK - 1) / 2
PAD = 8  # replicated border of b, px
PATCH, COLUMNS, WARPED, END = 0, 128, 256, 384  # regions of the scratch array of one block

njit: Any = nb.njit(fastmath=True, error_model="numpy", nogil=True, cache=True)


@njit
def _spline_row(image, y, s, d, a, gx, gy):
    """Row y of an image smoothed with the quintic B-spline, and its exact derivatives along columns and rows.

    image (h + 2 PAD, w + 2 PAD) has its border; s, d and a, gx, gy are rows of work space and output.
    """
    a0, a1, a2 = F(66 / 120), F(26 / 120), F(1 / 120)
    d1, d2 = F(10 / 24), F(1 / 24)
    r0, r1, r2 = image[y + PAD - 2][PAD - 2 :], image[y + PAD - 1][PAD - 2 :], image[y + PAD][PAD - 2 :]
    r3, r4 = image[y + PAD + 1][PAD - 2 :], image[y + PAD + 2][PAD - 2 :]
    n = len(a) - 4
    for x in range(n + 4):
        s[x] = a0 * r2[x] + a1 * (r1[x] + r3[x]) + a2 * (r0[x] + r4[x])
        d[x] = d1 * (r3[x] - r1[x]) + d2 * (r4[x] - r0[x])
    for x in range(n):
        a[x] = a0 * s[x + 2] + a1 * (s[x + 1] + s[x + 3]) + a2 * (s[x] + s[x + 4])
        gx[x] = d1 * (s[x + 3] - s[x + 1]) + d2 * (s[x + 4] - s[x])
        gy[x] = a0 * d[x + 2] + a1 * (d[x + 1] + d[x + 3]) + a2 * (d[x] + d[x + 4])


@njit
def spline_image(image, rows, out):
    """Smooth an image with the quintic B-spline, and take its derivatives.

    Parameters
    ----------
    image : (h + 2 PAD, w + 2 PAD) float32
        Image with replicated border.
    rows : (5, w + 4) float32
        Work space.
    out : (3, h, w) float32
        Output: the smoothed image and its derivatives along columns and rows, per px.
    """
    _, h, w = out.shape
    for y in range(h):
        _spline_row(image, y, rows[0], rows[1], rows[2], rows[3], rows[4])
        for k in range(3):
            out[k, y] = rows[2 + k][:w]


@njit
def _fold(row, out):
    """Sum BLOCK neighbours of `row` into each element of `out`."""
    for b in range(len(out)):
        total = F(0)
        for i in range(BLOCK):
            total += row[b * BLOCK + i]
        out[b] = total


@njit
def gradient_moments(image, rows, sums, out):
    """Sums per block of products of the gradients of a, alone and times the place in the block.

    Parameters
    ----------
    image : (h + 2 PAD, w + 2 PAD) float32
        a with its border.
    rows, sums : arrays of `scratch`
        Work space.
    out : (9, ny, nx) float32
        Output: sums of gx gx, gx gy, gy gy, then each of the three times x, then each times y
        (x, y counted from the block's centre).
    """
    _, ny, nx = out.shape
    s0, s1, s2, s3, s4, s5 = sums[0], sums[1], sums[2], sums[3], sums[4], sums[5]
    for by in range(ny):
        sums[:6] = F(0)
        for j in range(BLOCK):
            _spline_row(image, by * BLOCK + j, rows[0], rows[1], rows[2], rows[3], rows[4])
            p, q = rows[3], rows[4]
            y = F(j) - MID
            for x in range(len(s0)):
                xx, xy, yy = p[x] * p[x], p[x] * q[x], q[x] * q[x]
                s0[x] += xx
                s1[x] += xy
                s2[x] += yy
                s3[x] += y * xx
                s4[x] += y * xy
                s5[x] += y * yy
        for k in range(3):
            _fold(sums[k], out[k, by])
            _fold(sums[3 + k], out[6 + k, by])
            row, to = sums[k], out[3 + k, by]
            for b in range(nx):
                total = F(0)
                for i in range(BLOCK):
                    total += row[b * BLOCK + i] * (F(i) - MID)
                to[b] = total


@njit
def _move8(to, i, source, k):
    """Eight neighbours, all read before any is written: one vector move."""
    to[i], to[i + 1], to[i + 2], to[i + 3], to[i + 4], to[i + 5], to[i + 6], to[i + 7] = (
        source[k],
        source[k + 1],
        source[k + 2],
        source[k + 3],
        source[k + 4],
        source[k + 5],
        source[k + 6],
        source[k + 7],
    )


@njit
def _filter(t, source, target, taps, step):
    """TAPS taps along x (step 1) or y (step SIDE) over the flat patch."""
    for i in range(FLAT):
        value = F(0)
        for k in range(TAPS):
            value += taps[k] * t[source + i + k * step]
        t[target + i] = value


@njit
def _spline_taps(position, whole, taps):
    """Split positions into whole pixels and the six quintic B-spline weights of the fraction."""
    for b in range(len(position)):
        low = np.floor(position[b])
        f = position[b] - low
        g = F(1) - f
        f2, g2 = f * f, g * g
        f3, g3 = f2 * f, g2 * g
        whole[b] = int(low)
        taps[0, b] = g2 * g3 * F(1 / 120)
        taps[5, b] = f2 * f3 * F(1 / 120)
        taps[1, b] = (F(1) + F(5) * (g + g3 * (g - g2)) + F(10) * (g2 + g3)) * F(1 / 120)
        taps[4, b] = (F(1) + F(5) * (f + f3 * (f - f2)) + F(10) * (f2 + f3)) * F(1 / 120)
        taps[2, b] = (F(66) - F(60) * f2 + F(30) * f2 * f2 - F(10) * f2 * f3) * F(1 / 120)
        taps[3, b] = (F(66) - F(60) * g2 + F(30) * g2 * g2 - F(10) * g2 * g3) * F(1 / 120)


@njit
def _get(taps, b):
    """The taps of one block as a tuple: they stay in registers."""
    return taps[0, b], taps[1, b], taps[2, b], taps[3, b], taps[4, b], taps[5, b]


@njit
def _warp_strip(image, by, u, v, position, whole, taps, t, strip):
    """Read b under one row of blocks, each at its own displacement, into `strip` (BLOCK, nx BLOCK + 8)."""
    nx = len(u)
    h, w = image.shape
    for b in range(nx):
        position[0, b] = F(b * BLOCK + PAD - 2) + u[b]
        position[1, b] = F(by * BLOCK + PAD - 2) + v[b]
    _spline_taps(position[0], whole[0], taps[0])
    _spline_taps(position[1], whole[1], taps[1])
    for b in range(nx):
        x = min(max(whole[0, b], 0), w - SIDE)
        y = min(max(whole[1, b], 0), h - SIDE)
        for j in range(SIDE):
            row = image[y + j, x : x + SIDE]
            _move8(t, PATCH + j * SIDE, row, 0)
            _move8(t, PATCH + j * SIDE + SIDE - 8, row, SIDE - 8)
        _filter(t, PATCH, COLUMNS, _get(taps[1], b), SIDE)
        _filter(t, COLUMNS, WARPED, _get(taps[0], b), 1)
        for j in range(BLOCK):
            _move8(strip[j], b * BLOCK, t, WARPED + j * SIDE)


@njit
def plain_sums(first, second, u, v, position, whole, taps, t, strip, rows, sums, out):
    """Sums per block of gx r and gy r, with r = a - b(x + d) and d constant over the block.

    Parameters
    ----------
    first, second : (h + 2 PAD, w + 2 PAD) float32
        a and b with their borders.
    u, v : (ny, nx) float32
        Displacement, px.
    position, whole, taps, t, strip, rows, sums : arrays of `scratch`
        Work space.
    out : (2, ny, nx) float32
        Output.
    """
    ny = len(u)
    s0, s1 = sums[0], sums[1]
    for by in range(ny):
        _warp_strip(second, by, u[by], v[by], position, whole, taps, t, strip)
        sums[:2] = F(0)
        for j in range(BLOCK):
            _spline_row(first, by * BLOCK + j, rows[0], rows[1], rows[2], rows[3], rows[4])
            a, p, q, b = rows[2], rows[3], rows[4], strip[j]
            for x in range(len(s0)):
                r = a[x] - b[x]
                s0[x] += p[x] * r
                s1[x] += q[x] * r
        for k in range(2):
            _fold(sums[k], out[k, by])


@njit
def _ramp(to, i, slope):
    """The line of this slope through zero at the block's middle."""
    for k in range(BLOCK):
        to[i + k] = slope * (F(k) - MID)


@njit
def _level(to, i, value):
    for k in range(BLOCK):
        to[i + k] = value


@njit
def _spread_strip(slopes, c2, by, rows):
    """Slopes of the displacement and weight constants of one row of blocks, spread over its pixels."""
    for b in range(slopes.shape[2]):
        x = b * BLOCK
        _ramp(rows[5], x, slopes[0, by, b])
        _level(rows[6], x, slopes[1, by, b])
        _ramp(rows[7], x, slopes[2, by, b])
        _level(rows[8], x, slopes[3, by, b])
        _level(rows[9], x, c2[by, b])


@njit
def _robust_row(a, gx, gy, b, ux, uy, vx, vy, y, c2, c2b2, s0, s1, s2, s3, s4, s5):
    for x in range(len(s0)):
        r = a[x] - b[x] - gx[x] * (ux[x] + y * uy[x]) - gy[x] * (vx[x] + y * vy[x])
        m = a[x] + b[x]
        e = F(1) + m * m * (c2[x] * c2b2)
        w = e / (e + r * r * c2[x])
        w *= w
        wx, wy = w * gx[x], w * gy[x]
        s0[x] += wx * r
        s1[x] += wy * r
        s2[x] += wx * gx[x]
        s3[x] += wx * gy[x]
        s4[x] += wy * gy[x]
        s5[x] += r * r


@njit
def robust_sums(first, second, u, v, slopes, c2, c2b2, position, whole, taps, t, strip, rows, sums, out):
    """Sums per block with a weight w = (1 + r^2 / (c^2 (s^2 + beta^2 m^2)))^-2 per pixel.

    Parameters
    ----------
    first, second, u, v
        As for `plain_sums`.
    slopes : (4, ny, nx) float32
        du/dx, du/dy, dv/dx, dv/dy: the displacement inside the block is linear.
    c2 : (ny, nx) float32
        1 / (c s)^2, s^2 the residual variance of the block's window; 0 gives weight 1.
    c2b2 : float32
        c^2 beta^2 / 4: m in the formula is half the sum of both images.
    position, whole, taps, t, strip, rows, sums : arrays of `scratch`
        Work space.
    out : (6, ny, nx) float32
        Output: sums of w gx r, w gy r, w gx gx, w gx gy, w gy gy, r r.
    """
    ny = len(u)
    for by in range(ny):
        _warp_strip(second, by, u[by], v[by], position, whole, taps, t, strip)
        _spread_strip(slopes, c2, by, rows)
        sums[:6] = F(0)
        for j in range(BLOCK):
            _spline_row(first, by * BLOCK + j, rows[0], rows[1], rows[2], rows[3], rows[4])
            _robust_row(
                rows[2],
                rows[3],
                rows[4],
                strip[j],
                rows[5],
                rows[6],
                rows[7],
                rows[8],
                F(j) - MID,
                rows[9],
                c2b2,
                sums[0],
                sums[1],
                sums[2],
                sums[3],
                sums[4],
                sums[5],
            )
        for k in range(6):
            _fold(sums[k], out[k, by])


@njit
def _residual_row(a, gx, gy, b, ux, uy, vx, vy, y, c2, c2b2, r, w, psi):
    for x in range(len(r)):
        r[x] = a[x] - b[x] - gx[x] * (ux[x] + y * uy[x]) - gy[x] * (vx[x] + y * vy[x])
        m = a[x] + b[x]
        e = F(1) + m * m * (c2[x] * c2b2)
        root = e / (e + r[x] * r[x] * c2[x])
        w[x] = root * root
        psi[x] = root * root * (F(4) * root - F(3))


@njit
def _final_row(a, gx, gy, r, w, psi, s0, s1, s2, s3, s4, s5, s6, s7, s8, s9, s10, s11):
    for x in range(len(s0)):
        wx, wy = w[x] * gx[x], w[x] * gy[x]
        s0[x] += wx * r[x]
        s1[x] += wy * r[x]
        s2[x] += wx * gx[x]
        s3[x] += wx * gy[x]
        s4[x] += wy * gy[x]
        s5[x] += r[x] * r[x]
    for x in range(len(s0)):
        s6[x] += a[x]
        s7[x] += a[x] * a[x]
        s8[x] += r[x]
        s9[x] += a[x] * r[x]
    for x in range(1, len(s0) - 1):
        da, dr = a[x + 1] - a[x - 1], r[x + 1] - r[x - 1]
        mean = da - F(0.5) * dr
        s10[x] += psi[x] * da * (da - dr)
        s11[x] += w[x] * mean * mean


@njit
def final_sums(first, second, u, v, slopes, c2, c2b2, position, whole, taps, t, strip, rows, sums, out):
    """The sums of `robust_sums` and those that correlation and uncertainty are made of.

    Parameters
    ----------
    first, second, u, v, slopes, c2, c2b2, position, whole, taps, t, strip, rows, sums
        As for `robust_sums`.
    out : (12, ny, nx) float32
        Output: the six sums of `robust_sums`, then those of a, a a, r, a r,
        psi' ga gb, w ((ga + gb) / 2)^2 with psi' = w (1 - 4 t / (1 + t)), t the r^2 / (...) of the weight,
        and ga, gb differences along the row of a and of b read through the displacement.
    """
    ny = len(u)
    for by in range(ny):
        _warp_strip(second, by, u[by], v[by], position, whole, taps, t, strip)
        _spread_strip(slopes, c2, by, rows)
        sums[:] = F(0)
        for j in range(BLOCK):
            _spline_row(first, by * BLOCK + j, rows[0], rows[1], rows[2], rows[3], rows[4])
            a, p, q = rows[2], rows[3], rows[4]
            _residual_row(
                a,
                p,
                q,
                strip[j],
                rows[5],
                rows[6],
                rows[7],
                rows[8],
                F(j) - MID,
                rows[9],
                c2b2,
                rows[10],
                rows[11],
                rows[12],
            )
            _final_row(
                a,
                p,
                q,
                rows[10],
                rows[11],
                rows[12],
                sums[0],
                sums[1],
                sums[2],
                sums[3],
                sums[4],
                sums[5],
                sums[6],
                sums[7],
                sums[8],
                sums[9],
                sums[10],
                sums[11],
            )
        for k in range(12):
            _fold(sums[k], out[k, by])


@njit
def shift_sums(a, b, margin, first, dy, row, out):
    """Sums per block of a b, with b shifted by whole pixels: by dy rows and, one after another, more columns.

    Parameters
    ----------
    a : (h, w) float32
        First image.
    b : (h + 2 margin, w + 2 margin) float32
        Second image with its border.
    margin : int
        Width of that border, px.
    first, dy : int
        Shift along columns of the first output, along rows of all, px.
    row : (nx * BLOCK,) float32
        Work space.
    out : (n, ny, nx) float32
        Output, for shifts first, first + 1, ... along columns.
    """
    n, ny, _ = out.shape
    for by in range(ny):
        for k in range(n):
            row[:] = F(0)
            for j in range(BLOCK):
                y = by * BLOCK + j
                p, q = a[y], b[y + margin + dy][margin + first + k :]
                for x in range(len(row)):
                    row[x] += p[x] * q[x]
            _fold(row, out[k, by])


def scratch(nx: int) -> dict[str, np.ndarray]:
    """Work space for `nx` blocks in a row; every kernel writes what it reads."""
    n = nx * BLOCK
    return {
        "position": np.empty((2, nx), np.float32),
        "whole": np.empty((2, nx), np.int32),
        "taps": np.empty((2, TAPS, nx), np.float32),
        "t": np.zeros(END, np.float32),  # its garbage columns are read (and dropped) before they are written
        "strip": np.empty((BLOCK, n + 8), np.float32),
        "rows": np.empty((13, n + 4), np.float32),
        "sums": np.empty((12, n), np.float32),
    }
