"""The inner loops: everything that touches pixels.

What lets LLVM turn these plain loops into vector code, and must be kept:

* loops run along whole rows of the image;
* the one loop that cannot, the reading of a block, is written in vectors of eight (`_read_block`);
* the constants below are literals: numba's cache bakes them in and would not notice a change elsewhere;
  loops of other files take them as the default of an argument, by which the cache tells them apart.

`tests/matching/test_kernels.py` looks into the machine code for vector multiplies.
"""

from typing import Any

import numba as nb
import numba.extending
import numpy as np
from llvmlite import ir

from wavefield.compiled import compiled

F = np.float32
Array = np.ndarray

BLOCK = 5  # side of a block, px: the step of the lattice
TAPS = 6  # of the quintic B-spline
SIDE = 10  # BLOCK + TAPS - 1: side of the patch of b that one block needs
LANES = 8  # floats in a vector: BLOCK of them are wanted
MID = F(2.0)  # (BLOCK - 1) / 2
PAD = 8  # replicated border of b, px

njit = compiled(fastmath=True, error_model="numpy")
# a long function that is called is compiled alone and with its caller; the process that compiles runs one,
# those that read what it kept the other, which may add in another order: not the same to the bit
inlined = compiled(fastmath=True, error_model="numpy", forceinline=True)


@njit
def _spline_columns(image: Array, y: int, s: Array, d: Array) -> None:
    """Row y of an image smoothed with the quintic B-spline along y, and its exact derivative along y.

    image (h + 2 PAD, w + 2 PAD) has its border; s and d (w + 4) begin two pixels before the image.
    """
    a0, a1, a2 = F(66 / 120), F(26 / 120), F(1 / 120)
    d1, d2 = F(10 / 24), F(1 / 24)
    r0, r1, r2 = image[y + PAD - 2][PAD - 2 :], image[y + PAD - 1][PAD - 2 :], image[y + PAD][PAD - 2 :]
    r3, r4 = image[y + PAD + 1][PAD - 2 :], image[y + PAD + 2][PAD - 2 :]
    for x in range(len(s)):
        s[x] = a0 * r2[x] + a1 * (r1[x] + r3[x]) + a2 * (r0[x] + r4[x])
        d[x] = d1 * (r3[x] - r1[x]) + d2 * (r4[x] - r0[x])


@njit
def _value(s: Array, x: int) -> np.float32:
    """The spline along the row at pixel x, s beginning two pixels before it."""
    out: np.float32 = (
        F(66 / 120) * s[x + 2] + F(26 / 120) * (s[x + 1] + s[x + 3]) + F(1 / 120) * (s[x] + s[x + 4])
    )
    return out


@njit
def _slope(s: Array, x: int) -> np.float32:
    """Its derivative there."""
    out: np.float32 = F(10 / 24) * (s[x + 3] - s[x + 1]) + F(1 / 24) * (s[x + 4] - s[x])
    return out


@njit
def _spline_row(image: Array, y: int, s: Array, d: Array, a: Array, gx: Array, gy: Array) -> None:
    """Row y of an image smoothed with the quintic B-spline, and its exact derivatives along columns and rows.

    s, d (w + 4) are work space, a, gx, gy (w) output.
    """
    _spline_columns(image, y, s, d)
    for x in range(len(a)):
        a[x] = _value(s, x)
        gx[x] = _slope(s, x)
        gy[x] = _value(d, x)


@njit
def _fold(row: Array, out: Array) -> None:
    """Sum BLOCK neighbours of `row` into each element of `out`."""
    for b in range(len(out)):
        total = F(0)
        for i in range(BLOCK):
            total += row[b * BLOCK + i]
        out[b] = total


@njit
def gradient_moments(image: Array, rows: Array, sums: Array, out: Array) -> None:
    """Sums per block of products of the gradients of a, alone and times the place in the block.

    With image (h + 2 PAD, w + 2 PAD); out (9, ny, nx).
    """
    _, ny, nx = out.shape
    n = nx * BLOCK
    s, d = rows[0][: n + 4], rows[1][: n + 4]
    s0, s1, s2, s3, s4, s5 = sums[0][:n], sums[1], sums[2], sums[3], sums[4], sums[5]
    for by in range(ny):
        sums[:6] = F(0)
        for j in range(BLOCK):
            _spline_columns(image, by * BLOCK + j, s, d)
            y = F(j) - MID
            for x in range(len(s0)):
                p, q = _slope(s, x), _value(d, x)
                xx, xy, yy = p * p, p * q, q * q
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


