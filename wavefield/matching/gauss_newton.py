"""Block Gauss-Newton matching over a pyramid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wavefield.errors import FrameError
from wavefield.matching.assess import LastStep, assess, evaluation
from wavefield.matching.block_lattice import (
    block_weights,
    filtered,
    replace_outliers,
    slopes,
    smoothed,
    smoother_weights,
    step,
    subtract_slopes,
    subtract_strain,
    to_coarser,
    to_finer,
    window_weights,
)
from wavefield.matching.displacement import Displacement, Evaluation
from wavefield.matching.matching_gain import RESTORED_VARIANCE, displacement_area
from wavefield.matching.matching_kernels import (
    BLOCK,
    F,
    WorkSpace,
    final_sums,
    plain_sums,
    robust_sums,
    unweighted_sums,
    work_space,
)
from wavefield.matching.matching_settings import MatchSettings
from wavefield.matching.prepared import Level, PreparedImage, level_count, prepare
from wavefield.matching.search import search

# of the mean trace of the windowed Hessians: keeps steps small where images have little contrast
RIDGE_FRACTION = 0.01
MAX_STEP = 1.5  # px
_TYPICAL_AREA = displacement_area(1.5) - RESTORED_VARIANCE  # px^2: slopes within blocks depend little on it
Initial = Displacement | tuple[np.ndarray | float, np.ndarray | float] | None


def match(
    a: np.ndarray | PreparedImage,
    b: np.ndarray | PreparedImage,
    settings: MatchSettings | None = None,
    mask: np.ndarray | None = None,
    initial: Initial = None,
) -> Displacement:
    """Find the displacement of each block of image a to image b.

    Parameters
    ----------
    a, b : (h, w) array, or PreparedImage
        The two images; prepare an image that is used in several matches once.
    settings : MatchSettings, optional
        Default `MatchSettings.piv()`, which searches 16 px in each direction. For larger displacements give
        `search_x` and `search_y`; for few or weak particles a larger `window` and a lower `min_correlation`.
    mask : (h, w) bool, optional
        True where pixels of both images may be used; for images that are not prepared.
    initial : Displacement, or (u, v), optional
        First estimate, px: fields on the same lattice or two numbers. It replaces the search.

    Returns
    -------
    Displacement
        On blocks of 5 px: centres at 2, 7, 12 ... px. The lattice depends on the size of the image only.

    Raises
    ------
    FrameError
        If the images differ in size or cannot be matched.
    ValueError
        If a prepared image does not suit the settings, or `initial` does not suit the lattice.

    Notes
    -----
    Local least squares (Lucas-Kanade) iterated from coarse to fine: per block the sums of gx gx, gx gy, gy
    gy, gx r, gy r, with r the residual between a and b read through the displacement by quintic B-splines;
    Gaussian windows over the lattice of these sums; one 2 x 2 solve per block; outliers against 5 x 5
    medians; a flat smoother. Champagnat et al. (2011), Exp. Fluids 50, 1169.

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
    a, b = prepared_pair(a, b, settings, mask)
    u, v = _coarse(a, b, settings, initial)
    finest = _LevelPair(a.levels[0], b.levels[0], settings.smoother_sigma, settings)
    return _finest(finest, u, v, settings.iterations[-1])


