"""A bead counts in one block: cameras that see it unequally bright do not move it."""

import cv2
import numpy as np
from matching_cases import interior, particle_pair, truth, uniform

from wavefield.matching import MatchSettings, match, prepare
from wavefield.matching.kernels import BLOCK, PAD, bead_blocks
from wavefield.matching.pyramid import reevaluate, scores_at

SETTINGS = MatchSettings.stereo(search_x=(-6.0, 6.0), search_y=(-6.0, 6.0))
MOVE = uniform(1.3, -0.4)


def test_every_pixel_counts_where_the_steepest_way_leads_to():
    rng = np.random.default_rng(4)
    padded = cv2.GaussianBlur(rng.normal(0, 1, (40 + 2 * PAD, 55 + 2 * PAD)).astype(np.float32), (0, 0), 1.0)
    image = padded[PAD - 1 : 41 + PAD, PAD - 1 : 56 + PAD]
    image[0] = image[-1] = image[:, 0] = image[:, -1] = -np.inf
    found = np.empty((40, 55), np.int32)
    bead_blocks(padded, found)
    for y, x in np.ndindex(found.shape):
        at, before = (y, x), None
        while at != before:
            before = at
            around = image[at[0] : at[0] + 3, at[1] : at[1] + 3]
            j, i = np.unravel_index(around.argmax(), around.shape)
            at = at[0] + int(j) - 1, at[1] + int(i) - 1
        assert divmod(found[y, x], 11) == (at[0] // BLOCK, at[1] // BLOCK)


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


def test_scores_of_whole_beads_add_up_to_those_of_all_pixels():
    a, b = (prepare(image, SETTINGS) for image in particle_pair(MOVE, shape=(160, 200)))
    d = match(a, b, SETTINGS)
    block, hessian = a.levels[0].beads
    assert block.shape == tuple(BLOCK * n for n in d.u.shape)
    np.testing.assert_allclose(
        hessian.sum(axis=(1, 2)), a.levels[0].moments[:3].sum(axis=(1, 2)), rtol=1e-4, atol=1e-3
    )
    whole, own = (look.score.sum(axis=(1, 2)) for look in (scores_at(d, a, b, d.u, d.v), d))
    size = np.abs(d.score).sum(axis=(1, 2))
    assert (np.abs(whole - own) < 0.05 * size).all()


def test_blocks_beside_masked_ones_do_not_count():
    image, other = particle_pair(MOVE, shape=(160, 200))
    mask = np.ones(image.shape, bool)
    mask[60:100, 80:120] = False
    a, b = prepare(image, SETTINGS, mask), prepare(other, SETTINGS)
    d = match(a, b, SETTINGS)
    usable = scores_at(d, a, b, d.u, d.v).hessian[0] > 0
    assert not usable[11:21, 15:25].any()
    assert usable[3:9, 3:36].mean() > 0.3  # no bead has its top in the others
