"""The inner loops over pixels, which sum over the blocks of an image.

Three rules keep these loops fast (LLVM vectorises them) and numba's cache correct:

* Loops run along complete rows of the image.
* The only loop that cannot, the sampling of a block, is written in vectors of eight (`_block_reader`).
* The constants below are literals. Numba compiles them into its cache and would not notice that they were
  changed in another file. Loops in other files take them as default arguments, which the cache does compare.

Names: a is the first image, b the second; s is a row of image a, smoothed by the spline along y, and d its
derivative along y; `by` is the number of a row of blocks. In a residual, both images are smoothed by the
quintic B-spline without prefilter.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numba.extending
import numpy as np
from llvmlite import ir
from numba import types
from numba.core.base import BaseContext
from numba.core.typing.templates import Signature

from wavefield.compiled import compiled

F = np.float32
Array = np.ndarray

BLOCK = 5  # side of a block, px: the step of the lattice
TAPS = 6  # weights of the quintic B-spline along one axis
SIDE = BLOCK + TAPS - 1  # side of the patch of b that one block needs
LANES = 8  # floats in a vector register (AVX), of which BLOCK are needed
MID = F(2.0)  # (BLOCK - 1) / 2: centre of a block, px from its first pixel
PAD = 8  # width of the replicated border of a prepared image, px

njit = compiled(fastmath=True, error_model="numpy")
# LLVM compiles a long function twice: alone, and as part of its caller. The process that compiles runs one
# version, processes that load the cache run the other, and their sums may differ in the last bits. Inlining
# leaves one version.
inlined = compiled(fastmath=True, error_model="numpy", forceinline=True)


class WorkSpace(NamedTuple):
    """Scratch arrays for the loops over pixels; every thread needs its own set."""

    position: Array  # (2, nx) float32: column and row of b at which each block begins
    whole: Array  # (2, nx) int32: integer part of the positions
    taps: Array  # (2, TAPS, nx) float32: spline weights for the fractional part
    strip: Array  # (BLOCK, width) float32: b sampled at the displaced positions of one row of blocks
    rows: Array  # (19, width) float32: rows of pixels of a: splines, gradients, slopes, residuals
    sums: Array  # (12, width) float32: sums over the rows of a block


def work_space(nx: int) -> WorkSpace:
    """Return uninitialised scratch arrays for images with `nx` blocks in a row."""
    # The distance between rows is three cache lines more than a multiple of 1024 bytes. Rows of an image of
    # 1024 px would otherwise lie exactly a page apart, where they evict each other from the cache.
    width = nx * BLOCK + 8
    width += (48 - width) % 256
    lines = np.empty((BLOCK + 19 + 12, width), np.float32)
    return WorkSpace(
        position=np.empty((2, nx), np.float32),
        whole=np.empty((2, nx), np.int32),
        taps=np.empty((2, TAPS, nx), np.float32),
        strip=lines[:BLOCK],
        rows=lines[BLOCK:-12],
        sums=lines[-12:],
    )


@njit
def _spline_columns(image: Array, y: int, s: Array, d: Array) -> None:
    """Write row y of an image, smoothed along y by the quintic B-spline, to s; its derivative along y to d.
    `image` includes its border of PAD pixels; s and d (w + 4,) start two pixels left of the inner image."""
    a0, a1, a2 = F(66 / 120), F(26 / 120), F(1 / 120)
    d1, d2 = F(10 / 24), F(1 / 24)
    r0, r1, r2 = image[y + PAD - 2][PAD - 2 :], image[y + PAD - 1][PAD - 2 :], image[y + PAD][PAD - 2 :]
    r3, r4 = image[y + PAD + 1][PAD - 2 :], image[y + PAD + 2][PAD - 2 :]
    for x in range(len(s)):
        s[x] = a0 * r2[x] + a1 * (r1[x] + r3[x]) + a2 * (r0[x] + r4[x])
        d[x] = d1 * (r3[x] - r1[x]) + d2 * (r4[x] - r0[x])


@njit
def _value(s: Array, x: int) -> np.float32:
    """Return the value at pixel x of the spline along a row s that starts two pixels left of the image."""
    out: np.float32 = (
        F(66 / 120) * s[x + 2] + F(26 / 120) * (s[x + 1] + s[x + 3]) + F(1 / 120) * (s[x] + s[x + 4])
    )
    return out


@njit
def _slope(s: Array, x: int) -> np.float32:
    """Return the x derivative at pixel x of the spline along a row `s` (see `_value`)."""
    out: np.float32 = F(10 / 24) * (s[x + 3] - s[x + 1]) + F(1 / 24) * (s[x + 4] - s[x])
    return out


@njit
def _spline_row(image: Array, y: int, rows: Array, n: int) -> None:
    """Write n smoothed pixels of row y of an image to rows[2], gradients along x and y to rows[3], rows[4].
    `image` includes its border; rows[0] and rows[1] are overwritten."""
    s, d = rows[0][: n + 4], rows[1][: n + 4]
    a, gx, gy = rows[2][:n], rows[3], rows[4]
    _spline_columns(image, y, s, d)
    for x in range(len(a)):
        a[x] = _value(s, x)
        gx[x] = _slope(s, x)
        gy[x] = _value(d, x)


@njit
def _fold(row: Array, out: Array) -> None:
    """Write to out[n] the sum of the pixels of block n, from a row of pixels with BLOCK pixels per block."""
    for b in range(len(out)):
        total = F(0)
        for i in range(BLOCK):
            total += row[b * BLOCK + i]
        out[b] = total


@njit
def gradient_moments(image: Array, work: WorkSpace, out: Array) -> None:
    """Write block sums of G = (gx gx, gx gy, gy gy) to out[:3], of x G to out[3:6] and of y G to out[6:].
    gx, gy are the gradients of `image` (with border); x, y are px from the centre of a pixel's block."""
    _, ny, nx = out.shape
    n = nx * BLOCK
    sums = work.sums
    s, d = work.rows[0][: n + 4], work.rows[1][: n + 4]
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
    """Write row y of an image, smoothed along y, to s; its first and second y derivatives to d and e."""
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
    """Return the second x derivative at pixel x of the spline along a row `s` (see `_value`)."""
    out: np.float32 = F(2 / 6) * (s[x + 1] + s[x + 3]) + F(1 / 6) * (s[x] + s[x + 4]) - s[x + 2]
    return out


