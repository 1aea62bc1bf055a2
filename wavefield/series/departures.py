"""Departures of frames from even times, from the time stamps of the cameras."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from wavefield.series.clocks import MAX_OFFSET
from wavefield.series.frames import FrameSeries

Times = NDArray[np.float64]

_EVEN = 2e-4  # intervals: smaller departures change nothing
_RATE_ERROR = 1e-4  # of a quartz
_DECIMALS = 7  # of departures in intervals
_OTHER_RATE = 0.05  # by which a clock's rate and the stated one differ where frames were left out since
_DRIFT_FRAMES = 129  # over so many frames the drift of a clock is even
_RESOLUTIONS = (0.01, 0.001, 0.0001)  # s, to which clocks round
_ROUNDED = 1.05  # resolutions from the lowest to the highest departure that rounding makes


def frame_departures(series: Mapping[str, FrameSeries], frame_rate: float) -> Times | None:
    """By how much later than at even intervals a record's frames were taken, (n,), intervals; None if even.
    What the cameras' clocks share, less offset and drift: they are triggered together, the rest is noise.
    """
    each = [
        found
        for one in series.values()
        if one.times is not None and (found := departures_by_clock(one.times, frame_rate)) is not None
    ]
    if not each:
        return None
    stack = np.stack(each)
    count = np.isfinite(stack).sum(axis=0)
    common = np.nansum(stack, axis=0) / np.maximum(count, 1)
    freedom = int(np.maximum(count - 1, 0).sum())
    power = float(np.mean(np.square(common)))
    if freedom and power:
        noise = float(np.nansum(np.square(stack - common))) / freedom / len(each)
        common *= max(power - noise, 0.0) / power
    return np.round(common, _DECIMALS) if np.abs(common).max() > _EVEN else None


def departures_by_clock(times: Times, frame_rate: float) -> Times | None:
    """The same by one clock, from its times (n,), s; NaN where it has none.

    None where they do not fit even intervals at all.

    Examples
    --------
    >>> departures_by_clock(np.array([0.0, 0.052, 0.1, 0.15, 0.2]), 20.0).round(3).tolist()
    [-0.008, 0.032, -0.008, -0.008, -0.008]
    """
    there = np.flatnonzero(np.isfinite(times))
    if len(there) < 3:
        return None
    place, seconds = (there - there[0]).astype(float), times[there] - times[there[0]]
    rate = place[-1] / seconds[-1]
    if abs(rate / frame_rate - 1.0) < _OTHER_RATE:
        rate = frame_rate
    found = seconds * rate - place
    found -= _line(place, found)
    if len(times) > 2 * _DRIFT_FRAMES:
        import scipy.signal  # takes a second, which short records do not need

        drift = scipy.signal.savgol_filter(np.interp(np.arange(len(times)), there, found), _DRIFT_FRAMES, 1)
        found -= drift[there]
    if np.abs(found).max() > MAX_OFFSET:
        return None
    if np.ptp(found) <= _ROUNDED * _resolution(times[there]) * rate:
        found[:] = 0.0
    out = np.full(len(times), np.nan)
    out[there] = found
    return out


def _line(x: Times, y: Times) -> Times:
    """Mean and slope of y(x); the slope as far as it is not jitter, with the error of a clock's rate."""
    x = x - x.mean()
    mean, square = y.mean(), float(x @ x)
    rest = y - mean - x * float(x @ y) / square
    jitter = float(rest @ rest) / max(len(y) - 2, 1)
    return np.asarray(mean + x * float(x @ y) / (square + jitter / _RATE_ERROR**2))


def _resolution(times: Times) -> float:
    """Seconds to which times are rounded; 0 where they are not."""
    for step in _RESOLUTIONS:
        if np.abs(times / step - np.rint(times / step)).max() < 1e-3:
            return step
    return 0.0