@inlined
def _spline_bends(image: Array, y: int, s: Array, d: Array, e: Array) -> None:
    """As `_spline_columns`, and the second derivative along y into e (w + 4)."""
    a0, a1, a2 = F(66 / 120), F(26 / 120), F(1 / 120)
    d1, d2 = F(10 / 24), F(1 / 24)
    r0, r1, r2 = image[y + PAD - 2][PAD - 2 :], image[y + PAD - 1][PAD - 2 :], image[y + PAD][PAD - 2 :]
    r3, r4 = image[y + PAD + 1][PAD - 2 :], image[y + PAD + 2][PAD - 2 :]
    for x in range(len(s)):
        near, far = r1[x] + r3[x], r0[x] + r4[x]
        s[x] = a0 * r2[x] + a1 * near + a2 * far
        d[x] = d1 * (r3[x] - r1[x]) + d2 * (r4[x] - r0[x])
        e[x] = F(2 / 6) * near + F(1 / 6) * far - r2[x]


@inlined
def _bend(s: Array, x: int) -> np.float32:
    """The second derivative of the spline along the row."""
    out: np.float32 = F(2 / 6) * (s[x + 1] + s[x + 3]) + F(1 / 6) * (s[x] + s[x + 4]) - s[x + 2]
    return out


@inlined
def _strain_row(
    s: Array,
    d: Array,
    e: Array,
    s0: Array,
    s1: Array,
    s2: Array,
    s3: Array,
    s4: Array,
    s5: Array,
    s6: Array,
    s7: Array,
) -> None:
    for x in range(len(s0)):
        p, q, a = _slope(s, x), _value(d, x), _value(s, x)
        xx, xy, yy = _bend(s, x), _slope(d, x), _value(e, x)
        s0[x] += p * a
        s1[x] += q * a
        s2[x] += p * xx
        s3[x] += p * xy
        s4[x] += p * yy
        s5[x] += q * xx
        s6[x] += q * xy
        s7[x] += q * yy


@njit
def strain_moments(image: Array, rows: Array, sums: Array, out: Array) -> None:
    """Sums per block of products of a's gradients with a and with its second derivatives.

    With image (h + 2 PAD, w + 2 PAD); out (8, ny, nx).
    """
    _, ny, nx = out.shape
    n = nx * BLOCK
    s, d, e = rows[0][: n + 4], rows[1][: n + 4], rows[2][: n + 4]
    for by in range(ny):
        sums[:8] = F(0)
        for j in range(BLOCK):
            _spline_bends(image, by * BLOCK + j, s, d, e)
            _strain_row(s, d, e, sums[0][:n], sums[1], sums[2], sums[3], sums[4], sums[5], sums[6], sums[7])
        for k in range(8):
            _fold(sums[k], out[k, by])


def _block_reader(
    context: Any,
    image: Any,
    start: Any,
    stride: Any,
    strip: Any,
    to: Any,
    width: Any,
    along_x: Any,
    along_y: Any,
) -> tuple[Any, Any]:
    """Read BLOCK rows of LANES pixels between the pixels of `image`: TAPS taps along x, then TAPS along y.

    image is read from its element `start` on, its rows `stride` apart; `strip` is written from its element
    `to` on, its rows `width` apart. Plain loops take half as long again: they must first move the patch to
    where LLVM sees that nothing overlaps.
    """

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        floats, vector = ir.FloatType(), ir.VectorType(ir.FloatType(), LANES)
        source, target = (
            context.make_array(signature.args[n])(context, builder, arguments[n]).data for n in (0, 3)
        )

        def place(base: Any, index: Any) -> Any:
            return builder.bitcast(builder.gep(base, [index]), vector.as_pointer())

        def everywhere(value: Any) -> Any:
            one = builder.insert_element(
                ir.Constant(vector, ir.Undefined), value, ir.Constant(ir.IntType(32), 0)
            )
            lanes = ir.Constant(ir.VectorType(ir.IntType(32), LANES), None)
            return builder.shuffle_vector(one, one, lanes)

        def weighted(taps: Any, vectors: Any) -> Any:
            total = ir.Constant(vector, [ir.Constant(floats, 0.0)] * LANES)
            for tap, value in zip(taps, vectors):
                product = builder.fmul(tap, value, flags=("fast",))
                total = builder.fadd(total, product, flags=("fast",))
            return total

        taps_x, taps_y = (
            [everywhere(builder.extract_value(arguments[n], k)) for k in range(TAPS)] for n in (6, 7)
        )
        rows, at = [], arguments[1]
        for _ in range(SIDE):
            shifted = []
            for k in range(TAPS):
                value = builder.load(place(source, builder.add(at, ir.Constant(at.type, k))))
                value.align = 4
                shifted.append(value)
            rows.append(weighted(taps_x, shifted))
            at = builder.add(at, arguments[2])
        at = arguments[4]
        for j in range(BLOCK):
            stored = builder.store(weighted(taps_y, rows[j : j + TAPS]), place(target, at))
            stored.align = 4
            at = builder.add(at, arguments[5])
        return context.get_dummy_value()

    index = nb.types.intp
    return nb.types.void(image, index, index, strip, index, index, along_x, along_y), build


