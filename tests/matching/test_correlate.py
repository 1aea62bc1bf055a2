import numpy as np
import pytest
from matching_cases import interior, particle_pair, truth, uniform, wave

from wavefield.matching import MatchSettings, correlate, match


def rms(d, move, select):
    u, v = truth(d, move)
    return np.sqrt(np.mean(((d.u - u) ** 2 + (d.v - v) ** 2)[select]) / 2)


@pytest.mark.parametrize("shift", [(3.3, -1.7), (-13.6, 9.2)])
def test_uniform_displacement(shift):
    move = uniform(*shift)
    a, b = particle_pair(move)
    d = correlate(a, b)
    assert rms(d, move, interior(d, a.shape)) < 0.01


def test_centres_are_those_of_the_fast_matcher():
    move = wave(3.0, 240.0)
    a, b = particle_pair(move)
    d, fast = correlate(a, b), match(a, b)
    inside = interior(d, a.shape)
    np.testing.assert_array_equal(d.x, fast.x)
    right = rms(d, move, inside)
    assert right < 0.03
    assert rms(d, lambda x, y: move(x + 0.5, y + 0.5), inside) > right
    assert rms(d, lambda x, y: move(x - 0.5, y - 0.5), inside) > right
    assert np.sqrt(np.mean((d.u - fast.u)[inside] ** 2)) < 0.06


def test_wide_search_and_initial_field():
    move = uniform(41.3, -2.4)
    a, b = particle_pair(move)
    settings = MatchSettings.stereo()
    inside = None
    for d in (correlate(a, b, settings), correlate(a, b, settings, initial=(40.0, -2.0))):
        inside = interior(d, a.shape, 60)
        assert rms(d, move, inside) < 0.02
    assert inside.any()


def test_uncertainty_is_true_for_it_too():
    move = wave(2.0, 300.0)
    a, b = particle_pair(move, noise=0.03, unmatched=0.1)
    d = correlate(a, b)
    u, _ = truth(d, move)
    inside = interior(d, a.shape) & d.valid
    assert 0.5 < np.mean((np.abs(d.u - u) < d.u_std)[inside]) < 0.85
