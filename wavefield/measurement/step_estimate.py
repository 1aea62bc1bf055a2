"""Surfaces and motion of one step, from the cameras that are consistent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wavefield.measurement.elevation import Surface
from wavefield.measurement.field_model import Model
from wavefield.measurement.flow import Flows
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.instant import Instant
from wavefield.measurement.midtime import MidTime, rise_of_water, slope, where_measured, z_by_orders
from wavefield.measurement.rolling_shutter import common_lateness, elevation_errors
from wavefield.measurement.velocity import Motion, Regions, mean_flow, velocity
from wavefield.variables import AROUND

Surfaces = Sequence[Surface | None]
Float = NDArray[np.floating]


@dataclass(frozen=True)
class StepEstimate:
    """Elevation and motion of one step, from the cameras that are consistent."""

    surfaces: Surfaces  # of six frames
    motion: Motion
    mid_time: MidTime
    left_out: frozenset[str] = frozenset()  # cameras that contradict the others

    @property
    def nearest(self) -> tuple[Surface, Surface]:
        """Surfaces of the step's own two frames."""
        first, second = self.surfaces[AROUND : AROUND + 2]
        assert first is not None
        assert second is not None
        return first, second


def estimate_step(
    window: Sequence[Instant],
    moves: Sequence[Flows],
    geometry: GridGeometry,
    model: Model,
    times: Float | None = None,
) -> StepEstimate | None:
    """Surfaces and motion of a step; None if nothing can be measured.
    Uneven times of the six frames are in intervals from mid-time.
    """
    surfaces: Surfaces = [instant.surface for instant in window]
    estimate = _estimate(surfaces, moves, geometry, model.record.path_frames, times)
    if estimate is None:
        return None
    motion = estimate.motion
    # a knock between two frames spoils every path that contains it: those of four frames are used instead
    if motion.inconsistent and len(moves) > 3:
        return estimate_step(window, moves[1:-1], geometry, model, times)
    if not (motion.left_out or motion.regions):
        return estimate
    left_out: frozenset[str] = frozenset()
    if motion.left_out:
        left_out = frozenset({motion.left_out})
        surfaces = [instant.without(motion.left_out, geometry, model) for instant in window]
        if surfaces[AROUND] is None or surfaces[AROUND + 1] is None:
            return None
        moves = [{name: flow for name, flow in one.items() if name not in left_out} for one in moves]
    else:
        surfaces = [_repaired(instant, motion.regions, geometry, model) for instant in window]
    estimate = _estimate(surfaces, moves, geometry, model.record.path_frames, times, motion.regions)
    return None if estimate is None else replace(estimate, left_out=left_out)


def _estimate(
    surfaces: Surfaces,
    moves: Sequence[Flows],
    geometry: GridGeometry,
    path_frames: int,
    times: Float | None,
    regions: Regions | None = None,
) -> StepEstimate | None:
    """Motion and surface at mid-time: where water is in an image depends on its height, that on its path."""
    first, second = surfaces[AROUND : AROUND + 2]
    assert first is not None
    assert second is not None
    near = np.float32(0.5) * (first.z + second.z)
    flow, late = mean_flow(moves, near, geometry, path_frames, times), common_lateness(near, geometry)
    if flow is None:
        return None
    orders = z_by_orders(surfaces, flow, geometry.x, geometry.y, times, late)
    orders, frames, measured = where_measured(orders, surfaces, flow, geometry.x, geometry.y, times, late)
    z = shown = orders[0]
    motion = velocity(moves, z, geometry, path_frames, regions, times)
    if late is not None and motion is not None:
        z = _without_shutters(shown, motion, geometry)
        motion = velocity(moves, z, geometry, path_frames, regions, times)
    if motion is None:
        return None
    if late is not None:
        z = _without_shutters(shown, motion, geometry)
    if geometry.settings.sheet_thickness is not None:  # it does not rise
        rise = np.zeros_like(z)
    else:
        rise = rise_of_water(first, second, motion, flow, geometry.x, geometry.y)
    return StepEstimate(surfaces, motion, MidTime(z, rise, frames, measured))


def _without_shutters(z: Float, motion: Motion, geometry: GridGeometry) -> Float:
    """Surface (ny, nx), metres, without what rolling shutters make of its motion."""
    measured = np.isfinite(motion.d).all(axis=0)
    error, (x, y) = elevation_errors(z, np.where(measured, motion.d, 0.0), geometry)
    z_y, z_x = (slope(z, geometry.grid.step, axis) for axis in (0, 1))
    return np.asarray((z + x * z_x + y * z_y - error).astype(np.float32))


def _repaired(
    instant: Instant, regions: Mapping[str, NDArray[np.bool_]], geometry: GridGeometry, model: Model
) -> Surface | None:
    """An instant's surface with that of the other cameras where one contradicts them."""
    surface = instant.surface
    if geometry.settings.sheet_thickness is not None:
        return surface
    for name, where in regions.items():
        if surface is None or name in instant.images.missing or name not in geometry.surface_cameras:
            continue
        other = instant.without(name, geometry, model)
        if other is None:  # no other pair of cameras: the surface is not trusted
            surface = replace(surface, inconsistent=surface.inconsistent | where)
        else:
            surface = _joined(surface, other, where)
    return surface


def _joined(surface: Surface, other: Surface, where: NDArray[np.bool_]) -> Surface:
    """One surface with another in a part of the field."""
    names = ("z", "eps_y", "noise", "missing", "quality", "inconsistent")
    parts = {n: np.where(where, getattr(other, n), getattr(surface, n)) for n in names}
    return Surface(
        **parts,
        epipolar=max(surface.epipolar, other.epipolar),
        read=lambda x, y: np.where(where, other.read(x, y), surface.read(x, y)),
        is_measured=lambda x, y: np.where(where, other.is_measured(x, y), surface.is_measured(x, y)),
    )
