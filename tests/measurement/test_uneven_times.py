"""Frames at uneven times: paths, z at mid-time and their noise follow the times of the frames."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_midtime import AT
from test_paths import LATTICE, MIDDLE, turned

from wavefield.measurement.elevation import Surface
from wavefield.measurement.midtime import z_at_mid_time
from wavefield.measurement.paths import (
    EVEN_TIMES,
    path_weights,
    read_path,
)

EVEN = EVEN_TIMES
JITTER = st.lists(st.floats(-0.2, 0.2), min_size=6, max_size=6).map(lambda e: EVEN + e)
USED = {2: (2, 3), 3: (1, 2, 3), 4: (1, 2, 3, 4), 6: (0, 1, 2, 3, 4, 5)}


def error(angle, times, there, read):
    """Of a body that turns by an angle per interval, seen at these times."""
    splines = [turned(angle * span) if q else None for span, q in zip(np.diff(times), there)]
    everywhere = [np.ones(LATTICE.shape, bool) if q else None for q in there]
    X, Y = np.meshgrid(np.linspace(110.0, 190.0, 5), np.linspace(110.0, 190.0, 5))
    d, _ = read(splines, everywhere, LATTICE, X, Y)
    exact = angle * np.stack([-(Y - MIDDLE), X - MIDDLE])
    size = np.abs(exact).max()
    p = np.stack([X - MIDDLE, Y - MIDDLE])
    c, s = np.cos(angle * times), np.sin(angle * times)
    places = [np.stack([c[n] * p[0] - s[n] * p[1], s[n] * p[0] + c[n] * p[1]]) - p for n in (2, 3)]
    return (
        float(np.abs(d[:2] - exact).max() / size),
        float(np.abs(d[4:] - 0.5 * (places[0] + places[1])).max() / size),
        float(np.abs(d[2:4] - (places[1] - places[0])).max() / size),
    )


@given(JITTER, st.sampled_from([2, 3, 4, 6, -3]))
@settings(max_examples=25, deadline=None)
def test_paths_through_frames_at_uneven_times_are_as_exact_as_through_even_ones(times, places):
    there = {2: "00100", 3: "01100", -3: "00110", 4: "01110", 6: "11111"}[places]
    there = [q == "1" for q in there]
    limit = {2: 0.03, 3: 3e-3, 4: 5e-4, 6: 5e-4}[abs(places)]
    uneven = error(0.1, times, there, lambda *a: read_path(*a, path_weights(times)))
    assert max(uneven) < limit
    # and through the same places as where times are taken for even
    used = list(USED.get(places, ()))
    if places in (4, 6) and np.abs(times - EVEN)[used].max() > 0.1:
        assert max(error(0.1, times, there, read_path)) > 3 * max(uneven)


@given(JITTER, st.sampled_from([(), (0,), (5,), (1,), (4,), (1, 4)]), st.floats(-2, 2))
@settings(max_examples=40, deadline=None)
def test_z_at_mid_time_is_that_of_the_polynomial_through_the_frames(times, lost, speed):
    degree = {(): 5, (0,): 3, (5,): 3, (1,): 2, (4,): 2, (1, 4): 1}[lost]
    surfaces = []
    for n, t in enumerate(times):
        z, nowhere = np.zeros((1, 1), np.float32), np.zeros((1, 1), bool)
        read = lambda x, y, t=t: np.asarray((t + 1.0 - (x - speed * t)) ** degree, np.float32)  # noqa: E731
        surfaces.append(
            None
            if n in lost
            else Surface(z, z, z, z, 0.0, nowhere.astype(np.uint16), nowhere, read, lambda x, y, z: x == x)
        )
    chord = speed * (times[3] - times[2])
    found = z_at_mid_time(surfaces, (chord, 0.0), AT, AT, times)[0][0]
    assert float(found[0, 0]) == pytest.approx(1.0, abs=2e-3)
