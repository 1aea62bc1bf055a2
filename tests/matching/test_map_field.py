"""The most probable field: against a dense solve, with a gap, of noise."""

import numpy as np
import pytest
import scipy.fft

from wavefield.matching.map_field import Modes, cosines
from wavefield.matching.map_variance import PosteriorVariance
from wavefield.matching.spectrum import Prior

K = tuple(np.linspace(0.04, 3.1, 40))


def prior_of(power, information=1.0):
    return Prior.isotropic(K, [power(k) for k in K], information)


def sea(shape, power, rng, count=1):
    """Fields (count, ny, nx) whose cosines have a spectrum."""
    ky, kx = (np.pi * np.arange(n) / n for n in shape)
    k = np.hypot(kx, ky[:, None])
    waves = rng.standard_normal((count, *shape)) * np.sqrt(power(np.maximum(k, 0.02)))
    return scipy.fft.idctn(waves, axes=(1, 2), norm="ortho")


def steep_law(k):
    return 3.0 * (k / 0.2) ** -5 / (1 + (0.1 / k) ** 6)


@pytest.mark.parametrize("fields", [1, 2])
def test_the_solver_agrees_with_a_dense_solve(fields):
    rng = np.random.default_rng(1)
    shape = (14, 17)
    modes = Modes(prior_of(lambda k: 0.5 * k**-2), shape)
    my, mx = modes.shape
    basis = np.einsum("my,nx->mnyx", cosines(shape[0], my), cosines(shape[1], mx)).reshape(my * mx, -1)
    F, size = modes.foot.ravel().astype(float), my * mx
    seen = (basis * F[:, None]).T
    a = rng.uniform(0.2, 2.0, (1 if fields == 1 else 3, *shape)).astype(np.float32)
    if fields == 2:
        a[1] *= 0.2
    a[:, 4:9, 5:11] = 0  # a gap
    right = rng.standard_normal((fields, *shape)).astype(np.float32) * (a[0] > 0)
    parts = [[0]] if fields == 1 else [[0, 1], [1, 2]]
    dense = np.block([[seen.T @ (a[q].ravel()[:, None] * seen) for q in row] for row in parts])
    inverse = np.tile(modes.inverse.ravel().astype(float), fields)
    dense += np.diag(inverse)
    b = np.concatenate([seen.T @ f.ravel() for f in right])
    exact = np.linalg.solve(dense, b).reshape(fields, my, mx)
    start = np.zeros((fields, my, mx), np.float32)
    factor = modes.factor(a[0] if fields == 1 else 0.5 * (a[0] + a[2]))
    found = modes.solve(a, right, start, 1e-7, factor)
    assert np.abs(found - exact).max() < 3e-6 * np.abs(exact).max()
    assert size == exact[0].size


def test_a_gap_is_filled_as_well_as_its_uncertainty_states_and_better_than_by_nothing():
    rng = np.random.default_rng(2)
    shape, noise = (60, 70), 0.05
    prior = prior_of(steep_law, information=1 / noise**2)
    modes, spread = Modes(prior, shape), PosteriorVariance(prior, shape)
    known = np.ones(shape, np.float32)
    y, x = np.mgrid[: shape[0], : shape[1]]
    hole = np.hypot(y - 30, x - 35) < 5
    known[hole] = 0
    a = known / noise**2
    errors, stds = [], []
    for truth in sea(shape, steep_law, rng, 12):
        data = modes.block_mean(modes.waves(truth[None].astype(np.float32)))
        data = data + noise * rng.standard_normal(shape).astype(np.float32)
        start = modes.waves(known * data)
        waves = modes.solve(a[None], a * data, start, 1e-3, modes.factor(a))
        errors.append(modes.field(waves)[0] - truth)
        stds.append(np.sqrt(sum(spread(a)))[0])
    error, std = np.array(errors), np.array(stds)
    assert np.abs(error[:, hole]).mean() < 0.5 * np.std(truth)
    inside = np.abs(error) < std
    assert 0.55 < inside[:, hole].mean() < 0.95
    assert 0.6 < inside[:, 8:-8, 8:20].mean() < 0.76


@pytest.mark.parametrize("waves", [0.0, 0.01, 0.1, 1.0])
def test_noise_makes_no_slopes_at_the_edge(waves):
    rng, shape, noise = np.random.default_rng(2), (50, 60), 0.3
    prior = prior_of(lambda k: waves * steep_law(k) + 1e-4, information=1 / noise**2)
    modes, a = Modes(prior, shape), np.full(shape, 1 / noise**2, np.float32)
    factor, std = modes.factor(a), np.sqrt(sum(PosteriorVariance(prior, shape)(a)))[0]
    errors = []
    for truth in sea(shape, lambda k: waves * steep_law(k) + 1e-4, rng, 40).astype(np.float32):
        shown = (truth + noise * rng.standard_normal(shape).astype(np.float32))[None]
        edges, start = modes.split(shown)
        field = modes.field(modes.solve(a[None], a * (shown - edges), start, 1e-3, factor)) + edges
        errors.append((field - truth)[0])
    ratio = np.sqrt(np.mean(np.square(errors), axis=0)) / std
    edge = np.concatenate(
        [ratio[:, :3].ravel(), ratio[:, -3:].ravel(), ratio[:3].ravel(), ratio[-3:].ravel()]
    )
    assert 0.6 < edge.mean() < 1.6  # variance is that of the middle; lattices reach beyond the grid
