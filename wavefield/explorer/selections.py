"""Values of the thinned preview at a node, along a line, in a rectangle. Arrays in, arrays out.

The preview is int16 (variable, y, x, time): value = scale * stored, -32768 is missing.
"""

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.special import chdtri

MISSING = -32768
LONGEST_BRIDGED_GAP = 2  # steps: as in the analysis, longer gaps split a record
MIN_STEPS_OF_SPECTRUM = 32
MAX_SPECTRA_OF_AREA = 64
_CONFIDENCE = 0.95
_BINS = 60
Array = NDArray[np.floating]
Point = tuple[float, float]


def decode(stored: NDArray[np.int16], scale: float) -> NDArray[np.float32]:
    """Values of integers of 16 bits in units of scale; NaN where missing."""
    values = stored.astype(np.float32) * np.float32(scale)
    values[stored == MISSING] = np.nan
    return values


def nearest(positions: Array, requested: float) -> int:
    """Index of the position nearest to the requested one."""
    return int(np.argmin(np.abs(positions - requested)))


@dataclass(frozen=True)
class Spectrum:
    """A one-sided spectrum with its confidence interval."""

    frequency: Array  # (n,): Hz; without 0
    density: Array  # (n,): unit of the values squared, per Hz; its sum times the step is the variance
    low: float  # the true density is in [low, high] times the density with 95 % confidence
    high: float


def longest_run(values: Array) -> Array:
    """Longest stretch of a series (n,) without a gap of more than two steps; shorter ones are filled."""
    finite = np.flatnonzero(np.isfinite(values))
    if not finite.size:
        return np.empty(0)
    pieces = np.split(finite, np.flatnonzero(np.diff(finite) > LONGEST_BRIDGED_GAP + 1) + 1)
    longest = max(pieces, key=lambda piece: int(piece[-1] - piece[0]))
    steps = np.arange(longest[0], longest[-1] + 1)
    return np.asarray(np.interp(steps, longest, values[longest]))


