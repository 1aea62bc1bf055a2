"""Free waves that fit the fields of a few consecutive steps best, in a rectangle without periodic edges."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from wavefield.water import dispersion, group_velocity

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FIELDS = 4  # z, u, v and the rise at a fixed node: w less u . grad z
MAX_RELATIVE_WAVELENGTH = 12.0  # waves over the longer side: longer ones are no different in the rectangle
MAX_RELATIVE_WAVENUMBER = 0.45  # of half the sampling one: noise of neighbouring nodes is correlated
FIRST_AMPLITUDE = 1e-3  # m and m/s, before anything is learned
MIN_RING_INFORMATION = 0.3  # of a ring's unknowns: rings with less keep what they could hold undetected
MIN_NOISE_RATIO = 0.05  # of the stated variance: fields are not followed more closely
MIN_RELATIVE_EIGENVALUE = 1e-3  # of the largest: plane waves that differ in the rectangle
SINGLE_ROUNDS, ROUNDS = 7, 3  # of learning
CURRENT_ERROR, SMALL_CURRENT = 0.2, 1e-4  # m/s: of the mean velocity of the samples; of derivatives
MAX_ITERATIONS, TOLERANCE = 40, 1.0  # of conjugate gradients; of the energy, in squared standard deviations


class PlaneWaves:
    """Plane waves, eddies and constants over a rectangle and a window of times.

    Wave vectors lie on rings, so densely that waves may enter during the window: no period is imposed. Each
    has a complex amplitude; a potential gives z, u, v and the rise, a stream function that the current
    carries gives u and v of eddies.
    """

    def __init__(
        self, shape: tuple[int, int], step: float, times: Array, current: Array, depth: float, gamma: float
    ) -> None:
        self.shape, self.step, self.times, self.water = shape, step, times, (depth, gamma)
        side, last = step * max(shape), float(np.abs(times).max())
        vectors: list[Array] = []
        rings: list[NDArray[np.intp]] = []
        k = 2 * np.pi / (MAX_RELATIVE_WAVELENGTH * side)
        while k < MAX_RELATIVE_WAVENUMBER * np.pi / step:
            spacing = 2 * np.pi / (side + 2 * float(group_velocity(k, depth, gamma)) * last + 2 * np.pi / k)
            middle = k + spacing / 2
            count = 2 * int(np.ceil(np.pi * middle / spacing))
            angle = 2 * np.pi * (np.arange(count) + 0.5 * (len(rings) % 2)) / count
            vectors.append(middle * np.stack([np.cos(angle), np.sin(angle)]))
            rings.append(np.full(count, len(rings)))
            k += spacing
        self.kx, self.ky = np.concatenate(vectors, axis=1)
        # a stream function is real: half of the wave vectors hold all of it
        self.half = np.flatnonzero((self.ky > 1e-9 / step) | ((abs(self.ky) <= 1e-9 / step) & (self.kx > 0)))
        ring = np.concatenate(rings)
        self.group = np.concatenate([ring, len(rings) + ring[self.half], 2 * len(rings) + np.arange(FIELDS)])
        y, x = (step * (np.arange(n) - (n - 1) / 2) for n in shape)
        turned = np.exp(1j * (y[:, None, None] * self.ky + x[:, None] * self.kx)).reshape(-1, self.kx.size)
        one = np.ones((turned.shape[0], 1))
        self.basis = np.concatenate([turned.real, one, turned.imag, 0 * one], axis=1)  # (nodes, 2 vectors)
        self.vector = np.concatenate(
            [np.arange(self.kx.size), self.half, np.full(FIELDS, self.kx.size)]
        )  # of each unknown
        self.respond(current)

    def respond(self, current: Array) -> None:
        """Set what a unit of each unknown gives, (fields, times, unknowns), on a current, m/s."""
        self.current = np.asarray(current, float)
        k, drift = np.hypot(self.kx, self.ky), self.kx * current[0] + self.ky * current[1]
        sigma = dispersion(k, *self.water)
        per_elevation = sigma / (k * np.tanh(np.minimum(k * min(self.water[0], 1e6), 300.0)))
        wave = np.stack(
            [np.ones_like(k), per_elevation * self.kx, per_elevation * self.ky, -1j * (sigma + drift)]
        )
        zero = np.zeros(self.half.size)
        eddy = np.stack([zero, -(self.ky / k)[self.half], (self.kx / k)[self.half], zero])
        time = self.times[:, None]
        constant = np.broadcast_to(np.eye(FIELDS)[:, None], (FIELDS, self.times.size, FIELDS))
        self.response = np.concatenate(
            [
                wave[:, None] * np.exp(-1j * (sigma + drift) * time),
                eddy[:, None] * np.exp(-1j * drift[self.half] * time),
                constant,
            ],
            axis=2,
        )

    def fields(self, unknowns: Array, times: slice = slice(None)) -> Array:
        """Fields (fields, times, ny, nx) of unknowns: real parts of amplitudes, then imaginary ones."""
        return self._sums(self.response[:, times], unknowns)

    def slopes(self, unknowns: Array, time: int) -> Array:
        """Slopes z_x, z_y (2, ny, nx) at one time."""
        return self._sums(self._slope_response(time)[:, None], unknowns)[:, 0]

    def _slope_response(self, time: int) -> NDArray[np.complex128]:
        k = np.stack([np.append(self.kx, 0.0), np.append(self.ky, 0.0)])
        return np.asarray(1j * k[:, self.vector] * self.response[0, time])

    def _sums(self, response: NDArray[np.complex128], unknowns: Array) -> Array:
        real, imaginary = np.split(unknowns, 2)
        each = response * (real + 1j * imaginary)
        n, out = self.kx.size, np.zeros((*each.shape[:2], self.kx.size + 1), complex)
        out[..., :n] = each[..., :n]
        out[..., self.half] += each[..., n:-FIELDS]
        out[..., n] = each[..., -FIELDS:].sum(axis=-1)
        flat = np.concatenate([out.real, -out.imag], axis=-1).reshape(-1, self.basis.shape[1])
        return np.asarray((flat @ self.basis.T).reshape(*each.shape[:2], *self.shape))

    def transposed(self, weighted: Array) -> Array:
        """Scalar product of every unknown's fields with weighted ones, (fields, times, ny, nx)."""
        sums = weighted.reshape(-1, self.basis.shape[0]) @ self.basis
        real, imaginary = np.split(sums.reshape(*weighted.shape[:2], -1), 2, axis=-1)
        out = ((real + 1j * imaginary)[..., self.vector] * self.response).sum(axis=(0, 1))
        return np.concatenate([out.real, -out.imag])

    def products(self, mask: Mask) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Sums over nodes of conj(E_k) E_l and of E_k E_l of the unknowns' plane waves E."""
        real, imaginary = np.split(self.basis[mask.ravel()], 2, axis=1)
        waves = real + 1j * imaginary
        at = np.ix_(self.vector, self.vector)
        return (waves.conj().T @ waves)[at], (waves.T @ waves)[at]

    def normal(
        self, products: tuple[NDArray[np.complex128], ...], variance: Sequence[float] | Array
    ) -> Array:
        """Normal matrix of the fields with even variances of noise, at the nodes of `products`."""
        q = self.response.reshape(FIELDS, self.times.size, -1) / np.sqrt(np.asarray(variance))[:, None, None]
        q = q.reshape(-1, self.vector.size)
        hermitian, symmetric = products[0] * (q.conj().T @ q), products[1] * (q.T @ q)
        upper = np.concatenate([(hermitian + symmetric).real, -(hermitian + symmetric).imag], axis=1)
        lower = np.concatenate([(hermitian - symmetric).imag, (hermitian - symmetric).real], axis=1)
        return 0.5 * np.concatenate([upper, lower])

    def rows(self, nodes: NDArray[np.intp], time: int) -> Array:
        """Fields and slopes z_x, z_y of every unknown at some nodes, (6, nodes, 2 unknowns)."""
        real, imaginary = np.split(self.basis[nodes], 2, axis=1)
        response = np.concatenate([self.response[:, time], self._slope_response(time)])
        each = (real + 1j * imaginary)[:, self.vector] * response[:, None]
        return np.concatenate([each.real, -each.imag], axis=2)


