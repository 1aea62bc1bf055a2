"""The MAP field (optimal interpolation) on a lattice of blocks: all blocks weighted against the spectrum.

With the score s and the matched Hessian H of the blocks at the field u that matching reached, nu the noise
of the scores, A = H / nu, F the footprint of a block and S the field's spectrum, the field f solves

    (F A F + 1/S) f = F (A u + s / nu).

F and S are diagonal in cosines, A is diagonal in blocks; a hole has A = 0. Each of two components has an S of
its own.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.compiled import compiled
from wavefield.matching.cosines import Cosines, multiply
from wavefield.matching.edges import EDGE_REACH, edge_field
from wavefield.matching.noise import CLUSTER, hole_mask
from wavefield.matching.preconditioner import Factor, Preconditioner
from wavefield.matching.prior import Prior, wavenumbers

Float = NDArray[Any]
Mask = NDArray[np.bool_]

F = np.float32
MIN_SIGNAL_TO_NOISE = 2e-2  # of a mode, and so the gain below which it is left out
MAX_ITERATIONS = 200  # at most; some ten are usual
HOLE_KERNEL = np.ones((5, 5), np.uint8)  # blocks: smaller holes converge as fast as the rest
TOLERANCES_WITH_HOLES = 0.03, 0.007  # of the solver, in the first and the second evaluation
TOLERANCES = 0.2, 0.03  # the same without holes

# sums may be reordered by the compiler, but in the same way on every call
reassociating = compiled(error_model="numpy", fastmath={"contract", "reassoc"})


class Modes:
    """The cosine modes of a MAP field: those with more than a fiftieth of signal over noise.

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
    """

    def __init__(self, prior: Prior, shape: tuple[int, int], requested: Mask | None = None) -> None:
        self.prior = prior
        self._requested = np.ones(shape, np.bool_) if requested is None else requested.copy()
        inside = np.zeros(shape, np.bool_)  # the surroundings of the edge are not a hole
        inside[EDGE_REACH:-EDGE_REACH, EDGE_REACH:-EDGE_REACH] = True
        self._requested &= inside
        kx, ky = wavenumbers(shape)
        foot, spectrum, ratio = prior.footprint(kx, ky), prior.spectrum(kx, ky), prior.signal_to_noise(kx, ky)
        rows, columns = np.nonzero((ratio > MIN_SIGNAL_TO_NOISE).any(axis=0))
        # whole vectors, and as many even as odd ones
        my, mx = (
            min(n // 2 * 2, (int(i.max(initial=3)) + 8) // 8 * 8)
            for n, i in zip(shape, (rows, columns), strict=True)
        )
        band = np.s_[..., :my, :mx]
        self.kx, self.ky = kx[:mx], ky[:my]
        self.foot = np.ascontiguousarray(foot[band], np.float32)
        self.inverse = np.ascontiguousarray(1.0 / spectrum[band], np.float32)
        self._cosines = Cosines(shape, (my, mx))
        self._by_parity = [self._cosines.split_parities(f) for f in (self.foot[None], self.inverse)]
        self.freedom = float(np.mean([_freedom(one / (one + 1.0)) for one in ratio]))
        # signal over noise of single blocks, which also is that of slopes fitted to them
        of_blocks = prior.information * spectrum.mean(axis=(1, 2))
        self._kept = np.minimum(of_blocks, 1.0).astype(np.float32)[:, None, None]
        self._preconditioner = Preconditioner(
            shape, ratio[band].mean(axis=0), 1.0 / spectrum[band].mean(axis=0), self.foot
        )

    @property
    def lattice(self) -> tuple[int, int]:
        """Rows and columns of blocks."""
        return self._cosines.lattice

    @property
    def shape(self) -> tuple[int, int]:
        """Number of modes along y and x."""
        return self._cosines.shape

    def waves(self, field: Float) -> Float:
        """Coefficients (c, my, mx) of a field (c, ny, nx)."""
        return self._cosines.waves(field)

    def field(self, waves: Float) -> Float:
        """Field (c, ny, nx) of coefficients (c, my, mx)."""
        return self._cosines.field(waves)

    def seen(self, waves: Float) -> Float:
        """Field averaged over the footprint of the blocks, (c, ny, nx)."""
        return self.field(self.foot * waves)

    def split(self, field: Float) -> tuple[Float, Float]:
        """Split a field without holes into a smooth one with its edge slopes and cosines of the rest.

        Parameters
        ----------
        field : ndarray, (c, ny, nx)
            First estimate of the field.

        Returns
        -------
        edges : ndarray of float32, (c, ny, nx)
            The smooth field. Of slopes that noise exceeds only the fraction of waves is kept.
        waves : ndarray of float32, (c, my, mx)
            Coefficients of the rest.
        """
        edges = self._kept * edge_field(field)
        return edges, self.waves(field - edges)

    def factor(self, information: Float) -> Factor:
        """Preconditioner for some information.

        Parameters
        ----------
        information : ndarray of float32, (ny, nx)
            A, or the mean of its two diagonal parts.

        Returns
        -------
        tuple
            For `solve`.
        """
        return self._preconditioner.factor(information)

    def tolerances(self, information: Float) -> tuple[float, float]:
        """Tolerances of the first and the second evaluation.

        Parameters
        ----------
        information : ndarray of float32, (ny, nx)
            A, or the mean of its two diagonal parts.

        Returns
        -------
        float, float
            For `solve`: closer where there are holes, in which the field converges last.
        """
        hole = hole_mask(information, self.prior.information) & self._requested
        return TOLERANCES_WITH_HOLES if cv2.erode(hole.view(np.uint8), HOLE_KERNEL).any() else TOLERANCES

    def solve(
        self,
        information: Float,
        right: Float,
        start: Float,
        tolerance: float,
        factor: Factor,
        seen: Float | None = None,
    ) -> Float:
        """Solve (F A F + 1/S) f = F b by preconditioned conjugate gradients.

        Parameters
        ----------
        information : ndarray of float32, (1 or 3, ny, nx)
            A of one field, or A_xx, A_xy, A_yy of two.
        right : ndarray of float32, (c, ny, nx)
            b = A u + s / nu, with c = 1 or 2 fields, u less its smooth part of `split`.
        start : ndarray of float32, (c, my, mx)
            First guess.
        tolerance : float
            Of the residual in its own uncertainty, rms over the modes.
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
        residual = self.foot * self.waves(right - _apply_information(a, seen)) - self.inverse * start
        waves, residual = self._cosines.split_parities(start), self._cosines.split_parities(residual)
        foot, inverse = (np.repeat(f, c // f.shape[3], axis=3) for f in self._by_parity)
        typical = np.array([a[0].mean(), a[-1].mean()], np.float32)[:c, None]
        diagonal = 1 / (foot**2 * typical + inverse)
        a = self._cosines.mirrored(a)
        step = np.empty_like(residual)
        size = self._preconditioner.apply(residual, diagonal, factor, step)
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
            size, before = self._preconditioner.apply(residual, diagonal, factor, step), size
            _update_direction(F(size / before), step.ravel(), direction.ravel())
        return self._cosines.merge_parities(waves)


def _apply_information(a: Float, field: Float) -> Float:
    """A times a field, (c, ny, nx)."""
    if len(field) == 1:
        return a * field
    u, v = field
    return np.stack([a[0] * u + a[1] * v, a[1] * u + a[2] * v])


@reassociating
def _apply_prior(foot: Float, inverse: Float, direction: Float, image: Float) -> F:
    """Turn A F p into (F A F + 1/S) p for the direction p; return its product with p."""
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


def _freedom(gain: Float) -> float:
    """Fraction of the variance of clusters of scores that remains after a fit with this gain."""
    rows, columns = (_box(n) for n in gain.shape)
    power = np.square(rows[:, None] * columns)
    return float(max((power * (1.0 - gain)).sum() / power.sum(), 0.2))


def _box(n: int) -> NDArray[np.float64]:
    m = np.arange(1, CLUSTER // 2 + 1)[:, None]
    out: NDArray[np.float64] = 1.0 + 2.0 * np.cos(m * np.pi * np.arange(n) / n).sum(axis=0)
    return out
