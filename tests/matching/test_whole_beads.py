"""A bead counts in one block: cameras that see it unequally bright do not move it."""

import cv2
import numpy as np
from matching_cases import interior, particle_pair, truth, uniform

from wavefield.matching import MatchSettings, match, prepare
from wavefield.matching.pyramid import reevaluate, scores_at

SETTINGS = MatchSettings.stereo(search_x=(-6.0, 6.0), search_y=(-6.0, 6.0))
MOVE = uniform(1.3, -0.4)


def test_beads_that_cameras_see_unequally_bright_move_blocks_less():
    pair = particle_pair(MOVE, gain=0.3, density=0.01, seed=2)
    a, b = (prepare(image, SETTINGS) for image in pair)
    d = match(a, b, SETTINGS)
    u, v = (field.astype(np.float32) for field in truth(d, MOVE))
    inside = interior(d, a.shape) & d.valid

    def error(look):
        """Of the displacement of 3 x 3 blocks, px rms."""
        score, hessian = (
            np.array([cv2.blur(one, (3, 3)) for one in part]) for part in (look.score, look.hessian)
        )
        return float(np.std(score[0][inside]) / np.mean(hessian[0][inside]))

    assert error(scores_at(d, a, b, u, v)) < 0.8 * error(reevaluate(a, b, u, v, SETTINGS))


def test_blocks_beside_masked_ones_do_not_count():
    image, other = particle_pair(MOVE, shape=(160, 200))
    mask = np.ones(image.shape, bool)
    mask[60:100, 80:120] = False
    a, b = prepare(image, SETTINGS, mask), prepare(other, SETTINGS)
    d = match(a, b, SETTINGS)
    usable = scores_at(d, a, b, d.u, d.v).hessian[0] > 0
    assert not usable[11:21, 15:25].any()
    assert usable[3:9, 3:36].mean() > 0.3  # no bead has its top in the others
