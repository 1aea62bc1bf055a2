import threading

import numpy as np
from matching_cases import particle_pair, wave

from wavefield.matching import MatchSettings, kernels, match, prepare

F = np.float32


def test_places_outside_the_image_are_read_inside_it():
    rng = np.random.default_rng(3)
    ny, nx = 9, 17
    a, b = rng.normal(0, 1, (2, 5 * ny + 19, 5 * nx + 18)).astype(F)
    u, v = rng.uniform(-4, 4, (2, ny, nx)).astype(F)
    read = []
    for room in (np.full(b.size + 64, np.nan, F), np.zeros(b.size + 64, F)):
        room[32:-32] = b.ravel()
        inner = room[32:-32].reshape(b.shape)
        for move in (-1e6, -30.0, 30.0, 1e6):
            out = np.empty((2, *u.shape), F)
            kernels.plain_sums(a, inner, u + F(move), v + F(move), kernels.work_space(u.shape[1]), out)
            read.append(out)
    assert np.isfinite(read).all()
    np.testing.assert_array_equal(read[:4], read[4:])


def test_nothing_is_read_before_it_is_written(monkeypatch):
    a, b = particle_pair(wave(2.0, 200.0), shape=(130, 157))
    for settings in (MatchSettings.piv(), MatchSettings.stereo()):
        expected = match(a, b, settings)
        real = np.empty

        def poisoned(shape, dtype=float, *rest, real=real, **more):
            out = real(shape, dtype, *rest, **more)
            out[...] = np.nan if np.issubdtype(out.dtype, np.floating) else 85
            return out

        with monkeypatch.context() as patch:
            patch.setattr(np, "empty", poisoned)
            found = match(a, b, settings)
        for name in ("u", "v", "correlation", "reason", "score", "hessian"):
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)


def test_the_same_bits_every_time_and_in_every_thread():
    a, b = particle_pair(wave(2.0, 200.0), shape=(200, 230), unmatched=0.1, noise=0.02)
    settings = MatchSettings.piv()
    first, second = prepare(a, settings), prepare(b, settings)
    expected = match(a, b, settings)
    results = []
    threads = [
        threading.Thread(target=lambda: results.append(match(first, second, settings))) for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(results) == 4
    for found in results:
        np.testing.assert_array_equal(found.u, expected.u)
        np.testing.assert_array_equal(found.score, expected.score)
