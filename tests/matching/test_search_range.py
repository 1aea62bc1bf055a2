"""The range of displacements is found by itself."""

import numpy as np
import pytest
from matching_cases import particle_pair

import wavefield as wf


@pytest.mark.parametrize("seed", range(3))
def test_images_that_moved_far_are_matched_without_settings(seed):
    rng = np.random.default_rng(seed)
    dx, dy = rng.uniform(25.0, 45.0, 2) * rng.choice([-1.0, 1.0], 2)
    one, other = particle_pair(lambda x, y: (np.full_like(x, dx), np.full_like(y, dy)), seed=seed)
    found = wf.match(one, other)
    assert found.valid.mean() > 0.5
    assert np.median(found.u[found.valid]) == pytest.approx(dx, abs=0.05)
    assert np.median(found.v[found.valid]) == pytest.approx(dy, abs=0.05)


def test_unlike_images_are_not_matched():
    one, _ = particle_pair(lambda x, y: (0 * x, 0 * y), seed=1)
    other, _ = particle_pair(lambda x, y: (0 * x, 0 * y), seed=2)
    assert wf.match(one, other).valid.mean() < 0.1