@inlined
def _strain_row(s: Array, d: Array, e: Array, totals: tuple[Array, ...]) -> None:
    """Add the eight products of `strain_moments`, for each pixel of a row, to the eight arrays `totals`.
    s is the row smoothed along y, d and e are its first and second derivative along y (`_spline_bends`)."""
    s0, s1, s2, s3, s4, s5, s6, s7 = totals  # loops over slices that are made here do not vectorise
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
def strain_moments(image: Array, work: WorkSpace, out: Array) -> None:
    """Write eight sums over each block of an image a (with border) to out (8, ny, nx).
    They are of the products gx a, gy a, gx a_xx, gx a_xy, gx a_yy, gy a_xx, gy a_xy and gy a_yy; gx and gy
    are the first derivatives of a along x and y, and a_xx, a_xy, a_yy the second."""
    _, ny, nx = out.shape
    n = nx * BLOCK
    sums = work.sums
    s, d, e = work.rows[0][: n + 4], work.rows[1][: n + 4], work.rows[2][: n + 4]
    totals = sums[0][:n], sums[1], sums[2], sums[3], sums[4], sums[5], sums[6], sums[7]
    for by in range(ny):
        sums[:8] = F(0)
        for j in range(BLOCK):
            _spline_bends(image, by * BLOCK + j, s, d, e)
            _strain_row(s, d, e, totals)
        for k in range(8):
            _fold(sums[k], out[k, by])


