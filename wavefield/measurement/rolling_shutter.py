"""Rolling shutters: each row of an image is read a little later than the one above it.

What a camera shows in row Y was there at the time of its frame and r (Y - Y0) intervals later, with r the row
delay and Y0 the middle row. So the moment at which a frame shows a node follows from where the node is in the
image, and everything that is interpolated in time is taken at that much before the frames' own mid-time.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.sight import Sight

Float = NDArray[Any]


def row_delay(name: str, geometry: GridGeometry) -> float:
    """Intervals by which a camera reads a row of its binned image later than the one above it."""
    return dict(geometry.settings.row_delays).get(name, 0.0) * geometry.sights[name].binning


def middle_row(sight: Sight) -> float:
    """Row of the binned image that is read at the time of the frame."""
    return 0.5 * (sight.camera.size[1] - 1)


def lateness(z: Float, geometry: GridGeometry) -> dict[str, Float]:
    """By how many intervals after the frame's time each camera of the pairs shows the nodes, (ny, nx)."""
    out = {}
    for name in geometry.surface_cameras:
        sight = geometry.sights[name]
        out[name] = row_delay(name, geometry) * (sight.position(z)[1] - middle_row(sight))
    return out


def common_lateness(z: Float, geometry: GridGeometry) -> Float | None:
    """Mean of the cameras' lateness at nodes on the surface z, (ny, nx), intervals; None without any."""
    if not geometry.settings.row_delays or geometry.settings.sheet_thickness is not None:
        return None
    return np.asarray(np.mean(list(lateness(z, geometry).values()), axis=0))


def elevation_errors(z: Float, d: Float, geometry: GridGeometry) -> tuple[Float, Float]:
    """Error of the elevation (ny, nx) and its offset from the node (2, ny, nx) by cameras' lateness; metres.
    What camera n shows tau_n late is off by tau_n (d_xy - D_n d_z), D its sight line, d (3, ny, nx) a motion.
    """
    late = lateness(z, geometry)
    mean = np.mean(list(late.values()), axis=0)
    shift, slope = {}, {}
    for name, tau in late.items():
        slope[name] = np.stack(geometry.rig[name].sight_line(geometry.x, geometry.y, z))
        shift[name] = (tau - mean) * (d[:2] - slope[name] * d[2])
    # what differs between the cameras of a pair is taken for an elevation
    along = square = np.float32(0.0)
    for a, b in geometry.pairs:
        parallax = slope[b] - slope[a]
        along = along - np.sum(parallax * (shift[b] - shift[a]), axis=0)
        square = square + np.sum(np.square(parallax), axis=0)
    error = along / square
    return np.asarray(error), np.asarray(shift[geometry.reference] + slope[geometry.reference] * error)
