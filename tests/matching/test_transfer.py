"""What matching takes from short waves, and the filter that gives it back."""

import numpy as np
import scipy.fft
from matching_cases import interior, particle_pair, truth, wave

from wavefield.matching import footprint, match, restoring, transfer_function
from wavefield.measurement import Settings


def test_the_filter_undoes_the_known_gain_where_little_is_lost_and_gives_up_where_all_is():
    settings = Settings().stereo
    k = np.linspace(0.0, np.pi, 200)
    gain = transfer_function(settings, k, 0.0 * k) * footprint(k, 0.0 * k)
    whole = gain * restoring(settings, k, 0.0 * k)
    assert gain[0] == 1.0
    np.testing.assert_allclose(whole[gain > 0.8], 1.0, atol=0.03)
    assert whole[gain < 0.05].max() < 0.01
    assert restoring(settings, k, 0.0 * k).max() < 1.2 / np.sqrt(0.4)


def test_a_short_wave_comes_back_from_images():
    settings, move = Settings().piv, wave(0.4, 40.0)
    a, b = particle_pair(move)
    found = match(a, b, settings)
    ky, kx = (np.pi * np.arange(n) / n for n in found.u.shape)
    waves = scipy.fft.dctn(found.u, norm="ortho") * restoring(settings, kx, ky[:, None])
    exact, inner = truth(found, move)[0], interior(found, a.shape)

    def gain(field):
        return np.sum((field * exact)[inner]) / np.sum(exact[inner] ** 2)

    assert gain(found.u) < 0.94
    assert abs(gain(scipy.fft.idctn(waves, norm="ortho")) - 1.0) < 0.04
