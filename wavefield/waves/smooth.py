"""Smoothing over time: free waves are fitted to the fields of a few successive steps, called a window."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import dask.array as da
import numpy as np
import scipy.linalg
import xarray as xr
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import gaussian_filter
from scipy.sparse.linalg import LinearOperator, cg

from wavefield.errors import CubeError
from wavefield.one_thread import one_thread
from wavefield.variables import CUBE_DIMS, FrameStatus, Quality, annotate, validate
from wavefield.water import dispersion, group_velocity, water_of
from wavefield.waves.current import delayed_current
from wavefield.waves.inputs import a_cube, takes
from wavefield.waves.motion import slopes
from wavefield.waves.record import MIN_NODES, check_axes, whole_record

Array = NDArray[Any]
Mask = NDArray[np.bool_]

NAMES = ("z", "u", "v", "w")
FIELDS = len(NAMES)  # of the model, which has the rate of rise at a fixed node, w - u . grad z, instead of w
MAX_RELATIVE_WAVELENGTH = 12.0  # chosen, relative to the longer side; longer waves look alike in it
MAX_RELATIVE_WAVENUMBER = 0.45  # chosen, relative to Nyquist; the noise of neighbouring nodes is correlated
MIN_NOISE_RATIO = 0.05  # chosen: least noise variance, relative to that of the cube
MIN_RELATIVE_EIGENVALUE = 1e-3  # chosen: below it, combinations of waves vanish in the rectangle
ROUNDS = 8  # rounds of learning; in the last, spectra change by a few per cent


class PlaneWaves:
    """Linear model of z, u, v and rate of rise in a rectangle of nodes: free waves, plus a constant per
    field. Its n complex unknowns (amplitudes, constants) are stored as (2 n,): real, then imaginary parts."""

    def __init__(
        self, shape: tuple[int, int], step: float, times: Array, current: Array, depth: float, gamma: float
    ) -> None:
        self.shape, self.times = shape, times
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
        ring = np.concatenate(rings)
        self.group = np.concatenate([ring, ring[-1] + 1 + np.arange(FIELDS)])  # unknowns of one variance
        y, x = (step * (np.arange(n) - (n - 1) / 2) for n in shape)
        turned = np.exp(1j * (y[:, None, None] * self.ky + x[:, None] * self.kx)).reshape(-1, self.kx.size)
        one = np.ones((turned.shape[0], 1))
        self.basis = np.concatenate([turned.real, one, turned.imag, 0 * one], axis=1)  # (nodes, 2 vectors)
        # place of each unknown among the vectors, the last of which is zero
        self.vector = np.minimum(np.arange(self.group.size), self.kx.size)
        # response of the fields to each unknown, (fields, times, unknowns)
        k, drift = np.hypot(self.kx, self.ky), self.kx * current[0] + self.ky * current[1]
        sigma = dispersion(k, depth, gamma)
        per_elevation = sigma / (k * np.tanh(np.minimum(k * min(depth, 1e6), 300.0)))
        wave = np.stack(
            [np.ones_like(k), per_elevation * self.kx, per_elevation * self.ky, -1j * (sigma + drift)]
        )
        constant = np.broadcast_to(np.eye(FIELDS)[:, None], (FIELDS, self.times.size, FIELDS))
        turning = np.exp(-1j * (sigma + drift) * self.times[:, None])
        self.response = np.concatenate([wave[:, None] * turning, constant], axis=2)

    def fields(self, unknowns: Array) -> Array:
        """Return the fields z, u, v and rate of rise, (4, times, ny, nx), for given unknowns (2 n,)."""
        return self._sums(self.response, unknowns)

    def slopes(self, unknowns: Array, time: int) -> Array:
        """Return the slopes z_x, z_y, (2, ny, nx), for given unknowns (2 n,) at time index `time`."""
        return self._sums(self._slope_response(time)[:, None], unknowns)[:, 0]

    def _slope_response(self, time: int) -> NDArray[np.complex128]:
        """Return derivatives of z_x and z_y with respect to each unknown, (2, n), at time index `time`."""
        k = np.stack([np.append(self.kx, 0.0), np.append(self.ky, 0.0)])
        return np.asarray(1j * k[:, self.vector] * self.response[0, time])

    def _sums(self, response: NDArray[np.complex128], unknowns: Array) -> Array:
        real, imaginary = np.split(unknowns, 2)
        each = response * (real + 1j * imaginary)
        n = self.kx.size
        out = np.concatenate([each[..., :n], each[..., n:].sum(axis=-1, keepdims=True)], axis=-1)
        flat = np.concatenate([out.real, -out.imag], axis=-1).reshape(-1, self.basis.shape[1])
        return np.asarray((flat @ self.basis.T).reshape(*each.shape[:2], *self.shape))

    def transposed(self, weighted: Array) -> Array:
        """Return (2 n,): the transpose of the map `fields`, applied to `weighted` (4, times, ny, nx)."""
        sums = weighted.reshape(-1, self.basis.shape[0]) @ self.basis
        real, imaginary = np.split(sums.reshape(*weighted.shape[:2], -1), 2, axis=-1)
        out = ((real + 1j * imaginary)[..., self.vector] * self.response).sum(axis=(0, 1))
        return np.concatenate([out.real, -out.imag])

    def products(self, mask: Mask) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Return two matrices (n, n): sums over the nodes of `mask` of conj(E_k) E_l, and of E_k E_l. E_k is
        the plane wave exp(i k . x) of an unknown, or 1 for a constant."""
        real, imaginary = np.split(self.basis[mask.ravel()], 2, axis=1)
        waves = real + 1j * imaginary
        at = np.ix_(self.vector, self.vector)
        return (waves.conj().T @ waves)[at], (waves.T @ waves)[at]

    def normal(
        self, products: tuple[NDArray[np.complex128], ...], variance: Sequence[float] | Array
    ) -> Array:
        """Return the normal matrix (2 n, 2 n) of a least-squares fit of the n unknowns. `products` is a
        result of `PlaneWaves.products`; `variance` (4,) is the noise variance of z, u, v, rate of rise."""
        q = self.response.reshape(FIELDS, self.times.size, -1) / np.sqrt(np.asarray(variance))[:, None, None]
        q = q.reshape(-1, self.vector.size)
        hermitian, symmetric = products[0] * (q.conj().T @ q), products[1] * (q.T @ q)
        upper = np.concatenate([(hermitian + symmetric).real, -(hermitian + symmetric).imag], axis=1)
        lower = np.concatenate([(hermitian - symmetric).imag, (hermitian - symmetric).real], axis=1)
        return 0.5 * np.concatenate([upper, lower])

    def rows(self, nodes: NDArray[np.intp], time: int) -> Array:
        """Return the derivatives (6, nodes, 2 n) of z, u, v, rate of rise, z_x and z_y with respect to the
        unknowns. `nodes` are indices in the flattened rectangle, and `time` is the index of a time."""
        real, imaginary = np.split(self.basis[nodes], 2, axis=1)
        response = np.concatenate([self.response[:, time], self._slope_response(time)])
        each = (real + 1j * imaginary)[:, self.vector] * response[:, None]
        return np.concatenate([each.real, -each.imag], axis=2)


