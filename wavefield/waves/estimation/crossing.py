"""Correlation of segments by waves that are still in the window: how long waves take to cross it."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.water import dispersion, group_velocity
from wavefield.waves.estimation.welch import Welch

Array = NDArray[Any]

HEADINGS = 17  # of the waves, from along the current to against it
LAGS = 41  # at which the windows in time and space are joined
MOST_SEGMENTS = 40  # that may be correlated
STILL = 1e-6  # m/s, of a current
NOISE_LINES = 0.75  # of the Nyquist frequency: what is above counts as noise


def hann_autocorrelation(lag: Array) -> Array:
    """Autocorrelation of a Hann window of length 1.

    Examples
    --------
    >>> hann_autocorrelation(np.array([0.0, 0.5, 0.75])).round(3).tolist()
    [1.0, 0.167, 0.008]
    """
    x = np.minimum(np.abs(lag), 1.0)
    return np.asarray(((1 - x) * (2 + np.cos(2 * np.pi * x)) + 1.5 / np.pi * np.sin(2 * np.pi * x)) / 3)


def correlation_at(velocity: Sequence[Array], duration: float, lengths: Sequence[float], count: int) -> Array:
    """Variance of a mean of segments over that of independent ones, of packets of velocities (x and y), m/s.
    1 + 2 sum_n (1 - n / K) c(n T / 2)^2 / c(0)^2, T the duration, s; the window is lengths, m, along x and y.
    """
    s = np.linspace(-1, 1, LAGS)
    in_time = hann_autocorrelation(s)
    out, alone = np.ones_like(velocity[0]), np.ones(())
    for lag in range(min(count, MOST_SEGMENTS)):
        apart = (lag / 2 - s) * duration
        in_space = [
            hann_autocorrelation(v[..., None] * apart / length) for v, length in zip(velocity, lengths)
        ]
        # c(dt) = int a(s / T) a(v (dt - s) / L) ds for lines dt apart, a the autocorrelation of the Hann
        # window: a cell holds a packet while it is within the windows in space and in time
        power = (in_space[0] * in_space[1] * in_time).sum(axis=-1) ** 2
        if lag:
            out += 2 * (1 - lag / count) * power / alone
        else:
            alone = power
    return out


def crossing_correlation(welch: Welch) -> Array:
    """Variance of a mean of segments over that of independent segments, of free waves, (rings, lines).
    That of `correlation_at` of packets with v = c_g + U; the direction follows from omega = sigma(k) + k . U.
    """
    record, table = welch.record, welch.table
    duration = welch.segment * record.dt
    lengths = record.shape[1] * record.dx, record.shape[0] * record.dy
    group, still = group_velocity(table.k, welch.depth), dispersion(table.k, welch.depth)
    speed, towards = np.hypot(*welch.current), np.arctan2(welch.current[1], welch.current[0])
    turn = np.linspace(0, np.pi, HEADINGS)
    out = np.zeros((table.k.size, HEADINGS))
    for side in (1, -1):
        velocity = [
            group[:, None] * part(towards + side * turn) + along
            for part, along in zip((np.cos, np.sin), welch.current)
        ]
        out += correlation_at(velocity, duration, lengths, welch.count) / 2
    lines = welch.omega.size
    if speed < STILL:
        return np.repeat(out.mean(axis=1, keepdims=True), lines, axis=1)
    along = (welch.omega - still[:, None]) / (table.k * speed)[:, None]
    place = np.arccos(along.clip(-1, 1)) * (HEADINGS - 1) / np.pi
    first = np.minimum(place.astype(int), HEADINGS - 2)
    values = [np.take_along_axis(out, first + i, axis=1) for i in (0, 1)]
    return np.asarray(values[0] + (place - first) * (values[1] - values[0]))


def wave_share(power: Array) -> Array:
    """Share of waves in powers (rings, lines), noise being that of each ring's highest lines."""
    first = int(NOISE_LINES * (power.shape[1] - 1))
    noise = power[:, first:-1].mean(axis=1, keepdims=True) if first < power.shape[1] - 1 else 0.0
    return np.asarray(1 - np.minimum(noise / np.maximum(power, 1e-300), 1.0))
