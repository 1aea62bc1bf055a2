"""From a block of frames to a block of steps."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.matching.one_thread import one_thread
from wavefield.measurement.bead_tilt import bead_tilt
from wavefield.measurement.camera_jitter import motion_for, unsteady
from wavefield.measurement.elevation import Surface
from wavefield.measurement.flow import Flows, flows
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.instant import Instant, measure_instant
from wavefield.measurement.learn import learn, sample_steps
from wavefield.measurement.learned_record import LearnedRecord
from wavefield.measurement.masked import masked_nodes
from wavefield.measurement.midtime import MidTime, at_mid_time, frames_used, slope
from wavefield.measurement.model import Model
from wavefield.measurement.temporal_truncation import TemporalTruncation, typical
from wavefield.measurement.velocity import Motion, motion_at, velocity
from wavefield.variables import AROUND, CUBE_FIELDS, TABLE, FrameStatus, Quality
from wavefield.water import GRAVITY

Frames = Mapping[str, Sequence[NDArray[Any] | None]]

_FEW = 50  # nodes: fewer do not tell the level of the water
_SIX = 0.84  # root of the sum of squares of the weights of six frames in z at mid-time


@one_thread()
def measure(
    frames: Frames,
    geometry: GridGeometry,
    frame_rate: float,
    model: Model | None = None,
    masks: Frames | None = None,
) -> dict[str, NDArray[Any]]:
    """Turn a block of frames into a block of the cube.

    Parameters
    ----------
    frames : mapping of str to sequence of n + 5 (ndarray or None)
        Per camera, consecutive frames: two before the first step, the n + 1 frames of the n steps, two after
        the last. None where a frame is absent, as at the ends of a record.
    geometry : GridGeometry
        Rig, grid and settings.
    frame_rate : float
        Frames per second, Hz.
    model : Model, optional
        What was learned of the record. If left out, it is learned from these frames, and another chunk of the
        record would be weighted slightly differently.
    masks : mapping of str to sequence of n + 5 (ndarray of bool or None), optional
        Per camera, for every frame, True where its pixels do not count.

    Returns
    -------
    dict of str to ndarray
        Every field of the cube as (n, ny, nx), and ``frame_status`` (n,).

    Raises
    ------
    ValueError
        If the cameras have unequal numbers of frames, or fewer than six.

    Notes
    -----
    With the record known, every step comes out the same, to the bit, whatever block it is in. A step reads
    six frames: z at mid-time is from six surfaces, where the mean flow takes the nodes (`at_mid_time`),
    velocities are from as many as the record says, four or six (`read_path`). Where a neighbour is missing,
    ``quality`` says so. z_t is what remains of the surface's rise along the path
    without u . grad z, so that the residual z_t - w + u . grad z is what surfaces and displacements disagree
    by, whatever the current.
    """
    lengths = {len(frames[n]) for n in geometry.cameras if n in frames}
    if len(lengths) != 1 or min(lengths) < 2 * AROUND + 2:
        raise ValueError(
            f"every camera needs the same number of frames, at least {2 * AROUND + 2}; got {sorted(lengths)}"
        )
    steps = lengths.pop() - 2 * AROUND - 1
    out = _empty(steps, geometry)
    if model is None:
        samples = [1 + k for k in sample_steps(steps + 2)]
        pairs = [_pair(frames, k) for k in samples]
        record = learn(pairs, geometry, [_pair(masks, k) for k in samples] if masks else None)
        if record is None:
            return out
        model = Model(geometry, record)
    beside = model.record.path_frames // 2 - 1  # steps either way whose displacements are wanted
    window: list[Instant] = []
    moves: list[Flows] = []
    for number in range(steps + 2 * AROUND + 1):
        covered = {name: masks[name][number] for name in masks} if masks else None
        window.append(
            measure_instant({name: frames[name][number] for name in frames}, geometry, model, covered)
        )
        if AROUND - beside < number <= steps + AROUND + beside:
            moves.append(flows(window[-2].images, window[-1].images, geometry.settings.piv, model))
        if number:  # not wanted any more, or a neighbour of neighbours whose z alone is
            window[-2] = window[-2].followed()
        if len(window) == 2 * AROUND + 2:
            step = number - 2 * AROUND - 1
            row = {name: field[step : step + 1] for name, field in out.items()}
            _step(window, moves[: 2 * beside + 1], geometry, model, frame_rate, row)
            window.pop(0)
            moves.pop(0)
    return out


def _pair(frames: Frames, k: int) -> tuple[dict[str, NDArray[Any] | None], dict[str, NDArray[Any] | None]]:
    return {n: f[k] for n, f in frames.items()}, {n: f[k + 1] for n, f in frames.items()}


def _empty(steps: int, geometry: GridGeometry) -> dict[str, NDArray[Any]]:
    out: dict[str, NDArray[Any]] = {}
    for name in CUBE_FIELDS:
        dtype = np.dtype(TABLE[name].dtype)
        out[name] = np.full((steps, *geometry.grid.shape), np.nan if dtype.kind == "f" else 0, dtype)
    out["frame_status"] = np.full(steps, FrameStatus.FAILED, np.dtype(TABLE["frame_status"].dtype))
    return out


def _step(
    window: Sequence[Instant],
    moves: Sequence[Flows],
    geometry: GridGeometry,
    model: Model,
    frame_rate: float,
    out: dict[str, NDArray[Any]],
) -> None:
    """Fill one step, the only row of ``out``; what cannot be measured stays NaN."""
    _, before, first, second, after, _ = window
    missing = first.missing | second.missing
    out["quality"][:] = _without(missing, geometry)
    if first.surface is None or second.surface is None:
        return
    if before.surface is None or after.surface is None:
        out["quality"][:] |= np.uint16(Quality.TWO_FRAME_MEAN)
    seen = _measure_sample(window, moves, geometry, model, frame_rate)
    if seen is None:
        return
    surfaces, moved = seen.surfaces, seen.moved
    z, z_std, rise = seen.at.z, seen.at.std, seen.at.rise
    missing |= seen.left_out
    out["quality"][:] |= _without(seen.left_out, geometry)
    for name, where in moved.regions.items():
        out["quality"][0][where] |= _without({name}, geometry)
    inside = np.ones(z.shape, bool)
    for name in geometry.cameras:
        if name not in missing:
            inside &= geometry.sights[name].sees(*geometry.sights[name].position(seen.height))
    masked = inside & masked_nodes((first.covered, second.covered), missing, z, geometry)
    inside &= ~masked
    first_surface, second_surface = surfaces[2], surfaces[3]
    assert first_surface is not None
    assert second_surface is not None
    quality = first_surface.quality | second_surface.quality | moved.quality
    beyond = _beyond(surfaces[1:5], geometry)
    quality[beyond] |= np.uint16(Quality.REJECTED_RANGE | Quality.FILLED)
    apart = np.uint16(Quality.REJECTED_EPS | Quality.FILLED)
    quality = np.where(first_surface.apart | second_surface.apart, quality | apart, quality)
    filled = (quality & Quality.FILLED) != 0
    quality = np.where(filled, quality & ~np.uint16(Quality.MEASURED), quality)
    nothing = np.where(masked, np.uint16(Quality.MASKED), np.uint16(Quality.OUTSIDE))
    out["quality"][:] |= np.where(inside, quality, nothing)
    known = inside & ~filled  # what is made up in holes says nothing of the rest
    temporal_truncation = model.record.temporal_truncation
    left_out = np.zeros_like(moved.d)
    for places in np.unique(moved.frames[inside]):
        parts = temporal_truncation.of_displacement(int(places), moved.d, known)
        left_out = np.where(moved.frames == places, parts, left_out)
    d, d_std = moved.d.copy(), np.hypot(moved.d_std, left_out)
    beyond_water, its_std = bead_tilt(rise, geometry.grid.step, geometry.settings.bead_height)
    d[:2] -= beyond_water
    d_std[:2] = np.hypot(d_std[:2], its_std)
    z_y, z_x = (slope(z, geometry.grid.step, axis) for axis in (0, 1))
    fields = {
        "z": z,
        "z_t": (rise - d[0] * z_x - d[1] * z_y) * frame_rate,
        "u": d[0] * frame_rate,
        "v": d[1] * frame_rate,
        "w": d[2] * frame_rate,
        "eps_y": np.float32(0.5) * (first_surface.eps_y + second_surface.eps_y),
        "eps_piv": moved.eps_piv,
        "z_std": np.hypot(z_std, _left_out_of_z(surfaces, rise, known, temporal_truncation)),
        "u_std": d_std[0] * frame_rate,
        "v_std": d_std[1] * frame_rate,
        "w_std": d_std[2] * frame_rate,
    }
    for name in ("z", "u", "v", "w"):  # such water there cannot be: nothing is known
        fields[f"{name}_std"] = np.where(beyond, np.abs(fields[name]), fields[f"{name}_std"])
    for name, field in fields.items():
        out[name][0][inside] = field[inside]
    out["frame_status"][:] = FrameStatus.DONE_WITH_FAULTS if missing else FrameStatus.DONE


@dataclass(frozen=True)
class _Seen:
    """What the cameras that do not contradict each other have of a step."""

    surfaces: Sequence[Surface | None]
    height: NDArray[Any]  # at which the cameras' displacements are read
    moved: Motion
    at: MidTime
    left_out: frozenset[str] = frozenset()


def _measure_sample(
    window: Sequence[Instant],
    moves: Sequence[Flows],
    geometry: GridGeometry,
    model: Model,
    frame_rate: float,
) -> _Seen | None:
    """Surfaces and motion of a step; None if nothing can be said of it.

    A knock between two frames spoils one displacement, and in part every path that it belongs to: where
    cameras contradict each other along paths of six frames, those of four are looked at.
    """
    surfaces: list[Surface | None] = [instant.surface for instant in window]
    seen = _follow(surfaces, moves, geometry, model.record, frame_rate)
    if seen is None:
        return None
    moved = seen.moved
    if moved.inconsistent and len(moves) > 3:
        return _measure_sample(window, moves[1:-1], geometry, model, frame_rate)
    if not (moved.left_out or moved.regions):
        return seen
    left_out: frozenset[str] = frozenset()
    if moved.left_out:
        left_out = frozenset({moved.left_out})
        surfaces = [instant.without(moved.left_out, geometry, model) for instant in window]
        if surfaces[2] is None or surfaces[3] is None:
            return None
        moves = [{n: f for n, f in flow.items() if n not in left_out} for flow in moves]
    else:
        surfaces = [_repaired(instant, moved.regions, geometry, model) for instant in window]
    seen = _follow(surfaces, moves, geometry, model.record, frame_rate, moved.regions)
    return None if seen is None else replace(seen, left_out=left_out)


def _follow(
    surfaces: Sequence[Surface | None],
    moves: Sequence[Flows],
    geometry: GridGeometry,
    record: LearnedRecord,
    frame_rate: float,
    without: Mapping[str, NDArray[np.bool_]] | None = None,
) -> _Seen | None:
    """Water and surface at mid-time: where the water is seen depends on its height, and that on its path."""
    first, second = surfaces[AROUND : AROUND + 2]
    assert first is not None
    assert second is not None
    level, jitters = _unsteady(surfaces, geometry, frame_rate)
    moved = motion_at(moves, np.float32(0.5) * (first.z + second.z), geometry, record)
    if moved is None:
        return None
    height = at_mid_time(surfaces, moved, geometry.x, geometry.y).z
    moved = velocity(moves, height, geometry, record, without, jitters)
    if moved is None:
        return None
    at = at_mid_time(surfaces, moved, geometry.x, geometry.y)
    if geometry.settings.sheet_thickness is not None:  # it does not rise
        at = replace(at, rise=np.zeros_like(at.rise))
    return _Seen(surfaces, height, moved, replace(at, std=np.hypot(at.std, np.float32(_SIX * level))))


def _unsteady(
    surfaces: Sequence[Surface | None], geometry: GridGeometry, frame_rate: float
) -> tuple[float, float]:
    """How far the level of z moves as no water does, metres; motion of the pictures that explains it, px."""
    known = [one for one in surfaces if one is not None]
    usable = np.logical_and.reduce([(one.quality & Quality.MEASURED) > 0 for one in known])
    if len(known) < len(surfaces) or usable.sum() < _FEW or geometry.settings.sheet_thickness is not None:
        return 0.0, 0.0
    # waves of half the field's width and more move its mean
    shortest = 0.5 * max(min(float(np.ptp(geometry.x)), float(np.ptp(geometry.y))), geometry.grid.step)
    turn = float(np.sqrt(2.0 * np.pi * GRAVITY / shortest)) / frame_rate
    level = unsteady([float(one.z[usable].mean(dtype=np.float64)) for one in known], turn)
    motion = np.sqrt(2.0) * motion_for(level, geometry.parallaxes(geometry.pairs)) / geometry.pixel
    return level, float(motion)


def _without(cameras: Collection[str], geometry: GridGeometry) -> np.uint16:
    """Bits of `Quality` for nodes that the other cameras measured."""
    bits = Quality(0)
    for name in cameras:
        bits |= Quality.without(geometry.cameras.index(name))
    return np.uint16(bits)


def _repaired(
    instant: Instant, regions: Mapping[str, NDArray[np.bool_]], geometry: GridGeometry, model: Model
) -> Surface | None:
    """An instant's surface with that of the other cameras where one contradicts them."""
    surface = instant.surface
    if geometry.settings.sheet_thickness is not None:
        return surface
    for name, where in regions.items():
        if surface is None or name in instant.missing or name not in geometry.surface_cameras:
            continue
        other = instant.without(name, geometry, model)
        if other is None:  # nobody else is there: what is made of it is not to be trusted
            surface = replace(surface, apart=surface.apart | where)
            continue
        surface = _joined(surface, other, where)
    return surface