def _block_reader(
    context: BaseContext,
    image: types.Type,
    start: types.Type,
    stride: types.Type,
    strip: types.Type,
    to: types.Type,
    width: types.Type,
    along_x: types.Type,
    along_y: types.Type,
) -> tuple[Signature, Callable[..., ir.Value]]:
    """Generate the LLVM code of `_read_block`, which samples a block of `image` at fractions of pixels.
    It reads rows of `stride` elements from element `start` on, with TAPS weights `along_x` and `along_y`. It
    writes BLOCK rows of LANES pixels to `strip`, from element `to` on, `width` elements apart."""

    def build(
        context: BaseContext, builder: ir.IRBuilder, signature: Signature, arguments: Sequence[ir.Value]
    ) -> ir.Value:
        # plain loops over so few pixels do not vectorise, which makes a whole step 11 % slower
        vector = ir.VectorType(ir.FloatType(), LANES)
        _, at, stride, _, to, width, along_x, along_y = arguments
        source, target = (
            context.make_array(signature.args[n])(context, builder, arguments[n]).data for n in (0, 3)
        )

        def pointer(base: ir.Value, index: ir.Value) -> ir.Value:
            return builder.bitcast(builder.gep(base, [index]), vector.as_pointer())

        def in_all_lanes(taps: ir.Value, k: int) -> ir.Value:
            first = ir.Constant(ir.IntType(32), 0)
            one = builder.insert_element(
                ir.Constant(vector, ir.Undefined), builder.extract_value(taps, k), first
            )
            return builder.shuffle_vector(one, one, ir.Constant(ir.VectorType(ir.IntType(32), LANES), None))

        def weighted(taps: Sequence[ir.Value], vectors: Sequence[ir.Value]) -> ir.Value:
            total = ir.Constant(vector, [ir.Constant(ir.FloatType(), 0.0)] * LANES)
            for tap, value in zip(taps, vectors, strict=True):
                total = builder.fadd(total, builder.fmul(tap, value, flags=("fast",)), flags=("fast",))
            return total

        taps_x, taps_y = ([in_all_lanes(taps, k) for k in range(TAPS)] for taps in (along_x, along_y))
        rows = []
        for _ in range(SIDE):
            shifted = [builder.load(pointer(source, builder.add(at, at.type(k)))) for k in range(TAPS)]
            for value in shifted:
                value.align = 4
            rows.append(weighted(taps_x, shifted))
            at = builder.add(at, stride)
        for j in range(BLOCK):
            builder.store(weighted(taps_y, rows[j : j + TAPS]), pointer(target, to)).align = 4
            to = builder.add(to, width)
        return context.get_dummy_value()

    index = types.intp
    return types.void(image, index, index, strip, index, index, along_x, along_y), build


_read_block: Callable[..., None] = numba.extending.intrinsic(_block_reader)


@njit
def _spline_taps(position: Array, whole: Array, taps: Array) -> None:
    """Write the whole part of positions (n,), px, to `whole` (n,) and six spline weights to taps (6, n).
    The weights sample an image at the fractional part of each position."""
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
    """Return the six spline weights of block b as a tuple, which the compiler keeps in registers."""
    return taps[0, b], taps[1, b], taps[2, b], taps[3, b], taps[4, b], taps[5, b]


@njit
def _spread(values: Array, out: Array) -> None:
    """Write the value of each block, `values` (nx,), to its BLOCK pixels in a row of pixels `out`."""
    for b in range(len(values)):
        for k in range(BLOCK):
            out[b * BLOCK + k] = values[b]


@njit
def _spread_ramps(slopes: Array, out: Array) -> None:
    """Write to each block of a row of pixels `out` a ramp that is 0 at the centre of the block.
    `slopes` (nx,) are the increases of the ramps per pixel."""
    for b in range(len(slopes)):
        for k in range(BLOCK):
            out[b * BLOCK + k] = slopes[b] * (F(k) - MID)


@njit
def _warp_strip(image: Array, by: int, u: Array, v: Array, work: WorkSpace) -> None:
    """Sample an image (with border) at the displaced pixels of block row `by`; write them to `work.strip`.
    The displacement u, v (nx,), px, is constant in each block."""
    position, whole, taps, strip = work.position, work.whole, work.taps, work.strip
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
def _plain_row(s: Array, d: Array, b: Array, sums: Array) -> None:
    """Add gx r to sums[0] and gy r to sums[1] at each pixel of a row. gx and gy are the derivatives of the
    first image, r the residual (see `plain_sums`). s is the row of the first image smoothed along y, d its
    derivative along y; b is the row of the displaced second image."""
    n = len(s) - 4
    s0, s1 = sums[0][:n], sums[1]
    for x in range(len(s0)):
        r = _value(s, x) - b[x]
        s0[x] += _slope(s, x) * r
        s1[x] += _value(d, x) * r


@njit
def plain_sums(first: Array, second: Array, u: Array, v: Array, work: WorkSpace, out: Array) -> None:
    """Write the block sums of gx r and gy r to out (2, ny, nx), with the residual r = a(x) - b(x + d).
    gx, gy are the gradients of the `first` image a; the displacement d = (u, v) (ny, nx), px, from a to the
    `second` image b is constant in a block. a and b include their borders."""
    n = u.shape[1] * BLOCK
    s, d = work.rows[0][: n + 4], work.rows[1][: n + 4]
    for by in range(len(u)):
        _warp_strip(second, by, u[by], v[by], work)
        work.sums[:2] = F(0)
        for j in range(BLOCK):
            _spline_columns(first, by * BLOCK + j, s, d)
            _plain_row(s, d, work.strip[j], work.sums)
        for k in range(2):
            _fold(work.sums[k], out[k, by])


# The functions below use these rows of the work space: 0 and 1 for the splines along y, 5 to 8 for the four
# displacement gradients at every pixel, from 9 on for values and residuals at every pixel.


