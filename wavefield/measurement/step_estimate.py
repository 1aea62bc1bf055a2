"""Surfaces and motion of one step, from the cameras that are consistent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wavefield.measurement.camera_jitter import level_jitter, motion_for_level
from wavefield.measurement.elevation import Surface
from wavefield.measurement.flow import Flows
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.instant import Instant
from wavefield.measurement.learned_record import LearnedRecord
from wavefield.measurement.midtime import MidTime, rise_of_water, slope, where_measured, z_by_orders
from wavefield.measurement.model import Model
from wavefield.measurement.rolling_shutter import common_lateness, elevation_errors
from wavefield.measurement.velocity import Motion, Regions, mean_flow, velocity
from wavefield.variables import AROUND, Quality
from wavefield.water import GRAVITY

Surfaces = Sequence[Surface | None]
Float = NDArray[np.floating]

_MIN_NODES_FOR_MEAN_LEVEL = 50
_SIX_FRAME_NOISE = 0.84  # root of the sum of squares of the weights of six frames in z at mid-time


@dataclass(frozen=True)
class StepEstimate:
    """Elevation and motion of one step, from the cameras that are consistent."""

    surfaces: Surfaces  # of six frames
    motion: Motion
    mid_time: MidTime
    left_out: frozenset[str] = frozenset()  # cameras that contradict the others


def estimate_step(
    window: Sequence[Instant],
    moves: Sequence[Flows],
    geometry: GridGeometry,
    model: Model,
    frame_rate: float,
    times: Float | None = None,
) -> StepEstimate | None:
    """Surfaces and motion of a step; None if nothing can be measured.
    Uneven times of the six frames are in intervals from mid-time.
    """
    surfaces: Surfaces = [instant.surface for instant in window]
    estimate = _estimate(surfaces, moves, geometry, model.record, frame_rate, times)
    if estimate is None:
        return None
    motion = estimate.motion
    # a knock between two frames spoils every path that contains it: those of four frames are used instead
    if motion.inconsistent and len(moves) > 3:
        return estimate_step(window, moves[1:-1], geometry, model, frame_rate, times)
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
    estimate = _estimate(surfaces, moves, geometry, model.record, frame_rate, times, motion.regions)
    return None if estimate is None else replace(estimate, left_out=left_out)


def _estimate(
    surfaces: Surfaces,
    moves: Sequence[Flows],
    geometry: GridGeometry,
    record: LearnedRecord,
    frame_rate: float,
    times: Float | None,
    regions: Regions | None = None,
) -> StepEstimate | None:
    """Motion and surface at mid-time: where water is in an image depends on its height, that on its path."""
    first, second = surfaces[AROUND : AROUND + 2]
    assert first is not None
    assert second is not None
    level_std, jitter_px = _level_jitter(surfaces, geometry, frame_rate, times)
    near = np.float32(0.5) * (first.z + second.z)
    flow, late = mean_flow(moves, near, geometry, record, times), common_lateness(near, geometry)
    if flow is None:
        return None
    orders = z_by_orders(surfaces, flow, geometry.x, geometry.y, times, late)
    orders, frames, measured = where_measured(orders, surfaces, flow, geometry.x, geometry.y, times, late)
    z = shown = orders[0]
    motion = velocity(moves, z, geometry, record, regions, jitter_px, times)
    if late is not None and motion is not None:
        z = _without_shutters(shown, motion, geometry)
        motion = velocity(moves, z, geometry, record, regions, jitter_px, times)
    if motion is None:
        return None
    if late is not None:
        z = _without_shutters(shown, motion, geometry)
    std = np.hypot(np.float32(0.5) * (first.std + second.std), np.float32(_SIX_FRAME_NOISE * level_std))
    if geometry.settings.sheet_thickness is not None:  # it does not rise
        rise = np.zeros_like(z)
    else:
        rise = rise_of_water(first, second, motion, flow, geometry.x, geometry.y)
        # where displacements contradict each other, the cameras show water of another height or other beads
        std = std * np.sqrt(np.nan_to_num(motion.noise_factor, nan=1.0))
    return StepEstimate(surfaces, motion, MidTime(z, std, rise, orders, frames, measured))


def _without_shutters(z: Float, motion: Motion, geometry: GridGeometry) -> Float:
    """Surface (ny, nx), metres, without what rolling shutters make of its motion."""
    measured = np.isfinite(motion.d).all(axis=0)
    error, (x, y) = elevation_errors(z, np.where(measured, motion.d, 0.0), geometry)
    z_y, z_x = (slope(z, geometry.grid.step, axis) for axis in (0, 1))
    return np.asarray((z + x * z_x + y * z_y - error).astype(np.float32))


def _level_jitter(
    surfaces: Surfaces, geometry: GridGeometry, frame_rate: float, times: Float | None
) -> tuple[float, float]:
    """Std of the level of z that no wave explains, metres, and of picture motion that explains it, px."""
    present = [one for one in surfaces if one is not None]
    usable = np.logical_and.reduce([(one.quality & Quality.MEASURED) > 0 for one in present])
    if len(present) < len(surfaces) or usable.sum() < _MIN_NODES_FOR_MEAN_LEVEL:
        return 0.0, 0.0
    if geometry.settings.sheet_thickness is not None:
        return 0.0, 0.0
    # waves of half the field's width and more move its mean
    width = min(float(np.ptp(geometry.x)), float(np.ptp(geometry.y)))
    phase = float(np.sqrt(2.0 * np.pi * GRAVITY / (0.5 * max(width, geometry.grid.step)))) / frame_rate
    level = level_jitter([float(one.z[usable].mean(dtype=np.float64)) for one in present], phase, times)
    motion = np.sqrt(2.0) * motion_for_level(level, geometry.parallaxes(geometry.pairs)) / geometry.pixel
    return level, float(motion)


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
    names = ("z", "eps_y", "std", "quality", "inconsistent")
    parts = {n: np.where(where, getattr(other, n), getattr(surface, n)) for n in names}
    return Surface(
        **parts,
        read=lambda x, y: np.where(where, other.read(x, y), surface.read(x, y)),
        is_measured=lambda x, y: np.where(where, other.is_measured(x, y), surface.is_measured(x, y)),
    )
