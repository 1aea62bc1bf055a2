import numpy as np
from waves_cases import linear_cube, random_waves

import wavefield.waves as wv


def test_coherence_of_wave_vectors_is_that_of_waves_and_not_of_noise():
    cube = linear_cube(random_waves(n=150), 400, 40, 50, dx=0.02, noise_z=0.0002, noise_dz=0.0002)
    plane = wv.plane_coherence(cube)
    waves = plane.sel(k=slice(8, 30))
    assert float(waves.mean_C.sel(term="tot").min()) > 0.95
    assert float(waves.mean_C.sel(term="nl").max()) < 0.3
    # where there is but noise, what a modulus of so few samples leaves
    assert float(plane.mean_C.sel(term="tot", k=slice(110, 150)).mean()) < 0.4
    assert plane.attrs["steps"] == 400
    ring = wv.coherence(cube)
    both = (found.sel(term="tot", k=slice(8, 30)) for found in (ring.C, plane.mean_C))
    np.testing.assert_allclose(*map(np.abs, both), atol=0.05)
