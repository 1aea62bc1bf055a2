import cv2
import numpy as np
import pytest
from matching_cases import interior, particle_pair, truth, uniform, wave

from wavefield.matching import MatchSettings, match


@pytest.fixture(scope="module")
def clean_pair():
    """A moderately waving field on good images."""
    move = wave(3.0, 200.0)
    return *particle_pair(move), move


def rms(d, move, select):
    u, v = truth(d, move)
    return np.sqrt(np.mean(((d.u - u) ** 2 + (d.v - v) ** 2)[select]) / 2)


def worst(d, move, select):
    u, v = truth(d, move)
    return np.max(np.hypot(d.u - u, d.v - v)[select])


def test_block_centres_are_pixel_centres_counted_from_zero(clean_pair):
    a, b, move = clean_pair
    d = match(a, b)
    np.testing.assert_array_equal(d.x, 2 + 5.0 * np.arange(a.shape[1] // 5))
    np.testing.assert_array_equal(d.y, 2 + 5.0 * np.arange(a.shape[0] // 5))
    inside = interior(d, a.shape)
    right = rms(d, move, inside)
    for shift in (-0.5, 0.5):
        assert rms(d, lambda x, y: move(x + shift, y + shift), inside) > 2 * right  # noqa: B023


def test_ten_pixels_with_gradient_one_third_leave_no_outlier():
    move = wave(10.0, 209.0)
    a, b = particle_pair(move, shape=(400, 420))
    d = match(a, b)
    assert worst(d, move, interior(d, a.shape)) < 0.5


def test_unmatched_particles_gain_and_noise_leave_no_outlier():
    move = wave(4.0, 200.0)
    a, b = particle_pair(move, gain=0.5, unmatched=0.25, noise=0.05)
    d = match(a, b)
    inside = interior(d, a.shape)
    assert worst(d, move, inside) < 1.0
    assert rms(d, move, inside) < 0.14


def stereo_move(x, y):
    return 20 + 14 * np.sin(2 * np.pi * x / 840 + 0.3) + 4 * np.sin(2 * np.pi * y / 700), np.sin(
        2 * np.pi * y / 500
    )


@pytest.mark.parametrize("sign", [1, -1])
def test_large_parallax_of_either_sign_under_different_lighting(sign):
    def move(x, y):
        u, v = stereo_move(x, y)
        return sign * u, sign * v

    a, b = particle_pair(move, as_type=np.float32)
    y, x = np.mgrid[: a.shape[0], : a.shape[1]]
    b = (
        b * (0.7 + 0.5 * np.sin(2 * np.pi * x / 1500) * np.cos(2 * np.pi * y / 1300))
        + 12
        + 8 * np.sin(y / 150)
    )
    d = match(a, b.astype(np.float32), MatchSettings.stereo())
    u, _ = truth(d, move)
    inside = interior(d, a.shape) & (d.x + u > 40) & (d.x + u < a.shape[1] - 41)
    assert rms(d, move, inside) < 0.008
    assert worst(d, move, inside) < 0.05


@pytest.mark.parametrize("sigma", [0.35, 0.675])
def test_no_peak_locking(sigma):
    bias = []
    for fraction in (0.25, 0.5, 0.75):
        a, b = particle_pair(uniform(fraction, 0.5 * fraction), sigma=sigma)
        d = match(a, b)
        bias.append(np.mean((d.u - fraction)[interior(d, a.shape)]))
    assert np.max(np.abs(bias)) < (0.002 if sigma > 0.5 else 0.007)


@pytest.mark.parametrize(("windows", "least"), [(2, 0.84), (4, 0.97)])
def test_short_waves_keep_their_amplitude(windows, least):
    wavelength = windows * MatchSettings.piv().window

    def move(x, y):
        return np.sin(2 * np.pi * y / wavelength) + 0 * x, 0.3 + 0 * x

    a, b = particle_pair(move)
    d = match(a, b)
    u, _ = truth(d, move)
    inside = interior(d, a.shape)
    assert np.sum((d.u * u)[inside]) / np.sum((u * u)[inside]) > least


def test_brightness_scale_changes_nothing():
    a, b = particle_pair(wave(3.0, 200.0), as_type=np.float32)
    eight = match(a, b)
    sixteen = match(np.rint(a * 100).astype(np.uint16), np.rint(b * 100).astype(np.uint16))
    inside = interior(eight, a.shape)
    np.testing.assert_allclose(sixteen.u[inside], eight.u[inside], atol=2e-3)


@pytest.mark.parametrize("shape", [(20, 20), (47, 203), (201, 64), (333, 127)])
def test_any_size(shape):
    move = uniform(1.3, -0.6)
    a, b = particle_pair(move, shape=shape)
    d = match(a, b)
    assert d.u.shape == (shape[0] // 5, shape[1] // 5)
    assert np.isfinite(d.u).all()
    assert np.isfinite(d.v).all()
    if min(shape) > 40:
        assert abs(np.median(d.u[d.valid]) - 1.3) < 0.03


def test_texture_that_is_not_particles():
    rng = np.random.default_rng(2)
    big = cv2.GaussianBlur(rng.normal(0, 1, (360, 360)), (0, 0), 1.0)
    a = big[20:340, 20:340]
    b = big[17:337, 22:342]  # the picture moved by (-2, 3)
    d = match(a, b)
    inside = interior(d, a.shape)
    assert np.max(np.hypot(d.u + 2, d.v - 3)[inside]) < 0.01
