"""Operations on fields (ny, nx) on the lattice of blocks: smoothing, slopes, Gauss-Newton steps, noise."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.compiled import compiled
from wavefield.matching.kernels import BLOCK

Float = NDArray[Any]
Mask = NDArray[np.bool_]

F = np.float32
BORDER, MIRROR = cv2.BORDER_REPLICATE, cv2.BORDER_REFLECT_101

SMOOTHER_ORDER = 4  # n of the smoother 1 - (1 - G)^n: a higher order has a flatter passband
RELAXATION = 1.25  # factor on every Gauss-Newton step, because noise in the gradients makes steps too short
# weights of the sixth-order central difference over seven blocks, per px
_DIFFERENCE = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / 60 / BLOCK

njit = compiled(error_model="numpy")


@lru_cache(maxsize=64)
def gaussian(sigma: float) -> np.ndarray:
    """Return the weights, with sum 1, of a Gaussian of `sigma` blocks, cut at 2.7 sigma."""
    reach = max(1, int(np.ceil(2.7 * sigma)))
    weights = np.exp(-(np.arange(-reach, reach + 1) ** 2) / (2 * sigma**2))
    return np.asarray(weights / weights.sum(), np.float32)


def window_weights(window: float) -> np.ndarray:
    """Return the weights, along one axis of the lattice, of the Gaussian window that averages block sums.
    The window has the same area as a square of `window` x `window` px."""
    return gaussian(float(window / np.sqrt(4 * np.pi) / BLOCK))


def filtered(field: np.ndarray, weights: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
    """Return a field (ny, nx) convolved along x and along y with `weights`, also written to `out` if given.
    Beyond the edges, the field continues with its edge values."""
    return cv2.sepFilter2D(field, -1, weights, weights, dst=out, borderType=BORDER)


def smoothed(
    field: np.ndarray, sigma: float, order: int, weighting: tuple[np.ndarray, np.ndarray] | None = None
) -> np.ndarray:
    """Return a field f (ny, nx) smoothed by 1 - (1 - G)^order, with G a Gaussian of `sigma` blocks.
    With `weighting` from `smoother_weights`, G is the weighted mean G(w f) / G(w). With sigma 0, f is
    returned."""
    if sigma == 0:
        return field
    g, part, rest = gaussian(sigma), np.empty_like(field), field.copy()
    for _ in range(order):
        if weighting is None:
            rest -= filtered(rest, g, part)
        else:
            weight, norm = weighting
            rest -= norm * filtered(weight * rest, g, part)
    return np.asarray(np.subtract(field, rest, out=rest))


def smoother_weights(weight: np.ndarray, sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the block weights w (ny, nx), unchanged, and 1 / G(w): the argument `weighting` of `smoothed`.
    G is a Gaussian of `sigma` blocks."""
    return weight, F(1) / np.maximum(filtered(weight, gaussian(sigma)), F(1e-3))


def slopes(u: np.ndarray, v: np.ndarray, averaged_variance: float = 0.0) -> np.ndarray:
    """Return du/dx, du/dy, dv/dx, dv/dy, px per px, (4, ny, nx), by differences of sixth order.
    u, v (ny, nx), px, are averages around each block over an area with the variance `averaged_variance`,
    px^2; the slopes are corrected for this averaging."""
    side = 0.5 * averaged_variance / BLOCK**2
    sharpened = np.array([-side, 1.0 + 2.0 * side, -side])
    difference = np.convolve(_DIFFERENCE, sharpened)
    margin = len(difference) // 2
    inside = slice(margin, -margin)
    out = np.empty((4, *u.shape), np.float32)
    for n, field in enumerate((u, v)):
        around = np.asarray(field, np.float32)
        for y, x in ((0, margin), (margin, 0)):  # reflect oddly at the edges, which keeps the slope there
            edges, mirror = (cv2.copyMakeBorder(around, y, y, x, x, kind) for kind in (BORDER, MIRROR))
            around = F(2) * edges - mirror
        for m, (along_x, along_y) in enumerate(((difference, sharpened), (sharpened, difference))):
            out[2 * n + m] = cv2.sepFilter2D(around, -1, along_x, along_y)[inside, inside]
    return out


