import numpy as np
import pytest
from matching_cases import interior, particle_pair, truth, uniform, wave

from wavefield.matching import MatchSettings, match
from wavefield.matching.matching_gain import transfer_kernel
from wavefield.matching.uncertainty import std_from_influence

CASES = {
    "clean": {},
    "noise": {"noise": 0.04},
    "unmatched": {"unmatched": 0.1, "gain": 0.3, "noise": 0.03},
    "sparse": {"density": 0.012, "unmatched": 0.1, "noise": 0.02},
    "small": {"sigma": 0.35},
}


@pytest.mark.parametrize("preset", ["piv", "stereo"])
@pytest.mark.parametrize("case", CASES)
def test_errors_fall_within_the_stated_uncertainty(case, preset):
    move = wave(3.0, 260.0)
    one, two = [], []
    for seed in (1, 2):
        a, b = particle_pair(move, shape=(420, 420), seed=seed, **CASES[case])
        d = match(a, b, getattr(MatchSettings, preset)())
        u, v = truth(d, move)
        inside = interior(d, a.shape) & d.valid
        for error, std in ((d.u - u, d.u_std), (d.v - v, d.v_std)):
            one.append(np.mean((np.abs(error) < std)[inside]))
            two.append(np.mean((np.abs(error) < 2 * std)[inside]))
    # large images give 60-78 % and 90-98 %; small ones scatter more, and all are cautious on clean images
    assert 0.55 < np.mean(one) < (0.95 if case == "clean" else 0.85)
    assert 0.86 < np.mean(two)


def test_transfer_kernel_is_the_response_to_one_block():
    for settings in (MatchSettings.piv(), MatchSettings.stereo()):
        kernel = transfer_kernel(settings)
        r = len(kernel) // 2
        assert kernel.sum() == pytest.approx(1, abs=0.01)
        assert kernel[r, r] == kernel.max()
        np.testing.assert_allclose(kernel, kernel.T, atol=1e-6)
        np.testing.assert_allclose(kernel, kernel[::-1, ::-1], atol=1e-6)


def test_independent_noise_gives_the_standard_deviation_of_the_filtered_field():
    """White influences, filtered by the kernel as matching does, and seen through what the fit leaves."""
    rng = np.random.default_rng(0)
    settings = MatchSettings.piv()
    kernel = transfer_kernel(settings).astype(float)
    noise = rng.normal(0, 1, (256, 256))
    pad = np.zeros_like(noise)
    pad[: len(kernel), : len(kernel)] = kernel
    pad = np.roll(pad, (-(len(kernel) // 2),) * 2, (0, 1))
    final = np.fft.ifft2(np.fft.fft2(noise) * np.fft.fft2(pad)).real
    left = (noise - final).astype(np.float32)
    std = std_from_influence(left, settings)[40:-40, 40:-40]
    assert np.sqrt(np.mean(std**2)) == pytest.approx(final.std(), rel=0.15)


def test_uncertainty_scales_with_a_combination_of_influences():
    a, b = particle_pair(uniform(2.2, 1.1), noise=0.03)
    settings = MatchSettings.stereo()
    d = match(a, b, settings)
    one = std_from_influence(d.influence_u, settings)
    np.testing.assert_allclose(std_from_influence(3 * d.influence_u, settings), 3 * one, rtol=1e-4)
    both = std_from_influence(d.influence_u + d.influence_v, settings)
    assert np.all(both <= one + std_from_influence(d.influence_v, settings) + 1e-6)


def test_what_the_window_takes_away_is_counted():
    def move(x, y):
        return np.sin(2 * np.pi * y / 40) + 0 * x, 0 * x

    a, b = particle_pair(move)
    d = match(a, b)
    u, _ = truth(d, move)
    inside = interior(d, a.shape) & d.valid
    assert np.sqrt(np.mean((d.u - u)[inside] ** 2)) > 0.15
    assert np.mean((np.abs(d.u - u) < 2 * d.u_std)[inside]) > 0.75