def _joined(surface: Surface, other: Surface, where: NDArray[np.bool_]) -> Surface:
    """One surface with another in a part of the field."""
    names = ("z", "eps_y", "std", "quality", "apart")
    parts = {n: np.where(where, getattr(other, n), getattr(surface, n)) for n in names}
    return Surface(**parts, read=lambda x, y: np.where(where, other.read(x, y), surface.read(x, y)))


def _left_out_of_z(
    surfaces: Sequence[Surface | None],
    rise: NDArray[Any],
    known: NDArray[np.bool_],
    temporal_truncation: TemporalTruncation,
) -> Any:
    """Standard uncertainty of z for what its frames cannot follow, metres: a number, or (ny, nx)."""
    count = frames_used(surfaces)
    out = np.float32(temporal_truncation.of_z(count))
    if count != 3 or not known.any():
        return out
    # a parabola errs with the third derivative: where water rises fast
    return out * typical(rise, known) / max(float(np.sqrt(np.mean(np.square(rise[known])))), 1e-12)


def _beyond(surfaces: Sequence[Surface | None], geometry: GridGeometry) -> NDArray[np.bool_]:
    """Nodes at which a surface with much to say of z at mid-time stands where none was searched, (ny, nx)."""
    lowest, highest = geometry.z_range
    found = [(one.z < lowest) | (one.z > highest) for one in surfaces if one is not None]
    return np.asarray(np.logical_or.reduce(found))
