"""From a block of frames to a block of steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wavefield import matching
from wavefield.measurement import surface as stereo
from wavefield.measurement import velocity as motion
from wavefield.measurement.frame import ready, usable
from wavefield.measurement.plan import Plan
from wavefield.measurement.surface import Surface
from wavefield.variables import CUBE_FIELDS, TABLE, FrameStatus, Quality

Frames = Mapping[str, Sequence[NDArray | None]]


@dataclass(frozen=True)
class Instant:
    """What is kept of one instant.

    Parameters
    ----------
    surface : Surface or None
        Elevation at the nodes; None if it could not be measured.
    images : mapping of str to Prepared
        Raw images ready for matching in time.
    missing : frozenset of str
        Cameras without a usable frame.
    """

    surface: Surface | None
    images: Mapping[str, matching.Prepared]
    missing: frozenset[str]


def look(frames: Mapping[str, NDArray | None], plan: Plan, moving: Sequence[str]) -> Instant:
    """Everything that the frames of one instant give on their own.

    Parameters
    ----------
    frames : mapping of str to ndarray or None
        One frame per camera.
    plan : Plan
        Everything computed beforehand.
    moving : sequence of str
        Cameras whose raw images will be matched in time.

    Returns
    -------
    Instant
    """
    good: dict[str, NDArray] = {}
    for name in plan.cameras:
        image = frames.get(name)
        if image is not None and usable(image, plan.rig[name].size):
            good[name] = ready(image, plan.binning[name])
    flat = {n: stereo.prepare(good[n], n, plan) for n in plan.surface_cameras if n in good}
    raw = {n: matching.prepare(good[n], plan.settings.piv) for n in moving if n in good}
    return Instant(stereo.surface(flat, plan), raw, frozenset(n for n in plan.cameras if n not in good))


def measure(frames: Frames, plan: Plan, frame_rate: float) -> dict[str, NDArray]:
    """Turn a block of frames into a block of the cube.

    Parameters
    ----------
    frames : mapping of str to sequence of n + 3 (ndarray or None)
        Per camera, consecutive frames: the one before the first step, the n + 1 frames of the n steps, the
        one after the last. None where a frame is absent, as at the ends of a record.
    plan : Plan
        Rig, grid and settings.
    frame_rate : float
        Frames per second, Hz.

    Returns
    -------
    dict of str to ndarray
        Every field of the cube as (n, ny, nx), and ``frame_status`` (n,).

    Raises
    ------
    ValueError
        If the cameras have unequal numbers of frames, or fewer than four.

    Notes
    -----
    Every step comes out the same, to the bit, whatever block it is in. z at mid-time is
    (9 (z_0 + z_1) - z_-1 - z_2) / 16: the plain mean of two frames is off by z_tt dt^2 / 8. Where a
    neighbour is missing the mean is all there is, and ``quality`` says so. z_t = (z_1 - z_0) / dt.
    """
    lengths = {len(frames[n]) for n in plan.cameras if n in frames}
    if len(lengths) != 1 or min(lengths) < 4:
        raise ValueError(f"every camera needs the same number of frames, at least 4; got {sorted(lengths)}")
    steps = lengths.pop() - 3
    out = _empty(steps, plan)
    window: list[Instant] = []
    for number in range(steps + 3):
        # the outermost frames serve z alone
        moving = plan.velocity_cameras if 0 < number < steps + 2 else ()
        window.append(look({name: frames[name][number] for name in frames}, plan, moving))
        if len(window) == 4:
            row = {name: field[number - 3 : number - 2] for name, field in out.items()}
            _step(window, plan, frame_rate, row)
            window.pop(0)
    return out


def _empty(steps: int, plan: Plan) -> dict[str, NDArray]:
    out: dict[str, NDArray] = {}
    for name in CUBE_FIELDS:
        dtype = np.dtype(TABLE[name].dtype)
        out[name] = np.full((steps, *plan.grid.shape), np.nan if dtype.kind == "f" else 0, dtype)
    out["frame_status"] = np.full(steps, FrameStatus.FAILED, np.dtype(TABLE["frame_status"].dtype))
    return out


def _step(window: Sequence[Instant], plan: Plan, frame_rate: float, out: dict[str, NDArray]) -> None:
    """Fill one step, the only row of ``out``; what cannot be measured stays NaN."""
    before, first, second, after = window
    missing = first.missing | second.missing
    out["quality"][:] = Quality.FEWER_CAMERAS if missing else 0
    if first.surface is None or second.surface is None:
        return
    surfaces = [instant.surface for instant in (before, first, second, after)]
    z, z_std = _at_mid_time(surfaces)
    if before.surface is None or after.surface is None:
        out["quality"][:] |= np.uint8(Quality.TWO_FRAME_MEAN)
    moved = motion.velocity(first.images, second.images, z, plan)
    if moved is None:
        return
    inside = np.ones(z.shape, bool)
    for name in plan.cameras:
        if name not in missing:
            inside &= plan.sights[name].sees(*plan.sights[name].position(z))
    quality = first.surface.quality | second.surface.quality | moved.quality
    filled = (quality & Quality.FILLED) != 0
    quality = np.where(filled, quality & ~np.uint8(Quality.MEASURED), quality)
    quality = np.where(inside, quality, np.uint8(Quality.OUTSIDE))
    out["quality"][:] |= quality
    squared = _squared_phase(surfaces, moved.d[2], inside)
    d_std = [np.hypot(std, squared / 18.0 * _typical(d, inside)) for d, std in zip(moved.d, moved.d_std)]
    fields = {
        "z": z,
        "z_t": (second.surface.z - first.surface.z) * np.float32(frame_rate),
        "u": moved.d[0] * frame_rate,
        "v": moved.d[1] * frame_rate,
        "w": moved.d[2] * frame_rate,
        "eps_y": np.float32(0.5) * (first.surface.eps_y + second.surface.eps_y),
        "eps_piv": moved.eps_piv,
        "z_std": np.hypot(z_std, _left_out(surfaces, z, squared, inside)),
        "u_std": d_std[0] * frame_rate,
        "v_std": d_std[1] * frame_rate,
        "w_std": d_std[2] * frame_rate,
    }
    for name, field in fields.items():
        out[name][0][inside] = field[inside]
    out["frame_status"][:] = FrameStatus.DONE_WITH_FAULTS if missing else FrameStatus.DONE


def _at_mid_time(surfaces: Sequence[Surface | None]) -> tuple[NDArray, NDArray]:
    """Elevation at mid-time and its standard uncertainty, from four frames or from the two in the middle.

    The same beads in the same places err the same way in all of them, so the errors do not average out.
    """
    before, first, second, after = surfaces
    assert first is not None
    assert second is not None
    z = np.float32(0.5) * (first.z + second.z)
    if before is not None and after is not None:
        z = (np.float32(9.0) * (first.z + second.z) - before.z - after.z) / np.float32(16.0)
    return z, 0.5 * (first.std + second.std)


def _squared_phase(surfaces: Sequence[Surface | None], dz: NDArray, inside: NDArray) -> float:
    """Mean (omega dt)^2 of the waves in view, from the third and first differences of four frames.

    From two frames it can only be guessed, from how far the water rises in a step and how high it stands.
    """
    before, first, second, after = surfaces
    assert first is not None
    assert second is not None
    if not inside.any():
        return 0.0
    if before is not None and after is not None:
        third = after.z - before.z - 3.0 * (second.z - first.z)
        ratio = np.mean(third[inside] ** 2) / max(np.mean((second.z - first.z)[inside] ** 2), 1e-30)
        return float(np.sqrt(ratio))
    z = 0.5 * (first.z + second.z)[inside]
    return float(np.nanmean(dz[inside] ** 2) / max(np.mean(z**2), 1e-30))


def _left_out(surfaces: Sequence[Surface | None], z: NDArray, squared: float, inside: NDArray) -> NDArray:
    """What the finite time step leaves out of z at mid-time, metres.

    Of a wave of phase p = omega dt per step two frames leave out p^2/8, four frames 3/16 p^2 of that.
    (Likewise a displacement leaves out p^2/24 of the velocity, and a third as much again because the
    middle of the chord lies beside the path.)
    """
    before, first, second, after = surfaces
    assert first is not None
    assert second is not None
    if before is not None and after is not None:
        correction = z - np.float32(0.5) * (first.z + second.z)
        return 0.1875 * squared * _typical(correction, inside)
    return 0.125 * squared * _typical(z, inside)


def _typical(field: NDArray, inside: NDArray) -> NDArray:
    """Half what is here, half what is elsewhere: errors do not vanish where a field passes through zero."""
    elsewhere = np.nanmean(np.square(field[inside])) if inside.any() else 0.0
    return np.sqrt(0.5 * (np.square(field) + elsewhere))
