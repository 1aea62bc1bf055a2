"""Departures of frames from even times: what the cameras' clocks share, without their noise and drift."""

import numpy as np
import pytest

from wavefield.series.clocks import frame_departures
from wavefield.series.frames import FrameSeries

RATE = 20.0


def series(*clocks):
    return {
        f"cam{n}": FrameSeries(f"cam{n}", 0, [None] * len(t), (2, 2), "uint8", times=t)
        for n, t in enumerate(clocks)
    }


def departures(*clocks):
    return frame_departures(series(*clocks))


@pytest.mark.parametrize("frames", [60, 2000])
def test_jitter_that_all_cameras_share_is_found_whatever_the_offset_of_their_clocks(frames):
    jitter = np.random.default_rng(frames).normal(0, 1e-3, frames)
    shared = np.arange(frames) / RATE + jitter
    found = departures(shared, shared + 7.0, 1000.0 + shared * (1 + 2e-4))
    off = found / RATE - (jitter - jitter.mean())
    assert np.sqrt(np.mean(off**2)) < 2e-4


@pytest.mark.parametrize("frames", [9, 2000])
def test_noise_of_stamps_rates_of_clocks_and_rounding_are_no_departures(frames):
    rng = np.random.default_rng(frames)
    even = np.arange(frames) / RATE
    assert departures(even) is None
    assert departures(even + 12.3, even * 1.0004) is None
    noisy = departures(*(even + rng.normal(0, 1e-3, frames) for _ in range(3)))
    assert noisy is None or np.sqrt(np.mean(noisy**2)) / RATE < 0.4e-3
    # as by video files: whole milliseconds
    thirty = np.round(np.arange(frames) / 29.97, 3)
    assert departures(thirty, thirty + 0.123) is None
