"""z at mid-time from the frames around, and what frames so far apart leave out."""

import numpy as np
import pytest

from wavefield.measurement.elevation import Surface
from wavefield.measurement.midtime import frames_used, rise_of_water, slope, z_by_orders
from wavefield.measurement.temporal_truncation import (
    NOTHING,
    TemporalTruncation,
    temporal_truncation,
)
from wavefield.measurement.time_weights import elevation_gain, path_gain
from wavefield.measurement.velocity import Motion
from wavefield.tank import Scene
from wavefield.tank.basin import Basin
from wavefield.tank.beads import carry
from wavefield.waves.nonlinear.kinematics import slopes

TIMES = (-2.5, -1.5, -0.5, 0.5, 1.5, 2.5)


def everywhere(x, y):
    return np.ones(np.shape(x), bool)


def surfaces(field, lost=()):
    """Surfaces z = field(x, t) at the node x = 0 and wherever they are read."""
    out = []
    for n, t in enumerate(TIMES):
        z, places = np.full((1, 1), field(0.0, t), np.float32), np.zeros((1, 1), bool)
        read = lambda x, y, t=t: np.asarray(field(x, t), np.float32) + np.zeros_like(x)  # noqa: E731
        out.append(
            None if n in lost else Surface(z, z, z, places.astype(np.uint16), places, read, everywhere)
        )
    return out


def moving(chord=(0.0, 0.0, 0.0), bend=(0.0, 0.0, 0.0), d=(0.0, 0.0, 0.0)):
    """Water that moves so."""
    chord, bend, d = (np.array(part, float)[:, None, None] for part in (chord, bend, d))
    one = np.zeros((1, 1), np.uint8)
    return Motion(d, d, d[0], d[0], d[0], one.astype(np.uint16), one, chord, bend)


AT = np.zeros((1, 1))


def z_of(field, lost=(), speed=0.0):
    return float(z_by_orders(surfaces(lambda x, t: field(t - x), lost), (speed, 0.0), AT, AT)[0][0, 0])


def test_six_frames_take_a_polynomial_of_fifth_degree_to_mid_time():
    assert z_of(lambda t: 1 + t + t**4 - t**5) == pytest.approx(1.0, abs=1e-5)
    # without an outer frame a cubic, without a neighbour a parabola, without both a line
    for lost in ((0,), (5,)):
        assert frames_used(surfaces(lambda x, t: t, lost)) == 4
        assert z_of(lambda t: 1 + t**2 + t**3, lost) == pytest.approx(1.0, abs=1e-5)
        assert abs(z_of(lambda t: t**4, lost)) > 0.1
    for lost in ((1,), (4,), (0, 1), (0, 4)):
        assert frames_used(surfaces(lambda x, t: t, lost)) == 3
        assert z_of(lambda t: 1 + t + t**2, lost) == pytest.approx(1.0, abs=1e-5)
    assert frames_used(surfaces(lambda x, t: t, (1, 4))) == 2
    assert z_of(lambda t: 1 + t, (1, 4)) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize(("frames", "lost"), [(6, ()), (4, (0,)), (2, (1, 4))])
@pytest.mark.parametrize("speed", [0.0, 0.7, -2.0])
def test_a_wave_keeps_what_theory_states_of_how_it_turns_beside_the_mean_flow(frames, lost, speed):
    for phase in (0.3, 1.0, 2.0):
        kept = z_of(lambda t, p=phase: np.cos(p * t), lost, speed)  # it passes the node with its crest
        turns = phase * (1 - speed)
        assert kept == pytest.approx(float(elevation_gain(np.array([turns]), frames)[0]), abs=1e-6)


def test_the_rise_is_that_of_the_surface_along_the_path_of_the_water():
    def surface(x, t):
        return 0.3 * t**3 + 0.2 * x * t + 0.1 * x

    for chord, bend in ((0.0, 0.0), (1.5, 0.0), (1.5, 0.2)):
        moved = moving((chord, 0, 0.4), (bend, 0, 0), (0, 0, 0.5))
        rise = float(rise_of_water(*surfaces(surface)[2:4], moved, (0.0, 0.0), AT, AT)[0, 0])
        exact = surface(0.5 * chord + bend, 0.5) - surface(-0.5 * chord + bend, -0.5)
        # and what the velocity at mid-time rises beyond the displacement over the step
        assert rise == pytest.approx(exact + 0.1, abs=1e-6)


def test_slopes_are_those_of_the_kinematics():
    z = np.random.default_rng(0).normal(size=(12, 9)).astype(np.float32)
    for axis, exact in enumerate(slopes(z[None], 0.01, 0.01)):
        np.testing.assert_allclose(slope(z, 0.01, axis), exact[0], rtol=1e-4, atol=1e-2)


