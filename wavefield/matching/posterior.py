"""The most probable field on a lattice of blocks: what every block says, weighed against its spectrum.

With the score s and the matched Hessian H of the blocks at the field u that matching reached, nu the noise
that scores really have, A = H / nu, F the footprint of a block and S the field's spectrum, the field f solves

    (F A F + 1/S) f = F (A u + s / nu).

F and S are diagonal in cosines, A is diagonal in blocks; a hole has A = 0. Each of two components has an S of
its own.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from wavefield.compiled import compiled
from wavefield.matching.cosines import Cosines, multiply
from wavefield.matching.edges import EDGE_REACH, Edge, Slopes
from wavefield.matching.matching_gain import footprint
from wavefield.matching.noise import CLUSTER, hole_mask
from wavefield.matching.prior import Prior, wavenumbers

Float = NDArray[Any]
Mask = NDArray[np.bool_]
Factor = tuple[Float, Float]

F = np.float32
MIN_SIGNAL_TO_NOISE = (
    2e-2  # signal over noise below which a mode is left out: it would keep no more of itself
)
EXACT_MODES = 300  # modes of the highest signal over noise that the preconditioner solves exactly
MAX_ITERATIONS = 200  # at most; some ten are usual
HOLE_KERNEL = np.ones(
    (5, 5), np.uint8
)  # blocks, bare all of them: smaller holes are as soon solved as the rest
TOLERANCES_WITH_HOLES = 0.03, 0.007  # tolerances of the solver at the first and the second look
TOLERANCES = 0.1, 0.025  # the same without holes: only what lies far from any block converges late

njit = compiled(error_model="numpy")
# sums may be taken in any order, and are always taken in the same
reassociating = compiled(error_model="numpy", fastmath={"contract", "reassoc"})


class Modes:
    """The cosine modes in which a field is sought: those with more than a fiftieth of signal over noise.

    Parameters
    ----------
    prior : Prior
        Spectrum and typical information.
    shape : tuple of int
        Lattice (ny, nx).
    requested : ndarray of bool, (ny, nx), optional
        Blocks whose field is requested; all if left out.

    Attributes
    ----------
    kx, ky : ndarray, (mx,) and (my, 1)
        Wavenumbers along columns and rows, rad per block.
    foot : ndarray, (my, mx)
        Footprint of every mode.
    inverse : ndarray, (1 or c, my, mx)
        Inverse spectrum of every mode, of all components alike or of each.
    edge : Edge
        Smooth fields with slopes at the edges of the lattice.
    """

    def __init__(self, prior: Prior, shape: tuple[int, int], requested: Mask | None = None) -> None:
        self.prior, self.lattice = prior, shape
        self._requested = np.ones(shape, np.bool_) if requested is None else requested.copy()
        edge = int(EDGE_REACH)  # so near to it little is known anyway: that is no hole
        inside = np.zeros(shape, np.bool_)
        inside[edge:-edge, edge:-edge] = True
        self._requested &= inside
        kx, ky = wavenumbers(shape)
        foot, spectrum = footprint(kx, ky), prior.spectrum(kx, ky)
        ratio = foot**2 * prior.information * spectrum
        rows, columns = np.nonzero((ratio > MIN_SIGNAL_TO_NOISE).any(axis=0))
        # whole vectors, and as many even as odd ones
        my, mx = (
            min(n // 2 * 2, (int(i.max(initial=3)) + 8) // 8 * 8)
            for n, i in zip(shape, (rows, columns), strict=True)
        )
        band = np.s_[..., :my, :mx]
        self.shape = my, mx
        self.kx, self.ky = kx[:mx], ky[:my]
        self.foot = np.ascontiguousarray(foot[band], np.float32)
        self.inverse = np.ascontiguousarray(1.0 / spectrum[band], np.float32)
        self._cosines = Cosines(shape, self.shape)
        self._foot, self._inverse = (self._cosines.split_parities(f) for f in (self.foot[None], self.inverse))
        self.freedom = float(np.mean([_freedom(one / (one + 1.0)) for one in ratio]))
        self.edge = Edge(shape)
        none = np.zeros(1)
        self._truncated = self.edge.truncated_profiles(
            self.shape, (footprint(none, ky[:, 0]), footprint(kx, none))
        )
        self._prepare_preconditioner(ratio[band].mean(axis=0), 1.0 / spectrum[band].mean(axis=0))

    def _prepare_preconditioner(self, ratio: Float, inverse: Float) -> None:
        """What the exact block of the preconditioner needs: one for all components."""
        count = min(EXACT_MODES, ratio.size)
        order = np.sort(np.argsort(-ratio.ravel(), kind="stable")[:count])
        self._index = order
        self._iy, self._ix = (i.astype(np.int64) for i in np.divmod(order, ratio.shape[1]))
        sums = []
        for n, i in zip(self.lattice, (self._iy, self._ix), strict=True):
            m = np.arange(2 * int(i.max()) + 1)[:, None]
            sums.append(np.cos(np.pi * m * (np.arange(n) + 0.5) / n).astype(np.float32))
        self._sum_rows, self._sum_columns = sums[0], np.ascontiguousarray(sums[1].T)
        norm = 0.5 * self.foot.ravel()[order].astype(np.float64)
        for n, i in zip(self.lattice, (self._iy, self._ix), strict=True):
            norm *= np.where(i == 0, np.sqrt(1.0 / n), np.sqrt(2.0 / n))
        self._norm = norm.astype(np.float32)
        self._own_inverse = inverse.ravel()[order].astype(np.float32)
        self._square = np.square(self.foot.ravel()[order])
        half = self.shape[1] // 2  # where they stand among coefficients by kind
        line = (self._iy % 2 * (self.shape[0] // 2) + self._iy // 2) * 2 + self._ix % 2
        self._positions = {c: (line * c + np.arange(c)[:, None]) * half + self._ix // 2 for c in (1, 2)}

    def waves(self, field: Float) -> Float:
        """Coefficients (c, my, mx) of a field (c, ny, nx)."""
        return self._cosines.waves(field)

    def field(self, waves: Float) -> Float:
        """Field (c, ny, nx) of coefficients (c, my, mx)."""
        return self._cosines.field(waves)

    def seen(self, waves: Float) -> Float:
        """Field as blocks see it, (c, ny, nx): with their footprint over it."""
        return self.field(self.foot * waves)

    def mean(self, field: Float) -> tuple[Float, Float, Slopes]:
        """A smooth field that has the edge slopes of a given one: cosines have none there.

        Parameters
        ----------
        field : ndarray, (c, ny, nx)
            First estimate of the field, without holes.

        Returns
        -------
        waves : ndarray of float32, (c, my, mx)
            Its coefficients.
        beyond : ndarray of float32, (c, ny, nx)
            What these modes leave of it, as blocks see it: without it the field would ring far into the
            lattice.
        slopes : Slopes
            The slopes, for `edge`.
        """
        slopes = self.edge.slopes(np.asarray(field, np.float32))
        return self.waves(self.edge.field(slopes)), self.edge.field(slopes, self._truncated), slopes

    def factor(self, information: Float) -> Factor:
        """Preconditioner for some information: the strongest modes as they really couple.

        Parameters
        ----------
        information : ndarray of float32, (ny, nx)
            A, or the mean of its two diagonal parts.

        Returns
        -------
        tuple
            For `solve`.
        """
        table = self._sum_rows @ information @ self._sum_columns
        scale = 1.0 / np.sqrt(self._own_inverse + self._square * F(information.mean()))
        count = self._index.size
        matrix = np.zeros((count, count), np.float32)
        _assemble(table, self._iy, self._ix, self._norm * scale, self._own_inverse * scale * scale, matrix)
        lower, failed = scipy.linalg.lapack.spotrf(matrix.T, lower=0, clean=0, overwrite_a=1)
        if failed:  # by rounding: scaled as it is, its diagonal is about 1
            lower = np.eye(count, dtype=np.float32, order="F")
        return lower, scale.astype(np.float32)

    def tolerances(self, information: Float) -> tuple[float, float]:
        """How exactly to solve at the first and at the second look.

        Parameters
        ----------
        information : ndarray of float32, (ny, nx)
            A, or the mean of its two diagonal parts.

        Returns
        -------
        float, float
            For `solve`: closer where there are holes, in which the field follows last.
        """
        hole = hole_mask(information, self.prior.information) & self._requested
        return TOLERANCES_WITH_HOLES if cv2.erode(hole.view(np.uint8), HOLE_KERNEL).any() else TOLERANCES

    def solve(
        self,
        information: Float,
        right: Float,
        start: Float,
        tolerance: float,
        mean: Float,
        factor: Factor,
        seen: Float | None = None,
    ) -> Float:
        """Solve (F A F + 1/S) f = F b + m/S by preconditioned conjugate gradients.

        Parameters
        ----------
        information : ndarray of float32, (1 or 3, ny, nx)
            A of one field, or A_xx, A_xy, A_yy of two.
        right : ndarray of float32, (c, ny, nx)
            b = A u + s / nu, with c = 1 or 2 fields.
        start : ndarray of float32, (c, my, mx)
            First guess.
        tolerance : float
            Of the residual in its own uncertainty, rms over the modes.
        mean : ndarray of float32, (c, my, mx)
            m, as given by `mean`.
        factor : tuple
            As given by `factor`.
        seen : ndarray of float32, (c, ny, nx), optional
            `seen` of the first guess, where it is at hand.

        Returns
        -------
        ndarray of float32, (c, my, mx)
            Coefficients of f.
        """
        a, c = information, len(right)
        seen = self.seen(start) if seen is None else seen
        residual = self.foot * self.waves(right - _apply_information(a, seen)) + self.inverse * (mean - start)
        waves, residual = self._cosines.split_parities(start), self._cosines.split_parities(residual)
        foot, inverse = (np.repeat(f, c // f.shape[3], axis=3) for f in (self._foot, self._inverse))
        typical = np.array([a[0].mean(), a[-1].mean()], np.float32)[:c, None]
        diagonal = 1 / (foot**2 * typical + inverse)
        a = self._cosines.mirrored(a)
        step = np.empty_like(residual)
        size = self._precondition(residual, diagonal, factor, step)
        direction, image = step.copy(), np.empty_like(residual)
        for _ in range(MAX_ITERATIONS):
            if size <= tolerance * tolerance * waves.size:
                break
            np.multiply(foot, direction, out=image)
            quarters = self._cosines.quarters_of(image)
            multiply(a, quarters)
            image = self._cosines.coefficients_of(quarters)
            flat = direction.ravel(), image.ravel()
            length = F(size / _apply_prior(foot.ravel(), inverse.ravel(), *flat))
            _advance(length, *flat, waves.ravel(), residual.ravel())
            size, before = self._precondition(residual, diagonal, factor, step), size
            _update_direction(F(size / before), step.ravel(), direction.ravel())
        return self._cosines.merge_parities(waves)

    def _precondition(self, residual: Float, diagonal: Float, factor: Factor, out: Float) -> float:
        """Write the next step; return its product with what is left."""
        lower, scale = factor
        positions = self._positions[residual.shape[3]]
        gathered = np.empty(positions.shape, F)
        _gather(residual.ravel(), positions, scale, gathered)
        exact, _ = scipy.linalg.lapack.spotrs(lower, gathered.T, lower=0, overwrite_b=1)
        return float(
            _preconditioned(diagonal.ravel(), residual.ravel(), exact.T, positions, scale, out.ravel())
        )


def _apply_information(a: Float, field: Float) -> Float:
    """A times a field, (c, ny, nx)."""
    if len(field) == 1:
        return a * field
    u, v = field
    return np.stack([a[0] * u + a[1] * v, a[1] * u + a[2] * v])


@reassociating
def _gather(residual: Float, positions: Float, scale: Float, out: Float) -> None:
    for n in range(len(positions)):
        for k in range(len(scale)):
            out[n, k] = residual[positions[n, k]] * scale[k]


@reassociating
def _preconditioned(
    diagonal: Float, residual: Float, exact: Float, positions: Float, scale: Float, out: Float
) -> F:
    """Write what diagonal and exact part of the preconditioner make of ``residual``; return their product."""
    for i in range(len(out)):
        out[i] = diagonal[i] * residual[i]
    for n in range(len(positions)):
        for k in range(len(scale)):
            out[positions[n, k]] = exact[n, k] * scale[k]
    total = F(0)
    for i in range(len(out)):
        total += residual[i] * out[i]
    return total


@reassociating
def _apply_prior(foot: Float, inverse: Float, direction: Float, image: Float) -> F:
    """Make F A F direction, and 1/S of it, of A F direction; return its product with the direction."""
    total = F(0)
    for i in range(len(image)):
        value = foot[i] * image[i] + inverse[i] * direction[i]
        image[i] = value
        total += value * direction[i]
    return total


@reassociating
def _advance(length: F, direction: Float, image: Float, waves: Float, residual: Float) -> None:
    for i in range(len(waves)):
        waves[i] += length * direction[i]
        residual[i] -= length * image[i]


@reassociating
def _update_direction(ratio: F, step: Float, direction: Float) -> None:
    for i in range(len(step)):
        direction[i] = ratio * direction[i] + step[i]


@njit
def _assemble(table: Float, iy: Float, ix: Float, norm: Float, own: Float, out: Float) -> None:
    """Lower triangle of F A F + 1/S among some modes, scaled: products of cosines are sums of cosines."""
    for p in range(iy.size):
        for q in range(p + 1):
            y0, y1 = abs(iy[p] - iy[q]), iy[p] + iy[q]
            x0, x1 = abs(ix[p] - ix[q]), ix[p] + ix[q]
            total = table[y0, x0] + table[y0, x1] + table[y1, x0] + table[y1, x1]
            out[p, q] = norm[p] * norm[q] * total
        out[p, p] += own[p]


def _freedom(gain: Float) -> float:
    """Fraction of the variance of clusters of scores that a fit with this response leaves in them."""
    rows, columns = (_box(n) for n in gain.shape)
    power = np.square(rows[:, None] * columns)
    return float(max((power * (1.0 - gain)).sum() / power.sum(), 0.2))


def _box(n: int) -> NDArray[np.float64]:
    m = np.arange(1, CLUSTER // 2 + 1)[:, None]
    out: NDArray[np.float64] = 1.0 + 2.0 * np.cos(m * np.pi * np.arange(n) / n).sum(axis=0)
    return out
