"""Two cameras see a bead unequally bright: scores between them do not depend on it."""

import numpy as np
import pytest
from matching_cases import interior, particle_pair, truth, uniform

from wavefield.matching import MatchSettings, match, prepare, reevaluate, scores_at
from wavefield.matching.block_lattice import filtered, window_weights

SETTINGS = MatchSettings.stereo()
SHAPE = (300, 340)
WINDOW = window_weights(24.0)
MOVE = uniform(1.3, -0.7)


def departure(evaluated, inside):
    """Steps over windows by scores and Hessians of blocks, (2, n), px: but for noise 0 at the truth."""
    fields = (*evaluated.hessian, *evaluated.score)
    xx, xy, yy, sx, sy = (filtered(field * evaluated.valid, WINDOW)[inside] for field in fields)
    return np.array([yy * sx - xy * sy, xx * sy - xy * sx]) / (xx * yy - xy * xy)


def evaluations(offset=0.0, **drawn):
    """Of both kinds at a true displacement plus an offset along x: as between cameras, and of one camera."""
    a, b = (prepare(image, SETTINGS) for image in particle_pair(MOVE, SHAPE, **drawn))
    found = match(a, b, SETTINGS)
    u, v = truth(found, MOVE)
    inside = interior(found, SHAPE) & found.valid
    return [
        departure(each, inside)
        for each in (
            scores_at(found, a, b, u + offset, v),
            reevaluate(a, b, u + offset, v, SETTINGS),
        )
    ]


@pytest.mark.parametrize("seed", range(6))
def test_beads_of_unequal_brightness_hardly_seem_to_move(seed):
    rng = np.random.default_rng([41, seed])
    drawn = {
        "density": rng.uniform(0.02, 0.06),
        "sigma": rng.uniform(0.65, 0.95),
        "gain": rng.uniform(0.15, 0.4),
        "seed": seed,
    }
    without, with_it = evaluations(**drawn)
    assert np.sqrt(np.mean(without**2)) < 0.85 * np.sqrt(np.mean(with_it**2)), drawn


@pytest.mark.parametrize("seed", range(3))
def test_beads_of_equal_brightness_are_matched_as_well_as_without(seed):
    without, with_it = evaluations(noise=0.01, seed=10 + seed)
    assert np.sqrt(np.mean(without**2)) < 1.1 * np.sqrt(np.mean(with_it**2))


@pytest.mark.parametrize("gain", [0.0, 0.3])
def test_a_step_leads_to_the_displacement(gain):
    without, _ = evaluations(offset=-0.05, gain=gain)
    at_truth, _ = evaluations(gain=gain)
    assert np.allclose((without - at_truth).mean(axis=1), [0.05, 0.0], atol=0.005)
