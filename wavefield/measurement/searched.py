"""A geometry whose search includes the water of the frames at hand, where its settings state no range."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.measurement.first_guess import first_guess, searched, wide_enough
from wavefield.measurement.first_heights import first_heights, high_enough
from wavefield.measurement.frame import ready, usable
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.measurement_settings import Settings

Images = Mapping[str, NDArray[Any] | None]


def search_widened(pairs: Sequence[tuple[Images, Images]], geometry: GridGeometry) -> GridGeometry:
    """The geometry with the ranges to search found in some steps; itself if its own suffice."""

    def read(name: str, frame: int) -> NDArray[Any] | None:
        image = pairs[frame // 2][frame % 2].get(name)
        if image is None or not usable(image, geometry.rig[name].size):
            return None
        return np.asarray(ready(image, geometry.sights[name].binning))

    first_frames = [2 * k for k in range(len(pairs))]
    settings = geometry.settings
    if searched(settings) == searched(Settings()):
        settings = wide_enough(settings, first_guess(read, geometry.velocity_cameras, first_frames))
    if settings.z_range is None:
        settings, _ = high_enough(settings, first_heights(read, geometry, first_frames))
    if settings == geometry.settings:
        return geometry
    return GridGeometry(geometry.rig, geometry.grid, settings, geometry.covered)
