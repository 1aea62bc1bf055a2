"""What the finite time step leaves out of single steps: groups of waves, long waves, flat orbits."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from wavefield.matching import Prior
from wavefield.measurement.step_truncation import elevation_truncation, motion_truncation
from wavefield.measurement.temporal_truncation import detected_waves, temporal_truncation
from wavefield.measurement.time_weights import ELEVATION_WEIGHTS, path_gain, uneven_weights
from wavefield.water import dispersion

TIMES = np.arange(6) - 2.5
SHAPE = 18, 24
EVERYWHERE = np.ones(SHAPE, bool)


def of_frames(number):
    return np.full(SHAPE, number, np.uint8)


class Waves:
    """Waves of random lengths, directions and phases over a field of 18 cm by 24 cm; per frame."""

    def __init__(self, seed, longest, depth):
        rng = np.random.default_rng(seed)
        self.rate = rng.uniform(9.0, 16.0)
        length = np.geomspace(0.15, longest, 14)
        k, angle = 2 * np.pi / length, rng.uniform(-0.6, 0.6, 14) + rng.uniform(0, 6)
        x, y = np.meshgrid(np.arange(SHAPE[1]) * 0.01, np.arange(SHAPE[0]) * 0.01)
        self.direction = np.stack([np.cos(angle), np.sin(angle)])
        self.omega = np.sqrt(9.81 * k * np.tanh(k * depth)) / self.rate
        self.flat = 1 / np.tanh(k * depth)
        self.height = 0.004 * length**1.5 * rng.uniform(0.5, 1.5, 14)
        self.phase = np.einsum("in,iyx->nyx", k * self.direction, np.stack([x, y]))
        self.phase += rng.uniform(0, 6, 14)[:, None, None]

    def z(self, t):
        turned = self.phase - (self.omega * t)[:, None, None]
        return np.tensordot(self.height, np.cos(turned), 1)

    def motion(self, t):
        turned = self.phase - (self.omega * t)[:, None, None]
        size = self.height * self.omega
        across = np.einsum("in,nyx->iyx", size * self.flat * self.direction, np.cos(turned))
        return np.stack([*across, np.tensordot(size, np.sin(turned), 1)])

    def displaced(self, t):
        """Over the step around t."""
        return np.mean([self.motion(t + s) for s in np.arange(-0.475, 0.5, 0.05)], axis=0)

    def record(self):
        """As sample steps show it, whose waves are at other places of their groups."""
        pairs = [(self.z(t), self.z(t + 1)) for t in (3.0, 30.0, 57.0, 84.0)]
        moved = np.sqrt(
            np.mean([np.var(self.motion(t), axis=(1, 2)) for t in (3.5, 30.5, 57.5, 84.5)], axis=0)
        )
        return SimpleNamespace(temporal_truncation=temporal_truncation(pairs, 0.01), moved=tuple(moved))

    def orders(self, t, most):
        frames = [self.z(t + s) for s in TIMES]
        return tuple(np.tensordot(ELEVATION_WEIGHTS[n], frames, 1) for n in (6, 4, 2) if n <= most)


def rms(field):
    return np.sqrt(np.mean(np.square(field)))


@pytest.mark.parametrize("frames", [6, 4])
def test_elevations_of_steps_with_more_fast_waves_than_the_samples_are_stated_more_uncertain(frames):
    now, record_alone = [], []
    for seed in range(12):
        waves = Waves(seed, longest=2.0, depth=np.inf)
        record = waves.record()
        for t in np.linspace(10.0, 120.0, 8):
            orders = waves.orders(t, frames)
            stated = elevation_truncation(orders, of_frames(frames), np.ones(SHAPE), EVERYWHERE, record, 0.0)
            error = rms(orders[0] - waves.z(t))
            now.append(error / rms(stated))
            record_alone.append(error / record.temporal_truncation.of_z(frames))
    assert np.percentile(now, 95) < min(2.2, 0.8 * np.percentile(record_alone, 95))
    assert np.median(now) > 0.3, "not more cautious than that"


@pytest.mark.parametrize("places", [4, 2])
def test_motion_is_stated_as_uncertain_as_groups_and_the_depth_make_it(places):
    now, record_alone = [], []
    for seed in range(12):
        waves = Waves(seed, longest=1.5, depth=0.06)
        record = waves.record()
        for t in np.linspace(10.0, 120.0, 8):
            before, chord, after = (waves.displaced(t + s) for s in (-1, 0, 1))
            d = chord if places == 2 else (26 * chord - before - after) / 24
            motion = SimpleNamespace(d=d, chord=chord, frames=np.full(SHAPE, places, np.uint8))
            orders = waves.orders(t, 6 if places == 4 else 4)
            stated = motion_truncation(motion, orders, of_frames(6), EVERYWHERE, EVERYWHERE, record, 0.0)
            alone = record.temporal_truncation.of_displacement(places, d, EVERYWHERE)
            error = d - waves.motion(t)
            now.append(rms(error[:2]) / rms(stated[:2]))
            record_alone.append(rms(error[:2]) / rms(alone[:2]))
    assert np.percentile(now, 95) < min(2.2, 0.8 * np.percentile(record_alone, 95))
    assert np.median(now) > 0.3, "not more cautious than that"


@pytest.mark.parametrize("places", [4, 2])
def test_motion_is_stated_where_no_measured_node_has_z_of_six_frames(places):
    """On a fast current all water of some steps enters or leaves the view."""
    now, measured = [], np.arange(SHAPE[1]) > 8
    measured = np.broadcast_to(measured, SHAPE)
    for seed in range(12):
        waves = Waves(seed, longest=0.6, depth=0.5)
        record = waves.record()
        before, chord, after = (waves.displaced(20.0 + s) for s in (-1, 0, 1))
        d = chord if places == 2 else (26 * chord - before - after) / 24
        motion = SimpleNamespace(d=d, chord=chord, frames=of_frames(places))
        of_z = np.where(measured, of_frames(2), of_frames(6))
        stated = motion_truncation(motion, waves.orders(20.0, 6), of_z, EVERYWHERE, measured, record, 0.0)
        error = d - waves.motion(20.0)
        now.append(rms(error[:, measured]) / rms(stated[:, measured]))
    assert 0.3 < np.median(now) < 1.5
    assert np.percentile(now, 90) < 3.0, "by what the record shows alone, not this step"


@pytest.mark.parametrize("places", [4, 2])
def test_paths_through_frames_at_uneven_times_are_as_uncertain_as_they_err(places):
    """Four frames, or the parabola of a record's first step; chords are the velocity of another moment."""
    now = []
    for seed in range(30):
        waves, rng = Waves(seed, longest=0.8, depth=np.inf), np.random.default_rng(seed)
        waves.omega *= 0.3
        record, times = waves.record(), TIMES + 0.08 * rng.standard_normal(6)
        orders = waves.orders(20.0, 6 if places == 4 else 4)
        parts = [(t / 8) * sum(waves.motion(20.0 + t * (n + 0.5) / 8) for n in range(8)) for t in times]
        rate = uneven_weights(times, (1, 2, 3, 4) if places == 4 else (2, 3, 4))[1]
        d, chord = np.tensordot(rate.ravel(), parts, 1), parts[3] - parts[2]
        motion = SimpleNamespace(d=d, chord=chord, frames=of_frames(places))
        stated = motion_truncation(motion, orders, of_frames(6), EVERYWHERE, EVERYWHERE, record, 0.0, times)
        now.append(rms(d - waves.motion(20.0)) / rms(stated))
    assert 0.3 < np.median(now) < 1.2
    assert np.percentile(now, 90) < 1.2


