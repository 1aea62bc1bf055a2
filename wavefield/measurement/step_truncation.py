"""Error of the finite time step in a single step, by how results from more frames depart from those of fewer.

`temporal_truncation` states it for a record from sample steps. Groups of waves pass, depth makes orbits flat,
and of waves longer than the field samples show little: a step that departs more is stated more uncertain.
"""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.measurement.learned_record import LearnedRecord
from wavefield.measurement.temporal_truncation import typical_size
from wavefield.measurement.velocity import Motion
from wavefield.variables import EXACT_SIX

Float = NDArray[Any]
Mask = NDArray[np.bool_]

_MAX_RATIO = 0.75  # of successive departures: their series is not summed further
_MARGIN = 1.25  # on the sum of that series: it falls more slowly further on
_EVEN_PARABOLA = 0.25  # of three successive frames: t1 t2 + t1 t3 + t2 t3, in intervals squared
_NOISE_OF_DEPARTURES = 1 / 8, 0.062  # of four frames from two, of six from four, over that of a frame


def _rms(field: Float, measured: Mask) -> float:
    return float(np.sqrt(np.mean(np.square(field[measured]), dtype=np.float64)))


def convergence(
    orders: tuple[Float, ...], measured: Mask, record: LearnedRecord, std: Float | float
) -> tuple[float, float]:
    """By how much more than in the record elevations depart from those of two frames, and what is left then.
    What is left is the ratio of successive departures (six, four, two frames), a geometric series. Elevations
    of the standard uncertainty std (ny, nx) depart by noise as well, beside which smaller waves do not show.
    """
    known = dict(record.temporal_truncation.z)
    ratio = known[4] / max(known[2], 1e-12)
    if len(orders) < 2 or not measured.any():
        return 1.0, min(ratio, _MAX_RATIO)
    frame = _rms(np.broadcast_to(std, measured.shape), measured)
    near, far = (max(share * frame, 1e-12) for share in _NOISE_OF_DEPARTURES)

    def of_waves(departure: Float, noise: float) -> float:
        return float(np.sqrt(max(_rms(departure, measured) ** 2 - noise**2, 0.0)))

    last = of_waves(orders[-2] - orders[-1], near)
    if len(orders) == 3:
        ratio = max(ratio, of_waves(orders[0] - orders[1], far) / max(last, near))
    return max(last / max(known[2], near), 1.0), min(ratio, _MAX_RATIO)


def elevation_truncation(
    orders: tuple[Float, ...],
    frames: NDArray[np.uint8],
    rise: Float,
    measured: Mask,
    record: LearnedRecord,
    std: Float | float,
) -> Float:
    """Standard uncertainty of z by the finite time step, (ny, nx), metres; at least that of the record.
    D r / (1 - r), with the departure D of z from that of fewer frames and the ratio r of successive ones.
    Of nodes that fewer frames measured (their number, (ny, nx)) it is the record's, as much larger.
    """
    known, most = record.temporal_truncation, int(frames.max())
    measured = measured & (frames == most)
    least = np.float32(known.of_z(most))
    size, ratio = convergence(orders, measured, record, std)
    out = np.full(rise.shape, least)
    if measured.any() and most == 3:
        # the error of a parabola is that of the third derivative: large where water rises fast
        out *= size * typical_size(rise, measured) / max(_rms(rise, measured), 1e-12)
    elif measured.any() and most > 2:
        departure = _MARGIN * typical_size(orders[0] - orders[1], measured)
        out = np.maximum(least, np.float32(ratio / (1.0 - ratio)) * departure)
    for fewer in np.unique(frames[frames < most]).tolist():
        out = np.where(frames == fewer, np.float32(known.of_z(fewer) * size), out)
    return out


def uneven_errors(times: Float) -> tuple[float, float]:
    """Errors of rates through three and through four frames at uneven times, (6,), intervals from mid-time.
    With the n-th derivative x_n of a place and the sum e_n of the products of n times: e_2 x_3 / 6 over that
    at even times, at least 1; e_3 x_4 / 24 over the geometric mean of what chords and cubics leave out at
    even times, x_3 / 24 and 3 x_5 / 640.
    """

    def products(of: Float, count: int) -> float:
        return abs(float(sum(np.prod(some) for some in combinations(of, count))))

    parabola = max(products(times[part], 2) for part in (slice(1, 4), slice(2, 5))) / _EVEN_PARABOLA
    return max(1.0, parabola), products(times[1:5], 3) / float(np.sqrt(24 * 3 / 640))


def motion_truncation(
    motion: Motion,
    orders: tuple[Float, ...],
    frames_of_z: NDArray[np.uint8],
    seen: Mask,
    measured: Mask,
    record: LearnedRecord,
    std: Float | float,
    times: Float | None = None,
) -> Float:
    """Standard uncertainty of displacements by the finite time step, (3, ny, nx), metres.
    Sizes are those of nodes whose z is of the most frames; of all measured ones if none of these is.
    Paths of four places depart from chords by what chords leave out; beyond the record's, more is left out.
    At uneven times, of six frames in intervals, they also depart because chords are of another moment.
    """
    known = record.temporal_truncation
    of_most = measured & (frames_of_z == frames_of_z.max())
    size, ratio = convergence(orders, of_most, record, std)
    measured = of_most if of_most.any() else measured
    faster = max(1.0, ratio / max(min(known.of_z(4) / max(known.of_z(2), 1e-12), _MAX_RATIO), 1e-12))
    # where paths are chords, or as smooth as those of six places, elevations show the size, and this how flat
    # orbits are
    x, y, up = np.square(record.moved)
    flat = float(np.sqrt(max(1.0, (x + y) / max(up, 1e-30))))
    scale = np.array([flat, flat, 1.0], np.float32)[:, None, None] * np.float32(size)
    out = np.zeros_like(motion.d)
    for frames in np.unique(motion.frames[seen]):
        here = motion.frames == frames
        kind = max(int(frames), record.path_frames) if frames == 6 else int(frames)
        parts = known.of_displacement(kind, motion.d, measured)
        more: Float | np.float32 = np.float32(size) if kind == 6 else scale
        chords = np.maximum(known.of_displacement(2, motion.d, measured), np.float32(1e-12))
        if frames == 2 and times is not None:
            parts = parts * np.float32(uneven_errors(times)[0])
        elif frames == 4 and times is not None:
            parts = np.hypot(parts, np.float32(uneven_errors(times)[1]) * np.sqrt(parts * chords))
        elif kind in (4, EXACT_SIX) and times is None and (here & measured).any():
            square = np.square(motion.chord - motion.d)
            counted = (here & measured).astype(np.float32)
            mean = np.nansum(square * counted, axis=(1, 2)) / counted.sum()
            beyond = np.sqrt(np.float32(0.5) * (square + mean[:, None, None].astype(np.float32))) / chords
            more = np.fmax(beyond, np.float32(1.0)) * np.float32(faster)
        out = parts * more if here.all() else np.where(here, parts * more, out)
    return np.asarray(out, np.float32)