class Posterior:
    """Gaussian posterior distribution of the n unknowns of `PlaneWaves`, given measured fields.
    It is computed from the normal matrix of the fit and the prior variance (n,) of the unknowns."""

    def __init__(self, normal: Array, prior: Array) -> None:
        self.scale = np.sqrt(np.tile(prior, 2))
        matrix = normal * self.scale[:, None] * self.scale
        matrix[np.diag_indices_from(matrix)] += 1.0
        self._lower = scipy.linalg.cholesky(matrix, lower=True, overwrite_a=True, check_finite=False)

    def solve(self, right: Array) -> Array:
        """Return the posterior mean of the unknowns, (2 n,).
        `right` is `PlaneWaves.transposed` of the fields divided by their noise variances."""
        out = scipy.linalg.cho_solve((self._lower, True), self.scale * right, check_finite=False)
        return np.asarray(self.scale * out)

    def covariance(self, rows: Array) -> Array:
        """Return the posterior covariance (nodes, r, r) of r linear functions of the unknowns at some nodes.
        `rows` (r, nodes, 2 n) holds the coefficients of these functions."""
        flat = (rows * self.scale).reshape(-1, self.scale.size).T
        half = scipy.linalg.solve_triangular(self._lower, flat, lower=True, check_finite=False)
        half = half.reshape(-1, *rows.shape[:2])
        return np.asarray(np.einsum("prn,psn->nrs", half, half, optimize=True))

    def covariance_of_unknowns(self) -> Array:
        """Return the posterior covariance of the unknowns, (2 n, 2 n)."""
        lower, _ = scipy.linalg.lapack.dpotri(self._lower, lower=True)
        inverse = np.tril(lower) + np.tril(lower, -1).T
        return np.asarray(self.scale[:, None] * inverse * self.scale)

    def solve_partial(self, waves: PlaneWaves, fields: Array, weight: Array) -> Array:
        """Return the posterior mean of the unknowns, (2 n,), for fields with missing values, by conjugate
        gradients. `weight` is 1 / noise variance, and 0 where `fields` (4, times, ny, nx) are missing."""
        size = self.scale.size
        matrix = LinearOperator(
            (size, size), lambda x: x / self.scale**2 + waves.transposed(weight * waves.fields(x))
        )
        right = waves.transposed(weight * fields)
        found, _ = cg(matrix, right, self.solve(right), M=LinearOperator((size, size), self.solve))
        return np.asarray(found)


