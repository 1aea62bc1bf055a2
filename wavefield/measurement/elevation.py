"""Elevation of one instant: the most probable one that all pairs of cameras together have."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield import matching
from wavefield.matching import Modes
from wavefield.measurement.camera_jitter import of_elevation
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.model import Model
from wavefield.measurement.outlier_detection import pairs_apart, scores_apart
from wavefield.measurement.pair_surface import PairMatch, match_pair
from wavefield.measurement.regrid import coefficients, push_pull, read_surface
from wavefield.variables import Quality

Float = NDArray[Any]
Mask = NDArray[np.bool_]

EVALUATIONS = 2  # at the images: where matching led, and where the first solution leads
MAX_LOOKS = 6  # where windows have left much of short steep waves and solutions still change
MAX_CHANGE = 0.15  # px, rms, of the displacement from one solution to the next that is taken for converged
MAX_RELATIVE_CHANGE = 0.05  # of the displacement's own rms: the same where there are short waves alone
NEGLIGIBLE_CHANGE = 0.05  # px, rms: a smaller one is always taken for converged
_SLOW = 0.7  # of the change before: solutions that change by more go to and fro
_FEW = 50  # blocks: fewer do not tell how pairs differ
_SMOOTH = 6  # half waves along the lattice: sight lines that miss each other so smoothly are ill calibrated
_CAREFUL = 1.5  # weights think the noise so much larger than across the sight lines: spectra hold some of it
_AT_RIMS = 3.0  # times more noise is thought around a hole
_LONGER = 1.05  # noise of z over that across the sight lines: cameras see a bead's light at different places


@dataclass(frozen=True)
class Surface:
    """Elevation of one instant at the nodes of the grid."""

    z: Float  # (ny, nx): Elevation, mismatch across the sight line, standard uncertainty of z, metres
    eps_y: Float
    std: Float
    quality: NDArray[np.uint16]  # (ny, nx): Bits of `Quality`: measured or filled, and why it was rejected
    apart: Mask  # (ny, nx): Where pairs of cameras see different surfaces
    # From places x, y (ny, nx), metres, one near each node, to the elevation there
    read: Callable[[Float, Float], Float] = field(repr=False)


@dataclass(frozen=True)
class Blocks:
    """Elevation on the lattice by plain least squares over all pairs."""

    z: Float  # (ny, nx): Elevation and mismatch, metres; NaN where no pair counts
    eps_y: Float
    valid: Mask  # (ny, nx): Where at least one pair counts
    rejected: NDArray[np.uint16]  # (ny, nx): Why none does: bits of `Quality`

    @property
    def whole(self) -> Float:
        """Elevation without holes, (1, ny, nx): filled by coarser and coarser means."""
        return np.moveaxis(push_pull(self.z[..., None], self.valid), -1, 0)


def combine(matches: Sequence[PairMatch]) -> Blocks:
    """Least squares over all pairs.

    z = -sum dD . d / sum |dD|^2 over the pairs that count. eps_Y is the like sum across the sight line,
    sum (dD_y d_x - dD_x d_y) / sum |dD|.
    """
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
    """The most probable elevation of one instant, and what it rests on."""

    waves: Float  # (1, my, mx): Cosine coefficients of the elevation and of its prior mean, metres
    mean: Float
    slopes: matching.Slopes = field(repr=False)  # At the edges of the lattice
    information: Float = field(repr=False)  # (ny, nx): A of every block, per square metre
    # By how much sight lines miss each other smoothly, rms, as metres of elevation: the calibration's fault,
    # which is thought to be as large along them
    miss: float
    apart: Mask = field(repr=False)  # (ny, nx): Where pairs contradict each other (`scores_apart`)


class Convergence:
    """How solutions change from look to look.

    With scale, px.
    """

    def __init__(self, scale: float = 1.0) -> None:
        self._scale, self._looks, self._change = scale, 0, np.inf
        self._allowed = MAX_CHANGE

    @property
    def converged(self) -> bool:
        """Whether no further look is needed."""
        return self._looks >= EVALUATIONS and self._change <= self._allowed

    def next(self, modes: Modes, waves: Float, found: Float, seen: Float | None) -> tuple[Float, Float]:
        """Coefficients to go on with and the field that blocks see: half way where it goes to and fro."""
        after = modes.seen(found)
        self._looks += 1
        if seen is None:
            return found, after
        change = self._scale * float(np.sqrt(np.mean(np.square(after - seen))))
        relative = MAX_RELATIVE_CHANGE * self._scale * float(after.std())
        self._allowed = min(MAX_CHANGE, max(NEGLIGIBLE_CHANGE, relative))
        to_and_fro = self._looks > EVALUATIONS and change > max(_SLOW * self._change, self._allowed)
        self._change = change
        if to_and_fro:
            half = np.float32(0.5)
            return half * (waves + found), half * (seen + after)
        return found, after


def most_probable(
    blocks: Blocks,
    matches: Sequence[PairMatch],
    prepared: Mapping[str, matching.PreparedImage],
    modes: Modes,
    pixel: float,
    across: bool = True,
) -> ElevationEstimate:
    """Elevation as the blocks of all pairs together have it.

    A rise of z moves a pair's patches by -dD z: its score is -dD . s, its information dD H dD. Pairs of one
    reference share its noise, which cancels between opposite sides; so scores are summed over the pairs
    before their noise is measured. Across the sight lines nothing but noise is to be found, once what is
    smooth there, the calibration's fault, is taken off: no wave hides in it, and no fit has taken from it.

    With pixel, metres.
    """
    z = blocks.whole
    waves, (mean, beyond, slopes) = modes.waves(z), modes.mean(z)
    instants_used = [_PairScores(m, pixel) for m in matches]
    smooth = _smooth(matches, modes)
    seen, scores = None, [z[0]]
    information = z[:1]
    progress = Convergence(float(np.sqrt(np.mean([np.square(one.D).sum(axis=0) for one in instants_used]))))
    for number in range(MAX_LOOKS):
        if number:
            z = seen + beyond
            for one in instants_used:
                one.again(z[0], prepared)
        scores = [one.score(z[0]) for one in instants_used]
        score = np.sum(scores, axis=0)
        hessian = np.sum([one.hessian for one in instants_used], axis=0)
        nu = _noise_across(instants_used, smooth) if across else _noise(score, hessian, modes.freedom)
        information = (hessian / nu)[None]
        right = information * (z - beyond) + (score / nu)[None]
        if not number:
            factor, tolerances = modes.factor(information[0]), modes.tolerances(information[0])
        found = modes.solve(information, right, waves, tolerances[min(number, 1)], mean, factor, seen)
        waves, seen = progress.next(modes, waves, found, seen)
        if progress.converged:
            break
    counts = information[0] > 0
    miss = float(np.sqrt(np.mean(np.square(smooth[counts])))) if counts.any() else 0.0
    lengths = [np.hypot(*one.D) for one in instants_used]
    apart = scores_apart(scores, [one.hessian for one in instants_used], lengths)
    return ElevationEstimate(waves, mean, slopes, information[0], miss, apart)


def _noise(score: Float, hessian: Float, freedom: float) -> Float:
    return matching.noise_of_scores(score[None], hessian, (hessian > 0).astype(np.float32), freedom)


def _noise_across(instants_used: Sequence[_PairScores], smooth: Float) -> Float:
    """Noise of the scores, (ny, nx), from those across the sight lines."""
    parts = [one.across(smooth) for one in instants_used]
    score, hessian = (np.sum(part, axis=0) for part in zip(*parts, strict=True))
    out: Float = np.float32(_CAREFUL) * _noise(score, hessian, 1.0)
    information = np.sum([one.hessian for one in instants_used], axis=0) / out
    return out * matching.noise_factor_near_holes(information, _AT_RIMS)


def _smooth(matches: Sequence[PairMatch], modes: Modes) -> Float:
    """What is smooth of the "elevation" across the sight lines, metres, (ny, nx)."""
    waves = modes.waves(combine(turned(matches)).whole)
    waves[:, _SMOOTH:] = 0.0
    waves[:, :, _SMOOTH:] = 0.0
    out: Float = modes.field(waves)[0]
    return out


def turned(matches: Sequence[PairMatch]) -> list[PairMatch]:
    """Pairs with parallaxes turned to the left by a quarter: what they show along these is no elevation."""
    return [replace(m, parallax=_quarter(m.parallax)) for m in matches]


def _quarter(vector: Float) -> Float:
    """Turned to the left by a quarter, (2, ny, nx)."""
    return np.stack([-vector[1], vector[0]])


def first_information(blocks: Blocks, matches: Sequence[PairMatch], pixel: float, freedom: float) -> float:
    """Mean information of a block about the elevation, before any posterior."""
    instants_used = [_PairScores(m, pixel) for m in matches]
    z = blocks.whole[0]
    hessian = np.sum([one.hessian for one in instants_used], axis=0)
    score = np.sum([one.score(z) for one in instants_used], axis=0)
    return float((hessian / _noise(score, hessian, freedom)).mean())


class _PairScores:
    """What the blocks of one pair say about the elevation."""

    def __init__(self, match: PairMatch, pixel: float) -> None:
        self.match = match
        self.D = match.parallax / np.float32(pixel)
        self.own = _height(match.parallax, match.difference)
        self.here, self.counts, self.found = self.own, match.valid, match.found
        self._weigh()

    def _weigh(self) -> None:
        self.hessian = _through(self.D, self.found.hessian * self.counts)

    def again(self, z: Float, prepared: Mapping[str, matching.PreparedImage]) -> None:
        """Look at the images at an elevation (ny, nx)."""
        m, rise = self.match, z - self.own
        a, b = (prepared[name] for name in m.pair)
        u, v = m.found.u - self.D[0] * rise, m.found.v - self.D[1] * rise
        self.here, self.found = z, matching.scores_at(self.found, a, b, u, v)
        self._weigh()

    def score(self, z: Float) -> Float:
        """Score at an elevation (ny, nx) near to where the images were looked at."""
        s = self.found.score
        out: Float = self.hessian * (self.here - z)
        out -= (self.D[0] * s[0] + self.D[1] * s[1]) * self.counts
        return out

    def across(self, smooth: Float) -> tuple[Float, Float]:
        """Score and Hessian as if the parallax were turned by a quarter, at a field (ny, nx) of heights."""
        D, m, s = _quarter(self.D), self.match, self.found.score
        hessian = _through(D, self.found.hessian * self.counts)
        here = _height(_quarter(m.parallax), m.difference)
        return hessian * (here - smooth) - (D[0] * s[0] + D[1] * s[1]) * self.counts, hessian


def _through(D: Float, h: Float) -> Float:
    """D h D of blocks."""
    out: Float = D[0] ** 2 * h[0] + 2 * D[0] * D[1] * h[1] + D[1] ** 2 * h[2]
    return out


def _height(parallax: Float, difference: Float) -> Float:
    """Elevation, metres, that explains a difference best."""
    out: Float = -np.sum(parallax * difference, axis=0) / np.sum(np.square(parallax), axis=0)
    return out


def surface(
    prepared: Mapping[str, matching.PreparedImage], geometry: GridGeometry, model: Model
) -> Surface | None:
    """Elevation at the nodes from the frames of one instant."""
    if geometry.settings.sheet_thickness is not None:
        return _sheet(geometry.settings.sheet_thickness, geometry.grid.shape)
    found = match_pairs(prepared, geometry)
    return None if found is None else surface_of(*found, prepared, geometry, model)


def surface_of(
    blocks: Blocks,
    matches: Sequence[PairMatch],
    prepared: Mapping[str, matching.PreparedImage],
    geometry: GridGeometry,
    model: Model,
) -> Surface:
    """Elevation at the nodes from matched pairs."""
    estimate = most_probable(blocks, matches, prepared, model.elevation.modes, geometry.pixel)
    spline = model.elevation.splined(estimate.waves, estimate.slopes)
    (noise,), (missing,) = model.elevation.spread(estimate.information)
    centre = geometry.rig[matches[0].pair[0]].centre

    def read(x: Float, y: Float) -> Float:
        out: Float = read_surface(spline, geometry.lattice, centre, x, y)[0][0]
        return out

    z, block = _read(spline, matches, geometry)
    variance = np.float32(_LONGER / _CAREFUL) * noise + missing
    variance += np.float32(estimate.miss**2 + _shaken(matches, geometry, model.record.camera_jitter[0]))
    std = np.sqrt(variance).ravel()[block]
    apart = (pairs_apart(matches, geometry.pixel) | estimate.apart).ravel()[block]
    return Surface(z, blocks.eps_y.ravel()[block], std, _quality(blocks, block), apart, read)


def _shaken(matches: Sequence[PairMatch], geometry: GridGeometry, jitter: float) -> float:
    """Variance of the elevation from cameras that move (`of_elevation`), square metres."""
    usable = np.logical_and.reduce([m.valid for m in matches])
    if usable.sum() < _FEW:
        usable = np.logical_or.reduce([m.valid for m in matches])
    heights = [np.median(_height(m.parallax, m.difference)[usable]) for m in matches]
    between = jitter * geometry.pixel  # two frames, each of which has moved
    return of_elevation(np.array(heights), geometry.parallaxes([m.pair for m in matches]), 0.5 * between**2)


def _sheet(thickness: float, shape: tuple[int, int]) -> Surface:
    """A light sheet on z = 0: its particles stand about it as far as its light does (1/e2 is two std)."""
    z = np.zeros(shape, np.float32)
    unknown, std = np.full_like(z, np.nan), np.full_like(z, 0.25 * thickness)
    quality, apart = np.full(shape, Quality.MEASURED, np.uint16), np.zeros(shape, bool)
    return Surface(z, unknown, std, quality, apart, lambda x, y: z)


def match_pairs(
    prepared: Mapping[str, matching.PreparedImage], geometry: GridGeometry
) -> tuple[Blocks, list[PairMatch]] | None:
    """Match the pairs of one instant.

    Returns (Blocks, list of PairMatch): None if fewer than two cameras have a frame, or too little of it can
    be matched.
    """
    present = tuple(prepared)
    while pairs := geometry.pairs_for(present):
        reference = pairs[0][0]
        least = geometry.settings.min_valid * np.sum(geometry.views[reference].visible_blocks > 0.5)
        matches = [match_pair(prepared[a], prepared[b], (a, b), geometry) for a, b in pairs]
        matches = [m for m in matches if m.valid.sum() >= least] or matches
        blocks = combine(matches)
        if blocks.valid.sum() >= least:
            return blocks, matches
        # its images may be there and yet show nothing: the others may do without it
        present = tuple(n for n in present if n != reference)
    return None


def windowed(matches: Sequence[PairMatch], geometry: GridGeometry) -> NDArray[Any]:
    """Elevation at the nodes as windows have it, without the posterior: to compare pairs with each other.

    Returns (ny, nx): Metres.
    """
    blocks = combine(matches)
    if not blocks.valid.any():
        return np.full(geometry.grid.shape, np.nan, np.float32)
    z, block = _read(coefficients(np.moveaxis(blocks.whole, 0, -1)), matches, geometry)
    return np.where(blocks.valid.ravel()[block], z, np.float32(np.nan))


def _read(
    spline: Float, matches: Sequence[PairMatch], geometry: GridGeometry
) -> tuple[Float, NDArray[np.int64]]:
    """Elevation at the nodes and the block nearest to each, from spline coefficients (ny, nx, 1)."""
    centre = geometry.rig[matches[0].pair[0]].centre
    values, block = read_surface(spline, geometry.lattice, centre, geometry.x, geometry.y)
    return values[0], block


def _quality(blocks: Blocks, block: NDArray[np.int64]) -> NDArray[np.uint16]:
    measured = blocks.valid.ravel()[block]
    out = np.where(measured, np.uint16(Quality.MEASURED), np.uint16(Quality.FILLED))
    return out | blocks.rejected.ravel()[block]