@njit
def subtract_slopes(sums: np.ndarray, moments: np.ndarray, slope: np.ndarray) -> None:
    """Subtract the effect of displacement gradients inside blocks from scores `sums` (2, ny, nx), in place.
    A score is a sum of gradient times residual. `slope` (4, ny, nx) are the displacement gradients (see
    `slopes`), `moments` (9, ny, nx) come from `gradient_moments`."""
    _, ny, nx = sums.shape
    for j in range(ny):
        sx, sy = sums[0, j], sums[1, j]
        ux, uy, vx, vy = slope[0, j], slope[1, j], slope[2, j], slope[3, j]
        xxx, xyx, yyx = moments[3, j], moments[4, j], moments[5, j]
        xxy, xyy, yyy = moments[6, j], moments[7, j], moments[8, j]
        for i in range(nx):
            sx[i] -= xxx[i] * ux[i] + xxy[i] * uy[i] + xyx[i] * vx[i] + xyy[i] * vy[i]
            sy[i] -= xyx[i] * ux[i] + xyy[i] * uy[i] + yyx[i] * vx[i] + yyy[i] * vy[i]


def subtract_strain(
    sums: np.ndarray, moments: np.ndarray, slope: np.ndarray, count: np.ndarray
) -> tuple[float, float]:
    """Correct scores `sums` (2, ny, nx), in place, for strained beads that block edges cut; return c and s^2.
    The correction is c a + s^2 b, with a and b from `_strains`; c and s^2 are fitted (see `reevaluate`).
    `moments` (8, ny, nx) come from `strain_moments`, `slope` (4, ny, nx) are displacement gradients, and
    `count` (ny, nx) is 1 for usable blocks, else 0."""
    aa, ab, bb, ra, rb = _strain_products(sums, moments, slope, count)
    determinant = max(aa * bb - ab * ab, 1e-6 * aa * bb + 1e-30)
    c = min(max((ra * bb - rb * ab) / determinant, 0.0), 1.0)
    s2 = max((rb - c * ab) / max(bb, 1e-30), 0.0)
    _subtract_strain(sums, moments, slope, count, F(c), F(s2))
    return c, s2


@njit
def _strains(moments: np.ndarray, slope: np.ndarray, j: int, i: int) -> Any:
    """Return the strain terms a and b of the score of block (j, i), as four numbers: a_x, a_y, b_x, b_y.
    a contains the brightness of the image, b its second derivatives; strain changes the score by c a + s^2 b.
    `subtract_strain` describes the arguments."""
    ux, shear, vy = slope[0, j, i], slope[1, j, i] + slope[2, j, i], slope[3, j, i]
    divergence = ux + vy
    return (
        divergence * moments[0, j, i],
        divergence * moments[1, j, i],
        moments[2, j, i] * ux + moments[3, j, i] * shear + moments[4, j, i] * vy,
        moments[5, j, i] * ux + moments[6, j, i] * shear + moments[7, j, i] * vy,
    )


@njit
def _strain_products(
    sums: np.ndarray, moments: np.ndarray, slope: np.ndarray, count: np.ndarray
) -> tuple[float, float, float, float, float]:
    """Return a.a, a.b, b.b, r.a, r.b, summed over usable blocks, for a least-squares fit of r = c a + s^2 b.
    a and b are the terms of `_strains`, r the scores `sums` (2, ny, nx); `count` (ny, nx) is 1 if usable."""
    aa = ab = bb = ra = rb = 0.0
    for j in range(count.shape[0]):
        for i in range(count.shape[1]):
            if count[j, i] > 0:
                a, b, p, q = _strains(moments, slope, j, i)
                x, y = sums[0, j, i], sums[1, j, i]
                aa += a * a + b * b
                ab += a * p + b * q
                bb += p * p + q * q
                ra += x * a + y * b
                rb += x * p + y * q
    return aa, ab, bb, ra, rb


@njit
def _subtract_strain(
    sums: np.ndarray, moments: np.ndarray, slope: np.ndarray, count: np.ndarray, c: F, s2: F
) -> None:
    """Subtract c a + s^2 b from scores `sums` (2, ny, nx), in place, with the terms a and b of `_strains`."""
    for j in range(count.shape[0]):
        for i in range(count.shape[1]):
            a, b, p, q = _strains(moments, slope, j, i)
            sums[0, j, i] -= count[j, i] * (c * a + s2 * p)
            sums[1, j, i] -= count[j, i] * (c * b + s2 * q)


