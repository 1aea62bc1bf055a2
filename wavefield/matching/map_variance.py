"""Uncertainty of the MAP field: the posterior's variance from the information around a block."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, spline_filter1d

from wavefield.compiled import compiled
from wavefield.matching.map_field import cosines
from wavefield.matching.noise import hole_mask
from wavefield.matching.spectrum import Prior, wavenumbers

Float = NDArray[Any]
F = np.float32

# information over the typical one at which variances are tabulated: from three times to a thousandth
INFORMATION_LEVELS = 3.0 * 4.0 ** np.arange(0.0, -7.0, -1.0)
KERNEL_CUTOFF = 1e-3  # smaller values of a kernel's transform are left out
HOLE_RADII = (1.0, 2.0, 3.0, 4.5, 6.5, 9.0, 12.0, 16.0)  # blocks: radii of tabulated holes
HOLE_DEPTHS = (0.0, 0.25, 0.5, 0.75, 1.0)  # tabulated fractions of the way from a hole's rim to its middle
EVERY = 4  # blocks: the variance is computed on every fourth, because it varies slowly, and interpolated
MIN_WAVE_FRACTION = 1e-3  # of a spectrum: keeps logarithms finite
# rings of blocks around a hole that are taken as measured, from its edge: farther ones hardly count
RIM_MIDDLES, RIM_WIDTHS = np.array([0.5, 2.5, 7.0]), np.array([1.0, 3.0, 6.0])
RIM_POINTS = 16  # of each ring


class PosteriorVariance:
    """Variance of the MAP field on a lattice (ny, nx), as noise and as waves that the prior suppresses.

    For uniform information A a mode has the variance 1 / (F^2 A + 1/S): the part F^2 A / (F^2 A + 1/S)^2 is
    noise, the part 1/S / (F^2 A + 1/S)^2 missing waves. Where information varies, a block gets the value for
    the mean information around it, weighted by the squared impulse response of the estimate. The variance in
    holes is tabulated for round holes by radius and depth.
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
        return [hole_variance(variance, 1.0 / self.typical_information) for variance in self._spectrum]

    def __call__(self, information: Float) -> tuple[Float, Float]:
        """Variances of noise and of missing waves, each (1 or c, ny, nx), for the information (ny, nx)."""
        waves = self._forward[0] @ (information @ self._forward[1])
        x = self._inverse[0] @ ((self._kernels * waves) @ self._inverse[1])
        log_variances = np.empty((len(self._variance), *x.shape[1:]), np.float32)
        _at_level(x, self._log, self._variance, log_variances)
        noise, missing = np.array([self._to_full_lattice(f) for f in log_variances]).reshape(
            2, -1, *self.shape
        )
        # a frame that is darker than usual has less information everywhere, which is not a hole
        bare = information[information > 0]
        own = float(bare.mean()) if bare.size else np.inf
        hole = hole_mask(information, min(self.typical_information, own))
        if hole.any():
            hole = cv2.dilate(hole.view(np.uint8), np.ones((7, 7), np.uint8)) > 0
            # the lower information around the hole has added a part of this already
            more = _in_holes(~hole, self._holes) - noise - missing
            missing += np.maximum(more, np.float32(0)) * hole
        return noise, missing

    def _to_full_lattice(self, some: Float) -> Float:
        """Interpolate from every fourth block to all blocks."""
        ny, nx = self.shape
        scale = np.array([[EVERY, 0.0, 0], [0, EVERY, 0.0]])
        return cv2.warpAffine(some, scale, (nx, ny), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


@compiled(error_model="numpy", fastmath={"contract"})
def _at_level(x: Float, log: Float, variance: Float, out: Float) -> None:
    """Interpolate log variances to the level of information that equals the local mean.
    x (levels, ny, nx) is the local mean as the kernel of each level sees it; log (levels,) and variance
    (n, levels) are logarithms, highest information first.
    """
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
    """Response to a single block, (ny + 1, nx + 1), of a filter with the given cosine gains (ny, nx).
    Only one quarter, as it is even along both axes; the gain of the two-block wave is taken as zero.
    """
    out: Float = scipy.fft.dctn(np.pad(gain, (0, 1)), type=1) / (4 * gain.size)
    return out


def _squared_response(gain: Float) -> Float:
    """Gain of the squared impulse response of a filter, normalised to the sum 1."""
    out: Float = scipy.fft.dctn(_impulse(gain) ** 2, type=1)[:-1, :-1]
    out /= out[0, 0]
    return out


def hole_variance(spectrum: Float, noise: float) -> Float:
    """Variance in round holes, (radii, depths), of a field with a spectrum (ny, nx) and the noise of blocks.
    It is that of optimal interpolation from three rings of blocks around the hole.
    """
    covariance = _impulse(spectrum)
    side = min(spectrum.shape)
    curve = spline_filter1d(0.5 * (covariance[0, :side] + covariance[:side, 0]), mode="mirror")

    def at(distance: Float) -> Float:
        places = np.minimum(distance, side - 1)[None]
        return np.asarray(map_coordinates(curve, places, mode="mirror", prefilter=False))

    angle = 2.0 * np.pi * np.arange(RIM_POINTS) / RIM_POINTS
    out = np.zeros((len(HOLE_RADII), len(HOLE_DEPTHS)))
    for i, radius in enumerate(HOLE_RADII):
        ring = np.repeat(radius + RIM_MIDDLES, RIM_POINTS)
        x, y = ring * np.tile([np.cos(angle), np.sin(angle)], len(RIM_MIDDLES))
        # blocks that a point stands for
        blocks = 2.0 * np.pi / RIM_POINTS * ring * np.repeat(RIM_WIDTHS, RIM_POINTS)
        measured = at(np.hypot(x[:, None] - x, y[:, None] - y)) + noise * np.diag(1.0 / blocks)
        inside = at(np.hypot(x[:, None] - radius * (1.0 - np.array(HOLE_DEPTHS)), y[:, None]))
        known = np.sum(inside * np.linalg.solve(measured, inside), axis=0)
        out[i] = np.maximum(covariance[0, 0] - known, 0.0)
    return out


def _in_holes(measured: Float, tables: Sequence[Float]) -> Float:
    """Variance in holes, by their width and the distance to the rim, (tables, ny, nx)."""
    depth = cv2.distanceTransform((~measured).astype(np.uint8), cv2.DIST_L2, 5)
    out = np.zeros((len(tables), *measured.shape), np.float32)
    inside = depth > 0
    radius = depth.copy()
    for _ in range(3):
        radius = np.where(inside, cv2.dilate(radius, np.ones((9, 9), np.uint8)), np.float32(0))
    width = np.maximum(radius[inside], 1.0)
    i = np.interp(width, HOLE_RADII, np.arange(len(HOLE_RADII)))
    j = np.interp(depth[inside] / width, HOLE_DEPTHS, np.arange(len(HOLE_DEPTHS)))
    for variance, table in zip(out, tables):
        variance[inside] = np.exp(map_coordinates(np.log(table + 1e-30), [i, j], order=1, mode="nearest"))
    return out
