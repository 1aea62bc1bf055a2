"""Surface elevation of one instant, from pairs of cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield import matching
from wavefield.matching import Reason
from wavefield.matching.uncertainty import std_from_influence
from wavefield.measurement.plan import Plan
from wavefield.measurement.rectify import rectify, widen
from wavefield.measurement.regrid import coefficients, fill, levelled, push_pull, read_surface
from wavefield.robust import robust_std
from wavefield.variables import Quality

Float = NDArray[Any]
Mask = NDArray[Any]


@dataclass(frozen=True)
class PairMatch:
    """What one pair of cameras says about the blocks of the lattice.

    Parameters
    ----------
    pair : tuple of str
        The cameras (a, b); the lattice is fixed in a's apparent coordinates.
    difference : ndarray, (2, ny, nx)
        x_b - x_a, metres.
    parallax : ndarray, (2, ny, nx)
        dD = D_b - D_a, each at its own apparent position.
    influence : ndarray, (2, ny, nx)
        Influence of each block on the difference, metres.
    eps_y : ndarray, (ny, nx)
        Mismatch across the line of sight, metres.
    rejected : ndarray of uint8, (ny, nx)
        Bits of `Quality` that say why a block does not count; 0 where it does.
    matched : ndarray of bool, (ny, nx)
        Blocks that both cameras see and that matching itself trusts.
    settings : matching.Settings
        The settings of this match.
    """

    pair: tuple[str, str]
    difference: Float
    parallax: Float
    influence: Float
    eps_y: Float
    rejected: NDArray[np.uint8]
    matched: Mask
    settings: matching.Settings

    @property
    def valid(self) -> Mask:
        """Blocks that count, (ny, nx)."""
        return self.rejected == 0


@dataclass(frozen=True)
class Surface:
    """Elevation of one instant at the nodes of the grid.

    Parameters
    ----------
    z, eps_y, std : ndarray of float32, (ny, nx)
        Elevation, mismatch across the line of sight, standard uncertainty of z, metres.
    quality : ndarray of uint8, (ny, nx)
        Bits of `Quality`: measured or filled, and why it was rejected.
    """

    z: Float
    eps_y: Float
    std: Float
    quality: NDArray[np.uint8]


def prepare(image: NDArray, camera: str, plan: Plan) -> matching.Prepared:
    """Rectify a raw image and make it ready for matching.

    Parameters
    ----------
    image : ndarray, (row, column)
        Raw image, its pixels binned.
    camera : str
        Its camera.
    plan : Plan
        Maps and masks.

    Returns
    -------
    matching.Prepared
    """
    flat = widen(rectify(image, *plan.maps[camera]), *plan.blur[camera])
    return matching.prepare(flat, plan.settings.stereo, mask=plan.masks[camera])


def match_pair(a: matching.Prepared, b: matching.Prepared, pair: tuple[str, str], plan: Plan) -> PairMatch:
    """Match two rectified images of one instant.

    Parameters
    ----------
    a, b : Prepared
        As given by `prepare`.
    pair : tuple of str
        Their cameras.
    plan : Plan
        Lattice, lines of sight, search range.

    Returns
    -------
    PairMatch

    Notes
    -----
    x_a, x_b: apparent positions; d = x_b - x_a = -(D_b - D_a) z, so z = -(dD . d) / |dD|^2 and
    eps_Y = (dD_y d_x - dD_x d_y) / |dD|.
    """
    settings = plan.stereo_settings(pair)
    found = matching.match(a, b, settings)
    pixel = np.float32(plan.pixel)
    d = np.stack([found.u, found.v]) * pixel
    parallax = np.stack(
        _sight(plan.rig[pair[1]].centre, plan.block_x + d[0], plan.block_y + d[1])
    ) - np.stack(_sight(plan.rig[pair[0]].centre, plan.block_x, plan.block_y))
    length = np.sqrt(parallax[0] ** 2 + parallax[1] ** 2)
    eps_y = (parallax[1] * d[0] - parallax[0] * d[1]) / length
    z = -(parallax[0] * d[0] + parallax[1] * d[1]) / length**2
    rejected = why_rejected(found.reason)
    rejected[(z < plan.z_range[0]) | (z > plan.z_range[1])] |= np.uint8(Quality.REJECTED_NEIGHBOURS)
    matched = rejected == 0
    if matched.any():
        spread = robust_std(eps_y[matched])
        limit = max(plan.settings.eps_limit * spread, plan.settings.eps_floor * plan.pixel)
        rejected[np.abs(eps_y) > limit] |= np.uint8(Quality.REJECTED_EPS)
    influence = np.stack([found.influence_u, found.influence_v]) * pixel
    return PairMatch(pair, d, parallax, influence, eps_y, rejected, matched, settings)


def difference_of(one: PairMatch, other: PairMatch) -> PairMatch:
    """Displacement between the partners of two pairs of one reference.

    Parameters
    ----------
    one, other : PairMatch
        Pairs (a, b) and (a, c).

    Returns
    -------
    PairMatch
        What they say together about (c, b), on a's lattice: x_b - x_c = (x_b - x_a) - (x_c - x_a).
    """
    d, parallax = one.difference - other.difference, one.parallax - other.parallax
    return PairMatch(
        (one.pair[0], one.pair[1]),
        d,
        parallax,
        one.influence - other.influence,
        (parallax[1] * d[0] - parallax[0] * d[1]) / np.hypot(*parallax),
        one.rejected | other.rejected,
        one.matched & other.matched,
        one.settings,
    )


def _sight(centre: NDArray, x: Float, y: Float) -> tuple[Float, Float]:
    depth = np.float32(-centre[2])
    return (x - np.float32(centre[0])) / depth, (y - np.float32(centre[1])) / depth


def why_rejected(reason: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Matching's reasons (`Reason`) in the words of the cube (`Quality`)."""
    return _WHY[reason]