@njit
def step(
    h: np.ndarray,
    s: np.ndarray,
    ridge: np.float32,
    relaxation: np.float32,
    limit: np.float32,
    u: np.ndarray,
    v: np.ndarray,
) -> None:
    """Add relaxation (H + ridge)^-1 s to u, v (ny, nx), px, in every block, in place: one Gauss-Newton step.
    h (3, ny, nx) is xx, xy, yy of the Hessian H, and s (2, ny, nx) the scores (gradient times residual), both
    summed over windows. The step along each axis is at most `limit` px."""
    ny, nx = u.shape
    for j in range(ny):
        xx, xy, yy, sx, sy = h[0, j], h[1, j], h[2, j], s[0, j], s[1, j]
        to_u, to_v = u[j], v[j]
        for i in range(nx):
            a, c, b = xx[i] + ridge, yy[i] + ridge, xy[i]
            scale = relaxation / max(a * c - b * b, F(1e-30))
            to_u[i] += min(max((c * sx[i] - b * sy[i]) * scale, -limit), limit)
            to_v[i] += min(max((a * sy[i] - b * sx[i]) * scale, -limit), limit)


def replace_outliers(u: np.ndarray, v: np.ndarray, limit: float) -> np.ndarray:
    """Replace outliers in u, v (ny, nx), px, in place, by the median of 5 x 5 blocks; return a mask of them.
    A block is an outlier if |u - median of u| + |v - median of v| is more than `limit` px."""
    median_u, median_v = cv2.medianBlur(u, 5), cv2.medianBlur(v, 5)
    outlier: np.ndarray = np.abs(u - median_u) + np.abs(v - median_v) > F(limit)
    np.copyto(u, median_u, where=outlier)
    np.copyto(v, median_v, where=outlier)
    return outlier


