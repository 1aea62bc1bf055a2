"""How much more the heights of single blocks scatter than noise explains: beads at several depths."""

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


@one_thread()
def height_scatter(frames: Frames, geometry: GridGeometry, model: Model, masks: Frames) -> float:
    """Variance of single blocks' heights about the surface over that of the "heights" across the sight lines.
    Of one frame of each camera. About 1 where beads float on waves that blocks resolve; NaN where nothing
    was matched.
    """
    images = images_of(frames, geometry, dict(model.record.beads), masks).flat
    found = match_pairs(images, geometry)
    if found is None:
        return np.nan
    blocks, matches = found
    modes = model.elevation.modes
    estimate = elevations.map_elevation(blocks, matches, images, modes, geometry.pixel)
    field = (modes.seen(estimate.waves) + modes.mean(blocks.filled)[1])[0]
    along, across = elevations.noise_along_and_across(matches, images, modes, geometry.pixel, field)
    inner = np.s_[_MARGIN_BLOCKS:-_MARGIN_BLOCKS, _MARGIN_BLOCKS:-_MARGIN_BLOCKS]
    ratios = [np.square(score[inner]).sum() / hessian[inner].sum() for score, hessian in (along, across)]
    return float(ratios[0] / ratios[1]) if ratios[1] > 0 else np.nan