CURRENTS = [(0.0, 0.0), (0.4, -0.2), (0.66, 0.45)]


@pytest.mark.parametrize("current", CURRENTS)
@pytest.mark.parametrize(("rate", "longest"), [(20.0, 0.08), (40.0, 0.06), (100.0, 0.05)])
@pytest.mark.parametrize("order", [1, 2])
def test_surface_and_kinematics_are_exact_to_the_interpolation_on_any_current(current, rate, longest, order):
    """Surfaces and paths without noise: z, z_t and the residual are those of the sea."""
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
    moved = Motion(d, d, d[0], d[0], d[0], none, none.astype(np.uint8), chord, bend)
    frames = [Surface(x, x, x, none, none > 0, lambda x, y, t=t: height(x, y, t), everywhere) for t in TIMES]
    flow = float(np.median(chord[0])), float(np.median(chord[1]))
    z, rise = z_by_orders(frames, flow, x, y)[0], rise_of_water(*frames[2:4], moved, flow, x, y)
    inside = np.s_[3:-3, 3:-3]
    rms = lambda field: np.sqrt(np.mean(np.square(field[inside])))  # noqa: E731
    assert rms(z - exact["z"]) < 2e-5, "m"
    nonlinear = sum(exact[name] * slope(z, step, axis) for name, axis in (("u", 1), ("v", 0)))
    z_t = rise / dt - nonlinear
    assert rms(z_t - exact["z_t"]) < 0.02 * rms(exact["z_t"])
    residual = z_t - exact["w"] + nonlinear
    assert rms(residual) < 1e-3 * rms(exact["w"])


def sea(rate, t, waves):
    x, y = np.meshgrid(np.arange(100) * 0.01, np.arange(80) * 0.01)
    z, w = np.zeros((2, *x.shape))
    for length, height, angle, shift in waves:
        k = 2 * np.pi / length
        omega = np.sqrt(9.81 * k) / rate  # per frame
        phase = k * (np.cos(angle) * x + np.sin(angle) * y) - omega * t + shift
        z += height * np.cos(phase)
        w += height * omega * np.sin(phase)
    return z, w


@pytest.mark.parametrize("rate", [10.0, 20.0])
def test_what_frames_cannot_follow_is_foreseen(rate):
    """Short waves are small, but they turn most in a step: the rms of all shows nothing of what is lost."""
    rng = np.random.default_rng(3)
    waves = [(length, 0.002 * length, *rng.uniform(0, 6, 2)) for length in (0.7, 0.4, 0.2, 0.13, 0.1)]
    found = temporal_truncation(
        [(sea(rate, t, waves)[0], sea(rate, t + 1, waves)[0]) for t in (0.0, 7.0, 15.0)], 0.01
    )
    lost = {n: [] for n in (2, 4, 6)}
    moved, missed = [], {4: [], 6: []}
    for t in np.arange(8) * 2.3:
        z = [sea(rate, t + s, waves)[0] for s in TIMES]
        exact, w = sea(rate, t, waves)
        means = {
            2: (z[2] + z[3]) / 2,
            4: (9 * (z[2] + z[3]) - z[1] - z[4]) / 16,
            6: (150 * (z[2] + z[3]) - 25 * (z[1] + z[4]) + 3 * (z[0] + z[5])) / 256,
        }
        for n, mean in means.items():
            lost[n].append(np.mean((mean - exact) ** 2))
        rises = np.diff(z, axis=0)
        moved.append(np.mean(w**2))
        beside, beyond = rises[1] + rises[3], rises[0] + rises[4]
        missed[4].append(np.mean(((26 * rises[2] - beside) / 24 - w) ** 2))
        missed[6].append(np.mean(((34 * rises[2] + 10 * beside - 3 * beyond) / 48 - w) ** 2))
    for n, squares in lost.items():
        assert found.of_z(n) == pytest.approx(np.sqrt(np.mean(squares)), rel=0.25), n
    for n, squares in missed.items():
        of_still_water = np.sqrt(2) * dict(found.d)[n][0]  # an axis has half of what water moves
        assert of_still_water == pytest.approx(np.sqrt(np.mean(squares) / np.mean(moved)), rel=0.25), n