class Posterior:
    """Unknowns from fields: Gaussian with a prior variance each, given a normal matrix."""

    def __init__(self, normal: Array, prior: Array) -> None:
        self.scale = np.sqrt(np.tile(prior, 2))
        matrix = normal * self.scale[:, None] * self.scale
        matrix[np.diag_indices_from(matrix)] += 1.0
        self._lower = scipy.linalg.cholesky(matrix, lower=True, overwrite_a=True, check_finite=False)

    def solve(self, right: Array) -> Array:
        """The unknowns of a right side (`PlaneWaves.transposed` of fields over their variances)."""
        out = scipy.linalg.cho_solve((self._lower, True), self.scale * right, check_finite=False)
        return np.asarray(self.scale * out)

    def covariance(self, rows: Array) -> Array:
        """Covariance (nodes, r, r) of what rows (r, nodes, 2 unknowns) give at each node."""
        flat = (rows * self.scale).reshape(-1, self.scale.size).T
        half = scipy.linalg.solve_triangular(self._lower, flat, lower=True, check_finite=False)
        half = half.reshape(-1, *rows.shape[:2])
        return np.asarray(np.einsum("prn,psn->nrs", half, half, optimize=True))

    @cached_property
    def inverse(self) -> Array:
        """Of the matrix of unknowns over their prior standard deviations."""
        lower, _ = scipy.linalg.lapack.dpotri(self._lower, lower=True)
        return np.asarray(np.tril(lower) + np.tril(lower, -1).T)

    def solve_partial(self, waves: PlaneWaves, fields: Array, weight: Array) -> Array:
        """Unknowns of fields that lack nodes which the normal matrix has, by conjugate gradients."""
        precision = self.scale**-2

        def apply(x: Array) -> Array:
            return precision * x + waves.transposed(weight * waves.fields(x))

        right = waves.transposed(weight * fields)
        x = self.solve(right)
        rest = right - apply(x)
        search = step = self.solve(rest)
        energy = float(rest @ step)
        for _ in range(MAX_ITERATIONS):
            if energy < TOLERANCE:  # of the noise's
                break
            moved = apply(search)
            length = energy / float(search @ moved)
            x, rest = x + length * search, rest - length * moved
            step = self.solve(rest)
            energy, before = float(rest @ step), energy
            search = step + energy / before * search
        return x