def _coarse(
    a: PreparedImage, b: PreparedImage, settings: MatchSettings, initial: Initial
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement by the coarse levels alone, u and v (ny, nx) on the finest lattice, px."""
    top = min(len(a.levels), settings.levels) - 1
    u, v = _start(a.levels[top], b.levels[top], top, a.levels[0].blocks, settings, initial)
    for number in range(top, 0, -1):
        pair = _LevelPair(a.levels[number], b.levels[number], settings.coarse_smoother_sigma, settings)
        u, v = _plain_steps(pair, u, v, settings.iterations[settings.levels - 1 - number])
        u, v = (to_finer(field, a.levels[number - 1].blocks) for field in (u, v))
    return u, v


def prepared_pair(
    a: np.ndarray | PreparedImage,
    b: np.ndarray | PreparedImage,
    settings: MatchSettings,
    mask: np.ndarray | None,
) -> tuple[PreparedImage, PreparedImage]:
    """Two images prepared for these settings, if they are not yet, and of one size."""
    a, b = _prepared(a, settings, mask), _prepared(b, settings, mask)
    if a.shape != b.shape:
        raise FrameError(f"the images to match differ in size: {a.shape} and {b.shape}")
    return a, b


def _prepared(
    image: np.ndarray | PreparedImage, settings: MatchSettings, mask: np.ndarray | None
) -> PreparedImage:
    """The image prepared for these settings, if it is not yet."""
    if not isinstance(image, PreparedImage):
        return prepare(image, settings, mask)
    if mask is not None:
        raise ValueError("give the mask when preparing the image")
    if image.normalization != settings.normalization:
        raise ValueError(
            f"the image was prepared with normalization {image.normalization} px but the settings need "
            f"{settings.normalization}: prepare it with the settings of the match"
        )
    if len(image.levels) < level_count(image.shape, settings.levels):
        raise ValueError(
            f"the image was prepared with {len(image.levels)} levels but the settings need "
            f"{settings.levels}: prepare it with the settings of the match"
        )
    return image


def _start(
    a: Level, b: Level, levels: int, finest: tuple[int, int], settings: MatchSettings, initial: Initial
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement at the coarsest level to begin with, px of that level."""
    if initial is not None:
        u, v = (to_coarser(field, levels, a.blocks) for field in initial_fields(initial, finest))
        return u, v
    if settings.search_x is not None and settings.search_y is not None:
        factor = 2**levels
        x_range, y_range = (
            (int(np.floor(lo / factor)), int(np.ceil(hi / factor)))
            for lo, hi in (settings.search_x, settings.search_y)
        )
        return search(a, b, x_range, y_range, settings)
    return np.zeros(a.blocks, np.float32), np.zeros(a.blocks, np.float32)


def initial_fields(
    initial: Displacement | tuple[np.ndarray | float, np.ndarray | float], shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """The first estimate as two fields on the lattice, unknown parts filled with the median."""
    if isinstance(initial, Displacement):
        initial = initial.u, initial.v
    fields = []
    for value in initial:
        field = np.asarray(value, np.float32)
        if field.ndim and field.shape != shape:
            raise ValueError(f"initial is on a lattice of {field.shape} blocks but the image has {shape}")
        field = np.array(np.broadcast_to(field, shape))
        known = np.isfinite(field)
        if not known.all():
            field[~known] = np.median(field[known]) if known.any() else 0
        fields.append(field)
    return fields[0], fields[1]


class _LevelPair:
    """One pyramid level of two images: weights of the blocks, their windows, and steps with them."""

    def __init__(self, a: Level, b: Level, sigma: float, settings: MatchSettings) -> None:
        self.a, self.b, self.sigma, self.settings = a, b, sigma, settings
        self.masked = bool(a.good.size or b.good.size)
        self.weights = window_weights(settings.window)
        self.work = work_space(a.blocks[1])
        self.count: np.ndarray = np.zeros(a.blocks, np.float32)
        self.coverage: np.ndarray = self.count
        self.weighting: tuple[np.ndarray, np.ndarray] | None = None
        self._hessian: np.ndarray | None = None

    def update_weights(self, u: np.ndarray, v: np.ndarray) -> None:
        """Update `count` (1 for usable blocks, else 0), `coverage` (usable part of windows) and weights."""
        count = np.empty(u.shape, np.float32)
        block_weights(self.a.good, self.b.good, u, v, *self.b.shape, count)
        if np.array_equal(count, self.count):
            return
        self.count, self.coverage, self._hessian = count, filtered(count, self.weights), None
        if self.masked and self.sigma > 0:
            # so that large holes do not change their surroundings
            self.weighting = smoother_weights(np.maximum(self.coverage, F(1e-3)), self.sigma)

    @property
    def hessian(self) -> np.ndarray:
        """(3, ny, nx): the Hessian of a alone, over windows."""
        if self._hessian is None:
            self._hessian = self.windows(self.a.moments[:3] * self.count)
        return self._hessian

    def windows(self, fields: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """Fields filtered with the window."""
        out = np.empty_like(fields) if out is None else out
        for field, to in zip(fields, out):
            filtered(field, self.weights, to)
        return out

    def advance(
        self, u: np.ndarray, v: np.ndarray, hessian: np.ndarray, score: np.ndarray, number: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """One step, outliers replaced, smoothed; returns new u, v and where outliers were."""
        settings = self.settings
        u, v = u.copy(), v.copy()
        ridge = F(RIDGE_FRACTION) * F(hessian[0].mean() + hessian[2].mean()) + F(1e-12)
        step(hessian, score, ridge, F(settings.relaxation), F(MAX_STEP), u, v)
        # the first step of a level may still be far off
        outlier = replace_outliers(u, v, settings.max_deviation * (2 if number == 0 else 1))
        u, v = (smoothed(f, self.sigma, settings.smoother_order, self.weighting) for f in (u, v))
        return u, v, outlier


def _slopes(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Slopes within blocks of a displacement whose values represent the blocks' areas."""
    return slopes(u, v, _TYPICAL_AREA)


def last_sums(
    a: Level, b: Level, u: np.ndarray, v: np.ndarray, slope: np.ndarray, work: WorkSpace
) -> np.ndarray:
    """(12, ny, nx): the sums of `final_sums` without weights."""
    sums = np.empty((12, *u.shape), np.float32)
    unweighted_sums(a.padded, b.padded, u, v, slope, work, sums)
    sums[2:5] = a.moments[:3]
    return sums


def _plain_steps(pair: _LevelPair, u: np.ndarray, v: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Steps without weights per pixel: the Hessian is that of a alone."""
    for number in range(count):
        pair.update_weights(u, v)
        score = pair.windows(_plain_scores(pair, u, v, _slopes(u, v)))
        u, v, _ = pair.advance(u, v, pair.hessian, score, number)
    return u, v


def _plain_scores(pair: _LevelPair, u: np.ndarray, v: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """(2, ny, nx): sums of gx r and gy r of the usable blocks."""
    sums = np.empty((2, *u.shape), np.float32)
    plain_sums(pair.a.padded, pair.b.padded, u, v, pair.work, sums)
    subtract_slopes(sums, pair.a.moments, slope)
    sums *= pair.count
    return sums


def _finest(pair: _LevelPair, u: np.ndarray, v: np.ndarray, count: int) -> Displacement:
    """Steps of the finest level; the last one also measures correlation and uncertainty."""
    a, b, settings = pair.a, pair.b, pair.settings
    unweighted = 0 if settings.robust else count - 1
    u, v = _plain_steps(pair, u, v, unweighted)
    c2b2 = F(settings.robust**2 * settings.robust_beta**2 / 4)
    c2 = np.zeros(u.shape, np.float32)
    for number in range(unweighted, count):
        pair.update_weights(u, v)
        if settings.robust:
            kernel, fields = (robust_sums, 6) if number < count - 1 else (final_sums, 12)
            sums = np.empty((fields, *u.shape), np.float32)
            kernel(a.padded, b.padded, u, v, _slopes(u, v), c2, c2b2, pair.work, sums)
        else:
            sums = last_sums(a, b, u, v, _slopes(u, v), pair.work)
        sums *= pair.count
        windowed = np.empty_like(sums)
        if settings.robust:
            pair.windows(sums, windowed)
        else:
            pair.windows(sums[:2], windowed[:2])
            windowed[2:5] = pair.hessian
            pair.windows(sums[5:], windowed[5:])
        before = u, v
        u, v, outlier = pair.advance(u, v, windowed[2:5], windowed[:2], number)
        if settings.robust:
            c2 = _robust_scale(windowed[5], pair.coverage, settings)
    last = LastStep(sums, windowed, pair.coverage, u - before[0], v - before[1], outlier)
    return assess(a, b, u, v, last, settings)


def _robust_scale(rr: np.ndarray, coverage: np.ndarray, settings: MatchSettings) -> np.ndarray:
    """1 / (c s)^2 of the robust weights from the windowed sums of squared residuals."""
    variance = rr / (F(BLOCK * BLOCK) * np.maximum(coverage, F(1e-3)))
    least = F(1e-6) * F(variance.mean()) + F(1e-12)
    out: np.ndarray = 1 / (F(settings.robust**2) * np.maximum(variance, least))
    return out


def reevaluate(
    a: PreparedImage, b: PreparedImage, u: np.ndarray, v: np.ndarray, settings: MatchSettings
) -> Evaluation:
    """Evaluate the blocks of two images at a given displacement, without a step.

    Parameters
    ----------
    a, b : PreparedImage
        The two images.
    u, v : (ny, nx) array
        Displacement of every block, px.
    settings : MatchSettings
        Those of the match that gave the displacement.

    Returns
    -------
    Evaluation
        The blocks' scores, Hessians, correlation and reasons there.

    Raises
    ------
    FrameError, ValueError
        As for `match`.

    Notes
    -----
    b sampled at a displacement with slopes e_jk = dd_j/dx_k is strained. The images of beads only move and
    are not strained: the residual contains e_jk (delta_jk a + s^2 a_jk), with s^2 the variance of a bead's
    image; of a blurred texture s^2 e_jk a_jk alone. That is even around every bead, so that a complete bead
    contributes no score; beads cut by a block's edge do. So c e_jj a + s^2 e_jk a_jk is subtracted from the
    scores, here and in `scores_at`, with c from 0 to 1 and s^2 by least squares.

    Examples
    --------
    >>> import numpy as np, cv2
    >>> noise = np.random.default_rng(1).normal(128, 40, (200, 240)).astype(np.float32)
    >>> image = cv2.GaussianBlur(noise, (0, 0), 1.2)
    >>> a, b = (prepare(f, MatchSettings.piv()) for f in (image, np.roll(image, 3, 1)))
    >>> offset = np.full(a.levels[0].blocks, 2.9)
    >>> evaluated = reevaluate(a, b, offset, 0 * offset, MatchSettings.piv())
    >>> round(float((evaluated.score[0] / evaluated.hessian[0].clip(1e-9))[evaluated.valid].mean()), 1)
    0.1
    """
    a, b = prepared_pair(a, b, settings, None)
    pair = _LevelPair(a.levels[0], b.levels[0], settings.smoother_sigma, settings)
    u, v = initial_fields((u, v), pair.a.blocks)
    pair.update_weights(u, v)
    slope = _slopes(u, v)
    sums = last_sums(pair.a, pair.b, u, v, slope, pair.work)
    sums *= pair.count
    subtract_strain(sums[:2], pair.a.strain, slope, pair.count)
    none, windowed = np.zeros(u.shape, np.float32), np.empty_like(sums)
    pair.windows(sums[5:], windowed[5:])  # no step is taken
    last = LastStep(sums, windowed, pair.coverage, none, none, none > 0)
    return evaluation(pair.a, pair.b, u, v, last, settings)


def scores_at(
    found: Displacement, a: PreparedImage, b: PreparedImage, u: np.ndarray, v: np.ndarray
) -> Displacement:
    """Scores of the usable blocks at a displacement near the one that was found, for images of two cameras.

    Unlike `reevaluate` it does not assess the blocks again, which costs half as much: those that the match
    rejected stay rejected.

    Parameters
    ----------
    found : Displacement
        The match: the share of its Hessians that both images have in common is used again.
    a, b : PreparedImage
        Its two images.
    u, v : (ny, nx) array
        Displacement of every block, px.

    Returns
    -------
    Displacement
        The match at the given displacement, with the blocks' scores there and their Hessians, 0 where a block
        is not usable; the rest is unchanged.

    Raises
    ------
    FrameError, ValueError
        As for `match`.

    Examples
    --------
    >>> import numpy as np, cv2
    >>> noise = np.random.default_rng(1).normal(128, 40, (200, 240)).astype(np.float32)
    >>> image = cv2.GaussianBlur(noise, (0, 0), 1.2)
    >>> a, b = (prepare(f, MatchSettings.piv()) for f in (image, np.roll(image, 3, 1)))
    >>> found = match(a, b)
    >>> evaluated = scores_at(found, a, b, found.u - 0.1, found.v)
    >>> round(float((evaluated.score[0] / evaluated.hessian[0].clip(1e-9))[evaluated.valid].mean()), 1)
    0.1
    """
    a, b = prepared_pair(a, b, found.settings, None)
    pair = _LevelPair(a.levels[0], b.levels[0], found.settings.smoother_sigma, found.settings)
    u, v = initial_fields((u, v), pair.a.blocks)
    pair.update_weights(u, v)
    slope = _slopes(u, v)
    score = _plain_scores(pair, u, v, slope)
    subtract_strain(score, pair.a.strain, slope, pair.count)
    own = pair.a.moments[:3]
    shared = (found.hessian[0] + found.hessian[2]) / np.maximum(own[0] + own[2], F(1e-12))
    return replace(found, u=u, v=v, score=score, hessian=own * (shared * pair.count))