def _words() -> NDArray[np.uint8]:
    reason = np.arange(256)
    neighbours = int(Reason.NEIGHBOURS | Reason.RANGE)
    out = np.where(reason & ~neighbours, int(Quality.REJECTED_CORRELATION), 0)
    return (out | np.where(reason & neighbours, int(Quality.REJECTED_NEIGHBOURS), 0)).astype(np.uint8)


_WHY = _words()


@dataclass(frozen=True)
class Blocks:
    """Elevation on the lattice, all pairs together.

    Parameters
    ----------
    z, eps_y, std : ndarray of float32, (ny, nx)
        Elevation, mismatch, standard uncertainty, metres; NaN where no pair counts.
    valid : ndarray of bool, (ny, nx)
        Where at least one pair counts.
    rejected : ndarray of uint8, (ny, nx)
        Why none does.
    """

    z: Float
    eps_y: Float
    std: Float
    valid: Mask
    rejected: NDArray[np.uint8]


def combine(matches: Sequence[PairMatch]) -> Blocks:
    """Least squares over all pairs.

    Parameters
    ----------
    matches : sequence of PairMatch
        Pairs with the same reference camera.

    Returns
    -------
    Blocks

    Notes
    -----
    z = -sum dD . d / sum |dD|^2 over the pairs that count. Pairs of one reference share its noise, which
    cancels between opposite sides; so the influences are combined before they are squared:
    zeta_b = sum dD . i_b / sum |dD|^2. eps_Y is the like sum across the line of sight,
    sum (dD_y d_x - dD_x d_y) / sum |dD|.
    """
    shape = matches[0].eps_y.shape
    along, across, zeta, square, length = np.zeros((5, *shape), np.float32)
    rejected = np.zeros(shape, np.uint8)
    for m in matches:
        counts = m.valid
        Dx, Dy = m.parallax * counts
        along += Dx * m.difference[0] + Dy * m.difference[1]
        zeta += Dx * m.influence[0] + Dy * m.influence[1]
        own = Dx * Dx + Dy * Dy
        square += own
        own = np.sqrt(own)
        length += own
        across += own * m.eps_y
        rejected |= m.rejected
    valid = square > 0
    rejected[valid] = 0
    some = np.where(valid, square, np.float32(1.0))
    z = -along / some
    std = std_from_influence(zeta / some, matches[0].settings, field=z, restored=True)
    nan = np.float32(np.nan)
    eps_y = np.where(valid, across / np.where(valid, length, np.float32(1.0)), nan)
    return Blocks(np.where(valid, z, nan), eps_y, np.where(valid, std, nan), valid, rejected)