@dataclass(frozen=True)
class Learned:
    """What sample windows of a record show; arrays (fields,) but for the first and the last."""

    prior: Array  # (groups,): variance of the amplitudes
    variance: Array  # median of the stated variances
    noise: Array  # variance of noise per node that the fit takes
    misfit: Array  # variance of the noise over the stated one
    taken: Array  # share of the noise's variance that the fit follows
    current: Array  # (2,), m/s


def learn(waves: PlaneWaves, mask: Mask, windows: Sequence[Array], variance: Array) -> Learned:
    """Spectrum, noise and current from windows (fields, times, ny, nx), zero outside of the mask.

    Spectrum and current first from single steps, whose fields are coupled but do not turn, then from windows.
    """
    products = waves.products(mask)
    current = first = np.mean([w[1:3, :, mask].mean(axis=(1, 2)) for w in windows], axis=0)
    # noise that looks like waves: its values on an orthogonal basis of all plane waves
    basis = waves.basis[mask.ravel()]
    eigenvalues, vectors = scipy.linalg.eigh(basis.T @ basis)
    held = eigenvalues > MIN_RELATIVE_EIGENVALUE * eigenvalues[-1]
    basis = basis @ (vectors[:, held] / np.sqrt(eigenvalues[held]))
    nodes, values, times = basis.shape[0], basis.shape[1], waves.times.size
    noise, followed = variance * nodes / values, np.zeros(FIELDS)  # neighbouring nodes share their noise
    misfit, taken = np.ones(FIELDS), np.zeros(FIELDS)
    prior = np.full(waves.group.max() + 1, FIRST_AMPLITUDE**2)
    single = copy.copy(waves)
    single.times = np.zeros(1)
    for model, rounds in ((single, SINGLE_ROUNDS), (waves, ROUNDS)):
        data = windows if model is waves else [w[:, times // 2 : times // 2 + 1] for w in windows]
        for _ in range(rounds):
            model.respond(current)
            posterior = Posterior(model.normal(products, noise), prior[model.group])
            weight = mask / noise[:, None, None, None]
            found = [posterior.solve(model.transposed(weight * one)) for one in data]
            rest = [mask * (one - model.fields(x)) for one, x in zip(data, found)]
            current = current + _faster(model, posterior, found, rest, weight, first - current)
            if model is single:
                prior = _variances(posterior, found, model.group)
                continue
            covariance = posterior.scale[:, None] * posterior.inverse * posterior.scale
            for field in range(FIELDS):
                alone = np.where(np.arange(FIELDS) == field, noise[field], np.inf)
                followed[field] = np.sum(model.normal(products, alone) * covariance) / (values * times)
            like_waves = [one[:, :, mask] @ basis for one in rest]
            power = np.mean([np.sum(np.square(one), axis=(1, 2)) for one in like_waves], axis=0)
            density = power / (values * times * (1.0 - followed))
            total = np.mean([np.sum(np.square(one), axis=(1, 2, 3)) for one in rest], axis=0) / times
            lost = followed * values * density
            misfit, taken = (total + lost) / (nodes * variance), lost / (total + lost)
            # steps share frames: by so much more of their noise is left in a mean over the window
            alike = np.mean([np.sum(one.sum(axis=1) ** 2, axis=1) for one in like_waves], axis=0) / power
            noise = np.maximum(density * np.maximum(alike, 1.0), MIN_NOISE_RATIO * variance)
    return Learned(prior, variance, noise, misfit, taken, current)


def _variances(posterior: Posterior, found: Sequence[Array], group: NDArray[np.intp]) -> Array:
    """Variance of the amplitudes of each group: what was found, over the share of it that was measured."""
    kept = np.diag(posterior.inverse)  # of the prior's variance

    def total(values: Array) -> Array:
        return np.asarray(np.bincount(group, values.reshape(2, -1).sum(axis=0)), float)

    power = total(np.mean(np.square(found), axis=0))
    measured, count = total(1.0 - kept), 2.0 * np.bincount(group)
    uncertain = (power + total(kept * posterior.scale**2)) / count
    return np.maximum(
        np.where(measured > MIN_RING_INFORMATION * count, power / np.maximum(measured, 1e-9), uncertain),
        1e-20,
    )


def _faster(
    model: PlaneWaves,
    posterior: Posterior,
    found: Sequence[Array],
    rest: Sequence[Array],
    weight: Array,
    expected: Array,
) -> Array:
    """Change of the current (2,), m/s, that explains most of what is left: a step of Gauss and Newton."""
    normal = np.eye(2) / CURRENT_ERROR**2
    right = expected / CURRENT_ERROR**2
    response = model.response
    changed = []
    for axis in np.eye(2):
        model.respond(model.current + SMALL_CURRENT * axis)
        changed.append((model.response - response) / SMALL_CURRENT)
        model.respond(model.current - SMALL_CURRENT * axis)
    model.response = response
    for x, left in zip(found, rest):
        by = [model._sums(one, x) for one in changed]
        own = [one - model.fields(posterior.solve(model.transposed(weight * one))) for one in by]
        normal += [[np.sum(a * weight * b) for b in by] for a in own]
        right += [np.sum(a * weight * left) for a in own]
    return np.asarray(np.linalg.solve(normal, right))
