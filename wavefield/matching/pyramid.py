"""Block Gauss-Newton matching over a pyramid: first estimate, steps, and assessment of the blocks.

`match` starts on the coarsest level (from a search over whole pixels, if the settings give ranges) and takes
Gauss-Newton steps on every level. `_assess` then decides which blocks are valid. For the MAP field,
`reevaluate` or `scores_at` evaluates the blocks again at a better displacement.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from wavefield.errors import FrameError
from wavefield.matching.blocks import (
    RELAXATION,
    SMOOTHER_ORDER,
    block_weights,
    filtered,
    replace_outliers,
    slopes,
    smoothed,
    smoother_weights,
    step,
    subtract_slopes,
    subtract_strain,
    to_finer,
    window_weights,
)
from wavefield.matching.kernels import (
    BLOCK,
    F,
    bead_scores,
    final_sums,
    plain_sums,
    shift_sums,
    work_space,
)
from wavefield.matching.prepared import NO_MASK, Level, PreparedImage, level_count, prepare
from wavefield.matching.settings import Displacement, MatchSettings, Reason
from wavefield.matching.spectrum import RESTORED_VARIANCE, displacement_area
from wavefield.parabola import parabola_vertex

# ridge over the mean trace of the windowed Hessians, which keeps steps small where images lack contrast
RIDGE_FRACTION = 0.01
MAX_STEP = 1.5  # px: longest step along each axis
# px^2: variance of the area that a block averages over, for beads of 1.5 px; displacement gradients depend
# little on it
_TYPICAL_AREA = displacement_area(1.5) - RESTORED_VARIANCE


def match(
    a: np.ndarray | PreparedImage,
    b: np.ndarray | PreparedImage,
    settings: MatchSettings | None = None,
) -> Displacement:
    """Find the displacement of each block of image a to image b.

    Parameters
    ----------
    a, b : (h, w) array, or PreparedImage
        The two images. Call `prepare` first for an image that has a mask or is matched several times.
    settings : MatchSettings, optional
        Default: `MatchSettings.piv()`, which searches 16 px in each direction. For few or faint particles set
        a larger `window` and a lower `min_correlation`.

    Returns
    -------
    Displacement
        Displacement u, v (ny, nx), px, on blocks of 5 x 5 px with centres at 2, 7, 12 ... px, and its
        validity. The lattice depends on the size of the image only.

    Raises
    ------
    FrameError
        If the images differ in size, are not grey, or are smaller than 20 x 20 px.
    ValueError
        If a prepared image was prepared with other settings.

    Notes
    -----
    The method is local least squares (Lucas-Kanade), iterated from coarse to fine: Champagnat et al. (2011),
    Exp. Fluids 50, 1169. Image b is sampled at the displacement by quintic B-splines, and sums over blocks
    are averaged by a Gaussian window. In each step, outliers are replaced by the median of 5 x 5 blocks, and
    the field is smoothed by 1 - (1 - G)^4.

    Examples
    --------
    >>> import numpy as np, cv2
    >>> noise = np.random.default_rng(1).normal(128, 40, (200, 240)).astype(np.float32)
    >>> image = cv2.GaussianBlur(noise, (0, 0), 1.2)
    >>> d = match(image, np.roll(image, (2, 3), (0, 1)))
    >>> round(float(np.median(d.u[d.valid])), 2), round(float(np.median(d.v[d.valid])), 2)
    (3.0, 2.0)
    """
    settings = MatchSettings.piv() if settings is None else settings
    a, b = _prepared(a, settings), _prepared(b, settings)
    if a.shape != b.shape:
        raise FrameError(f"the images to match differ in size: {a.shape} and {b.shape}")
    u, v = _coarse(a, b, settings)
    pair = _LevelPair(a.levels[0], b.levels[0], settings.smoother_sigma, settings)
    last = settings.iterations[-1] - 1
    before_u, before_v = _plain_steps(pair, u, v, last)
    sums = _last_sums(pair, before_u, before_v, _slopes(before_u, before_v))
    u, v, outlier = pair.advance(before_u, before_v, pair.windows(sums[:2]), last)
    return _assess(pair, u, v, sums, np.stack([u - before_u, v - before_v]), outlier)


def _coarse(a: PreparedImage, b: PreparedImage, settings: MatchSettings) -> tuple[np.ndarray, np.ndarray]:
    """Return the displacement u, v (ny, nx), px of the finest level, from the coarser levels alone.
    The coarsest level starts from a search over the ranges of the settings, or from 0 without ranges."""
    top = min(len(a.levels), settings.levels) - 1
    u = v = np.zeros(a.levels[top].blocks, np.float32)
    if settings.search_x is not None and settings.search_y is not None:
        x_range, y_range = (
            (int(np.floor(low / 2**top)), int(np.ceil(high / 2**top)))
            for low, high in (settings.search_x, settings.search_y)
        )
        u, v = _search(a.levels[top], b.levels[top], x_range, y_range, settings)
    for number in range(top, 0, -1):
        pair = _LevelPair(a.levels[number], b.levels[number], settings.coarse_smoother_sigma, settings)
        u, v = _plain_steps(pair, u, v, settings.iterations[settings.levels - 1 - number])
        u, v = (to_finer(field, a.levels[number - 1].blocks) for field in (u, v))
    return u, v


def _prepared(image: np.ndarray | PreparedImage, settings: MatchSettings) -> PreparedImage:
    """Return an image prepared for these settings. Raise ValueError if it was prepared for other settings."""
    if not isinstance(image, PreparedImage):
        return prepare(image, settings)
    levels = level_count(image.shape, settings.levels)
    if image.normalization != settings.normalization or len(image.levels) < levels:
        raise ValueError(
            f"the image was prepared with normalization {image.normalization} px and {len(image.levels)} "
            f"levels but the settings need {settings.normalization} px and {levels}: prepare it with the "
            "settings of the match"
        )
    return image


class _LevelPair:
    """Two images on one pyramid level, with the weights of their blocks and the Gauss-Newton step.
    `sigma` is the standard deviation of the smoother, in blocks."""

    def __init__(self, a: Level, b: Level, sigma: float, settings: MatchSettings) -> None:
        self.a, self.b, self.sigma, self.settings = a, b, sigma, settings
        self.weights = window_weights(settings.window)
        self.work = work_space(a.blocks[1])
        self.count: np.ndarray = np.zeros(a.blocks, np.float32)
        self.coverage: np.ndarray = self.count
        self.weighting: tuple[np.ndarray, np.ndarray] | None = None
        self._hessian: np.ndarray | None = None

    def update_weights(self, u: np.ndarray, v: np.ndarray) -> None:
        """Compute the block weights (1: usable, 0: not) at a displacement u, v (ny, nx), px.
        If a weight changes, the stored Hessian is dropped."""
        count = np.empty(u.shape, np.float32)
        block_weights(self.a.good, self.b.good, u, v, *self.b.shape, count)
        if np.array_equal(count, self.count):
            return
        self.count, self.coverage, self._hessian = count, filtered(count, self.weights), None
        if (self.a.good.size or self.b.good.size) and self.sigma > 0:
            # a weighted smoother, so that holes do not spoil their surroundings
            self.weighting = smoother_weights(np.maximum(self.coverage, F(1e-3)), self.sigma)

    @property
    def hessian(self) -> np.ndarray:
        """Window averages of gx gx, gx gy, gy gy of image a, (3, ny, nx); stored until weights change."""
        if self._hessian is None:
            self._hessian = self.windows(self.a.moments[:3] * self.count)
        return self._hessian

    def windows(self, fields: np.ndarray) -> np.ndarray:
        """Return averages of each of the fields (n, ny, nx) over Gaussian windows, (n, ny, nx)."""
        out = np.empty_like(fields)
        for field, to in zip(fields, out):
            filtered(field, self.weights, to)
        return out

    def advance(
        self, u: np.ndarray, v: np.ndarray, score: np.ndarray, number: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Take a Gauss-Newton step, replace outliers and smooth; return new u, v and the mask of outliers.
        `score` (2, ny, nx) is the window average of gradient times residual; `number` counts steps from 0."""
        hessian = self.hessian
        u, v = u.copy(), v.copy()
        ridge = F(RIDGE_FRACTION) * F(hessian[0].mean() + hessian[2].mean()) + F(1e-12)
        step(hessian, score, ridge, F(RELAXATION), F(MAX_STEP), u, v)
        # after the first step of a level, the displacement may still be far off
        outlier = replace_outliers(u, v, self.settings.max_deviation * (2 if number == 0 else 1))
        u, v = (smoothed(f, self.sigma, SMOOTHER_ORDER, self.weighting) for f in (u, v))
        return u, v, outlier


