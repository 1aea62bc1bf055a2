"""What is asked of the thinned preview: series at a node, line, rectangle. Arrays in, arrays out.

The preview is int16 (variable, y, x, time): value = scale * stored, -32768 is missing.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import signal, stats

MISSING = -32768
_LONGEST_BRIDGE = 2  # steps: as in the analysis, longer gaps split a record
_SHORTEST = 32  # steps from which a spectrum is taken
_CONFIDENCE = 0.95


def decode(stored: NDArray[np.int16], scale: float) -> NDArray[np.float32]:
    """Values from 16 bits.

    Examples
    --------
    >>> decode(np.array([100, -32768], np.int16), 1e-3).tolist()
    [0.10000000149011612, nan]
    """
    values = stored.astype(np.float32) * np.float32(scale)
    values[stored == MISSING] = np.nan
    return values


def nearest(positions: NDArray[Any], requested: float) -> int:
    """Index of the nearest of some positions.

    With positions (n,), metres.

    Examples
    --------
    >>> nearest(np.array([0.0, 0.5, 1.0]), 0.7)
    1
    """
    return int(np.argmin(np.abs(np.asarray(positions) - requested)))


@dataclass(frozen=True)
class Spectrum:
    """A one-sided spectrum."""

    frequency: NDArray[Any]  # (n,): Hz; without 0
    density: NDArray[Any]  # (n,): Unit of the values squared, per Hz; its sum times the step is the variance
    low: float  # The truth lies in [low, high] times the density with 95 % confidence
    high: float


def longest_run(values: NDArray[Any]) -> NDArray[Any]:
    """Longest stretch without a gap of more than two steps; shorter gaps are bridged by lines.

    With values (n,); returns (m,): Empty if there is no value.

    Examples
    --------
    >>> longest_run(np.array([1.0, np.nan, 3.0, np.nan, np.nan, np.nan, 5.0])).tolist()
    [1.0, 2.0, 3.0]
    """
    there = np.flatnonzero(np.isfinite(values))
    if not there.size:
        return np.empty(0)
    pieces = np.split(there, np.flatnonzero(np.diff(there) > _LONGEST_BRIDGE + 1) + 1)
    longest = max(pieces, key=lambda piece: int(piece[-1] - piece[0]))
    steps = np.arange(longest[0], longest[-1] + 1)
    return np.asarray(np.interp(steps, longest, np.asarray(values, float)[longest]))


def spectrum(values: NDArray[Any], dt: float, lasting: float | None = None) -> Spectrum | None:
    """Welch's spectrum of the longest run of a series, with its interval.

    Hann windows that overlap by half, eight at least where the record allows it. Neighbouring nodes see the
    same waves, so that the interval counts the segments of one node only.

    With values (n,).
    """
    columns = np.asarray(values, float).reshape(len(values), -1).T
    runs = [run for run in map(longest_run, columns) if run.size >= _SHORTEST]
    if not runs:
        return None
    length = min(run.size for run in runs)
    requested = min(1024, 1 << int(np.log2(max(_SHORTEST, 2 * length / 9))))
    segment = min(requested if lasting is None else max(round(lasting / dt), 2), length)
    frequency, density = signal.welch(
        np.array([run[:length] for run in runs]), fs=1.0 / dt, nperseg=segment, detrend="constant"
    )
    count = max(1, (length - segment // 2) // (segment - segment // 2))
    dof = 2.0 * count * 18.0 / 19.0 if count > 1 else 2.0  # Hann, half overlapping
    low, high = dof / stats.chi2.ppf([0.5 + _CONFIDENCE / 2, 0.5 - _CONFIDENCE / 2], dof)
    return Spectrum(frequency[1:], density.mean(axis=0)[1:], float(low), float(high))


def line_points(start: tuple[float, float], end: tuple[float, float], spacing: float) -> tuple[Any, Any, Any]:
    """Points along a line.

    With start, end (x, y), metres; spacing, metres; returns distance, x, y (n,): Metres.
    """
    length = float(np.hypot(end[0] - start[0], end[1] - start[1]))
    count = int(np.clip(round(length / spacing) + 1, 2, 400))
    along = np.linspace(0.0, 1.0, count)
    x, y = (a + along * (b - a) for a, b in zip(start, end))
    return along * length, x, y


def interpolate(
    field: NDArray[Any], x: NDArray[Any], y: NDArray[Any], at_x: NDArray[Any], at_y: NDArray[Any]
) -> NDArray[Any]:
    """Values between nodes, bilinear.

    With field (ny, nx); x, y (nx,), metres; at_x, at_y (n,), metres; returns (n,): NaN outside and beside
    what is missing.
    """
    i, fx = _cell(x, at_x)
    j, fy = _cell(y, at_y)
    more = (slice(None),) + (None,) * (field.ndim - 2)
    fx, fy = fx[more], fy[more]
    lower = field[j, i] * (1 - fx) + field[j, i + 1] * fx
    upper = field[j + 1, i] * (1 - fx) + field[j + 1, i + 1] * fx
    out = lower * (1 - fy) + upper * fy
    outside = (at_x < x[0]) | (at_x > x[-1]) | (at_y < y[0]) | (at_y > y[-1])
    out[outside] = np.nan
    return np.asarray(out)


def _cell(nodes: NDArray[Any], at: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    place = (np.asarray(at, float) - nodes[0]) / ((nodes[-1] - nodes[0]) / (len(nodes) - 1))
    index = np.clip(np.floor(place).astype(int), 0, len(nodes) - 2)
    return index, place - index


def time_distance(
    stored: NDArray[np.int16],
    scale: float,
    x: NDArray[Any],
    y: NDArray[Any],
    at_x: NDArray[Any],
    at_y: NDArray[Any],
) -> NDArray[Any]:
    """A variable along a line as it goes by.

    With stored (ny, nx, time); x, y (nx,), metres; at_x, at_y (n,), metres; returns (time, n).
    """
    i = np.unique(np.clip(np.r_[_cell(x, at_x)[0], _cell(x, at_x)[0] + 1], 0, len(x) - 1))
    j = np.unique(np.clip(np.r_[_cell(y, at_y)[0], _cell(y, at_y)[0] + 1], 0, len(y) - 1))
    columns, rows = slice(i[0], i[-1] + 1), slice(j[0], j[-1] + 1)  # what the line touches
    part = decode(stored[rows, columns], scale)
    return interpolate(part, x[columns], y[rows], at_x, at_y).T


@dataclass(frozen=True)
class Area:
    """What a rectangle holds."""

    mean: NDArray[Any]  # (time,): Over its nodes, at each step; NaN where there is none
    std: NDArray[Any]
    edges: NDArray[Any]  # (n + 1,): Histogram of all its values, a probability density
    density: NDArray[Any]
    spectrum: Spectrum | None  # E(omega), mean over its nodes
    nodes: int  # Nodes of the preview in it
    count: int  # Values in it


def span(nodes: NDArray[Any], first: float, last: float) -> slice:
    """Nodes between two positions; the nearest one if there is none between.

    With nodes (n,).
    """
    low, high = sorted((first, last))
    inside = np.flatnonzero((nodes >= low) & (nodes <= high))
    if not inside.size:
        inside = np.array([nearest(nodes, 0.5 * (low + high))])
    return slice(int(inside[0]), int(inside[-1]) + 1)


def area(stored: NDArray[np.int16], scale: float, dt: float, most_spectra: int = 64) -> Area:
    """Means, histogram and spectrum of a variable over a rectangle.

    With stored (ny, nx, time).
    """
    flat = stored.reshape(-1, stored.shape[-1])
    there = flat != MISSING
    count = np.maximum(there.sum(axis=0), 1)
    clean = np.where(there, flat, np.int16(0))
    total = clean.sum(axis=0, dtype=np.int64)
    squares = np.einsum("nt,nt->t", clean, clean, dtype=np.float64)
    mean = scale * total / count
    std = np.sqrt(np.maximum(scale**2 * squares / count - mean**2, 0.0))
    empty = ~there.any(axis=0)
    mean[empty] = std[empty] = np.nan
    values = flat[there]
    bins = _bins(values)
    counts, _ = np.histogram(values, bins)
    edges = bins * scale
    density = counts / (max(values.size, 1) * np.diff(edges))
    every = -(-len(flat) // most_spectra)
    found = spectrum(decode(flat[::every], scale).T, dt)
    return Area(mean, std, edges, density, found, len(flat), int(values.size))


def _bins(values: NDArray[np.int16]) -> NDArray[Any]:
    """Edges of bins between the stored integers: none is counted in a bin of another."""
    if not values.size:
        return np.array([-0.5, 0.5])
    low, high = int(values.min()), int(values.max())
    width = max(1, -(-(high - low + 1) // 60))
    return np.arange(low, high + width + 1, width) - 0.5
