"""Brightness evened out before matching."""

import numpy as np
import pytest

from wavefield.matching import match
from wavefield.measurement import Settings
from wavefield.measurement.images import BETWEEN_CAMERAS, even_out, ready, sharpened
from wavefield.measurement.rectify import bin_pixels


def beads(rng: np.random.Generator) -> np.ndarray:
    image = np.full((160, 200), 12.0)
    y, x = np.mgrid[:160, :200]
    for px, py, a in zip(rng.uniform(0, 200, 300), rng.uniform(0, 160, 300), rng.uniform(20, 220, 300)):
        image += a * np.exp(-((x - px) ** 2 + (y - py) ** 2) / 2.0)
    return np.clip(image, 0, 255)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_gain_and_offset_of_a_camera_drop_out(dtype: type) -> None:
    image = np.rint(beads(np.random.default_rng(1)) / 3).astype(dtype)
    brighter = (2 * image + 30).astype(dtype)
    np.testing.assert_allclose(even_out(brighter), even_out(image), atol=1.0)


def test_all_types_of_images_give_the_same() -> None:
    image = np.rint(beads(np.random.default_rng(2))).astype(np.uint8)
    for other in (image.astype(np.uint16), image.astype(np.float32), image.astype(np.float64)):
        np.testing.assert_allclose(even_out(other), even_out(image).astype(float), atol=0.6)


def test_beads_of_different_brightness_become_more_alike() -> None:
    image = np.full((160, 200), 10.0)
    y, x = np.mgrid[:160, :200]
    places = [(i, j) for j in range(6, 160, 12) for i in range(6, 200, 12)]
    heights = np.where(np.arange(len(places)) % 2, 200.0, 50.0)
    for (px, py), a in zip(places, heights):
        image += a * np.exp(-((x - px) ** 2 + (y - py) ** 2) / 2.0)
    out = even_out(image.astype(np.uint8)).astype(float)
    tops = np.array([out[py, px] for px, py in places])
    assert tops[heights == 200].mean() / tops[heights == 50].mean() < 2.5


def test_the_order_of_brightness_is_kept_and_pixels_are_binned_after() -> None:
    image = np.rint(beads(np.random.default_rng(3))).astype(np.uint8)
    out = even_out(image)
    assert (np.diff(out.ravel()[np.argsort(image, axis=None)].astype(int)) >= 0).all()
    small = ready(image, 2, width=0.0).astype(float)
    np.testing.assert_array_equal(small, bin_pixels(out, 2))


def test_pixels_without_a_number_stay_without() -> None:
    image = beads(np.random.default_rng(4)).astype(np.float32)
    image[10:20, 30:40] = np.nan
    out = even_out(image)
    assert np.isnan(out[10:20, 30:40]).all()
    assert np.isfinite(out[30:, 50:]).all()


def test_beads_that_cameras_see_differently_bright_pull_less_where_images_are_sharp() -> None:
    rng = np.random.default_rng(4)
    y, x = np.mgrid[:160, :200]
    one, other = np.full((2, 160, 200), 12.0)
    for px, py, a in zip(rng.uniform(0, 200, 1000), rng.uniform(0, 160, 1000), rng.uniform(50, 200, 1000)):
        bead = a * np.exp(-((x - px) ** 2 + (y - py) ** 2) / 1.2)
        one += bead * rng.uniform(0.7, 1.3)
        other += bead * rng.uniform(0.7, 1.3)
    settings = Settings().stereo

    def error(amount: float) -> float:
        d = match(*(sharpened(ready(image, 1), amount) for image in (one, other)), settings)
        return float(np.sqrt(np.mean(np.square(d.u[2:-2, 2:-2]))))

    assert error(BETWEEN_CAMERAS) < 0.75 * error(0.0)