_read_block: Any = numba.extending.intrinsic(_block_reader)


@njit
def _spline_taps(position: Array, whole: Array, taps: Array) -> None:
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
def _get(taps: Array, b: int) -> tuple[np.float32, ...]:
    """The taps of one block as a tuple: they stay in registers."""
    return taps[0, b], taps[1, b], taps[2, b], taps[3, b], taps[4, b], taps[5, b]


@njit
def _warp_strip(
    image: Array, by: int, u: Array, v: Array, position: Array, whole: Array, taps: Array, strip: Array
) -> None:
    """Read b under one row of blocks, each at its own displacement, into `strip` (BLOCK, nx BLOCK + 8)."""
    nx = len(u)
    h, w = image.shape
    for b in range(nx):
        position[0, b] = F(b * BLOCK + PAD - 2) + u[b]
        position[1, b] = F(by * BLOCK + PAD - 2) + v[b]
    _spline_taps(position[0], whole[0], taps[0])
    _spline_taps(position[1], whole[1], taps[1])
    last = (h - SIDE + 1) * w - (LANES + TAPS - 1)  # from here on vectors would end outside the image
    for b in range(nx):
        x = min(max(whole[0, b], 0), w - SIDE)
        y = min(max(whole[1, b], 0), h - SIDE)
        start = min(y * w + x, last)
        _read_block(image, start, w, strip, b * BLOCK, strip.shape[1], _get(taps[0], b), _get(taps[1], b))


@njit
def _plain_row(s: Array, d: Array, b: Array, s0: Array, s1: Array) -> None:
    for x in range(len(s0)):
        r = _value(s, x) - b[x]
        s0[x] += _slope(s, x) * r
        s1[x] += _value(d, x) * r


@njit
def plain_sums(
    first: Array,
    second: Array,
    u: Array,
    v: Array,
    position: Array,
    whole: Array,
    taps: Array,
    strip: Array,
    rows: Array,
    sums: Array,
    out: Array,
) -> None:
    """Sums per block of gx r and gy r, with r = a - b(x + d) and d constant over the block.

    With first, second (h + 2 PAD, w + 2 PAD); u, v (ny, nx), px; out (2, ny, nx).
    """
    ny, n = len(u), u.shape[1] * BLOCK
    s, d = rows[0][: n + 4], rows[1][: n + 4]
    s0, s1 = sums[0][:n], sums[1]
    for by in range(ny):
        _warp_strip(second, by, u[by], v[by], position, whole, taps, strip)
        sums[:2] = F(0)
        for j in range(BLOCK):
            _spline_columns(first, by * BLOCK + j, s, d)
            _plain_row(s, d, strip[j], s0, s1)
        for k in range(2):
            _fold(sums[k], out[k, by])


@njit
def _ramp(to: Array, i: int, slope: np.float32) -> None:
    """The line of this slope through zero at the block's middle."""
    for k in range(BLOCK):
        to[i + k] = slope * (F(k) - MID)


@njit
def _level(to: Array, i: int, value: np.float32) -> None:
    for k in range(BLOCK):
        to[i + k] = value


@njit
def _spread_strip(slopes: Array, c2: Array, by: int, rows: Array) -> None:
    """Slopes of the displacement and weight constants of one row of blocks, spread over its pixels."""
    for b in range(slopes.shape[2]):
        x = b * BLOCK
        _ramp(rows[5], x, slopes[0, by, b])
        _level(rows[6], x, slopes[1, by, b])
        _ramp(rows[7], x, slopes[2, by, b])
        _level(rows[8], x, slopes[3, by, b])
        _level(rows[9], x, c2[by, b])


