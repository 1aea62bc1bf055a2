"""What pairs of cameras say about the surface of one instant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield import matching
from wavefield.matching import Reason
from wavefield.measurement.frame import BETWEEN_CAMERAS, sharpened
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.rectify import rectify, widen
from wavefield.robust import robust_std
from wavefield.variables import Quality

Float = NDArray[Any]
Mask = NDArray[Any]


@dataclass(frozen=True)
class PairMatch:
    """What one pair of cameras says about the blocks of the lattice."""

    pair: tuple[str, str]  # The cameras (a, b); the lattice is fixed in a's apparent coordinates
    difference: Float  # (2, ny, nx): x_b - x_a, metres
    parallax: Float  # (2, ny, nx): dD = D_b - D_a, each at its own apparent position
    eps_y: Float  # (ny, nx): Mismatch across the sight line, metres
    # (ny, nx): Bits of `Quality` that say why a block does not count; 0 where it does
    rejected: NDArray[np.uint16]
    matched: Mask  # (ny, nx): Blocks that both cameras see and that matching itself trusts
    settings: matching.MatchSettings  # The settings of this match
    found: matching.Displacement  # The match itself, px

    @property
    def valid(self) -> Mask:
        """Blocks that count, (ny, nx)."""
        out: Mask = self.rejected == 0
        return out


def prepare(
    image: NDArray[Any], camera: str, geometry: GridGeometry, mask: matching.prepared.Mask | None = None
) -> matching.PreparedImage:
    """Rectify a raw image and make it ready for matching.

    With image (row, column).
    """
    sharp = sharpened(image, BETWEEN_CAMERAS)
    flat = widen(rectify(sharp, *geometry.views[camera].maps), *geometry.views[camera].blur)
    return matching.prepare(flat, geometry.settings.stereo, mask=mask or geometry.views[camera].mask)


def match_pair(
    a: matching.PreparedImage, b: matching.PreparedImage, pair: tuple[str, str], geometry: GridGeometry
) -> PairMatch:
    """Match two rectified images of one instant.

    x_a, x_b: apparent positions; d = x_b - x_a = -(D_b - D_a) z, so z = -(dD . d) / |dD|^2 and
    eps_Y = (dD_y d_x - dD_x d_y) / |dD|.
    """
    settings = geometry.stereo_settings(pair)
    found = matching.match(a, b, settings)
    pixel = np.float32(geometry.pixel)
    x, y = (v.astype(np.float32) for v in np.meshgrid(geometry.lattice.x, geometry.lattice.y))
    d = np.stack([found.u, found.v]) * pixel
    parallax = np.stack(_sight(geometry.rig[pair[1]].centre, x + d[0], y + d[1])) - np.stack(
        _sight(geometry.rig[pair[0]].centre, x, y)
    )
    length = np.sqrt(parallax[0] ** 2 + parallax[1] ** 2)
    eps_y = (parallax[1] * d[0] - parallax[0] * d[1]) / length
    z = -(parallax[0] * d[0] + parallax[1] * d[1]) / length**2
    rejected = why_rejected(found.reason)
    rejected[(z < geometry.z_range[0]) | (z > geometry.z_range[1])] |= np.uint16(Quality.REJECTED_RANGE)
    matched = rejected == 0
    if matched.any():
        spread = robust_std(eps_y[matched])
        limit = max(geometry.settings.eps_limit * spread, geometry.settings.eps_floor * geometry.pixel)
        rejected[np.abs(eps_y) > limit] |= np.uint16(Quality.REJECTED_EPS)
    return PairMatch(pair, d, parallax, eps_y, rejected, matched, settings, found)


def difference_of(one: PairMatch, other: PairMatch) -> PairMatch:
    """Displacement between the partners of two pairs of one reference."""
    d, parallax = one.difference - other.difference, one.parallax - other.parallax
    return PairMatch(
        (one.pair[0], one.pair[1]),
        d,
        parallax,
        (parallax[1] * d[0] - parallax[0] * d[1]) / np.hypot(*parallax),
        one.rejected | other.rejected,
        one.matched & other.matched,
        one.settings,
        one.found,
    )


def _sight(centre: NDArray[Any], x: Float, y: Float) -> tuple[Float, Float]:
    depth = np.float32(-centre[2])
    return (x - np.float32(centre[0])) / depth, (y - np.float32(centre[1])) / depth


def why_rejected(reason: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Matching's reasons (`Reason`) in the words of the cube (`Quality`)."""
    return _WHY[reason]


def _words() -> NDArray[np.uint16]:
    reason = np.arange(256)
    out = np.where(reason & ~int(Reason.NEIGHBOURS | Reason.RANGE), int(Quality.REJECTED_CORRELATION), 0)
    out |= np.where(reason & int(Reason.NEIGHBOURS), int(Quality.REJECTED_NEIGHBOURS), 0)
    return (out | np.where(reason & int(Reason.RANGE), int(Quality.REJECTED_RANGE), 0)).astype(np.uint16)


_WHY = _words()
