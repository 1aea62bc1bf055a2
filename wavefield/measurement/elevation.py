"""Elevation in one frame: match pairs of cameras, estimate the most probable (MAP) field, read the nodes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield import matching
from wavefield.errors import CalibrationError
from wavefield.matching import Reason
from wavefield.matching.blocks import CLUSTER, noise_of_scores
from wavefield.matching.map_field import Modes
from wavefield.matching.pyramid import reevaluate, scores_at
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.images import prepare, ready, usable
from wavefield.measurement.model import MAX_EVALUATIONS, Convergence, FieldModel
from wavefield.measurement.regrid import blocks_below, local_coefficients, push_pull, read_surface
from wavefield.robust import robust_std
from wavefield.variables import Quality

Float = NDArray[np.floating]
Mask = NDArray[np.bool_]
PreparedImages = Mapping[str, matching.PreparedImage]

NEVER_REJECTED_PX = 0.3  # epipolar error that is always accepted, because calibrations have as much
_SMOOTH_MODES = 6  # cosines along each side: epipolar errors as smooth as these come from the calibration
NOISE_MARGIN = 1.5  # factor on the noise across the sight lines, because learned spectra contain some noise
MIN_MEASURED = 0.2  # least fraction of the common view with valid blocks; below, there is no surface
MAX_PAIR_DIFFERENCE_PX = 1.5  # largest difference between the elevations of two pairs, as parallax
_PAIR_MEAN_BLOCKS = (5, 5)  # blocks over which this difference is averaged
_SCORE_MEAN_BLOCKS = (9, 9)  # blocks over which scores are averaged: noise is below a third of the next limit
_MAX_SCORE_DIFFERENCE_PX = 0.75  # largest difference between two pairs' corrections, as parallax
_MIN_RELATIVE_HESSIAN = 0.3  # times the mean Hessian: blocks with less do not determine z
_WINDOW_REACH = np.ones((5, 5), np.uint8)  # blocks that share the window of one block


@dataclass(frozen=True)
class PairMatch:
    """Displacement between the rectified images of two cameras (a pair), for each block of the lattice."""

    pair: tuple[str, str]  # the cameras (a, b); the lattice is in apparent positions of a
    difference: Float  # (2, ny, nx): d = x_b - x_a, difference of the apparent positions, metres
    parallax: Float  # (2, ny, nx): dD = D_b - D_a, each at its own apparent position
    eps_y: Float  # (ny, nx): epipolar error, metres
    rejected: NDArray[np.uint16]  # (ny, nx): bits of `Quality`: why a block is not valid; 0 if it is
    matched: NDArray[np.bool_]  # (ny, nx): valid except for the test of the epipolar error
    found: matching.Displacement  # the match itself, px

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Mask (ny, nx), True for blocks whose match was not rejected."""
        return np.asarray(self.rejected == 0)

    @property
    def height(self) -> Float:
        """Elevation z = -dD . d / |dD|^2, (ny, nx), metres, with d = `difference`, dD = `parallax`."""
        out: Float = -np.sum(self.parallax * self.difference, axis=0)
        out /= np.sum(np.square(self.parallax), axis=0)
        return out

    @property
    def turned(self) -> PairMatch:
        """This match with parallaxes turned by 90 degrees: its `height` is epipolar error / |dD|, m."""
        return replace(self, parallax=quarter_turn(self.parallax))


def quarter_turn(vector: Float) -> Float:
    """Return vectors, x and y components (2, ny, nx), turned by 90 degrees from the x to the y axis."""
    return np.stack([-vector[1], vector[0]])


