"""Beads are visible above the water: z is too high, and they move with the tilt of the surface."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from wavefield.rig.resolution import pixel_at

if TYPE_CHECKING:
    from wavefield.measurement.geometry import GridGeometry
    from wavefield.measurement.learned_record import LearnedRecord

Float = NDArray[Any]

RELATIVE_HEIGHT_STD = 0.2  # the visible part of a bead changes with light and view
HEIGHT_PER_WIDTH = 0.2  # of beads on still water, by their width in the images: 0.17 to 0.20 when path-traced


def bead_tilt(rise: Float, step: float, height: float) -> tuple[Float, Float]:
    """Excess motion of beads per step along x and y, and its std, (2, ny, nx), by the rise (ny, nx), metres.
    A point at a height h above the water along its normal moves by -h d(grad z)/dt more than the water.
    """
    along_y, along_x = np.gradient(rise, step)
    moved = np.nan_to_num(-height * np.stack([along_x, along_y]))
    return moved, RELATIVE_HEIGHT_STD * np.abs(moved)


def level_std(geometry: GridGeometry, record: LearnedRecord | None) -> float:
    """Standard uncertainty of z = 0, metres, common to all nodes and times; NaN where nothing was learned."""
    levelled = geometry.rig.provenance.get("levelled")
    if geometry.settings.sheet_thickness is not None:
        return 0.0  # that of z contains it
    if isinstance(levelled, Mapping) and "camera_height_std_m" in levelled:
        return float(levelled["camera_height_std_m"])
    if isinstance(levelled, Mapping) and "rms_m" in levelled:
        return float(levelled["rms_m"])
    if geometry.settings.bead_height:
        return geometry.settings.bead_height
    if record is None:
        return float("nan")
    x, y = float(np.mean(geometry.grid.x)), float(np.mean(geometry.grid.y))
    widths = [width * pixel_at(geometry.rig[name], x, y) for name, width in record.beads]
    # z is too high by the height of the beads unless the rig was levelled on still water, which includes it
    return HEIGHT_PER_WIDTH * min(widths)
