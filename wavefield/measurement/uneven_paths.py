"""Paths as in `wavefield.measurement.paths`, through frames that were not taken at even times."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.compiled import compiled
from wavefield.measurement.paths import displacement_at, five, read_path
from wavefield.measurement.regrid import BlockLattice
from wavefield.measurement.time_weights import uneven_weights

Float = NDArray[Any]
Mask = NDArray[np.bool_]

_ITERATIONS = 6  # each leaves the gradient of the displacement, at most a third, of the error in px


def displacement_weights(
    times: Float, block: NDArray[np.int64], at: Float | float = 0.0, frames: int = 6
) -> tuple[Float, Float]:
    """Weights of five displacements, (5, ...), in the way from the step's first frame to the place at a time,
    and in the displacement per interval then; times (6,) and at: intervals from mid-time, block (5, ...).
    """
    before, after = block[1] >= 0, block[3] >= 0
    case = before + 2 * after + ((block[0] >= 0) & (block[4] >= 0))
    used = [(2, 3), (1, 2, 3), (2, 3, 4), (1, 2, 3, 4), (0, 1, 2, 3, 4, 5)]
    way, moved = np.empty((2, 5, *case.shape))
    for n, some in enumerate(used):
        here = case == n
        if not here.any():
            continue
        when = at if np.ndim(at) == 0 else np.asarray(at)[here]
        value, rate = uneven_weights(times, some, len(some) == frames == 6, when)
        if len(some) == 6:  # the place is that of a cubic, as at even times
            value = uneven_weights(times, used[3], at=when)[0]
        later = [np.cumsum(weights[::-1], axis=0)[::-1][1:].reshape(5, -1) for weights in (value, rate)]
        way[:, here], moved[:, here] = later[0] - [[1], [1], [0], [0], [0]], later[1]
    return way, moved


def read_uneven_path(
    splines: Sequence[Float | None],
    valid: Sequence[Mask | None],
    lattice: BlockLattice,
    X: Float,
    Y: Float,
    times: Float,
    at_time: Float | float = 0.0,
    frames: int = 6,
) -> tuple[Float, NDArray[np.int64]]:
    """As `read_path`, by the polynomial through the same places, with times (6,) and at_time in intervals.
    Displacements are per interval, that over the step is the step's own; X, Y are places at at_time.
    """
    first, block = read_path(splines, valid, lattice, X, Y)
    way, weights = displacement_weights(times, block, at_time, frames)
    at = np.stack([X, Y]).astype(np.float64)
    seen = np.isfinite(first[0])
    fields = five(splines)
    start = np.where(seen, at - 0.5 * first[2:4] + first[4:], 0.0)
    d = np.zeros((5, *start.shape))
    d[:2] = np.where(seen, first[2:4], 0.0)
    for _ in range(_ITERATIONS):
        for n, place in ((1, start - d[1]), (0, start - d[1] - d[0])):
            d[n] = _read(fields[n], lattice, place)
        place = start
        for n in (2, 3, 4):
            d[n] = _read(fields[n], lattice, place)
            place = place + d[n]
        start = np.where(seen, at - np.einsum("n...,nc...->c...", way, d), 0.0)
    out = np.empty_like(first)
    out[:2] = np.einsum("n...,nc...->c...", weights, d)
    out[2:4], out[4:] = d[2], start + 0.5 * d[2] - at
    out[:, ~seen] = np.nan
    return out, block


def _read(spline: Float | None, lattice: BlockLattice, place: Float) -> Float:
    """Displacements (2, ...) at places (2, ...), px; zero where there is no field."""
    out = np.zeros(place.shape, np.float32)
    if spline is not None:
        x, y = ((p - p0) / lattice.step for p, p0 in zip(place, (lattice.x0, lattice.y0)))
        places = np.ascontiguousarray(np.stack([x, y]).reshape(2, -1), np.float32)
        flat = out.reshape(2, -1)
        _read_all(np.ascontiguousarray(spline, np.float32).ravel(), lattice.shape, places, flat)
    return out


@compiled(error_model="numpy")
def _read_all(c: Float, shape: tuple[int, int], places: Float, out: Float) -> None:
    """Fill out (2, n) at places (2, n), in blocks."""
    for k in range(places.shape[1]):
        out[0, k], out[1, k] = displacement_at(c, shape[1], shape[0], places[0, k], places[1, k])