@dataclass(frozen=True)
class Learned:
    """Wave spectrum and noise, estimated from sample windows; arrays (4,) are for z, u, v, rate of rise."""

    prior: Array  # (groups,): variance of the amplitudes on each ring, and of the constants
    variance: Array  # median of the squared standard uncertainties of the cube
    noise: Array  # noise variance per node in the fit
    misfit: Array  # noise variance relative to `variance`
    taken: Array  # fraction of the noise variance that the fit reproduces


def learn(waves: PlaneWaves, mask: Mask, windows: Sequence[Array], variance: Array) -> Learned:
    """Return wave spectrum and noise, from sample windows (4, times, ny, nx) that are 0 outside `mask`, by
    expectation maximisation. ``variance`` (4,) is the noise variance that the cube states."""
    products = waves.products(mask)
    # the noise that resembles waves is estimated on an orthogonal basis of all plane waves
    basis = waves.basis[mask.ravel()]
    eigenvalues, vectors = scipy.linalg.eigh(basis.T @ basis)
    held = eigenvalues > MIN_RELATIVE_EIGENVALUE * eigenvalues[-1]
    basis = basis @ (vectors[:, held] / np.sqrt(eigenvalues[held]))
    nodes, values, times = basis.shape[0], basis.shape[1], waves.times.size
    noise = variance * nodes / values  # neighbouring nodes have correlated noise
    prior = np.full(waves.group.max() + 1, 1e-2**2)  # m and m/s, larger than the amplitudes of waves
    for _ in range(ROUNDS):
        posterior = Posterior(waves.normal(products, noise), prior[waves.group])
        weight = mask / noise[:, None, None, None]
        found = [posterior.solve(waves.transposed(weight * one)) for one in windows]
        rest = [mask * (one - waves.fields(x)) for one, x in zip(windows, found)]
        covariance = posterior.covariance_of_unknowns()
        square = np.mean(np.square(found), axis=0) + np.diag(covariance)
        prior = np.bincount(waves.group, square.reshape(2, -1).mean(axis=0)) / np.bincount(waves.group)
        followed = np.empty(FIELDS)  # fraction of the noise on the basis that the fit reproduces
        for field in range(FIELDS):
            alone = np.where(np.arange(FIELDS) == field, noise[field], np.inf)
            followed[field] = np.sum(waves.normal(products, alone) * covariance) / (values * times)
        like_waves = [one[:, :, mask] @ basis for one in rest]
        power = np.mean([np.sum(np.square(one), axis=(1, 2)) for one in like_waves], axis=0)
        density = power / (values * times * (1.0 - followed))
        total = np.mean([np.sum(np.square(one), axis=(1, 2, 3)) for one in rest], axis=0) / times
        lost = followed * values * density
        misfit, taken = (total + lost) / (nodes * variance), lost / (total + lost)
        # successive steps share frames, so their noise is correlated: increase the variance accordingly
        alike = np.mean([np.sum(one.sum(axis=1) ** 2, axis=1) for one in like_waves], axis=0) / power
        noise = np.maximum(density * np.maximum(alike, 1.0), MIN_NOISE_RATIO * variance)
    return Learned(prior, variance, noise, misfit, taken)