def match_pair(
    a: matching.PreparedImage, b: matching.PreparedImage, pair: tuple[str, str], geometry: GridGeometry
) -> PairMatch:
    """Match the rectified images a, b of two cameras; reject blocks with implausible z or epipolar error.

    A point at elevation z appears on the plane z = 0 at x_a and x_b; its sight lines have the slopes D_a and
    D_b. With d = x_b - x_a and dD = D_b - D_a, z = -(dD . d) / |dD|^2; the epipolar error is eps_Y = (dD_y
    d_x - dD_x d_y) / |dD|.
    """
    found = matching.match(a, b, geometry.stereo_settings(pair))
    d = np.stack([found.u, found.v]) * np.float32(geometry.pixel)
    x, y = (v.astype(np.float32) for v in np.meshgrid(geometry.lattice.x, geometry.lattice.y))
    centre_a, centre_b = (geometry.rig[name].centre for name in pair)
    parallax = _sight_line(centre_b, x + d[0], y + d[1]) - _sight_line(centre_a, x, y)
    length = np.sqrt(parallax[0] ** 2 + parallax[1] ** 2)
    eps_y = (parallax[1] * d[0] - parallax[0] * d[1]) / length
    z = -(parallax[0] * d[0] + parallax[1] * d[1]) / length**2
    rejected = why_rejected(found.reason)
    rejected[(z < geometry.z_range[0]) | (z > geometry.z_range[1])] |= np.uint16(Quality.REJECTED_RANGE)
    matched = rejected == 0
    if matched.any():
        settings = geometry.settings
        limit = max(settings.eps_limit * robust_std(eps_y[matched]), NEVER_REJECTED_PX * geometry.pixel)
        rejected[np.abs(eps_y) > limit] |= np.uint16(Quality.REJECTED_EPS)
    return PairMatch(pair, d, parallax, eps_y, rejected, matched, found)


def _sight_line(centre: Float, x: Float, y: Float) -> Float:
    """Return the slopes dx/dz, dy/dz of the lines from a camera's `centre` to x, y on z = 0, (2, ny, nx)."""
    depth = np.float32(-centre[2])
    return np.stack([(x - np.float32(centre[0])) / depth, (y - np.float32(centre[1])) / depth])


