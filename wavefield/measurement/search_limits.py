"""Whether the water of a step was outside the ranges that were searched."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.matching.patch_shifts import confirmed, shifts
from wavefield.measurement.first_guess import beyond
from wavefield.measurement.first_heights import first_heights
from wavefield.measurement.frame import ready, usable
from wavefield.measurement.geometry import GridGeometry
from wavefield.variables import Quality

BORDER_FRACTION = 0.03  # of the range of elevations at either end
MIN_FRACTION_AT_BORDER = 0.01  # of the nodes
MIN_MEASURED_FRACTION = 0.5  # of the nodes in view


def at_border(z: NDArray[Any], searched: tuple[float, float]) -> bool:
    """Whether a surface z (ny, nx), metres, reaches an end of the range of elevations searched.

    Examples
    --------
    >>> at_border(np.array([[0.01, 0.099], [np.nan, 0.02]]), (-0.1, 0.1))
    True
    """
    known = z[np.isfinite(z)]
    if not known.size:
        return False
    spare = BORDER_FRACTION * (searched[1] - searched[0])
    outside = (known < searched[0] + spare) | (known > searched[1] - spare)
    return bool(outside.mean() > MIN_FRACTION_AT_BORDER)


def few_measured(quality: NDArray[np.uint8]) -> bool:
    """Whether fewer than half of the nodes in view were measured."""
    seen = (quality & np.uint8(Quality.OUTSIDE)) == 0
    measured = (quality[seen] & np.uint8(Quality.MEASURED)) != 0
    return bool(measured.size) and bool(measured.mean() < MIN_MEASURED_FRACTION)


def rose_beyond(images: Mapping[str, NDArray[Any] | None], geometry: GridGeometry) -> bool:
    """Whether the water of an instant is outside the elevations searched, by a wider search."""

    def read(name: str, _: int) -> NDArray[Any] | None:
        image = images.get(name)
        if image is None or not usable(image, geometry.rig[name].size):
            return None
        return ready(image, geometry.sights[name].binning)

    found = first_heights(read, geometry, [0])
    return bool(found.found) and (found.z[0] < geometry.z_range[0] or found.z[1] > geometry.z_range[1])


def moved_beyond(
    one: NDArray[Any] | None, other: NDArray[Any] | None, name: str, geometry: GridGeometry
) -> bool:
    """Whether a camera's image moved further than is searched, by a wider search."""
    size, count = geometry.rig[name].size, geometry.sights[name].binning
    if one is None or other is None or not usable(one, size) or not usable(other, size):
        return False
    a, b = (np.asarray(ready(image, count), np.float32) for image in (one, other))
    moved = shifts(a, b)
    return beyond(geometry.settings, confirmed(moved[:, :2]))
