"""The area over which a block averages displacements, by the width of the beads' images."""

import numpy as np
import pytest
from matching_cases import interior, particle_pair, truth

from wavefield.matching import MatchSettings, match, prepare
from wavefield.matching.pyramid import reevaluate
from wavefield.matching.spectrum import RESTORED_VARIANCE, displacement_area
from wavefield.measurement.images import bead_width

PIV = MatchSettings.piv()
WAVELENGTH = 44.0  # px


def measured(sigma, seed):
    """Area, px^2, of which a wave's displacement is the mean where the scores of blocks vanish on average,
    and the width of the beads, px.
    """
    rng = np.random.default_rng(seed)
    direction, phase = rng.uniform(0, 2 * np.pi, 2)
    kx, ky = 2 * np.pi / WAVELENGTH * np.cos(direction), 2 * np.pi / WAVELENGTH * np.sin(direction)

    def move(x, y):
        wave = 0.3 * np.cos(kx * x + ky * y + phase)
        return wave, 0.5 * wave

    images = particle_pair(move, seed=seed, density=0.02, sigma=sigma)
    one, other = (prepare(image, PIV) for image in images)
    found = match(one, other, PIV)
    moved = np.array(truth(found, move))
    inside = interior(found, one.shape)
    gains = np.array([0.9, 1.0])
    total = [np.sum((reevaluate(one, other, *(g * moved), PIV).score * moved)[:, inside]) for g in gains]
    gain = gains[0] - total[0] * (gains[1] - gains[0]) / (total[1] - total[0])
    return -2.0 * np.log(gain) / (kx**2 + ky**2), bead_width(images[0])


@pytest.mark.parametrize("sigma", [0.6, 1.0, 1.6])
def test_blocks_average_over_their_own_area_and_that_of_the_beads(sigma):
    area, width = np.mean([measured(sigma, seed) for seed in range(11, 17)], axis=0)
    stated = displacement_area(width) - RESTORED_VARIANCE
    assert area == pytest.approx(stated, abs=0.5)