def to_nodes(blocks: Blocks, matches: Sequence[PairMatch], plan: Plan) -> Surface:
    """From the lattice to the nodes of the grid.

    Parameters
    ----------
    blocks : Blocks
        As given by `combine`.
    matches : sequence of PairMatch
        The pairs behind it.
    plan : Plan
        Lattice and grid.

    Returns
    -------
    Surface
        Finite everywhere, also where no camera looks: the caller knows what lies outside.
    """
    reference = matches[0].pair[0]
    std = levelled(blocks.std, blocks.valid)
    z = push_pull(blocks.z[..., None], blocks.valid)
    wanted = plan.seen_blocks[reference] > 0.5
    ny, nx = blocks.valid.shape
    column, row = np.arange(nx, dtype=np.float32), np.arange(ny, dtype=np.float32)[:, None]
    for m in matches:
        dx, dy = m.parallax * (z[..., 0] / np.float32(-plan.lattice.step))
        there = cv2.remap(
            plan.seen_blocks[m.pair[1]],
            column + dx,
            row + dy,
            cv2.INTER_NEAREST,
            borderMode=cv2.BORDER_REPLICATE,
        )
        wanted &= there > 0.5
    holes = wanted & ~blocks.valid
    if holes.any():
        z = fill(blocks.z[..., None], blocks.valid, wanted, plan.energy_of(reference))
        std = _widen(std, z[..., 0], blocks.valid)
    spline = coefficients(z, plan.response)
    values, block = read_surface(spline, plan.lattice, plan.rig[reference].centre, plan.x, plan.y)
    valid = blocks.valid.ravel()[block]
    quality = (
        np.where(valid, np.uint8(Quality.MEASURED), np.uint8(Quality.FILLED)) | blocks.rejected.ravel()[block]
    )
    return Surface(values[0], blocks.eps_y.ravel()[block], std.ravel()[block], quality.astype(np.uint8))


def _widen(std: Float, z: Float, valid: Mask) -> Float:
    """Uncertainty inside holes: the plate does not know the curvature there.

    In a hole of radius r, s from its rim, it errs by about a tenth of s (2r - s) times the rms curvature of
    the rest.
    """
    bend = cv2.Laplacian(cv2.GaussianBlur(z, (0, 0), 2.0), cv2.CV_32F)
    inner = cv2.erode(valid.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    curvature = float(np.sqrt(np.mean(np.square(bend[inner])))) if inner.any() else 0.0
    distance = cv2.distanceTransform((~valid).astype(np.uint8), cv2.DIST_L2, 5)
    radius = cv2.dilate(distance, np.ones((13, 13), np.uint8))
    return np.hypot(std, np.float32(0.1 * curvature) * distance * (2 * radius - distance))


def surface(prepared: Mapping[str, matching.Prepared], plan: Plan) -> Surface | None:
    """Elevation at the nodes from the frames of one instant.

    Parameters
    ----------
    prepared : mapping of str to Prepared
        The cameras that have a usable frame.
    plan : Plan
        Everything computed beforehand.

    Returns
    -------
    Surface or None
        None if fewer than two cameras have a frame, or too little of it can be matched.
    """
    present = tuple(prepared)
    while pairs := plan.pairs_for(present):
        matches = [match_pair(prepared[a], prepared[b], (a, b), plan) for a, b in pairs]
        blocks = combine(matches)
        reference = pairs[0][0]
        if blocks.valid.sum() >= plan.settings.min_valid * np.sum(plan.seen_blocks[reference] > 0.5):
            return to_nodes(blocks, matches, plan)
        # its images may be there and yet show nothing: the others may do without it
        present = tuple(n for n in present if n != reference)
    return None
