"""The inner loops over pixels: sums over the blocks of an image.

What lets LLVM turn these plain loops into vector code, and must be kept:

* loops run along complete rows of the image;
* the one loop that cannot, the sampling of a block, is written in vectors of eight (`_block_reader`);
* the constants below are literals: numba's cache compiles them in and would not notice a change elsewhere;
  loops of other files take them as the default of an argument, by which the cache distinguishes them.
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
TAPS = 6  # of the quintic B-spline
SIDE = 10  # BLOCK + TAPS - 1: side of the patch of b that one block needs
LANES = 8  # floats in a vector, of which BLOCK are needed
MID = F(2.0)  # (BLOCK - 1) / 2
PAD = 8  # replicated border of b, px

njit = compiled(fastmath=True, error_model="numpy")
# A long function that is called is compiled alone and with its caller. The process that compiles runs one of
# them, processes that load the cache the other; these may add in another order and differ in the last bits.
inlined = compiled(fastmath=True, error_model="numpy", forceinline=True)


class WorkSpace(NamedTuple):
    """Scratch arrays of the kernels, one set per thread."""

    position: Array  # (2, nx) float32: column and row of b at which a block begins
    whole: Array  # (2, nx) int32: their whole part
    taps: Array  # (2, TAPS, nx) float32: weights of their fraction
    strip: Array  # (BLOCK, width) float32: b under a row of blocks
    rows: Array  # (19, width) float32: rows of a, its gradients, slopes, residuals, ...
    sums: Array  # (12, width) float32: sums over the rows of a block


def work_space(nx: int) -> WorkSpace:
    """Work space for `nx` blocks in a row."""
    # rows begin three cache lines beyond a multiple of sixteen apart: those of an image of 1024 px would else
    # begin a page apart, evict each other from the cache and seem to the processor to overlap
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
    """Row y of an image smoothed by the quintic B-spline along y, and its derivative along y.
    image (h + 2 PAD, w + 2 PAD) includes its border; the outputs s, d (w + 4) start two pixels left of the
    image.
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
    """Smooth along the row: the spline at pixel x of s, which starts two pixels left of the image."""
    out: np.float32 = (
        F(66 / 120) * s[x + 2] + F(26 / 120) * (s[x + 1] + s[x + 3]) + F(1 / 120) * (s[x] + s[x + 4])
    )
    return out


@njit
def _slope(s: Array, x: int) -> np.float32:
    """Derivative along the row of the spline at pixel x."""
    out: np.float32 = F(10 / 24) * (s[x + 3] - s[x + 1]) + F(1 / 24) * (s[x + 4] - s[x])
    return out


@njit
def _spline_row(image: Array, y: int, rows: Array, n: int) -> None:
    """Row y of an image smoothed with the quintic B-spline, and its derivatives, into rows 2, 3 and 4."""
    s, d = rows[0][: n + 4], rows[1][: n + 4]
    a, gx, gy = rows[2][:n], rows[3], rows[4]
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
def gradient_moments(image: Array, work: WorkSpace, out: Array) -> None:
    """Sums per block of the products of a's gradients, times 1, x and y in the block: (9, ny, nx)."""
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
    """As `_spline_columns`, with the second derivative along y in e (w + 4)."""
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
    """Second derivative along the row of the spline at pixel x."""
    out: np.float32 = F(2 / 6) * (s[x + 1] + s[x + 3]) + F(1 / 6) * (s[x] + s[x + 4]) - s[x + 2]
    return out


@inlined
def _strain_row(s: Array, d: Array, e: Array, totals: tuple[Array, ...]) -> None:
    s0, s1, s2, s3, s4, s5, s6, s7 = totals  # as a tuple: slices made here would not become vector code
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
    """Sums per block of a's gradients times a and times its second derivatives: (8, ny, nx)."""
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
    """Make a function that samples BLOCK rows of LANES pixels of `image` at a fractional position.
    It uses TAPS weights along x, then along y; reads from element `start` with row length `stride`, and
    writes
    from element `to` with row length `width`.
    """

    def build(
        context: BaseContext, builder: ir.IRBuilder, signature: Signature, arguments: Sequence[ir.Value]
    ) -> ir.Value:
        # plain loops over so few pixels do not become vector code: with them a step takes 11 % longer
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
    """The taps of one block as a tuple, which stays in registers."""
    return taps[0, b], taps[1, b], taps[2, b], taps[3, b], taps[4, b], taps[5, b]


@njit
def _spread(values: Array, out: Array) -> None:
    """Copy a value per block to all pixels of a row of the block."""
    for b in range(len(values)):
        for k in range(BLOCK):
            out[b * BLOCK + k] = values[b]


@njit
def _spread_ramps(slopes: Array, out: Array) -> None:
    """In each block a line of the given slope that is 0 at the block's middle."""
    for b in range(len(slopes)):
        for k in range(BLOCK):
            out[b * BLOCK + k] = slopes[b] * (F(k) - MID)