@njit
def _robust_row(
    a: Array,
    gx: Array,
    gy: Array,
    b: Array,
    ux: Array,
    uy: Array,
    vx: Array,
    vy: Array,
    y: np.float32,
    c2: Array,
    c2b2: np.float32,
    s0: Array,
    s1: Array,
    s2: Array,
    s3: Array,
    s4: Array,
    s5: Array,
) -> None:
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
def robust_sums(
    first: Array,
    second: Array,
    u: Array,
    v: Array,
    slopes: Array,
    c2: Array,
    c2b2: np.float32,
    position: Array,
    whole: Array,
    taps: Array,
    strip: Array,
    rows: Array,
    sums: Array,
    out: Array,
) -> None:
    """Sums per block with a weight w = (1 + r^2 / (c^2 (s^2 + beta^2 m^2)))^-2 per pixel.

    With slopes (4, ny, nx); c2 (ny, nx); out (6, ny, nx).
    """
    ny, n = len(u), u.shape[1] * BLOCK
    s, d = rows[0][: n + 4], rows[1][: n + 4]
    for by in range(ny):
        _warp_strip(second, by, u[by], v[by], position, whole, taps, strip)
        _spread_strip(slopes, c2, by, rows)
        sums[:6] = F(0)
        for j in range(BLOCK):
            _spline_row(first, by * BLOCK + j, s, d, rows[2][:n], rows[3][:n], rows[4][:n])
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
                sums[0][:n],
                sums[1],
                sums[2],
                sums[3],
                sums[4],
                sums[5],
            )
        for k in range(6):
            _fold(sums[k], out[k, by])


@njit
def _residual_row(
    a: Array,
    gx: Array,
    gy: Array,
    b: Array,
    ux: Array,
    uy: Array,
    vx: Array,
    vy: Array,
    y: np.float32,
    c2: Array,
    c2b2: np.float32,
    r: Array,
    w: Array,
    psi: Array,
) -> None:
    for x in range(len(r)):
        r[x] = a[x] - b[x] - gx[x] * (ux[x] + y * uy[x]) - gy[x] * (vx[x] + y * vy[x])
        m = a[x] + b[x]
        e = F(1) + m * m * (c2[x] * c2b2)
        root = e / (e + r[x] * r[x] * c2[x])
        w[x] = root * root
        psi[x] = root * root * (F(4) * root - F(3))


@njit
def _final_row(
    a: Array,
    gx: Array,
    gy: Array,
    r: Array,
    w: Array,
    psi: Array,
    s0: Array,
    s1: Array,
    s2: Array,
    s3: Array,
    s4: Array,
    s5: Array,
    s6: Array,
    s7: Array,
    s8: Array,
    s9: Array,
    s10: Array,
    s11: Array,
) -> None:
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
def final_sums(
    first: Array,
    second: Array,
    u: Array,
    v: Array,
    slopes: Array,
    c2: Array,
    c2b2: np.float32,
    position: Array,
    whole: Array,
    taps: Array,
    strip: Array,
    rows: Array,
    sums: Array,
    out: Array,
) -> None:
    """The sums of `robust_sums` and those that correlation and uncertainty are made of.

    With out (12, ny, nx).
    """
    ny, n = len(u), u.shape[1] * BLOCK
    s, d = rows[0][: n + 4], rows[1][: n + 4]
    for by in range(ny):
        _warp_strip(second, by, u[by], v[by], position, whole, taps, strip)
        _spread_strip(slopes, c2, by, rows)
        sums[:] = F(0)
        for j in range(BLOCK):
            _spline_row(first, by * BLOCK + j, s, d, rows[2][:n], rows[3][:n], rows[4][:n])
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
                rows[10][:n],
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
                sums[0][:n],
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
def _unweighted_row(
    s: Array,
    d: Array,
    b: Array,
    ux: Array,
    uy: Array,
    vx: Array,
    vy: Array,
    y: np.float32,
    a: Array,
    r: Array,
    s0: Array,
    s1: Array,
) -> None:
    for x in range(len(s0)):
        gx, gy, value = _slope(s, x), _value(d, x), _value(s, x)
        miss = value - b[x] - gx * (ux[x] + y * uy[x]) - gy * (vx[x] + y * vy[x])
        a[x] = value
        r[x] = miss
        s0[x] += gx * miss
        s1[x] += gy * miss