def why_rejected(reason: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Convert the `Reason` bits (from matching) of rejected blocks to bits of `Quality`, (ny, nx)."""
    out = np.zeros(reason.shape, np.uint16)
    known = int(Reason.NEIGHBOURS | Reason.RANGE)
    for bits, flag in (
        (~known & 0xFF, Quality.REJECTED_CORRELATION),
        (int(Reason.NEIGHBOURS), Quality.REJECTED_NEIGHBOURS),
        (int(Reason.RANGE), Quality.REJECTED_RANGE),
    ):
        out[(reason & np.uint8(bits)) != 0] |= np.uint16(flag)
    return out


@dataclass(frozen=True)
class Blocks:
    """Elevation of each block by least squares over the pairs of cameras, without a prior."""

    z: Float  # (ny, nx): elevation, metres; NaN where no pair is valid
    eps_y: Float  # (ny, nx): epipolar error, metres; NaN where no pair is valid
    valid: Mask  # (ny, nx): where at least one pair is valid
    rejected: NDArray[np.uint16]  # (ny, nx): bits of `Quality`: why no pair is valid

    @property
    def filled(self) -> Float:
        """Elevation, (1, ny, nx), metres; blocks without a value get averages of blocks nearby."""
        return push_pull(self.z[None], self.valid)


def combine(matches: Sequence[PairMatch]) -> Blocks:
    """Return the elevation of each block, by least squares over the pairs that have a valid match there.
    It is z = -sum dD . d / sum |dD|^2, with displacement d and parallax dD of each pair (`match_pair`)."""
    shape = matches[0].eps_y.shape
    along, across, square, length = np.zeros((4, *shape), np.float32)
    rejected = np.zeros(shape, np.uint16)
    for m in matches:
        Dx, Dy = m.parallax * m.valid
        along += Dx * m.difference[0] + Dy * m.difference[1]
        own = Dx * Dx + Dy * Dy
        square += own
        own = np.sqrt(own)
        length += own
        across += own * m.eps_y
        rejected |= m.rejected
    valid = square > 0
    rejected[valid] = 0
    nan, one = np.float32(np.nan), np.float32(1.0)
    z = np.where(valid, -along / np.where(valid, square, one), nan)
    return Blocks(z, np.where(valid, across / np.where(valid, length, one), nan), valid, rejected)


@dataclass
class ElevationEstimate:
    """Most probable (MAP) elevation in one frame: a cosine series, `waves`, plus a smooth field, `edges`."""

    waves: Float  # (1, my, mx): cosine coefficients, metres
    edges: Float = field(repr=False)  # (1, ny, nx): smooth part (`Modes.split`), metres
    information: Float = field(repr=False)  # (ny, nx): information A of every block, per square metre
    noise: float  # mean variance of the scores per unit of their Hessian
    # rms of the smooth epipolar error, as metres of elevation; it comes from the calibration, whose error
    # along the sight lines is assumed to be as large
    epipolar: float
    inconsistent: Mask = field(repr=False)  # (ny, nx): where pairs contradict each other


def map_elevation(
    blocks: Blocks,
    matches: Sequence[PairMatch],
    prepared: PreparedImages,
    modes: Modes,
    pixel: float,
    whole_beads: bool,
    noise_across: bool = True,
) -> ElevationEstimate:
    """Estimate the most probable (MAP) elevation from the matches of all pairs; `blocks` is from `combine`.
    A block has, for z, the score -dD . s and Hessian dD H dD, from the score s (gradient times residual) and
    Hessian H of its displacement and the parallax dD, px per m. Noise is measured across the sight lines, or,
    if not `noise_across`, from scores for z. `pixel` is the side of a rectified pixel, m. With `whole_beads`,
    a bead counts in one block only."""
    z = blocks.filled
    edges, waves = modes.split(z)
    pairs = [_PairScores(m, pixel) for m in matches]
    smooth, epipolar = _smooth_across(matches, modes)
    block_mean, scores = None, [z[0]]
    information = z[:1]
    convergence = Convergence(float(np.sqrt(np.mean([np.square(one.D).sum(axis=0) for one in pairs]))))
    for number in range(MAX_EVALUATIONS):
        if number:
            z = block_mean + edges
            for one in pairs:
                one.reevaluate(z[0], prepared, whole_beads)
        scores = [one.score(z[0]) for one in pairs]
        score = np.sum(scores, axis=0)
        hessian = np.sum([one.hessian for one in pairs], axis=0)
        # The scores are summed over the pairs before the noise is estimated: the pairs share the noise of the
        # reference, which cancels between cameras on opposite sides. Across the sight lines there is only
        # noise, once the smooth part (an error of the calibration) is subtracted.
        nu = _noise_across(pairs, smooth) if noise_across else _noise(score, hessian, modes.freedom)
        information = (hessian / nu)[None]
        right = information * (z - edges) + (score / nu)[None]
        if not number:
            factor, tolerances = modes.factor(information[0]), modes.tolerances(information[0])
        solved = modes.solve(information, right, waves, tolerances[min(number, 1)], factor, block_mean)
        waves, block_mean = convergence.next(modes, waves, solved, block_mean)
        if convergence.converged:
            break
    lengths = [np.hypot(*one.D) for one in pairs]
    inconsistent = inconsistent_scores(scores, [one.hessian for one in pairs], lengths)
    return ElevationEstimate(waves, edges, information[0], float(nu.mean()), epipolar, inconsistent)


def first_information(blocks: Blocks, matches: Sequence[PairMatch], pixel: float) -> float:
    """Return the mean inverse variance of z, m^-2, of blocks that contain information, without a prior."""
    pairs = [_PairScores(m, pixel) for m in matches]
    z = blocks.filled[0]
    hessian = np.sum([one.hessian for one in pairs], axis=0)
    score = np.sum([one.score(z) for one in pairs], axis=0)
    known = hessian > 0
    return float((hessian / _noise(score, hessian, 1.0))[known].mean()) if known.any() else 0.0


def _noise(score: Float, hessian: Float, freedom: float) -> Float:
    """Return the variance of scores (gradient times residual) divided by their Hessian, (ny, nx)."""
    return noise_of_scores(score[None], hessian, (hessian > 0).astype(np.float32), freedom)


def _noise_across(pairs: Sequence[_PairScores], smooth: Float) -> Float:
    """Return NOISE_MARGIN times the variance of scores across sight lines over their Hessian, (ny, nx).
    `smooth` (ny, nx), metres, the smooth epipolar error due to calibration, is subtracted first."""
    parts = [one.across(smooth) for one in pairs]
    score, hessian = (np.sum(part, axis=0) for part in zip(*parts, strict=True))
    return np.float32(NOISE_MARGIN) * _noise(score, hessian, 1.0)


def _smooth_across(matches: Sequence[PairMatch], modes: Modes) -> tuple[Float, float]:
    """Return a tuple: the smooth part of the epipolar error, (ny, nx), as metres of z, and its rms, metres.
    The rms excludes noise, and is reduced by the gain of the prior, like an equal error of z."""
    waves = modes.waves(combine([m.turned for m in matches]).filled)
    smooth = np.zeros_like(waves)
    smooth[:, :_SMOOTH_MODES, :_SMOOTH_MODES] = waves[:, :_SMOOTH_MODES, :_SMOOTH_MODES]
    # the gain of the MAP field: the same error along the sight lines would be reduced by it
    precision = np.square(modes.foot) * np.float32(modes.prior.information)
    kept = waves * precision / (precision + modes.inverse)
    near, all_of_them = (
        float(np.sum(np.square(kept[0, :n, :n]))) for n in (_SMOOTH_MODES, 3 * _SMOOTH_MODES // 2)
    )
    square = near - (all_of_them - near) / 1.25  # the shorter modes are 1.25 times as many
    return np.asarray(modes.field(smooth)[0]), float(np.sqrt(max(square, 0.0) / np.prod(modes.lattice)))


class _PairScores:
    """Scores (gradient times residual) of one pair of cameras and their Hessians, with respect to z."""

    def __init__(self, match: PairMatch, pixel: float) -> None:
        self.match, self.found = match, match.found
        self.D = match.parallax / np.float32(pixel)
        self.here = self._height = match.height
        self._weigh()

    def _weigh(self) -> None:
        """Set `hessian` (ny, nx), half the second derivative of a block's squared residual by z, or 0."""
        self._hessian = self.found.hessian * self.match.valid
        self.hessian = _through(self.D, self._hessian)

    def reevaluate(self, z: Float, prepared: PreparedImages, whole_beads: bool) -> None:
        """Compute scores and Hessians again for images shifted according to the elevation z (ny, nx), metres.
        With `whole_beads`, a bead counts in one block only (`scores_at`)."""
        rise = z - self._height
        a, b = (prepared[name] for name in self.match.pair)
        u, v = self.match.found.u - self.D[0] * rise, self.match.found.v - self.D[1] * rise
        found, self.here = self.match.found, z
        self.found = scores_at(found, a, b, u, v) if whole_beads else reevaluate(a, b, u, v, found.settings)
        self._weigh()

    def score(self, z: Float) -> Float:
        """Return scores (gradient times residual) at z (ny, nx), m, extrapolated from the last evaluation."""
        return self._score(self.D, self.hessian, self.here - z)

    def across(self, smooth: Float) -> tuple[Float, Float]:
        """Return a tuple: scores and Hessians, each (ny, nx), of displacements across the sight lines.
        Elevation does not cause these displacements. The part `smooth` (ny, nx), m of z, is subtracted."""
        D = quarter_turn(self.D)
        hessian = _through(D, self._hessian)
        return self._score(D, hessian, self.match.turned.height - smooth), hessian

    def _score(self, D: Float, hessian: Float, rise: Float) -> Float:
        s = self.found.score
        return np.asarray(hessian * rise - (D[0] * s[0] + D[1] * s[1]) * self.match.valid)


def _through(D: Float, h: Float) -> Float:
    """Return D . h D, (ny, nx), for vectors D (2, ny, nx) and symmetric h (3, ny, nx): xx, xy, yy."""
    return np.asarray(D[0] ** 2 * h[0] + 2 * D[0] * D[1] * h[1] + D[1] ** 2 * h[2])


def inconsistent_pairs(matches: Sequence[PairMatch], pixel: float) -> Mask:
    """Return a mask (ny, nx), True where one pair and the next in `matches` differ in z by over 1.5 px.
    This finds errors larger than a bead, which scores do not show. `pixel` is the side of a pixel, metres."""
    out = np.zeros(matches[0].eps_y.shape, bool)
    for one, other in pairwise(matches):
        lengths = (np.sqrt(np.sum(np.square(m.parallax), axis=0)) for m in (one, other))
        both = (one.valid & other.valid).astype(np.float32)
        difference = (one.height - other.height) * np.minimum(*lengths) / np.float32(pixel)
        mean = cv2.blur(np.where(both > 0, difference, np.float32(0)), _PAIR_MEAN_BLOCKS)
        limit = np.float32(MAX_PAIR_DIFFERENCE_PX)
        out |= np.abs(mean) > limit * np.maximum(cv2.blur(both, _PAIR_MEAN_BLOCKS), np.float32(0.2))
    return widened(out)


def inconsistent_scores(scores: Sequence[Float], hessians: Sequence[Float], lengths: Sequence[Float]) -> Mask:
    """Return a mask (ny, nx), True where successive pairs demand different corrections of the elevation.
    This finds shifts of one pixel. `scores` (gradient times residual) and `hessians` are with respect to z;
    `lengths` (ny, nx) of the parallaxes are in px/m. Each sequence is by pair."""
    means = [
        (cv2.blur(s, _SCORE_MEAN_BLOCKS), cv2.blur(h, _SCORE_MEAN_BLOCKS))
        for s, h in zip(scores, hessians, strict=True)
    ]
    # At the common surface only noise is left. Its std is 0.02 to 0.07 px on bright and on dark images, at
    # most 0.36 px. Matches may differ by more than a bead's width, which scores do not show.
    out = np.zeros(scores[0].shape, bool)
    for ((s, h), a), ((t, g), b) in pairwise(zip(means, lengths, strict=True)):
        least = np.float32(_MIN_RELATIVE_HESSIAN)
        usable = (h > least * h.mean()) & (g > least * g.mean())
        heights = [np.divide(p, q, out=np.zeros_like(p), where=usable) for p, q in ((s, h), (t, g))]
        difference = (heights[0] - heights[1]) * np.minimum(a, b)
        out |= np.abs(difference) > np.float32(_MAX_SCORE_DIFFERENCE_PX)
    return widened(out)


def widened(where: Mask) -> Mask:
    """Extend the True areas of a mask (ny, nx) by two blocks, as far as a matching window reaches."""
    return np.asarray(cv2.dilate(where.view(np.uint8), _WINDOW_REACH) > 0)


MatchedPairs = tuple[Blocks, list[PairMatch]]


@dataclass(frozen=True)
class Surface:
    """Elevation in one frame, at the nodes of the grid, with variances and quality flags."""

    z: Float  # (ny, nx): elevation, metres
    eps_y: Float  # (ny, nx): epipolar error, metres
    noise: Float  # (ny, nx): variance of z due to noise, m^2
    missing: Float  # (ny, nx): variance of waves that the prior suppresses, m^2
    epipolar: float  # rms of the smooth epipolar error as elevation, or of z in a light sheet, metres
    quality: NDArray[np.uint16]  # (ny, nx): bits of `Quality`: measured or filled, and why it was rejected
    inconsistent: Mask  # (ny, nx): where pairs of cameras give different elevations
    # read(x, y): elevation at points x, y (ny, nx), one near each node, metres
    read: Callable[[Float, Float], Float] = field(repr=False)
    # is_measured(x, y, z): whether the surface was measured at these points
    is_measured: Callable[[Float, Float, Float], Mask] = field(repr=False)


def surface(prepared: PreparedImages, geometry: GridGeometry, model: FieldModel) -> Surface | None:
    """Measure z at the nodes from rectified images; None if too few blocks match. A light sheet has z = 0."""
    if geometry.settings.sheet_thickness is not None:
        return _sheet(geometry.grid.shape, geometry.settings.sheet_thickness)
    found = match_pairs(prepared, geometry)
    return None if found is None else surface_of(*found, prepared, geometry, model)


def surface_of(
    blocks: Blocks,
    matches: Sequence[PairMatch],
    prepared: PreparedImages,
    geometry: GridGeometry,
    model: FieldModel,
) -> Surface:
    """Estimate the elevation at the nodes; `blocks` and `matches` are the two results of `match_pairs`."""
    estimate = map_elevation(blocks, matches, prepared, model.modes, geometry.pixel, model.whole_beads)
    spline = model.splined(estimate.waves, estimate.edges)
    (noise,), (missing,) = model.spread(estimate.information)
    noise /= np.float32(NOISE_MARGIN)
    lattice, centre = geometry.lattice, geometry.rig[matches[0].pair[0]].centre

    def read(x: Float, y: Float) -> Float:
        return read_surface(spline, lattice, centre, x, y)

    z = read(geometry.x, geometry.y)
    block, _ = blocks_below(lattice, centre, geometry.x, geometry.y, z)
    inconsistent = inconsistent_pairs(matches, geometry.pixel) | estimate.inconsistent
    quality = np.where(blocks.valid, np.uint16(Quality.MEASURED), np.uint16(Quality.FILLED))
    quality |= blocks.rejected
    measured = ((quality & Quality.MEASURED) > 0) & ~inconsistent

    def is_measured(x: Float, y: Float, z: Float) -> Mask:
        below, inside = blocks_below(lattice, centre, x, y, z)
        return np.asarray(measured.ravel()[below] & inside)

    return Surface(
        z,
        blocks.eps_y.ravel()[block],
        noise.ravel()[block],
        missing.ravel()[block],
        estimate.epipolar,
        quality.ravel()[block],
        inconsistent.ravel()[block],
        read,
        is_measured,
    )


def _sheet(shape: tuple[int, int], thickness: float) -> Surface:
    """Return the surface for a light sheet: all nodes (ny, nx) have z = 0 and count as measured.
    The standard deviation of z is taken as a quarter of the `thickness`, metres."""
    z = np.zeros(shape, np.float32)
    quality, inconsistent = np.full(shape, Quality.MEASURED, np.uint16), np.zeros(shape, bool)
    unknown = np.full_like(z, np.nan)
    return Surface(
        z,
        unknown,
        z,
        z,
        0.25 * thickness,
        quality,
        inconsistent,
        lambda x, y: z,
        lambda x, y, z: ~inconsistent,
    )


def match_pairs(prepared: PreparedImages, geometry: GridGeometry) -> MatchedPairs | None:
    """Return a tuple for one frame: blocks combined from all pairs of cameras, and the match of each pair.
    None if too few blocks match, even without the reference camera, whose image may be blank."""
    present = tuple(prepared)
    while pairs := geometry.pairs_for(present):
        reference = pairs[0][0]
        least = MIN_MEASURED * np.sum(geometry.views[reference].visible_blocks > 0.5)
        matches = [match_pair(prepared[a], prepared[b], (a, b), geometry) for a, b in pairs]
        matches = [m for m in matches if m.valid.sum() >= least] or matches
        blocks = combine(matches)
        if blocks.valid.sum() >= least:
            return blocks, matches
        # the frame of the reference may be blank: try again without it
        present = tuple(n for n in present if n != reference)
    return None


def windowed(matches: Sequence[PairMatch], geometry: GridGeometry) -> Float:
    """Return z at the nodes, (ny, nx), m, from matches alone, without a prior; NaN where no pair is valid."""
    blocks = combine(matches)
    if not blocks.valid.any():
        return np.full(geometry.grid.shape, np.nan, np.float32)
    spline, centre = local_coefficients(blocks.filled), geometry.rig[matches[0].pair[0]].centre
    z = read_surface(spline, geometry.lattice, centre, geometry.x, geometry.y)
    block, _ = blocks_below(geometry.lattice, centre, geometry.x, geometry.y, z)
    return np.where(blocks.valid.ravel()[block], z, np.float32(np.nan))


def matched_pixels(
    read: Callable[[str, int], NDArray[Any] | None],
    frames: Sequence[int],
    geometry: GridGeometry,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, NDArray[np.float64]]:
    """Match points of still water in all cameras, to level a rig; return pixel positions (n, 2) by camera.
    Columns are x, y in the image. Row n is the same point in all cameras, NaN where not matched.
    `read(camera, frame)` gives an image or None; `progress(done, total)` is called after each frame.
    CalibrationError if no frame is usable in all cameras."""
    rig = geometry.rig
    cells = np.s_[::CLUSTER, ::CLUSTER]  # closer blocks share beads
    x, y = (v[cells] for v in np.meshgrid(geometry.lattice.x, geometry.lattice.y))
    parts: dict[str, list[NDArray[np.float64]]] = {name: [] for name in geometry.surface_cameras}
    for done, index in enumerate(frames, 1):
        images = {name: read(name, index) for name in geometry.surface_cameras}
        if all(usable(image, rig[name].size) for name, image in images.items()):
            flat = {
                name: prepare(ready(np.asarray(image), geometry.sights[name].binning), name, geometry)
                for name, image in images.items()
            }
            valid = np.zeros(x.shape, bool)
            found = {}
            for a, b in geometry.pairs:
                match = match_pair(flat[a], flat[b], (a, b), geometry)
                dx, dy = (np.where(match.matched, d, np.nan)[cells] for d in match.difference)
                found[b] = np.stack(rig[b].project(x + dx, y + dy, 0.0), axis=-1)
                valid |= match.matched[cells]
            found[geometry.reference] = np.stack(rig[geometry.reference].project(x, y, 0.0), axis=-1)
            for name, pixels in found.items():
                parts[name].append(pixels[valid])
        if progress:
            progress(done, len(frames))
    if not any(parts.values()):
        raise CalibrationError(
            f"none of the {len(frames)} frames tried is there, and of the rig's size, in all of "
            f"{', '.join(parts)}: no points to match"
        )
    return {name: np.concatenate(pixels) for name, pixels in parts.items()}