@lru_cache(maxsize=32)
def _doubling_maps(coarse: tuple[int, int], fine: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    y, x = ((np.arange(n) + 0.5) / 2 - 0.5 for n in fine)
    x, y = np.meshgrid(x.astype(np.float32), y.astype(np.float32))
    return np.clip(x, 0, coarse[1] - 1), np.clip(y, 0, coarse[0] - 1)


def to_finer(field: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Interpolate a displacement component, px, to the next finer pyramid level with `shape` (ny, nx) blocks.
    The values are doubled, because a pixel of the finer level is half as large."""
    x, y = _doubling_maps(field.shape, shape)
    return cv2.remap(field, x, y, cv2.INTER_LINEAR, borderMode=BORDER) * F(2)


@njit
def block_weights(
    mask_a: np.ndarray,
    mask_b: np.ndarray,
    u: np.ndarray,
    v: np.ndarray,
    height: int,
    width: int,
    out: np.ndarray,
    block: int = BLOCK,
) -> None:
    """Write 1 to out (ny, nx) for blocks that are usable at the displacement u, v (ny, nx), px, else 0.
    A block is usable if it ends up inside image b (`height` x `width` px) and is masked in neither image.
    `mask_a` and `mask_b` (h, w) are 1 where all of the block around a pixel is usable; empty: no mask."""
    ny, nx = u.shape
    for j in range(ny):
        for i in range(nx):
            x, y = F(i * block + 2) + u[j, i], F(j * block + 2) + v[j, i]
            usable = x >= F(1) and y >= F(1) and x <= F(width - 2) and y <= F(height - 2)
            if usable and mask_b.size > 0:
                usable = mask_b[int(y + F(0.5)), int(x + F(0.5))] != 0
            if usable and mask_a.size > 0:
                usable = mask_a[j * block + 2, i * block + 2] != 0
            out[j, i] = F(1) if usable else F(0)


# Blocks along each side of the clusters over which scores are summed to measure their noise. The noise of
# closer blocks is correlated, because they share beads.
CLUSTER = 5
SMOOTHING_RADIUS = 6.0  # blocks: standard deviation of the Gaussian that averages the noise
HOLE_INFORMATION = 0.15  # a hole has less than this fraction of the typical information, over 7 x 7 blocks
# largest squared score of a cluster over its expected value; noise (an exponential variable) exceeds it once
# in 10^13
MAX_MISFIT = 30.0
LEAST_NOISE = 0.3  # lower bound of the noise expected around a cluster, over the median noise of the image


def noise_of_scores(
    score: Float, trace: Float, counts: Float, freedom: float, with_mismatches: bool = False
) -> Float:
    """Return the noise nu of the scores of blocks, (ny, nx): the variance of a score over its Hessian.

    `score` (c, ny, nx) are sums of gradient times residual, `trace` (ny, nx) the trace of the Hessian,
    `counts` (ny, nx) 1 for usable blocks, else 0. Scores and traces are summed over 5 x 5 blocks. nu is the
    squared score over the trace, each smoothed by a Gaussian of 6 blocks, divided by `freedom`, the fraction
    of the variance of scores that a fit leaves. Where the trace is small, nu approaches its mean over the
    image, or its median if `with_mismatches`, because mismatched blocks raise the mean.
    """
    complete = (_clusters(counts) > CLUSTER**2 - 0.5).astype(np.float32)
    square = np.zeros_like(trace)
    for part in score:
        square += np.square(_clusters(part * counts))
    square *= complete
    expected = _clusters(trace * counts) * complete
    total = float(square.sum(dtype=np.float64)) / max(float(expected.sum(dtype=np.float64)), 1e-30)
    if not complete.any():  # fall back to single blocks
        total = float(np.square(score * counts).sum()) / max(float((trace * counts).sum()), 1e-30)
    least_information = F(max(0.2 * float(expected.mean()), 1e-20))
    square, expected = _smoothed(square), _smoothed(expected)
    known = expected > least_information
    if with_mismatches and known.any():
        total = float(np.median(square[known] / expected[known]))
    out = (square + least_information * F(total)) / ((expected + least_information) * F(freedom))
    ny, nx = trace.shape
    return cv2.resize(np.maximum(out, F(1e-12)), (nx, ny), interpolation=cv2.INTER_LINEAR)


def trust_in_scores(score: Float, trace: Float, counts: Float) -> Float:
    """Return a weight of each block, (ny, nx): 1, or less where its score far exceeds the noise around it.
    A score (gradient times residual) is too large at edges of objects and where beads enter or leave.
    `noise_of_scores` describes the arguments."""
    square = np.sum([np.square(_clusters(part * counts)) for part in score], axis=0)
    information = _clusters(trace * counts)
    least = F(HOLE_INFORMATION) * information.mean()
    ratio = square / np.maximum(information, F(1e-20))
    # The median of 5 x 5 disjoint clusters is not raised by a small object. Squared scores are exponential
    # variables, whose median is log 2 times the mean.
    apart, known = (field[:: CLUSTER - 1, :: CLUSTER - 1] for field in (ratio, information > least))
    typical = np.median(apart[known]) if known.any() else F(0)
    around = cv2.medianBlur(np.where(known, apart, typical).astype(np.float32), CLUSTER) / F(np.log(2))
    around = cv2.resize(np.maximum(around, F(LEAST_NOISE) * typical), trace.shape[::-1])
    limit = np.where(information > least, F(MAX_MISFIT) * around, np.inf)
    trust = np.square(np.minimum(limit / np.maximum(ratio, F(1e-30)), F(1)))
    return cv2.erode(trust.astype(np.float32), np.ones((CLUSTER, CLUSTER), np.uint8))


def hole_mask(information: Float, typical_information: float) -> Mask:
    """Return a mask (ny, nx), True in holes, where the blocks measure the field poorly or not at all.
    In a hole, the mean of `information` (ny, nx), the inverse variance of blocks, over 7 x 7 blocks is at
    most 0.15 times `typical_information`."""
    return np.asarray(
        cv2.blur(np.asarray(information, np.float32), (7, 7)) <= HOLE_INFORMATION * typical_information
    )


def _clusters(field: Float) -> Float:
    """Return, for every block, the sum of a field (ny, nx) over the 5 x 5 blocks around it, (ny, nx)."""
    size = (CLUSTER, CLUSTER)
    return cv2.boxFilter(field, cv2.CV_32F, size, normalize=False, borderType=cv2.BORDER_REFLECT)


def _smoothed(field: Float) -> Float:
    """Return a field (ny, nx) smoothed by a Gaussian of 6 blocks, at every second row and column."""
    ny, nx = field.shape  # clusters around neighbouring blocks overlap, so every second one suffices
    half = cv2.resize(field, ((nx + 1) // 2, (ny + 1) // 2), interpolation=cv2.INTER_AREA)
    return cv2.GaussianBlur(half, (0, 0), 0.5 * SMOOTHING_RADIUS, borderType=cv2.BORDER_REFLECT)