@njit
def _strip_sums(
    a: Array, r: Array, s5: Array, s6: Array, s7: Array, s8: Array, s9: Array, s10: Array, s11: Array
) -> None:
    """Sums of r r, a, a a, r, a r, ga gb, ((ga + gb) / 2)^2 over the rows of a strip.

    a, r (BLOCK, n + 4) begin one pixel before the sums (n).
    """
    for x in range(len(s5)):
        rr = sa = aa = sr = ar = ab = mm = F(0)
        for j in range(BLOCK):
            p, q = a[j, x + 1], r[j, x + 1]
            da, dr = a[j, x + 2] - a[j, x], r[j, x + 2] - r[j, x]
            mean = da - F(0.5) * dr
            rr += q * q
            sa += p
            aa += p * p
            sr += q
            ar += p * q
            ab += da * (da - dr)
            mm += mean * mean
        s5[x] = rr
        s6[x] = sa
        s7[x] = aa
        s8[x] = sr
        s9[x] = ar
        s10[x] = ab
        s11[x] = mm


@njit
def unweighted_sums(
    first: Array,
    second: Array,
    u: Array,
    v: Array,
    slopes: Array,
    position: Array,
    whole: Array,
    taps: Array,
    strip: Array,
    rows: Array,
    sums: Array,
    out: Array,
) -> None:
    """The sums of `final_sums` with every weight 1, but without those of a's gradients alone.

    With out (12, ny, nx).
    """
    ny, n = len(u), u.shape[1] * BLOCK
    s, d = rows[0][: n + 4], rows[1][: n + 4]
    a, r = rows[9:14], rows[14:19]  # whole rows: loops over cut ones do not become vector code
    for by in range(ny):
        _warp_strip(second, by, u[by], v[by], position, whole, taps, strip)
        _spread_strip(slopes, u, by, rows)
        sums[:2] = F(0)
        for j in range(BLOCK):
            y = F(j) - MID
            _spline_columns(first, by * BLOCK + j, s, d)
            _unweighted_row(
                s,
                d,
                strip[j],
                rows[5],
                rows[6],
                rows[7],
                rows[8],
                y,
                a[j, 1:],
                r[j, 1:],
                sums[0][:n],
                sums[1],
            )
            for row in (a[j], r[j]):
                row[0], row[n + 1] = row[2], row[n - 1]  # no slope at the edge
        _strip_sums(a, r, sums[5][:n], sums[6], sums[7], sums[8], sums[9], sums[10], sums[11])
        for k in (0, 1, 5, 6, 7, 8, 9, 10, 11):
            _fold(sums[k], out[k, by])


@njit
def shift_sums(a: Array, b: Array, margin: int, first: int, dy: int, row: Array, out: Array) -> None:
    """Sums per block of a b, with b shifted by whole pixels: by dy rows and, one after another, more columns.

    With a (h, w); b (h + 2 margin, w + 2 margin); margin, px; first, dy, px; row (nx * BLOCK,); out (ny, n,
    nx + 2 border).
    """
    ny, n, width = out.shape
    nx = len(row) // BLOCK
    border = (width - nx) // 2
    for by in range(ny):
        y = by * BLOCK
        p0, p1, p2, p3, p4 = a[y], a[y + 1], a[y + 2], a[y + 3], a[y + 4]
        y += margin + dy
        for k in range(n):
            x = margin + first + k
            q0, q1, q2 = b[y][x:], b[y + 1][x:], b[y + 2][x:]
            q3, q4 = b[y + 3][x:], b[y + 4][x:]
            for i in range(len(row)):
                row[i] = p0[i] * q0[i] + p1[i] * q1[i] + p2[i] * q2[i] + p3[i] * q3[i] + p4[i] * q4[i]
            to = out[by, k]
            _fold(row, to[border : border + nx])
            to[:border] = to[border]
            to[border + nx :] = to[border + nx - 1]


def scratch(nx: int) -> dict[str, Array]:
    """Work space for `nx` blocks in a row; every kernel writes what it reads.

    Rows lie three cache lines beyond a multiple of sixteen apart: those of an image of 1024 px would else
    begin a page apart, push each other out of the cache and look to the processor as if they overlapped.
    """
    width = nx * BLOCK + 8
    width += (48 - width) % 256
    lines = np.empty((BLOCK + 19 + 12, width), np.float32)
    return {
        "position": np.empty((2, nx), np.float32),
        "whole": np.empty((2, nx), np.int32),
        "taps": np.empty((2, TAPS, nx), np.float32),
        "strip": lines[:BLOCK],
        "rows": lines[BLOCK:-12],
        "sums": lines[-12:],
    }
