"""Elevation of one instant at the nodes of the grid, from all pairs of cameras."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.matching import Modes
from wavefield.measurement.camera_jitter import elevation_variance
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.map_elevation import (
    NOISE_MARGIN,
    Blocks,
    PreparedImages,
    combine,
    map_elevation,
)
from wavefield.measurement.model import Model
from wavefield.measurement.outlier_detection import inconsistent_pairs
from wavefield.measurement.pair_surface import PairMatch, match_pair
from wavefield.measurement.regrid import blocks_below, coefficients, on_lattice, read_surface
from wavefield.variables import Quality

Float = NDArray[np.floating]
MatchedPairs = tuple[Blocks, list[PairMatch]]

_MIN_COMMON_BLOCKS = 50  # by which pairs are compared
_LOCAL_BLOCKS = 8.0  # over which waves are averaged, standard deviation
_LEAST_SHARE, _MAX_SHARE = np.float32(0.5), np.float32(6.0)  # of the mean, stated of single places
_NOISE_ALONG = 1.05  # of z over that across the sight lines: cameras see a bead's light at different places


@dataclass(frozen=True)
class Surface:
    """Elevation of one instant at the nodes of the grid."""

    z: Float  # (ny, nx): elevation, mismatch across the sight line, standard uncertainty of z, metres
    eps_y: Float
    std: Float
    quality: NDArray[np.uint16]  # (ny, nx): bits of `Quality`: measured or filled, and why it was rejected
    inconsistent: NDArray[np.bool_]  # (ny, nx): where pairs of cameras see different surfaces
    # From places x, y (ny, nx), metres, one near each node, to z there, and to whether it was measured
    read: Callable[[Float, Float], Float] = field(repr=False)
    is_measured: Callable[[Float, Float], NDArray[np.bool_]] = field(repr=False)


def surface(prepared: PreparedImages, geometry: GridGeometry, model: Model) -> Surface | None:
    """Elevation at the nodes from the rectified frames of one instant; None if they cannot be matched."""
    if geometry.settings.sheet_thickness is not None:
        return _sheet(geometry.settings.sheet_thickness, geometry.grid.shape)
    found = match_pairs(prepared, geometry)
    return None if found is None else surface_of(*found, prepared, geometry, model)


def surface_of(
    blocks: Blocks,
    matches: Sequence[PairMatch],
    prepared: PreparedImages,
    geometry: GridGeometry,
    model: Model,
) -> Surface:
    """Elevation at the nodes from matched pairs."""
    estimate = map_elevation(blocks, matches, prepared, model.elevation.modes, geometry.pixel)
    spline = model.elevation.splined(estimate.waves, estimate.edges)
    (noise,), (missing,) = model.elevation.spread(estimate.information)
    missing *= local_share(model.elevation.modes, estimate.waves, estimate.information)
    lattice, centre = geometry.lattice, geometry.rig[matches[0].pair[0]].centre

    def read(x: Float, y: Float) -> Float:
        return read_surface(spline, lattice, centre, x, y)

    z = read(geometry.x, geometry.y)
    block = blocks_below(lattice, centre, geometry.x, geometry.y, z)
    jitter = _jitter_variance(matches, geometry, model.record.camera_jitter[0])
    variance = np.float32(_NOISE_ALONG / NOISE_MARGIN) * noise + missing
    variance += np.float32(estimate.epipolar**2 + jitter)
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
        np.sqrt(variance).ravel()[block],
        quality.ravel()[block],
        inconsistent.ravel()[block],
        read,
        is_measured,
    )


def local_share(modes: Modes, waves: Float, information: Float) -> Float:
    """How much stronger waves that the prior removes in part are here than on average, (ny, nx).
    Where what is left of them is large, so is what is missing. waves (1, my, mx): less the prior mean.
    """
    lost = modes.inverse / (np.square(modes.foot) * np.float32(modes.prior.information) + modes.inverse)
    square = cv2.GaussianBlur(np.square(modes.field(lost * waves)[0]), (0, 0), _LOCAL_BLOCKS)
    mean = float(np.mean(square[information > 0])) if (information > 0).any() else 0.0
    share = square / np.float32(mean) if mean > 0 else np.ones_like(square)
    return np.asarray(np.clip(share, _LEAST_SHARE, _MAX_SHARE))


def _jitter_variance(matches: Sequence[PairMatch], geometry: GridGeometry, jitter: float) -> float:
    """Variance of the elevation from cameras that move (`elevation_variance`), square metres."""
    usable = np.logical_and.reduce([m.valid for m in matches])
    if usable.sum() < _MIN_COMMON_BLOCKS:
        usable = np.logical_or.reduce([m.valid for m in matches])
    # medians of differences: those of heights differ by what noise does to waves
    heights = np.array([np.median((m.height - matches[0].height)[usable]) for m in matches])
    between = jitter * geometry.pixel  # two frames, each of which has moved
    return elevation_variance(heights, geometry.parallaxes([m.pair for m in matches]), 0.5 * between**2)


def _sheet(thickness: float, shape: tuple[int, int]) -> Surface:
    """A light sheet on z = 0: its particles are about it as far as its light is (1/e2 is two std)."""
    z = np.zeros(shape, np.float32)
    unknown, std = np.full_like(z, np.nan), np.full_like(z, 0.25 * thickness)
    quality, inconsistent = np.full(shape, Quality.MEASURED, np.uint16), np.zeros(shape, bool)
    return Surface(z, unknown, std, quality, inconsistent, lambda x, y: z, lambda x, y: ~inconsistent)


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
