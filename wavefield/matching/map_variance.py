"""Posterior variance of the MAP field (most probable field) at each block, from the information around it."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from wavefield.compiled import compiled
from wavefield.matching.blocks import hole_mask
from wavefield.matching.map_field import cosines
from wavefield.matching.spectrum import Prior, wavenumbers

Float = NDArray[Any]
F = np.float32

# levels of information at which variances are tabulated, over the typical one: 3 down to 1/1400
INFORMATION_LEVELS = 3.0 * 4.0 ** np.arange(0.0, -7.0, -1.0)
KERNEL_CUTOFF = 1e-3  # modes at which the transform of a kernel is smaller are left out
EVERY = 4  # blocks: the variance varies slowly, so it is computed at every fourth block and interpolated
MIN_WAVE_FRACTION = 1e-3  # lower bound of the fraction that is waves, which keeps logarithms finite


class PosteriorVariance:
    """Variance of the MAP field on a lattice (ny, nx): from noise, and from waves that the prior suppresses.

    With uniform information A, footprint F and spectrum S, each mode adds F^2 A / (F^2 A + 1/S)^2 to the
    variance from noise. To that from suppressed waves it adds 1/S / (F^2 A + 1/S)^2 times the fraction of S
    that is waves. If A varies, a block gets the variances for the mean of A around it, weighted by the
    squared impulse response of the estimate. Inside holes, suppressed waves add at least `hole_variance`.
    """

    def __init__(self, prior: Prior, shape: tuple[int, int]) -> None:
        kx, ky = wavenumbers(shape)
        square, inverse = prior.footprint(kx, ky) ** 2, 1.0 / prior.spectrum(kx, ky)
        self.shape = shape
        self.typical_information = prior.information
        waves = np.maximum(prior.expected(kx, ky), MIN_WAVE_FRACTION)
        levels = INFORMATION_LEVELS * prior.information
        precision = [square * a + inverse for a in levels]
        noise = [np.mean(square * a / c**2, axis=(1, 2)) for a, c in zip(levels, precision)]
        missing = [np.mean(waves * inverse / c**2, axis=(1, 2)) for c in precision]
        self._log = np.log(levels).astype(np.float32)
        # (2 c, levels): noise of every component, then its missing waves
        self._variance = np.log(np.concatenate([np.transpose(noise), np.transpose(missing)])).astype(
            np.float32
        )
        kernels = np.array(
            [_squared_response((square * a / c).mean(axis=0)) for a, c in zip(levels, precision)]
        )
        rows, columns = np.nonzero((kernels > KERNEL_CUTOFF).any(axis=0))
        my, mx = rows.max() + 1, columns.max() + 1
        self._kernels = np.ascontiguousarray(kernels[:, :my, :mx], np.float32)
        down, along = (cosines(n, m).astype(np.float32) for n, m in zip(shape, (my, mx)))
        self._forward = down, np.ascontiguousarray(along.T)
        self._inverse = np.ascontiguousarray(down[:, ::EVERY].T), np.ascontiguousarray(along[:, ::EVERY])
        self._spectrum = waves / inverse

    @cached_property
    def _holes(self) -> list[Float]:
        return [hole_variance(one) for one in self._spectrum]

    def __call__(self, information: Float) -> tuple[Float, Float]:
        """Return variances from noise and from suppressed waves, (c, ny, nx) each, in squared field units.
        `information` (ny, nx) is the inverse variance of the value of each block."""
        waves = self._forward[0] @ (information @ self._forward[1])
        x = self._inverse[0] @ ((self._kernels * waves) @ self._inverse[1])
        log_variances = np.empty((len(self._variance), *x.shape[1:]), np.float32)
        _at_level(x, self._log, self._variance, log_variances)
        noise, missing = np.array([self._to_full_lattice(f) for f in log_variances]).reshape(
            2, -1, *self.shape
        )
        # a frame that is darker than usual has less information everywhere; that is not a hole
        bare = information[information > 0]
        own = float(bare.mean()) if bare.size else np.inf
        hole = hole_mask(information, min(self.typical_information, own))
        if hole.any():
            hole = cv2.dilate(hole.view(np.uint8), np.ones((7, 7), np.uint8)) > 0
            # add only what is missing: the low information around the hole has raised the variance already
            depth = cv2.distanceTransform(hole.view(np.uint8), cv2.DIST_L2, 5)
            inside = [np.interp(depth, np.arange(len(one)), one) for one in self._holes]
            more = np.array(inside, np.float32) - noise - missing
            missing += np.maximum(more, np.float32(0)) * hole
        return noise, missing

    def _to_full_lattice(self, some: Float) -> Float:
        """Interpolate a field `some`, with values at every fourth block, to all blocks, (ny, nx)."""
        ny, nx = self.shape
        scale = np.array([[EVERY, 0.0, 0], [0, EVERY, 0.0]])
        return cv2.warpAffine(some, scale, (nx, ny), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


@compiled(error_model="numpy", fastmath={"contract"})
def _at_level(x: Float, log: Float, variance: Float, out: Float) -> None:
    """Write n variances of each block to out (n, ny, nx), interpolated in a table over inverse variance A.
    `log` (levels,) is log A in the table, `variance` (n, levels) the log variance. x (levels, ny, nx) is the
    mean of A around each block, with one kernel per level; the level that equals its own mean is used."""
    for j in range(x.shape[1]):
        for i in range(x.shape[2]):
            previous = np.log(max(x[0, j, i], F(1e-30))) - log[0]
            n, t = 0, F(0)
            while previous < F(0) and n < x.shape[0] - 1:
                n += 1
                current = np.log(max(x[n, j, i], F(1e-30))) - log[n]
                t = min(max(current / max(current - previous, F(1e-6)), F(0)), F(1))
                previous = current
            for k in range(len(variance)):
                low, high = variance[k, n], variance[k, max(n - 1, 0)]
                out[k, j, i] = np.exp(low + t * (high - low))


def _impulse(gain: Float) -> Float:
    """Return the impulse response of a filter with gains (ny, nx): one even quadrant, (ny + 1, nx + 1)."""
    return np.asarray(scipy.fft.dctn(np.pad(gain, (0, 1)), type=1) / (4 * gain.size))


def _squared_response(gain: Float) -> Float:
    """Return gains (ny, nx), 1 at k = 0, of the filter with the squared impulse response of `gain`."""
    out: Float = scipy.fft.dctn(_impulse(gain) ** 2, type=1)[:-1, :-1]
    out /= out[0, 0]
    return out


def hole_variance(spectrum: Float) -> Float:
    """Return the variance of a field inside a hole without data, at 0, 1, 2, ... blocks from its rim, (n,).
    Value and slope are known at the rim, so it is C(0) - C(r)^2 / C(0) - C'(r)^2 / |C''(0)|, with the field's
    covariance C at the distance r from the rim. `spectrum` (ny, nx) is the power of each mode."""
    covariance = _impulse(spectrum)
    side = min(spectrum.shape)
    curve = 0.5 * (covariance[0, :side] + covariance[:side, 0])
    bend = max(2.0 * (curve[0] - curve[1]), 1e-30)
    known = curve**2 / max(curve[0], 1e-30) + np.gradient(curve) ** 2 / bend
    return np.asarray(np.maximum.accumulate(np.maximum(curve[0] - known, 0.0)))
