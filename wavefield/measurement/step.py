"""From frames to z, z_t, u, v, w and their uncertainties: one step from top to bottom.

A step is the interval between two frames; an instant is the time of one frame. The stages of a step:

images        remove the background, compress, bin         `measure_instant`, images.py
elevation     match the pairs, z of one instant            `surface`, elevation.py
displacement  match each camera in time                    `flows`, displacement.py
mid-time      z half-way, from six instants                `z_at_mid_time`, midtime.py
paths         each camera's image velocity at the nodes    `displacements_at_nodes`, paths.py
velocity      u, v, w by least squares over the cameras    `velocity`, velocity.py
outliers      cameras that contradict the others           `outlier_camera`, velocity.py
budget        standard uncertainties                       `error_budget`, error_budget.py
quality       why a node has no value                      `_quality`
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield import matching
from wavefield.measurement.displacement import Flows, flows
from wavefield.measurement.elevation import Surface, surface
from wavefield.measurement.error_budget import TERMS, bead_tilt, error_budget
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.images import Frames, Images, Masks, images_of, masked_nodes
from wavefield.measurement.midtime import (
    MidTime,
    StepEstimate,
    Surfaces,
    common_lateness,
    rise_of_water,
    slope,
    without_shutters,
    z_at_mid_time,
)
from wavefield.measurement.model import Model
from wavefield.measurement.paths import EVEN_TIMES
from wavefield.measurement.velocity import mean_flow, velocity
from wavefield.one_thread import one_thread
from wavefield.robust import robust_std
from wavefield.variables import AROUND, CUBE_FIELDS, TABLE, FrameStatus, Quality, frames_of_path

Series = Mapping[str, Sequence[NDArray[Any] | None]]
Mask = NDArray[np.bool_]
Float = NDArray[np.floating]

# Version of the measurement, part of every cube's recipe. Raise it with every change that alters the values
# of a cube. A cube that was begun with another version is then not continued.
ALGORITHM = 46
MIN_MEASURED = 0.05  # least fraction of measured nodes in view; below, a step has no values


@one_thread()
def measure(
    frames: Series,
    geometry: GridGeometry,
    frame_rate: float,
    model: Model | None = None,
    masks: Series | None = None,
    departures: Float | None = None,
    terms: bool = False,
) -> dict[str, NDArray[Any]]:
    """Measure z, z_t, u, v, w and their standard uncertainties in n steps: a chunk of the cube.

    Parameters
    ----------
    frames : mapping of str to sequence of n + 5 (ndarray or None)
        Consecutive frames of each camera: two before the first step, the n + 1 frames of the n steps, and two
        after the last. None where a frame is missing, for instance at the ends of a record.
    geometry : GridGeometry
        Rig, grid and settings.
    frame_rate : float
        Frames per second, Hz.
    model : Model, optional
        Spectra and noise of the record. By default they are learned from these frames, as are search ranges
        that the settings do not give; other chunks of the record are then weighted slightly differently.
    masks : mapping of str to sequence of n + 5 (ndarray of bool or None), optional
        True on pixels to ignore, for each camera and frame.
    departures : ndarray, (n + 5,), optional
        Delay of every frame relative to evenly spaced times, in frame intervals. Default: no delay.
    terms : bool, default False
        Return the terms of the standard uncertainties as well (`error_budget`).

    Returns
    -------
    dict of str to ndarray
        Every field of the cube as (n, ny, nx), and ``frame_status`` (n,). With terms ``uncertainty_terms``,
        (n, terms, 4, ny, nx): standard deviations of z (m) and of the displacement per step (m).

    Raises
    ------
    ValueError
        If the cameras have unequal numbers of frames, or fewer than six.

    Notes
    -----
    With a given model, a step has exactly the same values in every chunk. If neighbouring frames are missing,
    ``quality`` has a bit for it. z_t is the rate at which particles rise (from two surfaces) less u . grad z.
    The kinematic residual z_t - w + u . grad z is therefore the difference between this rate and w, which
    comes from displacements, whatever the current.
    """
    lengths = {len(frames[n]) for n in geometry.cameras if n in frames}
    if len(lengths) != 1 or min(lengths) < 2 * AROUND + 2:
        raise ValueError(
            f"every camera needs the same number of frames, at least {2 * AROUND + 2}; got {sorted(lengths)}"
        )
    steps = lengths.pop() - 2 * AROUND - 1
    out = _empty(steps, geometry)
    if terms:
        shape = steps, len(TERMS), 4, *geometry.grid.shape
        out["uncertainty_terms"] = np.full(shape, np.nan, np.float32)
    if model is None:
        # imported here because a step with a given model needs neither
        from wavefield.measurement.record import learn, sample_steps
        from wavefield.measurement.search_range import search_widened

        samples = [1 + k for k in sample_steps(steps + 2)]
        pairs = [_pair(frames, k) for k in samples]
        geometry = search_widened(pairs, geometry)
        record = learn(pairs, geometry, [_pair(masks, k) for k in samples] if masks else None, 1, frame_rate)
        if record is None:
            return out
        model = Model(geometry, record)
    # number of steps before and after a step whose displacements are needed
    neighbours = frames_of_path(model.record.path_frames) // 2 - 1
    window: list[Instant] = []
    moves: list[Flows] = []
    for number in range(steps + 2 * AROUND + 1):
        instant = {name: frames[name][number] for name in frames}
        covered = {name: masks[name][number] for name in masks} if masks else None
        window.append(measure_instant(instant, geometry, model, covered))
        if AROUND - neighbours < number <= steps + AROUND + neighbours:
            moves.append(flows(window[-2].in_time, window[-1].in_time, geometry.settings.piv, model))
        if number:  # frees most of the memory
            window[-2] = replace(window[-2], in_time={})
        if len(window) == 2 * AROUND + 2:
            step = number - 2 * AROUND - 1
            row = {name: field[step] for name, field in out.items()}
            row["frame_status"] = out["frame_status"][step : step + 1]
            times = EVEN_TIMES if departures is None else EVEN_TIMES + departures[step : step + 6]
            _fill_step(row, window, moves[: 2 * neighbours + 1], geometry, model, frame_rate, times)
            window.pop(0)
            moves.pop(0)
    return out


def _pair(frames: Series, k: int) -> tuple[dict[str, NDArray[Any] | None], dict[str, NDArray[Any] | None]]:
    """Return a tuple of two dicts by camera: frame number k, and frame number k + 1."""
    return {n: f[k] for n, f in frames.items()}, {n: f[k + 1] for n, f in frames.items()}


def _empty(steps: int, geometry: GridGeometry) -> dict[str, NDArray[Any]]:
    """Return the fields of a cube for `steps` steps, without values (NaN or 0), with the status failed."""
    out: dict[str, NDArray[Any]] = {}
    for name in CUBE_FIELDS:
        dtype = np.dtype(TABLE[name].dtype)
        out[name] = np.full((steps, *geometry.grid.shape), np.nan if dtype.kind == "f" else 0, dtype)
    out["frame_status"] = np.full(steps, FrameStatus.FAILED, np.dtype(TABLE["frame_status"].dtype))
    return out


def _fill_step(
    out: dict[str, NDArray[Any]],
    window: Sequence[Instant],
    moves: Sequence[Flows],
    geometry: GridGeometry,
    model: Model,
    frame_rate: float,
    times: Float,
) -> None:
    """Measure one step from six frames and the displacements between them; write its fields into `out`.
    `times` (6,) are in frame intervals from mid-time. Masked nodes and nodes out of view stay NaN."""
    _, before, first, second, after, _ = window
    missing = first.images.missing | second.images.missing
    out["quality"] |= _left_out_bits(missing, geometry)
    if first.surface is None or second.surface is None:
        return
    if before.surface is None or after.surface is None:
        out["quality"] |= np.uint16(Quality.TWO_FRAME_MEAN)
    estimate = estimate_step(window, moves, geometry, model, times)
    if estimate is None:
        return
    missing |= estimate.left_out
    out["quality"] |= _left_out_bits(estimate.left_out, geometry)
    inside = np.ones(geometry.grid.shape, bool)
    for name in geometry.cameras:
        if name not in missing:
            inside &= geometry.sights[name].sees(*geometry.sights[name].position(estimate.mid_time.z))
    covered = first.images.covered, second.images.covered
    masked = inside & masked_nodes(covered, missing, estimate.mid_time.z, geometry)
    inside &= ~masked
    out_of_range = _out_of_range(estimate.surfaces[1:5], geometry)
    quality = _quality(estimate, out_of_range)
    without_value = np.where(masked, np.uint16(Quality.MASKED), np.uint16(Quality.OUTSIDE))
    out["quality"] |= np.where(inside, quality, without_value)
    measured = inside & ((quality & Quality.FILLED) == 0)
    if measured.sum() < MIN_MEASURED * inside.sum():  # the step has no values
        out["quality"][measured] ^= np.uint16(Quality.MEASURED | Quality.FILLED)
        return
    fields = _fields(estimate, geometry, model, frame_rate, times)
    for name in ("z", "u", "v", "w"):  # implausible values get a standard uncertainty equal to their size
        fields[f"{name}_std"] = np.where(out_of_range, np.abs(fields[name]), fields[f"{name}_std"])
    for name, values in fields.items():
        if name in out:
            out[name][..., inside] = values[..., inside]
    out["frame_status"][:] = FrameStatus.DONE_WITH_FAULTS if missing else FrameStatus.DONE


def _left_out_bits(cameras: Collection[str], geometry: GridGeometry) -> np.uint16:
    """Return the bits of `Quality` that mark nodes as measured without `cameras`."""
    bits = Quality(0)
    for name in cameras:
        bits |= Quality.without(geometry.cameras.index(name))
    return np.uint16(bits)


def _out_of_range(surfaces: Surfaces, geometry: GridGeometry) -> Mask:
    """Return a mask (ny, nx), True where z of at least one surface is outside the search range."""
    lowest, highest = geometry.z_range
    outside = [(one.z < lowest) | (one.z > highest) for one in surfaces if one is not None]
    return np.asarray(np.logical_or.reduce(outside))


def _quality(estimate: StepEstimate, out_of_range: Mask) -> NDArray[np.uint16]:
    """Return the bits of `Quality` of a step, (ny, nx), except those for masked or invisible nodes.
    `out_of_range` (ny, nx) comes from `_out_of_range`."""
    first, second = estimate.nearest
    quality = first.quality | second.quality | estimate.motion.quality
    quality[out_of_range] |= np.uint16(Quality.REJECTED_RANGE | Quality.FILLED)
    quality[first.inconsistent | second.inconsistent] |= np.uint16(Quality.REJECTED_EPS | Quality.FILLED)
    quality[~estimate.mid_time.measured] |= np.uint16(Quality.FILLED)
    quality[estimate.mid_time.frames < 4] |= np.uint16(Quality.TWO_FRAME_MEAN)
    quality[(quality & Quality.FILLED) != 0] &= ~np.uint16(Quality.MEASURED)
    return quality


def _fields(
    estimate: StepEstimate,
    geometry: GridGeometry,
    model: Model,
    frame_rate: float,
    times: Float,
) -> dict[str, Float]:
    """Return a dict: the fields of a step, (ny, nx), in the units of the cube, and `uncertainty_terms`.
    The terms are standard deviations, (terms, 4, ny, nx), m, of z and of dx, dy, dz per step."""
    first, second = estimate.nearest
    motion, z, rise = estimate.motion, estimate.mid_time.z, estimate.mid_time.rise
    d = motion.d.copy()
    d[:2] -= bead_tilt(rise, geometry.grid.step, geometry.settings.bead_height)
    terms = np.stack(list(error_budget(estimate, geometry, model.record, frame_rate, times).values()))
    z_std, *d_std = np.sqrt(terms.sum(axis=0))
    z_y, z_x = (slope(z, geometry.grid.step, axis) for axis in (0, 1))
    return {
        "z": z,
        "z_t": (rise - d[0] * z_x - d[1] * z_y) * frame_rate,
        "u": d[0] * frame_rate,
        "v": d[1] * frame_rate,
        "w": d[2] * frame_rate,
        "eps_y": np.float32(0.5) * (first.eps_y + second.eps_y),
        "eps_piv": motion.eps_piv,
        "z_std": z_std,
        "u_std": d_std[0] * frame_rate,
        "v_std": d_std[1] * frame_rate,
        "w_std": d_std[2] * frame_rate,
        "uncertainty_terms": np.sqrt(terms),
    }


@dataclass(frozen=True)
class Instant:
    """The surface in one frame of all cameras, with the images from which it was measured."""

    surface: Surface | None  # elevation at the nodes; None if it could not be measured
    images: Images  # from which z is measured again if a camera must be left out
    in_time: Mapping[str, matching.PreparedImage]
    _without: dict[str, Surface | None] = field(default_factory=dict)

    def without(self, camera: str, geometry: GridGeometry, model: Model) -> Surface | None:
        """Return the surface measured without `camera`, or None if that fails; results are cached."""
        if camera not in self._without:
            self._without[camera] = surface(self.images.rectified(camera), geometry, model.elevation)
        return self._without[camera]


def measure_instant(
    frames: Frames, geometry: GridGeometry, model: Model, masks: Masks | None = None
) -> Instant:
    """Measure the elevation at one time from images by camera, and prepare these for matching in time."""
    images = images_of(frames, geometry, dict(model.record.beads), masks)
    # the rectified images are freed before those for matching in time are made: each set takes 20 MB
    found = surface(images.rectified(), geometry, model.elevation)
    return Instant(found, images, images.in_time())


def estimate_step(
    window: Sequence[Instant],
    moves: Sequence[Flows],
    geometry: GridGeometry,
    model: Model,
    times: Float,
) -> StepEstimate | None:
    """Estimate elevation and motion of a step; a camera that contradicts the others is left out.
    `window` holds the six frames around mid-time, `moves` the displacements between them. None on failure."""
    surfaces: Surfaces = [instant.surface for instant in window]
    estimate = _estimate(surfaces, moves, geometry, model.record.path_frames, times)
    if estimate is None:
        return None
    motion = estimate.motion
    if motion.left_out is None:
        return estimate
    left_out = frozenset({motion.left_out})
    surfaces = [instant.without(motion.left_out, geometry, model) for instant in window]
    if surfaces[AROUND] is None or surfaces[AROUND + 1] is None:
        return None
    moves = [{name: flow for name, flow in one.items() if name not in left_out} for one in moves]
    estimate = _estimate(surfaces, moves, geometry, model.record.path_frames, times, False)
    return None if estimate is None else replace(estimate, left_out=left_out)


def _estimate(
    surfaces: Surfaces,
    moves: Sequence[Flows],
    geometry: GridGeometry,
    path_frames: int,
    times: Float,
    may_leave_out: bool = True,
) -> StepEstimate | None:
    """Estimate elevation and motion at mid-time; None if fewer than two cameras have displacements.
    With rolling shutters, elevation and motion correct each other, and are therefore computed twice.
    `may_leave_out` permits leaving out a camera that contradicts the others."""
    first, second = surfaces[AROUND : AROUND + 2]
    assert first is not None
    assert second is not None
    if geometry.z_is_known:
        motion = velocity(moves, first.z, geometry, path_frames, times, may_leave_out)
        still = MidTime(first.z, first.z, np.full(first.z.shape, 2 * AROUND + 2, np.uint8), first.quality > 0)
        return None if motion is None else StepEstimate(surfaces, motion, still)
    near = np.float32(0.5) * (first.z + second.z)
    flow, late = mean_flow(moves, near, geometry, path_frames, times), common_lateness(near, geometry)
    if flow is None:
        return None
    orders, frames, measured = z_at_mid_time(surfaces, flow, geometry.x, geometry.y, times, late)
    z = orders[0]
    for _ in range(1 if late is None else 2):
        motion = velocity(moves, z, geometry, path_frames, times, may_leave_out)
        if motion is None:
            return None
        if late is not None:
            z = without_shutters(orders[0], motion, geometry)
    assert motion is not None
    rise = rise_of_water(first, second, motion, flow, geometry.x, geometry.y)
    # z from six frames minus z from four
    departure = robust_std((orders[0] - orders[1])[frames == 6]) ** 2 if len(orders) > 2 else 0.0
    return StepEstimate(surfaces, motion, MidTime(z, rise, frames, measured, departure))