@njit
def _warp_strip(image: Array, by: int, u: Array, v: Array, work: WorkSpace) -> None:
    """Sample image b below one row of blocks, each shifted by its own displacement, into `strip`."""
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
    n = len(s) - 4
    s0, s1 = sums[0][:n], sums[1]
    for x in range(len(s0)):
        r = _value(s, x) - b[x]
        s0[x] += _slope(s, x) * r
        s1[x] += _value(d, x) * r


@njit
def plain_sums(first: Array, second: Array, u: Array, v: Array, work: WorkSpace, out: Array) -> None:
    """Sums per block of gx r and gy r, with r = a - b(x + d) and d constant in the block: (2, ny, nx).
    The images first, second (h + 2 PAD, w + 2 PAD) include their border; u, v (ny, nx) are d, px.
    """
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


# Rows of the work space in the sums below: 0, 1 splines along y; 5 to 8 the slopes of the displacement, one
# per pixel; from 9 on what is kept of every pixel.


@njit
def _spread_slopes(slopes: Array, by: int, rows: Array) -> None:
    """Copy the displacement gradients (4, ny, nx) of one row of blocks to its pixels."""
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
    """Sums of r r, a, a a, r, a r, ga gb, ((ga + gb) / 2)^2 over the rows of a strip, for n pixels.
    a and r (BLOCK, n + 4) start one pixel left of the first sum.
    """
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
    """Sums per block of gx r, gy r (0, 1); r r, a, a a, r, a r, ga gb, ((ga + gb) / 2)^2 (5 to 11).
    r = a - b(x + d), with d linear in the block: its slopes (4, ny, nx); ga, gb are the gradients along x of
    the two images. Planes 2 to 4 of out (12, ny, nx), for sums of a's gradients, are left alone.
    """
    n = u.shape[1] * BLOCK
    rows, sums = work.rows, work.sums
    splines, spread = (rows[0][: n + 4], rows[1][: n + 4]), (rows[5], rows[6], rows[7], rows[8])
    scores = sums[0][:n], sums[1]
    totals = sums[5][:n], sums[6], sums[7], sums[8], sums[9], sums[10], sums[11]
    a, r = rows[9:14], rows[14:19]  # whole rows: loops over cut ones do not become vector code
    for by in range(len(u)):
        _warp_strip(second, by, u[by], v[by], work)
        _spread_slopes(slopes, by, rows)
        sums[:2] = F(0)
        for j in range(BLOCK):
            _spline_columns(first, by * BLOCK + j, splines[0], splines[1])
            _residual_row(splines, spread, work.strip[j], F(j) - MID, a[j, 1:], r[j, 1:], scores)
            for row in (a[j], r[j]):
                row[0], row[n + 1] = row[2], row[n - 1]  # no slope at the edge
        _strip_sums(a, r, totals)
        for k in (0, 1, 5, 6, 7, 8, 9, 10, 11):
            _fold(sums[k], out[k, by])


# Whole beads: what a pixel contributes counts in the block in which the top of its bead lies, to which the
# steepest way leads from it. Over a whole bead a gain of its light contributes no score.


@njit
def _uphill(above: Array, row: Array, below: Array, first: np.int32, width: np.int32, out: Array) -> None:
    """For a row of pixels: number of the brightest pixel among each pixel and its eight neighbours.
    The input rows start one pixel to the left; `first` is the number of the first pixel in the image.
    """
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
    """Number of the block that holds the top of each pixel's bead, (h, w).
    From each pixel the steepest ascent leads to the top. The border of the image must be lower than its
    inside.
    """
    h, w = out.shape
    for y in range(h):
        r = y + PAD
        above, row, below = image[r - 1][PAD - 1 :], image[r][PAD - 1 :], image[r + 1][PAD - 1 :]
        _uphill(above, row, below, np.int32(y * w), np.int32(w), out[y])
        for x in range(w):  # tops hold their block, below 0, all others the number of a pixel
            if out[y, x] == y * w + x:
                out[y, x] = -1 - (y // BLOCK * (w // BLOCK) + x // BLOCK)
    to = out.ravel()
    # two sweeps without branches leave few ways to go: processors mispredict loops of unknown length
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
    """Sums of gx gx, gx gy, gy gy over the pixels assigned to each block, (ny nx, 3).
    block (h, w) is the assignment from `bead_blocks`.
    """
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
    """Write the scores of each block to out (ny nx, 2): sums of gx r and gy r over its pixels.
    gx, gy are gradients of the first image, r the residual as in `final_sums`; block (h, w) assigns pixels.
    """
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
    """Sums per block of a b, with b shifted by dy rows and by `first`, `first` + 1, ... columns.
    b (h + 2 margin, w + 2 margin); row (nx BLOCK,) is scratch; out (ny, shifts, nx + 2 border) has its edge
    repeated in the border.
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
