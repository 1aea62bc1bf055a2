"""Elevation of one instant at the nodes of the grid, from all pairs of cameras."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from wavefield.measurement.field_model import FieldModel
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.map_elevation import (
    NOISE_MARGIN,
    Blocks,
    PreparedImages,
    combine,
    map_elevation,
)
from wavefield.measurement.outlier_detection import inconsistent_pairs
from wavefield.measurement.pair_surface import PairMatch, match_pair
from wavefield.measurement.regrid import blocks_below, coefficients, on_lattice, read_surface
from wavefield.variables import Quality

Float = NDArray[np.floating]
MatchedPairs = tuple[Blocks, list[PairMatch]]

_NOISE_ALONG = 1.05  # of z over that across the sight lines: cameras see a bead's light at different places


@dataclass(frozen=True)
class Surface:
    """Elevation of one instant at the nodes of the grid."""

    z: Float  # (ny, nx): elevation and mismatch across the sight line, metres
    eps_y: Float
    noise: Float  # (ny, nx): variance of z by noise, and of waves that the prior removes, m^2
    missing: Float
    epipolar: float  # rms of the smooth epipolar error as elevation, metres
    quality: NDArray[np.uint16]  # (ny, nx): bits of `Quality`: measured or filled, and why it was rejected
    inconsistent: NDArray[np.bool_]  # (ny, nx): where pairs of cameras see different surfaces
    # From places x, y (ny, nx), metres, one near each node, to z there, and to whether it was measured
    read: Callable[[Float, Float], Float] = field(repr=False)
    is_measured: Callable[[Float, Float], NDArray[np.bool_]] = field(repr=False)


def surface(prepared: PreparedImages, geometry: GridGeometry, model: FieldModel) -> Surface | None:
    """Elevation at the nodes from the rectified frames of one instant; None if they cannot be matched."""
    if geometry.settings.sheet_thickness is not None:
        return _sheet(geometry.grid.shape)
    found = match_pairs(prepared, geometry)
    return None if found is None else surface_of(*found, prepared, geometry, model)


def surface_of(
    blocks: Blocks,
    matches: Sequence[PairMatch],
    prepared: PreparedImages,
    geometry: GridGeometry,
    model: FieldModel,
) -> Surface:
    """Elevation at the nodes from matched pairs."""
    estimate = map_elevation(blocks, matches, prepared, model.modes, geometry.pixel)
    spline = model.splined(estimate.waves, estimate.slopes)
    (noise,), (missing,) = model.spread(estimate.information)
    noise *= np.float32(_NOISE_ALONG / NOISE_MARGIN)
    lattice, centre = geometry.lattice, geometry.rig[matches[0].pair[0]].centre

    def read(x: Float, y: Float) -> Float:
        return read_surface(spline, lattice, centre, x, y)

    z = read(geometry.x, geometry.y)
    block = blocks_below(lattice, centre, geometry.x, geometry.y, z)
    inconsistent = inconsistent_pairs(matches, geometry.pixel) | estimate.inconsistent
    quality = np.where(blocks.valid, np.uint16(Quality.MEASURED), np.uint16(Quality.FILLED))
    quality |= blocks.rejected
    measured = ((quality & Quality.MEASURED) > 0) & ~inconsistent

    def is_measured(x: Float, y: Float) -> NDArray[np.bool_]:
        place = lattice, centre, x, y, read(x, y)
        return np.asarray(measured.ravel()[blocks_below(*place)] & on_lattice(*place))

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


def _sheet(shape: tuple[int, int]) -> Surface:
    """A light sheet on z = 0."""
    z = np.zeros(shape, np.float32)
    quality, inconsistent = np.full(shape, Quality.MEASURED, np.uint16), np.zeros(shape, bool)
    unknown = np.full_like(z, np.nan)
    return Surface(z, unknown, z, z, 0.0, quality, inconsistent, lambda x, y: z, lambda x, y: ~inconsistent)


def match_pairs(prepared: PreparedImages, geometry: GridGeometry) -> MatchedPairs | None:
    """Match the pairs of one instant; None if fewer than two cameras have a frame or few blocks match."""
    present = tuple(prepared)
    while pairs := geometry.pairs_for(present):
        reference = pairs[0][0]
        least = geometry.settings.min_valid * np.sum(geometry.views[reference].visible_blocks > 0.5)
        matches = [match_pair(prepared[a], prepared[b], (a, b), geometry) for a, b in pairs]
        matches = [m for m in matches if m.valid.sum() >= least] or matches
        blocks = combine(matches)
        if blocks.valid.sum() >= least:
            return blocks, matches
        # the reference may have a frame that shows nothing: the others may do without it
        present = tuple(n for n in present if n != reference)
    return None


def windowed(matches: Sequence[PairMatch], geometry: GridGeometry) -> Float:
    """Elevation at the nodes without the posterior, (ny, nx), metres: to compare pairs with each other."""
    blocks = combine(matches)
    if not blocks.valid.any():
        return np.full(geometry.grid.shape, np.nan, np.float32)
    spline, centre = coefficients(np.moveaxis(blocks.filled, 0, -1)), geometry.rig[matches[0].pair[0]].centre
    z = read_surface(spline, geometry.lattice, centre, geometry.x, geometry.y)
    block = blocks_below(geometry.lattice, centre, geometry.x, geometry.y, z)
    return np.where(blocks.valid.ravel()[block], z, np.float32(np.nan))