@pytest.mark.parametrize("seed", [2, 3])
def test_waves_longer_than_the_field_do_not_pass_for_slow_short_ones(seed):
    rng = np.random.default_rng(seed)
    lengths = (1.6, 1.3, 1.1, 0.9, 0.25, 0.2, 0.17, 0.14)
    waves = [(length, 0.002 * length, *rng.uniform(0, 6, 2)) for length in lengths]
    part, times = np.s_[:29, :37], np.arange(12) * 2.3
    found = temporal_truncation([[sea(20.0, t + s, waves)[0][part] for s in (0, 1)] for t in times], 0.01)
    moved, missed = [], []
    for t in times:
        rises = np.diff([sea(20.0, t + s, waves)[0][part] for s in TIMES[1:5]], axis=0)
        w = sea(20.0, t, waves)[1][part]
        moved.append(np.mean(w**2))
        missed.append(np.mean(((26 * rises[1] - rises[0] - rises[2]) / 24 - w) ** 2))
    stated = np.sqrt(2) * dict(found.d)[4][0]
    assert 0.65 < stated / np.sqrt(np.mean(missed) / np.mean(moved)) < 1.3


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_waves_that_turn_more_than_half_round_in_a_frame_are_not_taken_for_slower_ones(seed):
    rng = np.random.default_rng(seed)
    rate, lengths = 9.0, (0.3, 0.2, 0.15, 0.12, 0.1, 0.09, 0.07, 0.06, 0.05)  # the last three beyond pi
    waves = [(length, 0.01 * length, *rng.uniform(0, 6, 2)) for length in lengths]
    times = np.arange(6) * 2.3
    found = temporal_truncation([(sea(rate, t, waves)[0], sea(rate, t + 1, waves)[0]) for t in times], 0.01)
    lost = []
    for t in times:
        z = [sea(rate, t + s, waves)[0] for s in TIMES]
        lost.append(np.mean(((9 * (z[2] + z[3]) - z[1] - z[4]) / 16 - sea(rate, t, waves)[0]) ** 2))
    assert found.of_z(4) == pytest.approx(np.sqrt(np.mean(lost)), rel=0.3)


@pytest.mark.parametrize("seed", range(4))
def test_paths_are_as_uncertain_at_the_crests_of_waves_longer_than_the_field(seed):
    rng = np.random.default_rng(seed)
    rate, part = 13.0, np.s_[:18, :24]
    waves = [(length, 0.005, *rng.uniform(0, 6, 2)) for length in (0.8, 0.75)]
    found = temporal_truncation(
        [[sea(rate, t + s, waves)[0][part] for s in (0, 1)] for t in (1.0, 9.0, 17.0, 25.0)], 0.01
    )
    everywhere = np.ones((18, 24), bool)
    for t in np.linspace(3.0, 30.0, 40):
        quarter = sea(rate, t, [(*one[:3], one[3] + np.pi / 2) for one in waves])  # moves along as much
        before = sea(rate, t - 0.5, [(*one[:3], one[3] + np.pi / 2) for one in waves])
        after = sea(rate, t + 0.5, [(*one[:3], one[3] + np.pi / 2) for one in waves])
        error = np.abs((after[0] - before[0] - quarter[1])[part])
        moved = np.stack([quarter[1][part], quarter[1][part], sea(rate, t, waves)[1][part]])
        stated = np.hypot(*found.of_displacement(2, moved, everywhere)[:2])
        assert (error < 5.0 * stated).all()


def carried(rate, t, span, waves, beside=(0.0, 0.0)):
    """Displacement over ``span`` frames of the water that is beside the nodes at t, (3, n), metres."""
    x, y = (nodes.ravel() for nodes in np.meshgrid(np.arange(0, 1, 0.04), np.arange(0, 0.8, 0.04)))
    x, y = x + beside[0], y + beside[1]

    def velocity(x, y, t):
        out = np.zeros((3, x.size))
        for length, height, angle, shift in waves:
            k = 2 * np.pi / length
            omega = np.sqrt(9.81 * k) / rate
            phase = k * (np.cos(angle) * x + np.sin(angle) * y) - omega * t + shift
            out[:2] += height * omega * np.cos(phase) * np.array([[np.cos(angle)], [np.sin(angle)]])
            out[2] += height * np.cos(phase)
        return out

    p, steps = np.stack([x, y]), 8
    h = span / steps
    for n in range(steps):
        middle = p + 0.5 * h * velocity(*p, t + n * h)[:2]
        p = p + h * velocity(*middle, t + (n + 0.5) * h)[:2]
    rise = velocity(*p, t + span)[2] - velocity(x, y, t)[2]
    return np.stack([*(p - [x, y]), rise])


