import threading

import numpy as np
import pytest
from matching_cases import particle_pair, wave

from wavefield.matching import MatchSettings, blocks, kernels, match, prepare

F = np.float32


def quintic(x):
    x = np.abs(x)
    return np.where(
        x < 1,
        (66 - 60 * x**2 + 30 * x**4 - 10 * x**5) / 120,
        np.where(
            x < 2,
            (51 + 75 * x - 210 * x**2 + 150 * x**3 - 45 * x**4 + 5 * x**5) / 120,
            np.where(x < 3, (3 - x) ** 5 / 120, 0),
        ),
    )


@pytest.fixture(scope="module")
def case():
    """Random images, displacements and slopes on a lattice, far enough from the border."""
    rng = np.random.default_rng(3)
    ny, nx = 9, 17
    h, w = ny * 5 + 3, nx * 5 + 2
    a, b = rng.normal(0, 1, (2, h + 16, w + 16)).astype(F)
    u, v = rng.uniform(-4, 4, (2, ny, nx)).astype(F)
    slope = rng.uniform(-0.2, 0.2, (4, ny, nx)).astype(F)
    c2 = rng.uniform(0.1, 2, (ny, nx)).astype(F)
    rows = np.empty((h, 5, w + 4), F)
    for y in range(h):
        kernels._spline_row(a, y, rows[y], w)
    smooth, gx, gy = (rows[:, k, :w] for k in (2, 3, 4))
    return a, b, u, v, slope, c2, smooth, gx, gy


def spline_matrix(places, n):
    return quintic(places[:, None] - np.arange(n))


def expected_sums(case):
    """The sums of every block by plain numpy in double precision."""
    _, b, u, v, slope, c2, smooth, gx, gy = case
    ny, nx = u.shape
    out = np.zeros((12, ny, nx))
    y, x = np.mgrid[-2:3, -2:3].astype(float)
    for j in range(ny):
        strip = {}
        for i in range(nx):
            rows = np.arange(5 * j, 5 * j + 5) + 8 + float(v[j, i])
            columns = np.arange(5 * i, 5 * i + 5) + 8 + float(u[j, i])
            read = spline_matrix(rows, b.shape[0]) @ b.astype(float) @ spline_matrix(columns, b.shape[1]).T
            box = np.s_[5 * j : 5 * j + 5, 5 * i : 5 * i + 5]
            p, q = gx[box].astype(float), gy[box].astype(float)
            s = slope[:, j, i].astype(float)
            r = smooth[box] - read - p * (s[0] * x + s[1] * y) - q * (s[2] * x + s[3] * y)
            m = (smooth[box] + read) / 2
            t = r**2 * c2[j, i] / (1 + c2[j, i] * 4 * 0.05 * m**2)
            strip[i] = smooth[box].astype(float), r, (1 + t) ** -2, t
            weight = strip[i][2]
            out[:10, j, i] = [
                np.sum(f)
                for f in (
                    weight * p * r,
                    weight * q * r,
                    weight * p * p,
                    weight * p * q,
                    weight * q * q,
                    r * r,
                    smooth[box],
                    smooth[box].astype(float) ** 2,
                    r,
                    smooth[box] * r,
                )
            ]
        a, r, weight, t = (np.concatenate([strip[i][k] for i in range(nx)], 1) for k in range(4))
        da, dr = np.zeros_like(a), np.zeros_like(r)
        da[:, 1:-1], dr[:, 1:-1] = a[:, 2:] - a[:, :-2], r[:, 2:] - r[:, :-2]
        psi = weight * (1 - 4 * t / (1 + t))
        out[10, j] = (psi * da * (da - dr)).sum(0).reshape(nx, 5).sum(1)
        out[11, j] = (weight * (da - dr / 2) ** 2).sum(0).reshape(nx, 5).sum(1)
    return out


def test_block_sums_follow_their_definition(case):
    a, b, u, v, slope, c2, *_ = case
    expected = expected_sums(case)
    work = kernels.work_space(u.shape[1])
    for kernel, n in ((kernels.robust_sums, 6), (kernels.final_sums, 12)):
        out = np.full((n, *u.shape), np.nan, F)
        kernel(a, b, u, v, slope, c2, F(0.05), work, out)
        for k in range(n):
            np.testing.assert_allclose(out[k], expected[k], atol=2e-5, err_msg=f"sum {k}")


def test_unweighted_sums_are_the_last_ones_with_weights_of_one(case):
    a, b, u, v, slope, c2, *_ = case
    work = kernels.work_space(u.shape[1])
    expected, out = np.full((2, 12, *u.shape), np.nan, F)
    kernels.final_sums(a, b, u, v, slope, 0 * c2, F(0.05), work, expected)
    kernels.unweighted_sums(a, b, u, v, slope, work, out)
    given = [0, 1, 5, 6, 7, 8, 9, 10, 11]
    np.testing.assert_allclose(out[given], expected[given], atol=2e-5)
    assert np.isnan(out[2:5]).all()


def test_places_outside_the_image_are_read_inside_it(case):
    a, b, u, v, *_ = case
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


def test_plain_sums_with_slopes_taken_off_are_the_unweighted_ones(case):
    a, b, u, v, slope, c2, *_ = case
    work = kernels.work_space(u.shape[1])
    full = np.empty((6, *u.shape), F)
    kernels.robust_sums(a, b, u, v, slope, 0 * c2, F(0.05), work, full)
    moments = np.empty((9, *u.shape), F)
    kernels.gradient_moments(a, work, moments)
    np.testing.assert_allclose(moments[:3], full[2:5], atol=1e-5)
    plain = np.empty((2, *u.shape), F)
    kernels.plain_sums(a, b, u, v, work, plain)
    blocks.subtract_slopes(plain, moments, slope)
    np.testing.assert_allclose(plain, full[:2], atol=2e-5)


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