def _slopes(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the gradients du/dx, du/dy, dv/dx, dv/dy, (4, ny, nx), of a displacement u, v (ny, nx), px."""
    return slopes(u, v, _TYPICAL_AREA)


def _last_sums(pair: _LevelPair, u: np.ndarray, v: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Return the sums of `final_sums`, (12, ny, nx), with the Hessian of image a in planes 2 to 4.
    `slope` (4, ny, nx) are the gradients of u, v (ny, nx), px. The sums of unusable blocks are 0."""
    pair.update_weights(u, v)
    sums = np.empty((12, *u.shape), np.float32)
    final_sums(pair.a.padded, pair.b.padded, u, v, slope, pair.work, sums)
    sums[2:5] = pair.a.moments[:3]
    sums *= pair.count
    return sums


def _plain_steps(pair: _LevelPair, u: np.ndarray, v: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the displacement after `count` Gauss-Newton steps from u, v (ny, nx), px."""
    for number in range(count):
        pair.update_weights(u, v)
        sums = np.empty((2, *u.shape), np.float32)
        plain_sums(pair.a.padded, pair.b.padded, u, v, pair.work, sums)
        subtract_slopes(sums, pair.a.moments, _slopes(u, v))
        sums *= pair.count
        score = pair.windows(sums)
        u, v, _ = pair.advance(u, v, score, number)
    return u, v


def reevaluate(
    a: PreparedImage, b: PreparedImage, u: np.ndarray, v: np.ndarray, settings: MatchSettings
) -> Displacement:
    """Return a match that evaluates the blocks at a given displacement u, v (ny, nx), px, without a step.

    A displacement with gradients e_jk = du_j/dx_k strains the sampled images of beads, while real beads keep
    their shape. The residual a - b of beads then contains e_jj a + s^2 e_jk a_jk, with second derivatives
    a_jk of image a and the variance s^2 of a bead's image (for a blurred texture, only the second term). A
    complete bead adds nothing to the score (gradient times residual), but a bead that is cut by the edge of a
    block does. Therefore c e_jj a + s^2 e_jk a_jk, with 0 <= c <= 1, is fitted to the scores and subtracted.
    Repeated indices are summed.
    """
    pair = _LevelPair(a.levels[0], b.levels[0], settings.smoother_sigma, settings)
    slope = _slopes(u, v)
    sums = _last_sums(pair, u, v, slope)
    subtract_strain(sums[:2], pair.a.strain, slope, pair.count)
    no_step = np.zeros((2, *u.shape), np.float32)
    return _assess(pair, u, v, sums, no_step, no_step[0] > 0)


def scores_at(
    found: Displacement, a: PreparedImage, b: PreparedImage, u: np.ndarray, v: np.ndarray
) -> Displacement:
    """Return the match `found` of two cameras with scores and Hessians at a displacement u, v (ny, nx), px.

    A bead differs in brightness between cameras, so a block with a part of a bead would appear displaced.
    Every pixel therefore counts in the block that contains the brightest point of its bead. The validity of
    the blocks is that of `found`. Scores and Hessians are 0 in unusable blocks and the eight blocks around
    each.
    """
    pair = _LevelPair(a.levels[0], b.levels[0], found.settings.smoother_sigma, found.settings)
    pair.update_weights(u, v)
    block, hessian = pair.a.beads
    sums = np.empty((u.size, 2), np.float32)
    bead_scores(pair.a.padded, pair.b.padded, u, v, _slopes(u, v), block, pair.work, sums)
    # a bead extends into neighbouring blocks, which must be usable as well
    usable = cv2.erode(pair.count, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_REPLICATE)
    score = np.ascontiguousarray(sums.T).reshape(2, *u.shape) * usable
    own = pair.a.moments
    shared = (found.hessian[0] + found.hessian[2]) / np.maximum(own[0] + own[2], F(1e-12))
    return replace(found, u=u, v=v, score=score, hessian=hessian * (shared * usable))


def _search(
    a: Level, b: Level, x_range: tuple[int, int], y_range: tuple[int, int], settings: MatchSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Return the displacement u, v (ny, nx), px, from a search over whole-pixel shifts, refined by parabolas.
    `x_range` and `y_range` are the first and the last shift, px of this level."""
    ny, nx = a.blocks
    w = nx * BLOCK
    margin = max(abs(n) for n in (*x_range, *y_range)) + 1
    first = np.ascontiguousarray(a.image)
    second = cv2.copyMakeBorder(b.image, margin, margin, margin, margin, cv2.BORDER_CONSTANT, value=0)
    weights = window_weights(settings.search_window)
    border = len(weights) // 2
    n = x_range[1] - x_range[0] + 1
    correlation = np.empty((y_range[1] - y_range[0] + 1, ny, n, nx + 2 * border), np.float32)
    row = np.empty(w, np.float32)
    for dy, plane in enumerate(correlation, y_range[0]):
        shift_sums(first, second, margin, x_range[0], dy, row, plane)
        side_by_side = plane.reshape(ny, -1)
        filtered(side_by_side, weights, side_by_side)
    u, v = _peaks(correlation, border, x_range[0], y_range[0])
    for _ in range(2):
        replace_outliers(u, v, 2.0)
    return smoothed(u, 1.0, 1), smoothed(v, 1.0, 1)


def _peaks(correlation: np.ndarray, border: int, first_x: int, first_y: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the shift u, v (ny, nx), px, of largest correlation for each block, refined by parabolas.
    `correlation` is (row shifts, ny, column shifts, nx + 2 border), for shifts from first_x, first_y on."""
    rows, ny, n, width = correlation.shape
    nx = width - 2 * border
    by_block = correlation[..., border : border + nx].transpose(1, 3, 0, 2)
    best = by_block.reshape(ny, nx, rows * n).argmax(axis=-1)
    y, x = np.divmod(best, n)
    j, i = np.indices(best.shape)

    def at(dy: int, dx: int) -> np.ndarray:
        row, column = np.clip(y + dy, 0, rows - 1), np.clip(x + dx, 0, n - 1)
        return np.asarray(correlation[row, j, column, border + i])

    dx = np.clip(parabola_vertex(at(0, -1), at(0, 0), at(0, 1)), -0.5, 0.5)
    dy = np.clip(parabola_vertex(at(-1, 0), at(0, 0), at(1, 0)), -0.5, 0.5)
    inside_x, inside_y = (x > 0) & (x < n - 1), (y > 0) & (y < rows - 1)
    u, v = (x + first_x).astype(np.float32), (y + first_y).astype(np.float32)
    return u + np.where(inside_x, dx, F(0)), v + np.where(inside_y, dy, F(0))


def _assess(
    pair: _LevelPair, u: np.ndarray, v: np.ndarray, sums: np.ndarray, step: np.ndarray, outlier: np.ndarray
) -> Displacement:
    """Return a match with displacement u, v (ny, nx), px, and correlation, score and validity of its blocks.
    `sums` (12, ny, nx) come from `_last_sums`, before `step` (2, ny, nx), px, was added to u, v. `outlier`
    (ny, nx) is True where the median of the neighbours replaced the displacement."""
    windowed = pair.windows(sums[5:])
    correlation, energy = _correlation(windowed, pair.coverage)
    # `sums` holds the Hessian of image a, noise included. `ratio` is the common gradient energy over that of
    # the mean image; the fraction of a's energy that both images share is ratio / (2 - ratio).
    ratio = np.clip(windowed[5] / np.maximum(windowed[6], F(1e-12)), F(0), F(1))
    hessian = sums[2:5] * (ratio / (F(2) - ratio))
    xx, xy, yy = hessian
    # the score is extrapolated over the last step
    score = sums[:2] - np.stack([xx * step[0] + xy * step[1], xy * step[0] + yy * step[1]])
    reason = _reasons(pair, u, v, outlier, correlation, energy)
    return Displacement(u, v, correlation, reason, pair.settings, score, hessian)


def _correlation(windowed: np.ndarray, coverage: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the normalised correlation and the gradient energy ga gb of windows, each (ny, nx).
    `windowed` (7, ny, nx) are window averages of the sums of `_strip_sums`, with gradients ga, gb of the two
    images; `coverage` (ny, nx) is the usable fraction of each window."""
    rr, sa, aa, sr, ar, ab = windowed[:6]
    power = float(aa.mean() / F(BLOCK * BLOCK))
    least = F((1e-4 * power + 1e-12) ** 2)
    n = F(1) / (np.maximum(coverage, F(1e-3)) * F(BLOCK * BLOCK))
    a, r = sa * n, sr * n
    var_a = np.maximum(aa * n - a * a, F(0))
    covariance = ar * n - a * r
    var_b = np.maximum(var_a - F(2) * covariance + (rr * n - r * r), F(0))
    correlation = (var_a - covariance) / np.sqrt(np.maximum(var_a * var_b, least))
    return np.clip(correlation, F(-1), F(1)), ab * n


def _reasons(
    pair: _LevelPair,
    u: np.ndarray,
    v: np.ndarray,
    outlier: np.ndarray,
    correlation: np.ndarray,
    energy: np.ndarray,
) -> np.ndarray:
    """Return why blocks are not valid at the displacement u, v (ny, nx), px: bits of `Reason`, (ny, nx).
    `correlation` and `energy` (gradient energy) come from `_correlation`; `_assess` describes `outlier`."""
    settings, shape = pair.settings, pair.b.shape
    inside, weight = np.empty((2, *u.shape), np.float32)
    block_weights(NO_MASK, NO_MASK, u, v, *shape, inside)
    block_weights(pair.a.good, pair.b.good, u, v, *shape, weight)
    sparse = energy[::3, ::3][weight[::3, ::3] > 0]  # every third block suffices for a median
    typical = float(np.median(sparse)) if sparse.size else 0.0
    least = F(max(settings.min_gradient_energy * typical, 1e-12))
    rejected = {
        Reason.EDGE: inside == 0,
        Reason.MASKED: (weight == 0) & (inside > 0),
        Reason.TEXTURE: energy <= least,
        Reason.CORRELATION: correlation < F(settings.min_correlation),
        Reason.NEIGHBOURS: outlier,
    }
    if settings.search_x is not None and settings.search_y is not None:
        slack = 2.0 ** (settings.levels - 1)  # px of the finest level in one of the coarsest
        limits = (u, settings.search_x), (v, settings.search_y)
        rejected[Reason.RANGE] = np.logical_or.reduce(
            [(field < low - slack) | (field > high + slack) for field, (low, high) in limits]
        )
    reason = np.zeros(u.shape, np.uint8)
    for bit, blocks in rejected.items():
        reason[blocks] |= np.uint8(bit)
    return reason
