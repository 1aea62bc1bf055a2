import numpy as np
import pytest

from wavefield.measurement.rectify import bin_pixels, binned, rectify, sight_map, widen
from wavefield.tank import paper_rig


def spots(X, Y, shape, sigma=0.9):
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    image = np.zeros(shape)
    for x, y in zip(X, Y):
        image += 180 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * sigma**2))
    return image


def test_a_spot_stays_where_it_is_to_a_hundredth_of_a_pixel():
    # centroid of a spot read at shifted places, over all fractions of a pixel
    worst = 0.0
    for shift in np.arange(0, 1, 0.1):
        image = np.round(spots([15.0 + shift], [15.0], (31, 31))).astype(np.uint8)
        columns, rows = np.meshgrid(np.arange(5.0, 26.0), np.arange(5.0, 26.0))
        seen = rectify(image, (2 * columns).astype(np.float32), (2 * rows).astype(np.float32)).astype(float)
        worst = max(worst, abs((seen * columns).sum() / seen.sum() - 15.0 - shift))
    assert worst < 0.01


@pytest.mark.parametrize("name", ["cam1", "cam2", "cam3"])
@pytest.mark.parametrize("count", [1, 2])
def test_a_point_appears_at_its_own_place(name, count):
    raw = paper_rig(0.5, crop=0.4)[name]
    camera = binned(raw, count)
    at_x, at_y = 0.05, -0.03
    X, Y = raw.project(at_x, at_y, 0.0)
    image = np.round(spots([X], [Y], raw.size[::-1], sigma=0.9 * count)).astype(np.uint8)
    x, y = np.linspace(-0.1, 0.2, 301), np.linspace(-0.15, 0.1, 251)
    mx, my, seen = sight_map(camera, x, y)
    flat = rectify(bin_pixels(image, count), mx, my).astype(float)
    assert seen.all()
    assert (flat * x).sum() / flat.sum() == pytest.approx(at_x, abs=3e-5 * count**2)
    assert (flat * y[:, None]).sum() / flat.sum() == pytest.approx(at_y, abs=3e-5 * count**2)


def test_what_the_camera_does_not_see_is_masked_and_dark():
    camera = paper_rig(0.5, crop=0.2)["cam3"]
    x, y = np.linspace(-1, 1, 401), np.linspace(-0.5, 0.5, 201)
    mx, my, seen = sight_map(camera, x, y)
    flat = rectify(np.full(camera.size[::-1], 200, np.uint8), mx, my)
    assert (flat[seen] == 200 * 256).all()
    assert (flat[~seen] == 0).all()
    grid_x, grid_y = np.meshgrid(x, y)
    np.testing.assert_array_equal(seen, camera.sees(grid_x, grid_y, 0.0, margin=3.0))


def test_binning_keeps_means_and_cuts_what_is_left_over():
    image = np.arange(7 * 9, dtype=np.uint8).reshape(7, 9)
    small = bin_pixels(image, 2)
    assert small.shape == (3, 4)
    assert small.dtype == np.uint16
    np.testing.assert_allclose(small[1, 1:3], [64 * image[2:4, i : i + 2].mean() for i in (2, 4)], atol=1)
    assert bin_pixels(image, 1) is image
    camera = paper_rig(0.5)["cam3"]
    X, Y = camera.project(0.1, 0.2, 0.01)
    x, y = binned(camera, 2).project(0.1, 0.2, 0.01)
    assert (2 * x + 0.5, 2 * y + 0.5) == pytest.approx((X, Y))


def test_blur_widens_by_its_variance_along_each_axis():
    image = np.zeros((41, 41), np.float32)
    image[20, 20] = 1000
    out = widen(image, 1.2, 0.0)
    k = np.arange(41) - 20
    assert (out.sum(axis=0) * k**2).sum() / out.sum() == pytest.approx(1.44, rel=0.05)
    assert np.count_nonzero(out.sum(axis=1)) == 1
    assert widen(image, 0.1, 0.2) is image


def test_a_sharp_bead_has_the_same_image_wherever_in_a_square_of_binned_pixels_it_is():
    energy = []
    for shift in np.arange(0, 2, 0.25):
        bead = spots([20.0 + shift], [20.0 + shift], (41, 41), sigma=0.65).astype(np.float32)
        energy.append(np.square(bin_pixels(bead, 2)).sum())
    assert np.ptp(energy) < 0.15 * np.mean(energy)  # means of squares alone: half of it
