import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_paths import JITTER

from wavefield.measurement.elevation import Surface
from wavefield.measurement.midtime import rise_of_water, slope, z_at_mid_time
from wavefield.measurement.paths import elevation_gain
from wavefield.measurement.velocity import Motion
from wavefield.tank import Scene
from wavefield.tank.beads import carry
from wavefield.tank.sea import Basin

TIMES = np.arange(6) - 2.5


def everywhere(x, y, z):
    return np.ones(np.shape(x), bool)


def surfaces(field, lost=(), times=TIMES):
    """Surfaces z = field(x, t) at the node x = 0 and wherever they are read."""
    out = []
    for n, t in enumerate(times):
        z, places = np.full((1, 1), field(0.0, t), np.float32), np.zeros((1, 1), bool)
        read = lambda x, y, t=t: np.asarray(field(x, t), np.float32) + np.zeros_like(x)  # noqa: E731
        out.append(
            None
            if n in lost
            else Surface(z, z, z, z, 0.0, places.astype(np.uint16), places, read, everywhere)
        )
    return out


AT = np.zeros((1, 1))


def z_of(field, lost=(), speed=0.0):
    return float(
        z_at_mid_time(surfaces(lambda x, t: field(t - x), lost), (speed, 0.0), AT, AT, TIMES)[0][0][0, 0]
    )


@pytest.mark.parametrize(("frames", "lost"), [(6, ()), (4, (0,)), (2, (1, 4))])
@pytest.mark.parametrize("speed", [0.0, 0.7, -2.0])
def test_a_wave_keeps_what_theory_states_of_how_it_turns_beside_the_mean_flow(frames, lost, speed):
    for phase in (0.3, 1.0, 2.0):
        kept = z_of(lambda t, p=phase: np.cos(p * t), lost, speed)  # it passes the node with its crest
        turns = phase * (1 - speed)
        assert kept == pytest.approx(float(elevation_gain(np.array([turns]), frames)[0]), abs=1e-6)


@given(JITTER, st.sampled_from([(), (0,), (5,), (1,), (4,), (1, 4)]), st.floats(-2, 2))
@settings(max_examples=40, deadline=None)
def test_z_at_mid_time_is_that_of_the_polynomial_through_the_frames(times, lost, speed):
    degree = {(): 5, (0,): 3, (5,): 3, (1,): 2, (4,): 2, (1, 4): 1}[lost]
    seen = surfaces(lambda x, t: (t + 1.0 - (x - speed * t)) ** degree, lost, times)
    chord = speed * (times[3] - times[2])
    found = z_at_mid_time(seen, (chord, 0.0), AT, AT, times)[0][0]
    assert float(found[0, 0]) == pytest.approx(1.0, abs=2e-3)


@pytest.mark.parametrize("current", [(0.0, 0.0), (0.66, 0.45)])
@pytest.mark.parametrize(("rate", "longest", "order"), [(20.0, 0.08, 2), (100.0, 0.05, 1)])
def test_surface_and_kinematics_are_exact_to_the_interpolation_on_any_current(current, rate, longest, order):
    sea = {"kind": "random", "rms": 0.006, "shortest": longest, "period": 2.0, "order": order}
    sea |= {"current": current, "spectrum": {"kind": "jonswap", "peak": 1.5}}
    sea = Scene.load("demo").with_(sea=sea, seed=int(rate)).build_sea()
    dt, now, step = 1.0 / rate, 0.3, 0.01
    x, y = np.meshgrid(np.arange(14) * step, np.arange(12) * step)
    basin = Basin(sea, (-0.4, 0.6), (-0.4, 0.6))

    def height(x, y, t):
        return basin.snapshot(now + t * dt)(x, y)[0]

    places = [np.stack(carry(basin, x, y, now, now + t * dt)) for t in (-0.5, 0.5)]
    path = [np.stack([*p, height(*p, t)]) for p, t in zip(places, (-0.5, 0.5))]
    chord = path[1] - path[0]
    bend = 0.5 * (path[0] + path[1]) - np.stack([x, y, height(x, y, 0.0)])
    exact = sea.on_grid(x[0], y[:, 0], now, ("z", "z_t", "u", "v", "w"))
    d = np.stack([exact[name] for name in "uvw"]) * dt
    none = np.zeros(x.shape, np.uint16)
    moved = Motion(d, d, d, d[0], d[0], d[0], none, none.astype(np.uint8), chord, bend)
    frames = [
        Surface(x, x, x, x, 0.0, none, none > 0, lambda x, y, t=t: height(x, y, t), everywhere) for t in TIMES
    ]
    flow = float(np.median(chord[0])), float(np.median(chord[1]))
    z, rise = z_at_mid_time(frames, flow, x, y, TIMES)[0][0], rise_of_water(*frames[2:4], moved, flow, x, y)
    inside = np.s_[3:-3, 3:-3]
    rms = lambda field: np.sqrt(np.mean(np.square(field[inside])))  # noqa: E731
    assert rms(z - exact["z"]) < 2e-5, "m"
    nonlinear = sum(exact[name] * slope(z, step, axis) for name, axis in (("u", 1), ("v", 0)))
    z_t = rise / dt - nonlinear
    assert rms(z_t - exact["z_t"]) < 0.02 * rms(exact["z_t"])
    residual = z_t - exact["w"] + nonlinear
    assert rms(residual) < 1e-3 * rms(exact["w"])