@pytest.mark.parametrize(("rate", "places"), [(10.0, 4), (20.0, 4), (40.0, 6)])
def test_paths_lose_more_of_short_waves_where_long_ones_carry_the_water_fast(rate, places):
    rng = np.random.default_rng(4)
    lengths = [1.5, 1.0, 0.7, 0.2, 0.16, 0.13, 0.11, 0.1, 0.09, 0.08]
    waves = [(length, 0.01 * length**1.5, *rng.uniform(0, 6, 2)) for length in lengths]
    times = np.arange(8) * 2.3
    found = temporal_truncation([(sea(rate, t, waves)[0], sea(rate, t + 1, waves)[0]) for t in times], 0.01)
    weights = {4: (0, -2, 52, -2, 0), 6: (-3, 10, 34, 10, -3)}[places]
    error, moved = [], []
    for t in times:
        path = np.diff(np.array([carried(rate, t, s, waves) for s in TIMES]), axis=0)
        moved.append((carried(rate, t, 1e-4, waves) - carried(rate, t, -1e-4, waves)) / 2e-4)
        error.append(np.tensordot(weights, path, 1) / 48 - moved[-1])
    error, moved = (np.concatenate(part, axis=1)[:, None] for part in (error, moved))
    stated = found.of_displacement(places, moved, np.ones(moved.shape[1:], bool))
    speed = np.hypot(*moved[:2])
    for where in (speed < np.median(speed), speed > np.median(speed)):
        for one, other in ((error[:2], stated[:2]), (error[2:], stated[2:])):
            rms = [np.sqrt(np.mean(part[:, where] ** 2)) for part in (one, other)]
            assert rms[1] == pytest.approx(rms[0], rel=0.4), (where.mean(), one.shape)
    if places == 4:
        chord = found.of_displacement(2, moved, np.ones(moved.shape[1:], bool))
        assert (chord > stated).mean() > 0.99


@pytest.mark.parametrize("seed", range(8))
def test_paths_of_steep_short_waves_are_as_uncertain_as_their_harmonics_and_places(seed):
    """Where matching makes up for what paths leave out of the wave itself."""
    rng = np.random.default_rng([seed, 7])
    length, steepness, phase = rng.uniform(0.07, 0.1), rng.uniform(0.1, 0.2), rng.uniform(1.1, 1.6)
    rate = np.sqrt(2 * np.pi * 9.81 / length) / phase
    waves = [(length, steepness * length / (np.sqrt(2) * np.pi), *rng.uniform(0, 6, 2))]
    times, gain = np.arange(8) * 2.3, float(path_gain(phase, 4))
    found = temporal_truncation(
        [(sea(rate, t, waves)[0], sea(rate, t + 1, waves)[0]) for t in times],
        0.01,
        matching_gain=lambda k: np.full_like(k, 1.0 / gain),
    )
    error, moved = [], []
    for t in times:
        path = np.array([carried(rate, t, s, waves)[:2] for s in TIMES[1:5]])
        velocity = np.tensordot((1, -27, 27, -1), path, 1) / 24 / gain
        place = np.tensordot((-1, 9, 9, -1), path, 1) / 16
        moved.append((carried(rate, t, 1e-4, waves) - carried(rate, t, -1e-4, waves)) / 2e-4)
        there = (carried(rate, t, 1e-4, waves, place) - carried(rate, t, -1e-4, waves, place)) / 2e-4
        error.append(velocity - there[:2])
    error, moved = (np.concatenate(part, axis=1)[:, None] for part in (error, moved))
    stated = found.of_displacement(4, moved, np.ones(moved.shape[1:], bool))[:2]
    rms = [np.sqrt(np.sum(np.mean(part**2, axis=(1, 2)))) for part in (error, stated)]
    assert 0.75 < rms[1] / rms[0] < 1.3


def test_a_displacement_keeps_what_theory_states():
    p = np.array([0.5, 1.0])
    np.testing.assert_allclose(path_gain(p, 2), 2 * np.sin(p / 2) / p)
    np.testing.assert_allclose(1 - path_gain(p[:1], 4), 3 / 640 * p[:1] ** 4, rtol=0.1)


def test_water_at_rest_leaves_nothing_out():
    still = np.zeros((40, 50))
    found = temporal_truncation([(still, still)], 0.01)
    assert set(dict(found.z).values()) == {0.0}
    assert {part for parts in dict(found.d).values() for part in parts} == {0.0}
    assert TemporalTruncation.from_dict(found.to_dict()) == found
    assert hash(found) == hash(TemporalTruncation.from_dict(found.to_dict())), "plans are found by it"
    for rise in (1e-12, 1e-8, 1e-3):  # without any wave, or almost
        level = temporal_truncation([(still, still + rise)], 0.01)
        assert np.isfinite([*dict(level.z).values(), *np.ravel(list(dict(level.d).values()))]).all()
    line = np.zeros((1, 50))  # too few nodes to show waves
    assert temporal_truncation([(line, line)], 0.01) == NOTHING