@njit
def _spread_slopes(slopes: Array, by: int, rows: Array) -> None:
    """Write displacement gradients, at each pixel of block row `by`, to rows[5:9]; `slopes` is (4, ny, nx).
    du/dx, dv/dx are multiplied by x from the block's centre; the caller multiplies du/dy, dv/dy by y."""
    _spread_ramps(slopes[0, by], rows[5])
    _spread(slopes[1, by], rows[6])
    _spread_ramps(slopes[2, by], rows[7])
    _spread(slopes[3, by], rows[8])


@njit
def _residual_row(
    splines: tuple[Array, ...],
    slopes: tuple[Array, ...],
    b: Array,
    y: np.float32,
    a: Array,
    r: Array,
    sums: tuple[Array, ...],
) -> None:
    """Write smoothed pixels of a row to a, residuals to r; add gx r and gy r to the two arrays `sums`.
    The row lies y px below the centre of its blocks. `splines` are s and d of `_spline_columns`, `slopes` the
    four rows of `_spread_slopes`, and b is the row of the displaced second image."""
    s, d = splines
    ux, uy, vx, vy = slopes
    s0, s1 = sums
    for x in range(len(s0)):
        gx, gy, value = _slope(s, x), _value(d, x), _value(s, x)
        residual = value - b[x] - gx * (ux[x] + y * uy[x]) - gy * (vx[x] + y * vy[x])
        a[x] = value
        r[x] = residual
        s0[x] += gx * residual
        s1[x] += gy * residual


@njit
def _strip_sums(a: Array, r: Array, totals: tuple[Array, ...]) -> None:
    """Write sums over BLOCK rows of r r, a, a a, r, a r, ga gb, ((ga + gb) / 2)^2 to the arrays `totals`.
    Each pixel column has its own sums. The rows a (first image) and r = a - b (residual) start one pixel left
    of the image; ga, gb are the differences a[x + 1] - a[x - 1], b[x + 1] - b[x - 1]."""
    s5, s6, s7, s8, s9, s10, s11 = totals
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
def final_sums(
    first: Array, second: Array, u: Array, v: Array, slopes: Array, work: WorkSpace, out: Array
) -> None:
    """Write nine sums over each block to planes 0, 1 and 5 to 11 of out (12, ny, nx).
    Planes 0 and 1 are the sums of gx r and gy r (see `plain_sums`), from 5 on those of `_strip_sums`. Images
    include borders. The displacement u, v (ny, nx), px, at block centres has the gradients du/dx, du/dy,
    dv/dx, dv/dy, `slopes` (4, ny, nx)."""
    n = u.shape[1] * BLOCK
    rows, sums = work.rows, work.sums
    splines, spread = (rows[0][: n + 4], rows[1][: n + 4]), (rows[5], rows[6], rows[7], rows[8])
    scores = sums[0][:n], sums[1]
    totals = sums[5][:n], sums[6], sums[7], sums[8], sums[9], sums[10], sums[11]
    a, r = rows[9:14], rows[14:19]  # complete rows: loops over slices of them do not vectorise
    for by in range(len(u)):
        _warp_strip(second, by, u[by], v[by], work)
        _spread_slopes(slopes, by, rows)
        sums[:2] = F(0)
        for j in range(BLOCK):
            _spline_columns(first, by * BLOCK + j, splines[0], splines[1])
            _residual_row(splines, spread, work.strip[j], F(j) - MID, a[j, 1:], r[j, 1:], scores)
            for row in (a[j], r[j]):
                row[0], row[n + 1] = row[2], row[n - 1]  # makes the gradient at the edge zero
        _strip_sums(a, r, totals)
        for k in (0, 1, 5, 6, 7, 8, 9, 10, 11):
            _fold(sums[k], out[k, by])


# Whole beads. Every pixel is assigned to the block that contains the brightest point (top) of its bead, which
# steepest ascent from the pixel reaches. A bead that is brighter in one image than in the other then adds
# nothing to the score, because its contributions cancel over the whole bead.


@njit
def _uphill(above: Array, row: Array, below: Array, first: np.int32, width: np.int32, out: Array) -> None:
    """Write to `out`, for each pixel of a row, the flat index of the brightest of the 3 x 3 pixels around it.
    The rows `above`, `row` and `below` start one pixel left of the image, which is `width` px wide; `first`
    is the flat index of the row's first pixel in the image without border."""
    for x in range(len(out)):
        at = np.int32(first + x)
        best, to = row[x + 1], at
        for k in range(3):
            to = np.int32(at - width + k - 1) if above[x + k] > best else to
            best = max(best, above[x + k])
        for k in range(0, 3, 2):
            to = np.int32(at + k - 1) if row[x + k] > best else to
            best = max(best, row[x + k])
        for k in range(3):
            to = np.int32(at + width + k - 1) if below[x + k] > best else to
            best = max(best, below[x + k])
        out[x] = to


