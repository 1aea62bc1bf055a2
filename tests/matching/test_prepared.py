import cv2
import numpy as np
import pytest

from wavefield.matching import MatchSettings, prepare
from wavefield.matching.prepared import Mask


def scene(shape=(203, 187), dtype=np.uint8):
    """Speckle under light that falls off, its contrast with it."""
    rng = np.random.default_rng(3)
    speckle = cv2.GaussianBlur(rng.normal(0, 1, shape).astype(np.float32), (0, 0), 1.2)
    light = np.linspace(0.3, 1.0, shape[1], dtype=np.float32)
    image = light * (120 + 120 * speckle / np.abs(speckle).max())
    return np.round(image).astype(dtype) if dtype != np.float32 else image


@pytest.mark.parametrize("with_mask", [False, True])
@pytest.mark.parametrize(("value", "row"), [(np.nan, 100), (np.inf, 202), (-np.inf, 202)])
def test_a_pixel_that_is_not_finite_is_left_out_and_spoils_nothing(with_mask, value, row):
    settings = MatchSettings.piv(normalization=10.0)
    good = np.ones((203, 187), bool)
    if with_mask:
        good[:, :40] = False
    mask = Mask.of(good, settings) if with_mask else None
    image = scene(dtype=np.float32)
    image[row, 100] = value
    found = prepare(image, settings, mask)
    good[row, 100] = False
    expected = prepare(np.nan_to_num(image, posinf=0, neginf=0), settings, good)
    for one, other in zip(found.levels, expected.levels, strict=True):
        np.testing.assert_array_equal(one.padded, other.padded)
        np.testing.assert_array_equal(one.good, other.good)
    if with_mask:
        assert mask.good[row, 100]  # the next image's own pixel is fine


@pytest.mark.parametrize("corner", [(51, 33), (198, 182)])
def test_the_smallest_saturated_patch_is_found_wherever_it_lies(corner):
    j, i = corner
    image = np.minimum(scene(), 250).astype(np.uint8)
    image[j : j + 5, i : i + 5] = 255
    level = prepare(image, MatchSettings.piv()).levels[0]
    assert (level.image[j : j + 5, i : i + 5] == 0).all()
    assert not level.good[j + 2, i + 2]
    image[j + 2, i + 2] = 250
    assert prepare(image, MatchSettings.piv()).levels[0].good.size == 0


def test_a_mask_hides_what_is_brighter_than_the_saturated_patch():
    image = np.minimum(scene(), 200).astype(np.uint8)
    image[20:40, 20:40], image[100:110, 100:110] = 255, 220
    good = np.ones(image.shape, bool)
    good[15:45, 15:45] = False
    assert not prepare(image, MatchSettings.piv(), good).levels[0].good[105, 105]
