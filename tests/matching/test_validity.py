import numpy as np
import pytest
from matching_cases import interior, particle_pair, truth, uniform, wave

from wavefield.errors import FrameError
from wavefield.matching import MatchSettings, Reason, match, prepare


def errors(d, move):
    u, v = truth(d, move)
    return np.hypot(d.u - u, d.v - v)


@pytest.fixture(scope="module")
def pair():
    move = wave(2.0, 200.0)
    return *particle_pair(move), move


def with_patch(images, value):
    """Both images with the same rectangle overwritten."""
    out = [q.copy() for q in images]
    for q in out:
        q[100:200, 120:220] = value
    return out


def patch_blocks(d, grow=0):
    x, y = np.meshgrid(d.x, d.y)
    return (x > 120 - grow) & (x < 219 + grow) & (y > 100 - grow) & (y < 199 + grow)


@pytest.mark.parametrize(("preset", "value"), [("piv", 90), ("stereo", 255)])
def test_uniform_and_saturated_areas_are_invalid_and_spoil_nothing(pair, preset, value):
    a, b, move = pair
    d = match(*with_patch((a, b), value), getattr(MatchSettings, preset)())
    deep = patch_blocks(d, -25)
    assert not d.valid[deep].any()
    outside = interior(d, a.shape) & ~patch_blocks(d, 12)
    assert d.valid[outside].mean() > 0.98
    assert np.max(errors(d, move)[outside & d.valid]) < 1.0  # the patch's edge stands still


@pytest.mark.parametrize("preset", ["piv", "stereo"])
def test_masked_pixels_are_never_read(pair, preset):
    a, b, move = pair
    settings = getattr(MatchSettings, preset)()
    mask = np.ones(a.shape, bool)
    mask[100:200, 120:220] = False
    results = []
    for value in (0, 100, 255):
        images = (prepare(image, settings, mask) for image in with_patch((a, b), value))
        results.append(match(*images, settings))
    for d in results[1:]:
        np.testing.assert_array_equal(d.u, results[0].u)
        np.testing.assert_array_equal(d.reason, results[0].reason)
    d = results[0]
    assert (d.reason[patch_blocks(d)] & Reason.MASKED).all()
    outside = interior(d, a.shape) & ~patch_blocks(d, 12)
    assert d.valid[outside].all()
    assert np.max(errors(d, move)[outside]) < 0.15


def test_unrelated_images_are_rejected():
    a, _ = particle_pair(uniform(0, 0), seed=1)
    b, _ = particle_pair(uniform(0, 0), seed=2)
    for settings in (MatchSettings.piv(), MatchSettings.stereo()):
        assert match(a, b, settings).valid.mean() < 0.05


def test_blocks_that_leave_the_image_are_marked():
    move = uniform(14.0, 0.0)
    a, b = particle_pair(move)
    d = match(a, b)
    out = np.broadcast_to(d.x + 14 > a.shape[1] - 2, d.u.shape)
    assert ((d.reason[out] & Reason.EDGE) > 0).all()
    assert not (d.reason[interior(d, a.shape)] & Reason.EDGE).any()


def test_displacements_beyond_the_search_range_are_marked():
    a, b = particle_pair(uniform(9.0, 0.0))
    d = match(a, b, MatchSettings.piv(search_x=(-2, 2), search_y=(-2, 2)))
    inside = interior(d, a.shape)
    assert ((d.reason[inside] & Reason.RANGE) > 0).mean() > 0.95


def test_a_lonely_wrong_block_is_marked_by_its_neighbours(pair):
    a, b, _ = pair
    d = match(a, b, MatchSettings.piv(max_deviation=1e-4))
    assert (d.reason & Reason.NEIGHBOURS).any()


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (np.zeros((10, 100), np.uint8), "at least 20"),
        (np.zeros((50, 50, 3), np.uint8), "grey"),
        (np.zeros((50, 50), complex), "complex"),
    ],
)
def test_images_that_cannot_be_matched_are_refused_with_the_reason(image, words):
    with pytest.raises(FrameError, match=words):
        prepare(image, MatchSettings.piv())


def test_wrong_use_is_refused_with_the_remedy(pair):
    a, b, _ = pair
    with pytest.raises(FrameError, match="differ in size"):
        match(a, b[:-10])
    with pytest.raises(FrameError, match="mask"):
        prepare(a, MatchSettings.piv(), np.ones((3, 3), bool))