@pytest.mark.parametrize("seed", range(6))
def test_ripples_beside_longer_waves_turn_as_fast_as_ripples(seed):
    """Beyond a gap in the spectrum they do not turn as long waves do, which a current slows down here."""
    rng = np.random.default_rng(seed)
    length = np.array([0.2, *rng.uniform(0.034, 0.042, 3)])
    height, rate = np.array([1e-3, *(3 * [8e-5])]), rng.uniform(11.0, 14.0)
    k, angle, phase = 2 * np.pi / length, rng.uniform(0, 6, 4), rng.uniform(0, 6, 4)
    y, x = np.mgrid[:40, :50] * 0.01
    turn = dispersion(k) / rate - [0.3 * k[0] / rate, 0, 0, 0]

    def z(t):
        waves = k * (x[..., None] * np.cos(angle) + y[..., None] * np.sin(angle)) - turn * t + phase
        return np.cos(waves) @ height

    pairs = [(z(t), z(t + 1)) for t in (3.0, 30.0, 57.0)]
    rings = np.geomspace(0.1, 3.0, 60)
    prior = Prior.isotropic(rings, np.ones(60), 1.0)
    shown = replace(prior, shown=(tuple(map(float, rings > 0.5)),))
    blind, found = (
        temporal_truncation(pairs, 0.01, detected=partial(detected_waves, one, 0.002, 0.01, rate))
        for one in (replace(prior, shown=((0.0,) * 60,)), shown)
    )
    left_out = (height * turn * (1.0 - path_gain(turn, 4)))[1:]
    d, measured = np.zeros((3, *x.shape)), np.ones(x.shape, bool)
    stated, short = (one.of_displacement(4, d, measured)[2].mean() for one in (found, blind))
    assert 0.7 < stated / np.sqrt(0.5 * left_out @ left_out) < 2.0
    assert short < 0.6 * stated


