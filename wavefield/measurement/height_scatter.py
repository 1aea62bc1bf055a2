"""How the heights of single blocks scatter beside what noise explains: beads at several depths."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.matching.one_thread import one_thread
from wavefield.measurement import map_elevation as elevations
from wavefield.measurement.elevation import match_pairs
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.instant import images_of
from wavefield.measurement.model import Model

Frames = Mapping[str, NDArray[Any] | None]

_MARGIN_BLOCKS = 6  # from the edge of the lattice, where fewer neighbours hold the field
_LEAST_HESSIAN = 0.2  # of the median: blocks with less show no height
_MAX_STD = 4.0  # single heights are limited to so many standard deviations
_ENOUGH_BLOCKS = (
    3000  # for their third moment: fewer have a larger one by chance, as the root of their number
)


@one_thread()
def height_scatter(
    frames: Frames, geometry: GridGeometry, model: Model, masks: Frames
) -> tuple[float, float]:
    """Variance and third moment of single blocks' heights about the surface, over the variance of "heights"
    across the sight lines, or its power of 3/2. Of one frame of each camera. About 1 and 0 where beads float
    on waves that blocks resolve; beads under the water are only ever lower. The third moment of few blocks
    counts less. NaN where nothing was matched.
    """
    images = images_of(frames, geometry, dict(model.record.beads), masks).flat
    found = match_pairs(images, geometry)
    if found is None:
        return np.nan, np.nan
    blocks, matches = found
    modes = model.elevation.modes
    estimate = elevations.map_elevation(blocks, matches, images, modes, geometry.pixel)
    field = (modes.seen(estimate.waves) + modes.mean(blocks.filled)[1])[0]
    along, across = elevations.noise_along_and_across(matches, images, modes, geometry.pixel, field)
    inner = np.s_[_MARGIN_BLOCKS:-_MARGIN_BLOCKS, _MARGIN_BLOCKS:-_MARGIN_BLOCKS]
    ratios = [np.square(score[inner]).sum() / hessian[inner].sum() for score, hessian in (along, across)]
    score, hessian = (part[inner] for part in along)
    usual = float(np.median(hessian[hessian > 0])) if (hessian > 0).any() else np.inf
    height = (score / np.sqrt(np.maximum(hessian, 1e-30)))[hessian > _LEAST_HESSIAN * usual]
    if not ratios[1] > 0 or not height.any():
        return np.nan, np.nan
    height = np.clip(height / np.sqrt(np.mean(np.square(height))), -_MAX_STD, _MAX_STD)
    variance = float(ratios[0] / ratios[1])
    certain = min(1.0, float(np.sqrt(height.size / _ENOUGH_BLOCKS)))
    return variance, certain * float(np.mean(height**3)) * variance**1.5