INPUTS = (*NAMES, *(f"{name}_std" for name in NAMES), "quality")
HALF_WINDOW = 0.1  # s, chosen
MIN_HALF_WINDOW_STEPS = 2  # chosen
SAMPLED_WINDOWS = 8  # chosen: windows that are read to learn; the half with most measured nodes is used
MIN_MEASURED_SHARE = 0.25  # chosen: least fraction of nodes that are measured throughout these windows
TILE_NODES = 60  # chosen: largest side of a rectangle that is fitted at once, for memory
OVERLAP_NODES = 16  # chosen: nodes in common with the next rectangle
MISFIT_RADIUS = 3.0  # nodes, chosen: standard deviation of the weights that average squared residuals
COMMON_ERROR_SHARE = 0.12  # fraction of the noise variance that all steps of a window have in common
JUMP_OF_TIME = -1.0  # marks a step at which time jumps, in place of its quality


class _Smoother:
    """Computes the smoothed fields of a time step from the fields of the steps around that step. The grid is
    covered by overlapping rectangles of nodes, in which waves are fitted separately."""

    def __init__(
        self,
        shape: tuple[int, int],
        step: float,
        dt: float,
        steps: int,
        current: Array,
        water: tuple[float, float],
    ) -> None:
        self.steps = min(max(round(HALF_WINDOW / dt), MIN_HALF_WINDOW_STEPS), (steps - 1) // 2)
        counts = [max(-(-(n - OVERLAP_NODES) // (TILE_NODES - OVERLAP_NODES)), 1) for n in shape]
        ny, nx = (-(-(n + (count - 1) * OVERLAP_NODES) // count) for n, count in zip(shape, counts))
        self.tile = ny, nx
        starts = [
            np.round(np.linspace(0, n - size, count)).astype(int)
            for n, size, count in zip(shape, self.tile, counts)
        ]
        self.tiles = [
            (slice(a, a + self.tile[0]), slice(b, b + self.tile[1])) for a in starts[0] for b in starts[1]
        ]
        ramps = [np.minimum(np.arange(n) + 1.0, n - np.arange(n)).clip(max=OVERLAP_NODES) for n in self.tile]
        self.taper = ramps[0][:, None] * ramps[1]
        self.step, times = step, dt * np.arange(-self.steps, self.steps + 1, dtype=np.float64)
        self.waves = PlaneWaves(self.tile, step, times, current, *water)
        self.learned: Learned
        self.mask = np.zeros(shape, bool)
        self._fits: dict[int, tuple[Posterior, Array]] = {}

    def parts(self, window: Array) -> tuple[Array, Array, Array]:
        """Return z, u, v, rate of rise, (4, times, ny, nx); variances of these, same shape; a mask of
        measured nodes. `window` (9, times, ny, nx) holds z, u, v, w, their standard uncertainties, and
        quality."""
        z, u, v, w = window[:4].astype(float)
        z_y, z_x = slopes(z, self.step, self.step)
        fields = np.stack([z, u, v, w - u * z_x - v * z_y])
        variance = np.square(window[4:8].astype(float))
        there = (np.isfinite(fields) & np.isfinite(variance) & (variance > 0)).all(axis=0)
        there &= (np.nan_to_num(window[8]).astype(int) & Quality.MEASURED) > 0
        return np.where(there, fields, 0.0), np.where(there, variance, 1.0), there

    def study(self, windows: list[Array]) -> None:
        """Estimate wave spectrum and noise (`learned`) from sample windows (9, times, ny, nx), as in `parts`.
        Only the half with most measured nodes is used. CubeError if under a quarter of nodes are measured."""
        parts = [self.parts(window) for window in windows]
        shares = [there.mean() for _, _, there in parts]
        parts = [parts[i] for i in np.argsort(shares, kind="stable")[len(parts) // 2 :]]
        measured = np.mean([there.mean(axis=0) for _, _, there in parts], axis=0)
        self.mask = measured > 0.5
        at = max(self.tiles, key=lambda tile: np.sum(measured[tile] == 1.0))
        mask, part = measured[at] == 1.0, (slice(None), slice(None), *at)
        if mask.sum() < MIN_MEASURED_SHARE * mask.size:
            raise CubeError(
                f"only {100 * mask.mean():.0f} % of the nodes are measured in all steps of a window:"
                f" smooth needs {100 * MIN_MEASURED_SHARE:.0f} %"
            )
        variance = np.median(
            np.concatenate([one[part][:, :, mask] for _, one, _ in parts], axis=1), axis=(1, 2)
        )
        samples = [np.where(mask, one[part], 0.0) for one, _, _ in parts]
        self.learned = learn(self.waves, mask, samples, variance)

    def fit_of(self, number: int) -> tuple[Posterior, Array]:
        """Return the posterior of rectangle `number`, and a covariance matrix for each node, (ny, nx, 6, 6).
        The matrix is for z, u, v, rate of rise, z_x, z_y at the middle time. Results are cached."""
        if number not in self._fits:
            waves, mask = self.waves, self.mask[self.tiles[number]]
            normal = waves.normal(waves.products(mask), self.learned.noise)
            posterior = Posterior(normal, self.learned.prior[waves.group])
            ny, nx = self.tile
            # the covariance varies slowly: it is computed at every fifth node and interpolated
            y, x = (np.unique(np.append(np.arange(0, n, 5), n - 1)) for n in (ny, nx))
            nodes = (y[:, None] * nx + x).ravel()
            covariance = posterior.covariance(waves.rows(nodes, self.steps)).reshape(y.size, x.size, 6, 6)
            at = np.stack(np.meshgrid(np.arange(ny), np.arange(nx), indexing="ij"), axis=-1)
            self._fits[number] = posterior, RegularGridInterpolator((y, x), covariance)(at)
        return self._fits[number]

    def smoothed(self, window: Array) -> Array:
        """Return z, u, v, w and their standard uncertainties, (8, ny, nx), at the middle step of a window.
        Nodes that are not measured, and windows with lost or doubled frames, are returned unchanged."""
        own = window[:8, self.steps]
        if (window[8] == JUMP_OF_TIME).any():
            return own.astype(np.float32)
        total, weights = np.zeros(own.shape), np.zeros(own.shape[1:])
        fields, variance, there = self.parts(window)
        for number, at in enumerate(self.tiles):
            if self.mask[at].any():
                part = (slice(None), slice(None), *at)
                values = self._tile(number, fields[part], variance[part], there[part[1:]], own[:4, *at])
                total[:, *at] += self.taper * values
                weights[at] += self.taper
        usable = there[self.steps] & self.mask & (weights > 0)
        with np.errstate(invalid="ignore", divide="ignore"):
            total /= weights
        total[4:] = np.minimum(np.sqrt(total[4:]), own[4:])
        return np.where(usable, total, own).astype(np.float32)

    def _tile(self, number: int, fields: Array, variance: Array, there: Array, own: Array) -> Array:
        """Return z, u, v, w and their variances, (8, ny, nx), of rectangle `number` at the middle step.
        `fields`, `variance` and `there` are from `parts`; `own` is the measured z, u, v, w at this step."""
        waves, learned, middle = self.waves, self.learned, self.steps
        posterior, covariance = self.fit_of(number)
        mask = self.mask[self.tiles[number]]
        there = there & mask
        weight = there / learned.noise[:, None, None, None]
        if there[:, mask].all():
            unknowns = posterior.solve(waves.transposed(weight * fields))
        else:
            unknowns = posterior.solve_partial(waves, fields, weight)
        fit = waves.fields(unknowns)
        expected = (np.minimum(learned.misfit, 1.0) * (1.0 - learned.taken))[:, None, None, None]
        ratio = there * (fields - fit) ** 2 / (variance * expected)
        near = np.maximum(gaussian_filter(there.sum(axis=0) * 1.0, MISFIT_RADIUS), 1e-9)
        mean = gaussian_filter(ratio.sum(axis=1), (0.0, MISFIT_RADIUS, MISFIT_RADIUS)) / near
        # steps and nodes that the fit of the rectangle has, relative to those that are measured
        fewer = gaussian_filter(waves.times.size * mask * 1.0, MISFIT_RADIUS) / near
        excess = np.maximum(mean - 1.0, 0.0)
        kept = excess / (1.0 + excess)  # of what the waves leave
        z, u, v, rise = fit[:, middle]
        z_x, z_y = waves.slopes(unknowns, middle)
        of_w = np.stack([np.ones_like(u), u, v], axis=-1)
        posterior_variance = np.stack(
            [
                *(covariance[..., i, i] for i in range(3)),
                np.einsum("yxr,yxrs,yxs->yx", of_w, covariance[..., 3:, 3:], of_w),
            ]
        )
        best = np.stack([z, u, v, rise + u * z_x + v * z_y])
        noise = np.minimum(learned.misfit, 1.0)[:, None, None]
        left = fewer * posterior_variance / learned.variance[:, None, None] + noise * (
            excess + COMMON_ERROR_SHARE
        )
        total = variance[:, middle] * ((1.0 - kept) ** 2 * left + kept**2)
        return np.concatenate([best + kept * (np.nan_to_num(own) - best), total])


@takes(a_cube)
def smooth(cube: xr.Dataset, *, depth: float | None = None) -> xr.Dataset:
    """Smooth a cube over time by fitting free waves to the steps around each step.

    The noise of the result is correlated in time. Compute spectra and statistics from the cube itself.

    Parameters
    ----------
    cube : Dataset
        z, u, v, w over (time, y, x), m and m/s, with their standard uncertainties ``z_std``, ``u_std``,
        ``v_std``, ``w_std``; ``quality`` and ``frame_status`` where present. A lazy cube gives a lazy
        result; a few of its steps are read at once, to learn spectrum, noise and current.
    depth : float, optional
        Depth of the water, m; by default the depth stored with the cube, or else deep water.

    Returns
    -------
    Dataset
        Smoothed z, u, v, w and their standard uncertainties, with the ``quality`` of the cube. Values do
        not change at nodes that are not measured, and in windows that contain lost or doubled frames. The
        attribute ``smoothed`` gives the number of steps in a window and the current.

    Raises
    ------
    CubeError
        If a variable is missing, there are fewer than five steps or 8 x 8 nodes, node spacings along x and y
        differ, or fewer than a quarter of the nodes are measured.

    Notes
    -----
    The model of the fields in a window of 0.1 s on either side is a sum of free waves of all directions,

        z = sum a e, u = sum (k / |k|) (sigma / tanh |k| h) a e, w - u . grad z = sum -i omega a e,

    with e = exp(i (k . x - omega t)), omega = sigma + k . U, and sigma by the dispersion relation, plus a
    constant for each field. U is the mean velocity. The amplitudes a are the posterior means for the noise
    and the spectrum of the record, which are estimated from sample windows.

    If the mean square of the residual is 1 + q times the noise, the fraction q / (1 + q) of the residual is
    added to the fit, so that other motion (steep waves, eddies) stays as measured.

    Examples
    --------
    >>> import wavefield as wf
    >>> smoothed = wf.smooth(wf.open_cube("sea.zarr"))
    >>> smoothed.z.dims, smoothed.attrs["smoothed"][:25]
    (('time', 'y', 'x'), 'by free waves over 5 step')
    """
    missing = [name for name in INPUTS[:8] if name not in cube]
    if missing:
        raise CubeError(f"the cube has no {missing[0]!r}: smooth needs z, u, v, w and their uncertainties")
    fields = validate(cube, *INPUTS[:8]).transpose(*CUBE_DIMS)
    dt, dy, dx = check_axes(fields)
    steps, shape = fields.sizes["time"], (fields.sizes["y"], fields.sizes["x"])
    if steps < 2 * MIN_HALF_WINDOW_STEPS + 1:
        raise CubeError(f"the record has {steps} steps: smooth needs {2 * MIN_HALF_WINDOW_STEPS + 1}")
    if min(shape) < MIN_NODES or not np.isclose(dx, dy, rtol=0.01):
        raise CubeError(
            f"the grid has {shape[1]} x {shape[0]} nodes: smooth needs {MIN_NODES} of equal distances"
        )
    quality = cube["quality"].transpose(*CUBE_DIMS) if "quality" in cube else xr.ones_like(fields["z"])
    used = quality
    if "frame_status" in cube:
        used = quality.where(cube["frame_status"] != FrameStatus.DISCONTINUOUS, JUMP_OF_TIME)
    arrays = [*(fields[name] for name in INPUTS[:8]), used]
    current, _ = delayed_current(fields, whole_record(fields)).compute()
    smoother = _Smoother(shape, dx, dt, steps, current, water_of(cube.attrs, depth))
    reach = smoother.steps
    middles = sorted(
        {reach + (2 * i + 1) * (steps - 2 * reach) // (2 * SAMPLED_WINDOWS) for i in range(SAMPLED_WINDOWS)}
    )
    parts = [slice(one - reach, one + reach + 1) for one in middles]
    with one_thread():
        smoother.study([np.stack([a[part].values.astype(np.float32) for a in arrays]) for part in parts])

    def work(block: Array) -> Array:
        windows = [block[:, i : i + 2 * reach + 1] for i in range(block.shape[1] - 2 * reach)]
        with one_thread():
            return np.stack([smoother.smoothed(window) for window in windows], axis=1)

    ends = {0: 0, 1: reach, 2: 0, 3: 0}
    if any(a.chunks for a in arrays):
        lazy = da.stack([a.astype(np.float32).data for a in arrays]).rechunk({0: -1, 2: -1, 3: -1})
        lazy = da.overlap.overlap(lazy, ends, {1: np.nan})
        chunks = ((8,), tuple(n - 2 * reach for n in lazy.chunks[1]), *lazy.chunks[2:])
        out = lazy.map_blocks(work, dtype=np.float32, chunks=chunks, meta=np.empty((0,) * 4, np.float32))
    else:
        whole = np.stack([a.values.astype(np.float32) for a in arrays])
        out = work(np.pad(whole, [(n, n) for n in ends.values()], constant_values=np.nan))
    found = fields.assign({name: (CUBE_DIMS, out[i]) for i, name in enumerate(INPUTS[:8])})
    if "quality" in cube:
        found["quality"] = quality
    current = ", ".join(f"{part:.4f}" for part in current)
    how = f"by free waves over {2 * reach + 1} steps, on a current of {current} m/s"
    return annotate(found).assign_attrs({**cube.attrs, "smoothed": how})