def spectrum(values: Array, dt: float, segment_s: float | None = None) -> Spectrum | None:
    """Welch spectrum of the longest run of a series (n,), or the mean spectrum of several (n, m).

    Hann windows with half overlap, at least eight where the record allows it. Neighbouring nodes measure the
    same waves: the interval counts the segments of one node only. None for less than 32 steps without a gap.
    """
    columns = np.asarray(values, float).reshape(len(values), -1).T
    runs = [run for run in map(longest_run, columns) if run.size >= MIN_STEPS_OF_SPECTRUM]
    if not runs:
        return None
    length = min(run.size for run in runs)
    segment = min(1024, 1 << int(np.log2(max(MIN_STEPS_OF_SPECTRUM, 2 * length / 9))))
    if segment_s is not None:
        segment = max(round(segment_s / dt), 2)
    segment = min(segment, length)
    density = _welch(np.array([run[:length] for run in runs]), dt, segment)
    frequency = np.fft.rfftfreq(segment, dt)
    count = max(1, (length - segment // 2) // (segment - segment // 2))
    dof = 2.0 * count * 18.0 / 19.0 if count > 1 else 2.0  # Hann windows with half overlap
    low, high = dof / chdtri(dof, [0.5 - _CONFIDENCE / 2, 0.5 + _CONFIDENCE / 2])
    return Spectrum(frequency[1:], density.mean(axis=0)[1:], float(low), float(high))


def _welch(values: Array, dt: float, segment: int) -> Array:
    """As `scipy.signal.welch`, whose import takes most of a second: densities (n, segment // 2 + 1)."""
    window = np.hanning(segment + 1)[:-1]
    parts = sliding_window_view(values, segment, axis=-1)[:, :: segment - segment // 2]
    amplitudes = np.fft.rfft((parts - parts.mean(axis=-1, keepdims=True)) * window)
    density = (np.abs(amplitudes) ** 2).mean(axis=1) * dt / np.sum(window**2)
    density[:, 1 : (segment + 1) // 2] *= 2.0  # one-sided
    return np.asarray(density)


def line_points(start: Point, end: Point, spacing: float) -> tuple[Array, Array, Array]:
    """Distance, x and y (n,) of points along a line, about `spacing` apart, metres."""
    length = float(np.hypot(end[0] - start[0], end[1] - start[1]))
    along = np.linspace(0.0, 1.0, int(np.clip(round(length / spacing) + 1, 2, 400)))
    x, y = (a + along * (b - a) for a, b in zip(start, end))
    return along * length, x, y


def interpolate(field: Array, x: Array, y: Array, at_x: Array, at_y: Array) -> Array:
    """Bilinear values of a field (ny, nx, ...) at points, (n, ...); NaN outside and next to gaps."""
    from scipy.interpolate import interpn  # takes a second to import

    return np.asarray(interpn((y, x), field, (at_y, at_x), bounds_error=False))


def time_distance(
    stored: NDArray[np.int16], scale: float, x: Array, y: Array, at_x: Array, at_y: Array
) -> Array:
    """A stored variable (ny, nx, time) along a line of n points at all its steps, (time, n)."""
    rows, columns = _cells(y, at_y), _cells(x, at_x)
    values = decode(stored[rows, columns], scale)
    return interpolate(values, x[columns], y[rows], at_x, at_y).T


def _cells(nodes: Array, at: Array) -> slice:
    """Nodes of the cells that some positions are in."""
    start = int(np.clip(np.searchsorted(nodes, at.min()) - 1, 0, len(nodes) - 2))
    return slice(start, max(int(np.searchsorted(nodes, at.max())) + 1, start + 2))


@dataclass(frozen=True)
class Area:
    """Statistics of a variable over a rectangle."""

    mean: Array  # (time,): over its nodes, at each step; NaN where nothing was measured
    std: Array  # (time,)
    edges: Array  # (n + 1,): bins of the histogram of all values
    density: Array  # (n,): their probability density
    spectrum: Spectrum | None  # mean over nodes
    nodes: int  # nodes of the preview in the rectangle
    count: int  # values in it


def span(nodes: Array, first: float, last: float) -> slice:
    """Nodes between two positions; the nearest node if there is none between."""
    low, high = sorted((first, last))
    inside = np.flatnonzero((nodes >= low) & (nodes <= high))
    if not inside.size:
        inside = np.array([nearest(nodes, 0.5 * (low + high))])
    return slice(int(inside[0]), int(inside[-1]) + 1)


def area(stored: NDArray[np.int16], scale: float, dt: float) -> Area:
    """Means, histogram and spectrum of a stored variable (ny, nx, time) over a rectangle."""
    flat = stored.reshape(-1, stored.shape[-1])
    measured = flat != MISSING
    count = np.maximum(measured.sum(axis=0), 1)
    clean = np.where(measured, flat, np.int16(0))
    mean = scale * clean.sum(axis=0, dtype=np.int64) / count
    squares = np.einsum("nt,nt->t", clean, clean, dtype=np.float64)
    std = np.sqrt(np.maximum(scale**2 * squares / count - mean**2, 0.0))
    empty = ~measured.any(axis=0)
    mean[empty] = std[empty] = np.nan
    values = flat[measured]
    bins = _bins(values)
    density = np.histogram(values, bins)[0] / (max(values.size, 1) * np.diff(bins * scale))
    every = -(-len(flat) // MAX_SPECTRA_OF_AREA)
    found = spectrum(decode(flat[::every], scale).T, dt)
    return Area(mean, std, bins * scale, density, found, len(flat), int(values.size))


def _bins(values: NDArray[np.int16]) -> Array:
    """Edges of bins halfway between stored integers, so that none is on an edge."""
    if not values.size:
        return np.array([-0.5, 0.5])
    low, high = int(values.min()), int(values.max())
    width = max(1, -(-(high - low + 1) // _BINS))
    return np.arange(low, high + width + 1, width) - 0.5
