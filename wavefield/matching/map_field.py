"""The MAP field on a lattice of blocks: optimal interpolation (kriging) of the blocks with a known spectrum.

u is the field that matching found, and s the scores of the blocks at u. With the information A of the blocks,
the noise nu of their scores, the footprint F of a block and the spectrum S of the field, the MAP field f
solves

    (F A F + 1/S) f = F (A u + s / nu).

F and S are diagonal in cosine modes, A is diagonal in blocks and zero in holes. The two components of a
displacement have separate spectra. "Waves" in names are the cosine coefficients of a field; `block_mean` is
the field averaged over the footprint, which is what the blocks measure.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from wavefield.compiled import compiled
from wavefield.matching.blocks import CLUSTER, hole_mask
from wavefield.matching.spectrum import Prior, wavenumbers

Float = NDArray[Any]
F = np.float32
Mask = NDArray[np.bool_]

MIN_SIGNAL_TO_NOISE = 2e-2  # modes below are left out: their gain would be at most as small
MAX_ITERATIONS = 200  # of the solver; about ten are usual
HOLE_KERNEL = np.ones((5, 5), np.uint8)  # blocks: smaller holes converge as fast as the rest
# tolerances of the solver (`Modes.solve`) in the first evaluation of the images and in later ones
TOLERANCES_WITH_HOLES = 0.03, 0.007  # a loose tolerance would leave holes wrong
TOLERANCES = 0.2, 0.05
Factor = tuple[Float, Float]

EXACT_MODES = 300  # modes with the highest signal-to-noise ratio, whose coupling the preconditioner inverts
# blocks over which the slope at an edge is fitted, and decay length of the field that has this slope: wide
# enough that the noise of a slope is small, and short compared with the lattice
EDGE_REACH = 6

# the compiler may reorder sums, but does so in the same way on every call
reassociating = compiled(error_model="numpy", fastmath={"contract", "reassoc"})
in_order = compiled(error_model="numpy")


# Cosine transforms by parity.
#
# Every cosine is even or odd about the middle of the lattice. A field is therefore the sum of four parts,
# even or odd along y and along x, and a quarter of the lattice determines each part. Transforming the parts
# separately halves the cost. Coefficients *by parity* are an array (2, my / 2, 2, c, mx / 2), in which the
# parity along each axis comes before the index; *quarters* are (2, hy, 2, c, hx), with hy = ceil(ny / 2).


def cosines(n: int, count: int) -> NDArray[np.float64]:
    """Return the values of the first `count` orthonormal cosines at n blocks, (count, n)."""
    phase = np.pi * np.arange(count)[:, None] * (np.arange(n) + 0.5) / n
    out: NDArray[np.float64] = np.cos(phase) * np.sqrt(2.0 / n)
    out[0] /= np.sqrt(2.0)
    return out


class Cosines:
    """Transforms between a field on a lattice (ny, nx) and the coefficients of its first cosines (my, mx).

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
        """Return the cosine coefficients (c, my, mx) of a field (c, ny, nx)."""
        return self.merge_parities(self.coefficients_of(self.quarters(field)))

    def field(self, waves: Float) -> Float:
        """Return the field (c, ny, nx) with the cosine coefficients `waves` (c, my, mx)."""
        ny, nx = self.lattice
        quarters = self.quarters_of(self.split_parities(waves))
        out = np.empty((len(waves), ny, nx), F)
        _unfold(quarters, out)
        return out

    def split_parities(self, waves: Float) -> Float:
        """Return coefficients (c, my, mx), sorted into even and odd modes, as (2, my / 2, 2, c, mx / 2).
        Axes 0 and 2 are the parities (even, odd) along y and x."""
        c, (my, mx) = len(waves), self.shape
        parts = waves.reshape(c, my // 2, 2, mx // 2, 2).transpose(2, 1, 4, 0, 3)
        return np.ascontiguousarray(parts, F)

    def merge_parities(self, by_parity: Float) -> Float:
        """Return the coefficients (c, my, mx) from the result `by_parity` of `split_parities`."""
        c = by_parity.shape[3]
        return np.ascontiguousarray(by_parity.transpose(3, 1, 0, 4, 2)).reshape(c, *self.shape)

    def quarters(self, field: Float) -> Float:
        """Split a field (c, ny, nx) into parts that are even or odd along y and x; return (2, hy, 2, c, hx).
        Axes 0 and 2 are the parities (even, odd) along y and x; a quarter lattice has hy x hx blocks."""
        hy, hx = self._half
        out = np.empty((2, hy, 2, len(field), hx), F)
        _fold(np.ascontiguousarray(field, F), out)
        return out

    def mirrored(self, field: Float) -> Float:
        """Return the quarters of a field (c, ny, nx), each mirrored onto the upper left: (2, 2, c, hy, hx).
        Axis 0 is 1 for the lower half of the lattice, axis 1 is 1 for the right half."""
        (ny, nx), (hy, hx) = self.lattice, self._half
        # the middle of an odd number of blocks is its own mirror image and is counted once
        out = np.zeros((2, 2, len(field), hy, hx), F)
        out[0, 0] = field[:, :hy, :hx]
        out[0, 1, ..., : nx - hx] = field[:, :hy, : hx - 1 : -1]
        out[1, 0, :, : ny - hy] = field[:, : hy - 1 : -1, :hx]
        out[1, 1, :, : ny - hy, : nx - hx] = field[:, : hy - 1 : -1, : hx - 1 : -1]
        return out

    def quarters_of(self, by_parity: Float) -> Float:
        """Return the parts of a field (see `quarters`) from its coefficients (see `split_parities`)."""
        _, my, _, c, mx = by_parity.shape
        hy, hx = self._half
        # transform along x first: there are fewer modes along y than blocks, so that the product is smaller
        part = np.empty((2 * my, 2, c, hx), F)
        flat = by_parity.reshape(2 * my, 2, c, mx)
        for parity in range(2):
            for n in range(c):
                np.matmul(flat[:, parity, n], self._columns[parity], out=part[:, parity, n])
        out: Float = np.matmul(self._rows_t, part.reshape(2, my, 2 * c * hx))
        return out.reshape(2, hy, 2, c, hx)

    def coefficients_of(self, quarters: Float) -> Float:
        """Return the coefficients of a field (see `split_parities`) from its parts (see `quarters`)."""
        _, hy, _, c, hx = quarters.shape
        my, mx = self.shape[0] // 2, self.shape[1] // 2
        part = np.matmul(self._rows, quarters.reshape(2, hy, 2 * c * hx)).reshape(2 * my, 2, c, hx)
        out = np.empty((2 * my, 2, c, mx), F)
        for parity in range(2):
            for n in range(c):
                np.matmul(part[:, parity, n], self._columns_t[parity], out=out[:, parity, n])
        return out.reshape(2, my, 2, c, mx)


@reassociating
def _fold(field: Float, out: Float) -> None:
    """Write the even and odd parts of a field (c, ny, nx) to `out`, ordered as in `Cosines.quarters`."""
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


@reassociating
def _unfold(quarters: Float, out: Float) -> None:
    """Write the field with the even and odd parts `quarters` (see `Cosines.quarters`) to out (c, ny, nx)."""
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


@reassociating
def multiply(a: Float, quarters: Float) -> None:
    """Multiply a field by the information A (inverse variance) of every block, in place.
    `quarters` are the even and odd parts of the field (`Cosines.quarters`). `a` is A from `Cosines.mirrored`,
    with one component, or with three (xx, xy, yy) for fields of two components."""
    _, hy, _, c, _ = quarters.shape
    for j in range(hy):
        top, bottom = quarters[0, j], quarters[1, j]
        if c == 1:
            _multiply_one(a[0, 0, 0, j], a[0, 1, 0, j], a[1, 0, 0, j], a[1, 1, 0, j], top, bottom)
        else:
            _multiply_two(a[0, 0, :, j], a[0, 1, :, j], a[1, 0, :, j], a[1, 1, :, j], top, bottom)


@reassociating
def _four_places(ee: F, eo: F, oe: F, oo: F) -> tuple[F, F, F, F]:
    """Return a field at (y, x), (y, -x), (-y, x), (-y, -x), from its four parts at (y, x).
    Letters of a part are its parities along y and x: `eo` is even along y. x, y start from the middle."""
    p, q, r, s = ee + oe, eo + oo, ee - oe, eo - oo
    return p + q, p - q, r + s, r - s


@reassociating
def _multiply_one(a0: Float, a1: Float, a2: Float, a3: Float, top: Float, bottom: Float) -> None:
    """Multiply a row of a one-component field by the information A (inverse variance of blocks), in place.
    a0 to a3 are A at the four places of `_four_places`. `top` holds the parts of the field that are even
    along y, `bottom` the odd parts."""
    ee, eo, oe, oo = top[0, 0], top[1, 0], bottom[0, 0], bottom[1, 0]
    for i in range(len(a0)):
        f0, f1, f2, f3 = _four_places(ee[i], eo[i], oe[i], oo[i])
        f0, f1, f2, f3 = a0[i] * f0, a1[i] * f1, a2[i] * f2, a3[i] * f3
        ee[i], eo[i] = (f0 + f2) + (f1 + f3), (f0 + f2) - (f1 + f3)
        oe[i], oo[i] = (f0 - f2) + (f1 - f3), (f0 - f2) - (f1 - f3)


@reassociating
def _multiply_two(a0: Float, a1: Float, a2: Float, a3: Float, top: Float, bottom: Float) -> None:
    """Multiply a row of a two-component field by A, as in `_multiply_one`; a0 to a3 (3, n) are xx, xy, yy."""
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


class Modes(Cosines):
    """Solver for a MAP field (the most probable field) on a lattice (ny, nx), in cosine modes.

    Modes beyond the last one with a signal-to-noise ratio above 0.02 are left out. `requested` (ny, nx) is
    True where the solution is needed (None: everywhere): holes there demand a smaller tolerance. `foot` (my,
    mx) is the gain F of averaging over a block, `inverse` (c, my, mx) is 1/S, and `freedom` the fraction of
    the variance of scores (gradient times residual) that a fit leaves.
    """

    def __init__(self, prior: Prior, shape: tuple[int, int], requested: Mask | None = None) -> None:
        self.prior = prior
        self._requested = np.ones(shape, np.bool_) if requested is None else requested.copy()
        inside = np.zeros(shape, np.bool_)  # blocks near the edge never count as a hole
        inside[EDGE_REACH:-EDGE_REACH, EDGE_REACH:-EDGE_REACH] = True
        self._requested &= inside
        kx, ky = wavenumbers(shape)
        foot, spectrum, ratio = prior.footprint(kx, ky), prior.spectrum(kx, ky), prior.signal_to_noise(kx, ky)
        rows, columns = np.nonzero((ratio > MIN_SIGNAL_TO_NOISE).any(axis=0))
        # a multiple of eight modes (vector registers), and as many even as odd ones
        my, mx = (
            min(n // 2 * 2, (int(i.max(initial=3)) + 8) // 8 * 8)
            for n, i in zip(shape, (rows, columns), strict=True)
        )
        band = np.s_[..., :my, :mx]
        self.foot = np.ascontiguousarray(foot[band], np.float32)
        self.inverse = np.ascontiguousarray(1.0 / spectrum[band], np.float32)
        super().__init__(shape, (my, mx))
        self._by_parity = [self.split_parities(f) for f in (self.foot[None], self.inverse)]
        self.freedom = float(np.mean([_freedom(one / (one + 1.0)) for one in ratio]))
        # signal-to-noise ratio of single blocks, and therefore of the edge slopes that are fitted to them
        of_blocks = prior.information * spectrum.mean(axis=(1, 2))
        self._kept = np.minimum(of_blocks, 1.0).astype(np.float32)[:, None, None]
        self._preconditioner = Preconditioner(
            shape, ratio[band].mean(axis=0), 1.0 / spectrum[band].mean(axis=0), self.foot
        )

    def block_mean(self, waves: Float) -> Float:
        """Return a field with coefficients (c, my, mx), averaged over the area of each block, (c, ny, nx)."""
        return self.field(self.foot * waves)

    def split(self, field: Float) -> tuple[Float, Float]:
        """Split a field (c, ny, nx) into a smooth part (c, ny, nx) and cosine coefficients of the remainder.
        The smooth part has the slopes of the field at the edges (`edge_field`), reduced if they are noisy."""
        edges = self._kept * edge_field(field)
        return edges, self.waves(field - edges)

    def factor(self, information: Float) -> Factor:
        """Return the factorised preconditioner for `solve`, from the inverse variance of blocks, (ny, nx)."""
        return self._preconditioner.factor(information)

    def tolerances(self, information: Float) -> tuple[float, float]:
        """Return two tolerances for `solve`: at the first evaluation of the images, and at later ones.
        They are smaller if the inverse variance of blocks (ny, nx) has large holes, which converge last."""
        hole = hole_mask(information, self.prior.information) & self._requested
        return TOLERANCES_WITH_HOLES if cv2.erode(hole.view(np.uint8), HOLE_KERNEL).any() else TOLERANCES

    def solve(
        self,
        information: Float,
        right: Float,
        start: Float,
        tolerance: float,
        factor: Factor,
        block_mean: Float | None = None,
    ) -> Float:
        """Return the solution f (c, my, mx) of (F A F + 1/S) f = F b by conjugate gradients from `start`.

        `information` is A, (1, ny, nx), or (3, ny, nx) with xx, xy, yy for two components. `right` (c, ny,
        nx) is b = A u + s / nu, with the matched field u minus its smooth part, the scores s and their noise
        nu. `factor` comes from `Modes.factor`; `block_mean` is the block mean of `start` (None: computed).
        The iteration stops when the rms residual is below `tolerance` standard uncertainties.
        """
        a, c = information, len(right)
        block_mean = self.block_mean(start) if block_mean is None else block_mean
        residual = self.foot * self.waves(right - _apply_information(a, block_mean)) - self.inverse * start
        waves, residual = self.split_parities(start), self.split_parities(residual)
        foot, inverse = (np.repeat(f, c // f.shape[3], axis=3) for f in self._by_parity)
        typical = np.array([a[0].mean(), a[-1].mean()], np.float32)[:c, None]
        diagonal = 1 / (foot**2 * typical + inverse)
        a = self.mirrored(a)
        step = np.empty_like(residual)
        size = self._preconditioner.apply(residual, diagonal, factor, step)
        direction, image = step.copy(), np.empty_like(residual)
        for _ in range(MAX_ITERATIONS):
            if size <= tolerance * tolerance * waves.size:
                break
            np.multiply(foot, direction, out=image)
            quarters = self.quarters_of(image)
            multiply(a, quarters)
            image = self.coefficients_of(quarters)
            flat = direction.ravel(), image.ravel()
            length = F(size / _apply_prior(foot.ravel(), inverse.ravel(), *flat))
            _advance(length, *flat, waves.ravel(), residual.ravel())
            size, before = self._preconditioner.apply(residual, diagonal, factor, step), size
            _update_direction(F(size / before), step.ravel(), direction.ravel())
        return self.merge_parities(waves)


def _apply_information(a: Float, field: Float) -> Float:
    """Return A f for a field f (c, ny, nx), with the inverse variance A of each block.
    A is (1, ny, nx) for one component, and (3, ny, nx) with xx, xy, yy for two."""
    if len(field) == 1:
        return a * field
    u, v = field
    return np.stack([a[0] * u + a[1] * v, a[1] * u + a[2] * v])


@reassociating
def _apply_prior(foot: Float, inverse: Float, direction: Float, image: Float) -> F:
    """Replace A F p in `image` by q = (F A F + 1/S) p, in place; return the inner product of q and p.
    p is `direction`, `foot` is F and `inverse` 1/S; all arrays are flat."""
    total = F(0)
    for i in range(len(image)):
        value = foot[i] * image[i] + inverse[i] * direction[i]
        image[i] = value
        total += value * direction[i]
    return total


@reassociating
def _advance(length: F, direction: Float, image: Float, waves: Float, residual: Float) -> None:
    """Add `length` * `direction` to `waves` and subtract `length` * `image` from `residual`, in place."""
    for i in range(len(waves)):
        waves[i] += length * direction[i]
        residual[i] -= length * image[i]


@reassociating
def _update_direction(ratio: F, step: Float, direction: Float) -> None:
    """Replace `direction`, in place, by the next conjugate direction: `ratio` times itself, plus `step`."""
    for i in range(len(step)):
        direction[i] = ratio * direction[i] + step[i]


def _freedom(gain: Float) -> float:
    """Return the fraction of the variance of scores that remains after a fit of the field, at least 0.2.
    Scores (gradient times residual) are summed over 5 x 5 blocks; `gain` (ny, nx) is that of the fit per
    mode."""
    rows, columns = (_box(n) for n in gain.shape)
    power = np.square(rows[:, None] * columns)
    return float(max((power * (1.0 - gain)).sum() / power.sum(), 0.2))


def _box(n: int) -> NDArray[np.float64]:
    """Return the factors (n,) by which a sum over 5 blocks along an axis multiplies n cosine modes."""
    m = np.arange(1, CLUSTER // 2 + 1)[:, None]
    return np.asarray(1.0 + 2.0 * np.cos(m * np.pi * np.arange(n) / n).sum(axis=0))


# A cosine series has no slope at the edges of the lattice, so long waves that cross an edge would ring far
# into the field. A smooth field with the same edge slopes is therefore subtracted before the transform. A
# quadratic fitted to the whole lattice instead makes errors on texture half as large again.


def edge_field(field: Float) -> Float:
    """Return a smooth field (c, ny, nx) whose slopes at the four edges are those of `field` (c, ny, nx).
    It decays exponentially inwards. `field` must have no holes."""
    field = np.asarray(field, np.float32)
    out = _with_slopes_along_x(field)
    rest = np.ascontiguousarray(np.swapaxes(field - out, 1, 2))
    out += np.swapaxes(_with_slopes_along_x(rest), 1, 2)
    return out


def _with_slopes_along_x(field: Float) -> Float:
    """Return a field (c, ny, nx) with the slopes d/dx of `field` at the first and the last column.
    The slopes are smoothed along y."""
    fit, profile, smoother = _tables(*field.shape[1:])
    first, last = field[..., :EDGE_REACH] @ fit @ smoother, field[..., -EDGE_REACH:] @ fit @ smoother
    return np.asarray(last[..., None] * profile - first[..., None] * profile[::-1])


@lru_cache(maxsize=16)
def _tables(ny: int, nx: int) -> tuple[Float, Float, Float]:
    """Return tables for edge slopes: fit weights (6,), exponential (nx,) of slope 1, smoother (ny, ny)."""
    t = np.arange(EDGE_REACH, dtype=np.float32) - np.float32((EDGE_REACH - 1) / 2)
    profile = EDGE_REACH * np.exp((np.arange(nx) + 0.5 - nx) / EDGE_REACH)
    modes = cosines(ny, ny)
    # along the edge the slopes are smoothed by a Gaussian of half the reach
    gain = np.exp(-0.5 * np.square(0.5 * EDGE_REACH * np.pi * np.arange(ny) / ny))
    return t / (t * t).sum(), profile.astype(np.float32), ((modes.T * gain) @ modes).astype(np.float32)


class Preconditioner:
    """Preconditioner of `Modes.solve`: exact for the 300 strongest modes, diagonal for all others.
    `lattice` is (ny, nx). `ratio` (my, mx) is the signal-to-noise ratio, `inverse` (my, mx) is 1/S, and
    `foot` (my, mx) the gain of averaging over a block."""

    def __init__(self, lattice: tuple[int, int], ratio: Float, inverse: Float, foot: Float) -> None:
        count = min(EXACT_MODES, ratio.size)
        order = np.sort(np.argsort(-ratio.ravel(), kind="stable")[:count])
        self._iy, self._ix = (i.astype(np.int64) for i in np.divmod(order, ratio.shape[1]))
        sums = []
        for n, i in zip(lattice, (self._iy, self._ix), strict=True):
            m = np.arange(2 * int(i.max()) + 1)[:, None]
            sums.append(np.cos(np.pi * m * (np.arange(n) + 0.5) / n).astype(np.float32))
        self._sum_rows, self._sum_columns = sums[0], np.ascontiguousarray(sums[1].T)
        norm = 0.5 * foot.ravel()[order].astype(np.float64)
        for n, i in zip(lattice, (self._iy, self._ix), strict=True):
            norm *= np.where(i == 0, np.sqrt(1.0 / n), np.sqrt(2.0 / n))
        self._norm = norm.astype(np.float32)
        self._own_inverse = inverse.ravel()[order].astype(np.float32)
        self._square = np.square(foot.ravel()[order])
        half = ratio.shape[1] // 2  # below: positions of the strongest modes in coefficients by parity
        line = (self._iy % 2 * (ratio.shape[0] // 2) + self._iy // 2) * 2 + self._ix % 2
        self._positions = {c: (line * c + np.arange(c)[:, None]) * half + self._ix // 2 for c in (1, 2)}

    def factor(self, information: Float) -> Factor:
        """Return Cholesky factor (n, n) and scaling (n,) of the n strongest modes; A is `information`."""
        table = self._sum_rows @ information @ self._sum_columns
        scale = 1.0 / np.sqrt(self._own_inverse + self._square * F(information.mean()))
        count = self._norm.size
        matrix = np.zeros((count, count), np.float32)
        _assemble(table, self._iy, self._ix, self._norm * scale, self._own_inverse * scale * scale, matrix)
        lower, failed = scipy.linalg.lapack.spotrf(matrix.T, lower=0, clean=0, overwrite_a=1)
        if failed:  # rounding made it indefinite: keep the scaling alone, as the diagonal is about 1
            lower = np.eye(count, dtype=np.float32, order="F")
        return lower, scale.astype(np.float32)

    def apply(self, residual: Float, diagonal: Float, factor: Factor, out: Float) -> float:
        """Write the preconditioned residual to `out`; return the inner product of `out` and `residual`.
        Arrays are ordered as by `Cosines.split_parities`. The weaker modes are multiplied by `diagonal`, the
        strongest are solved exactly with `factor`, from the method of that name."""
        lower, scale = factor
        positions = self._positions[residual.shape[3]]
        gathered = np.empty(positions.shape, F)
        _gather(residual.ravel(), positions, scale, gathered)
        exact, _ = scipy.linalg.lapack.spotrs(lower, gathered.T, lower=0, overwrite_b=1)
        return float(
            _preconditioned(diagonal.ravel(), residual.ravel(), exact.T, positions, scale, out.ravel())
        )


@reassociating
def _gather(residual: Float, positions: Float, scale: Float, out: Float) -> None:
    """Write `residual` times `scale` (modes,), for the strongest modes only, to out (c, modes).
    `positions` (c, modes) are the positions of these modes in the flat `residual`."""
    for n in range(len(positions)):
        for k in range(len(scale)):
            out[n, k] = residual[positions[n, k]] * scale[k]


@reassociating
def _preconditioned(
    diagonal: Float, residual: Float, exact: Float, positions: Float, scale: Float, out: Float
) -> F:
    """Write diagonal * residual to `out`, but exact * scale at `positions`; return the sum of out * residual.
    `exact` and `positions` are (c, modes), `scale` is (modes,); the other arrays are flat."""
    for i in range(len(out)):
        out[i] = diagonal[i] * residual[i]
    for n in range(len(positions)):
        for k in range(len(scale)):
            out[positions[n, k]] = exact[n, k] * scale[k]
    total = F(0)
    for i in range(len(out)):
        total += residual[i] * out[i]
    return total


@in_order
def _assemble(table: Float, iy: Float, ix: Float, norm: Float, own: Float, out: Float) -> None:
    """Write the lower triangle of the scaled matrix F A F + 1/S of the strongest modes (iy, ix) to `out`.
    `table` holds sums over blocks of A times cosines, which suffice because a product of cosines is a sum of
    cosines. `norm` is F times the scaling of each mode, `own` is 1/S times the scaling squared."""
    for p in range(iy.size):
        for q in range(p + 1):
            y0, y1 = abs(iy[p] - iy[q]), iy[p] + iy[q]
            x0, x1 = abs(ix[p] - ix[q]), ix[p] + ix[q]
            total = table[y0, x0] + table[y0, x1] + table[y1, x0] + table[y1, x1]
            out[p, q] = norm[p] * norm[q] * total
        out[p, p] += own[p]