def test_noise_is_not_taken_for_waves_that_turn_fast():
    """Elevations of six, four and two frames differ by noise, too: beside none at all, infinitely much."""
    rng = np.random.default_rng(4)
    for std in (1e-6, 1e-5, 1e-4):
        still, d = np.zeros(SHAPE), rng.normal(0, std, (3, *SHAPE))
        frames = rng.normal(0, std, (6, *SHAPE))
        orders = tuple(np.tensordot(ELEVATION_WEIGHTS[n], frames, 1) for n in (6, 4, 2))
        motion = SimpleNamespace(d=d, chord=d, frames=np.full(SHAPE, 4, np.uint8))
        for moved in (0.0, 1e-3 * std, std):
            pairs = [(still, still + moved)]
            record = SimpleNamespace(
                temporal_truncation=temporal_truncation(pairs, 0.01), moved=(std, std, std)
            )
            stated = motion_truncation(motion, orders, of_frames(6), EVERYWHERE, EVERYWHERE, record, std)
            assert rms(stated) < 0.5 * std
            assert rms(elevation_truncation(orders, of_frames(6), still, EVERYWHERE, record, std)) < 0.5 * std


def test_water_at_rest_leaves_nothing_out():
    still = np.zeros(SHAPE)
    record = SimpleNamespace(
        temporal_truncation=temporal_truncation([(still, still)], 0.01), moved=(1e-6,) * 3
    )
    assert not elevation_truncation((still,) * 3, of_frames(6), still, EVERYWHERE, record, 0.0).any()
    motion = SimpleNamespace(
        d=np.stack([still] * 3), chord=np.stack([still] * 3), frames=np.full(SHAPE, 4, np.uint8)
    )
    assert not motion_truncation(
        motion, (still,) * 3, of_frames(6), EVERYWHERE, EVERYWHERE, record, 0.0
    ).any()


def test_errors_that_stay_hardly_change_how_fast_waves_are_taken_to_turn():
    """Waves of 13 to 25 cm at 10 frames/s, beside errors of 8 cm and a twentieth of their height."""
    x, y = np.meshgrid(np.arange(SHAPE[1]) * 0.01, np.arange(SHAPE[0]) * 0.01)

    def waves(rng, shortest, longest, height):
        k, angle = 2 * np.pi / rng.uniform(shortest, longest, 12), rng.uniform(0, 2 * np.pi, 12)
        phase = k[:, None, None] * (np.multiply.outer(np.cos(angle), x) + np.multiply.outer(np.sin(angle), y))
        phase += rng.uniform(0, 2 * np.pi, 12)[:, None, None]
        turn = dispersion(k)[:, None, None] / 10.0
        return lambda t: height * np.sqrt(2.0 / 12) * np.cos(phase - turn * t).sum(0)

    def stated(seed, error):
        rng, pairs = np.random.default_rng(seed), []
        for _ in range(4):
            sea, stays = waves(rng, 0.13, 0.25, 1e-3), waves(rng, 0.075, 0.085, error)(0.0)
            pairs.append((sea(-0.5) + stays, sea(0.5) + stays))
        return temporal_truncation(pairs, 0.01).of_z(6)

    assert np.median([stated(seed, 5e-5) / stated(seed, 0.0) for seed in range(24)]) > 0.87