@njit
def bead_blocks(image: Array, out: Array) -> None:
    """Write to out (h, w), for each pixel, the block that contains the brightest point of its bead.
    Blocks are numbered row by row. `image` has a border of PAD px; its innermost pixels are the darkest."""
    h, w = out.shape
    for y in range(h):
        r = y + PAD
        above, row, below = image[r - 1][PAD - 1 :], image[r][PAD - 1 :], image[r + 1][PAD - 1 :]
        _uphill(above, row, below, np.int32(y * w), np.int32(w), out[y])
        for x in range(w):  # a top stores -1 - its block, every other pixel the index of the next pixel
            if out[y, x] == y * w + x:
                out[y, x] = -1 - (y // BLOCK * (w // BLOCK) + x // BLOCK)
    to = out.ravel()
    # two sweeps without branches shorten most paths: processors mispredict loops of unknown length
    for k in range(len(to)):
        at, further = to[k], to[max(to[k], 0)]
        to[k] = at if at < 0 else further
    for k in range(len(to) - 1, -1, -1):
        at, further = to[k], to[max(to[k], 0)]
        to[k] = at if at < 0 else further
    for start in range(len(to)):
        top = to[start]
        while top >= 0:
            top = to[top]
        to[start] = top
    for k in range(len(to)):
        to[k] = -1 - to[k]


@njit
def bead_hessians(image: Array, block: Array, work: WorkSpace, out: Array) -> None:
    """Write sums of gx gx, gx gy, gy gy over all beads of each block to out (ny nx, 3).
    All pixels of a bead count in the block of its brightest point, `block` (h, w) from `bead_blocks`."""
    h, n = block.shape
    out[:] = F(0)
    gx, gy = work.rows[3], work.rows[4]
    for y in range(h):
        _spline_row(image, y, work.rows, n)
        for x in range(n):
            to = out[block[y, x]]
            to[0] += gx[x] * gx[x]
            to[1] += gx[x] * gy[x]
            to[2] += gy[x] * gy[x]


@njit
def _scores_of_pixels(
    splines: tuple[Array, ...], slopes: tuple[Array, ...], b: Array, y: np.float32, to: tuple[Array, ...]
) -> None:
    """Write gx r and gy r (gradient times residual) of each pixel of a row to the two arrays `to`.
    The other arguments are those of `_residual_row`."""
    s, d = splines
    ux, uy, vx, vy = slopes
    along, down = to
    for x in range(len(along)):
        gx, gy = _slope(s, x), _value(d, x)
        r = _value(s, x) - b[x] - gx * (ux[x] + y * uy[x]) - gy * (vx[x] + y * vy[x])
        along[x] = gx * r
        down[x] = gy * r


@njit
def bead_scores(
    first: Array,
    second: Array,
    u: Array,
    v: Array,
    slopes: Array,
    block: Array,
    work: WorkSpace,
    out: Array,
) -> None:
    """Write sums of gx r and gy r (gradient times residual) over all beads of each block to out (ny nx, 2).
    `block` (h, w) comes from `bead_blocks`; `final_sums` describes the other arguments."""
    n = u.shape[1] * BLOCK
    rows = work.rows
    splines, spread = (rows[0][: n + 4], rows[1][: n + 4]), (rows[5], rows[6], rows[7], rows[8])
    along, down = rows[9][:n], rows[10][:n]
    out[:] = F(0)
    for by in range(len(u)):
        _warp_strip(second, by, u[by], v[by], work)
        _spread_slopes(slopes, by, rows)
        for j in range(BLOCK):
            y = by * BLOCK + j
            _spline_columns(first, y, splines[0], splines[1])
            _scores_of_pixels(splines, spread, work.strip[j], F(j) - MID, (along, down))
            for x in range(n):
                to = out[block[y, x]]
                to[0] += along[x]
                to[1] += down[x]


@njit
def shift_sums(a: Array, b: Array, margin: int, first: int, dy: int, row: Array, out: Array) -> None:
    """Write sums over each block of image a times a shifted image b to out (ny, shifts, nx + 2 border).
    b is shifted by dy rows, and by `first`, `first` + 1, ... columns. b has `margin` px of border, a has
    none; `row` is scratch. The border of `out` repeats the values of the outermost blocks."""
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
