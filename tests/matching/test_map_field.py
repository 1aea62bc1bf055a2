"""The most probable field: against a dense solve, with a gap, with a slope at the edge; noise, spectrum."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.fft

from wavefield.matching import Prior
from wavefield.matching.learned_spectrum import refined_prior
from wavefield.matching.map_field import Modes, cosines
from wavefield.matching.map_variance import PosteriorVariance, hole_variance
from wavefield.matching.noise import noise_factor_near_holes, noise_of_scores

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
        data = modes.seen(modes.waves(truth[None].astype(np.float32)))
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


def test_a_slope_at_the_edge_is_kept():
    shape, noise = (50, 60), 0.1
    prior = prior_of(steep_law, information=1 / noise**2)
    modes = Modes(prior, shape)
    x = np.broadcast_to(np.arange(shape[1], dtype=np.float32), shape)
    truth = (0.2 * x - 6.0)[None]
    a = np.full(shape, 1 / noise**2, np.float32)
    factor = modes.factor(a)
    errors = []
    for edges, start in (modes.split(truth), (0 * truth, modes.waves(truth))):
        waves = modes.solve(a[None], a * (truth - edges), start, 1e-3, factor)
        errors.append(np.abs(modes.field(waves) + edges - truth))
    assert errors[0][:, :, :2].max() < 0.1 * errors[1][:, :, :2].max()
    inside = np.s_[:, 10:-10, 10:-10]  # what cosines leave of a slope would ring far inside
    assert errors[0][inside].max() < 0.3 * errors[1][inside].max()


@pytest.mark.parametrize("waves", [0.0, 0.01, 0.1, 1.0])
def test_noise_makes_no_slopes_at_the_edge(waves):
    """Slopes at the edge are no wave of the spectrum: on still water they were most of the error."""
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


def test_the_noise_of_scores_is_found_where_it_is():
    rng = np.random.default_rng(3)
    shape = (80, 100)
    trace = rng.uniform(0.5, 1.5, shape).astype(np.float32)
    nu = np.where(np.arange(shape[1]) < 50, 0.5, 2.0)
    # of each of two components half the trace
    score = rng.standard_normal((2, *shape)) * np.sqrt(0.5 * nu * trace)
    counts = np.ones(shape, np.float32)
    counts[30:40, 20:30] = 0
    found = noise_of_scores(score.astype(np.float32), trace, counts, 1.0)
    assert np.median(found[:, :35]) == pytest.approx(0.5, rel=0.3)
    assert np.median(found[:, 65:]) == pytest.approx(2.0, rel=0.2)


def test_a_corner_that_does_not_match_leaves_the_noise_of_the_rest_alone():
    rng = np.random.default_rng(5)
    trace, counts = np.full((80, 100), 200.0, np.float32), np.ones((80, 100), np.float32)
    score = (rng.standard_normal((2, 80, 100)) * np.sqrt(0.5 * trace)).astype(np.float32)
    mismatched = score.copy()
    mismatched[0, :6, :6] += 300.0
    sound, found = (
        noise_of_scores(s, trace, counts, 1.0, with_mismatches=True)[35:, 35:] for s in (score, mismatched)
    )
    assert np.abs(found / sound - 1.0).max() < 0.1


def directed(kx, ky):
    """Spectra of two components: each moves along its own axis, and waves along y are longer."""
    k = np.maximum(np.hypot(kx, ky), 0.02)
    law = steep_law(np.hypot(kx, 1.5 * ky) + 0.02)
    return np.array([law * (0.03 + (kx / k) ** 2), law * (0.03 + (ky / k) ** 2)])


def learned(data, a, prior, rounds=4):
    """A prior learned from blocks, and the fields that it gives in the end."""
    h = np.stack([a, 0 * a, a])[: 3 if len(data[0]) == 2 else 1]

    def most_probable(modes):
        factor = modes.factor(a)
        return [modes.solve(h, a * f, modes.waves(f), 1e-3, factor) for f in data]

    for _ in range(rounds):
        prior = prior.with_min_signal_to_noise()
        modes = Modes(prior, a.shape)
        prior = refined_prior(prior, modes, most_probable(modes), float(a.mean()))
    modes = Modes(prior, a.shape)
    return prior, [modes.field(f) for f in most_probable(modes)]


def test_waves_have_a_direction_and_components_a_spectrum_of_their_own():
    rng = np.random.default_rng(14)
    shape, noise = (84, 90), 0.1
    ky, kx = (np.pi * np.arange(n) / n for n in shape)
    power = directed(kx, ky[:, None])
    fields = scipy.fft.idctn(
        rng.standard_normal((4, 2, *shape)) * np.sqrt(power), axes=(2, 3), norm="ortho"
    ).astype(np.float32)
    a = np.full(shape, 1 / noise**2, np.float32)
    radial = Prior.isotropic(K, [steep_law(k) for k in K], 1 / noise**2)
    exact = Modes(Prior.isotropic(K, [1e3] * len(K), 1 / noise**2), shape)
    data = [exact.seen(exact.waves(f)) for f in fields]
    data = [f + noise * rng.standard_normal(f.shape).astype(np.float32) for f in data]
    prior, found = learned(data, a, radial)
    for turn in (0.3, 0.8, 1.2):
        k = np.array([0.25, 0.35, 0.5])
        x, y = k * np.cos(turn), k * np.sin(turn)
        assert np.abs(np.log(prior.spectrum(x, y) / directed(x, y))).max() < np.log(2.5), turn
    # the same with one spectrum for all directions and both components
    alike = Modes(Prior.isotropic(prior.k, np.array(prior.power).mean(axis=(0, 1)), prior.information), shape)
    h = np.stack([a, 0 * a, a])
    errors = []
    for f, own, truth in zip(data, found, fields):
        waves = alike.solve(h, a * f, alike.waves(f), 1e-3, alike.factor(a))
        inside = np.s_[:, 8:-8, 8:-8]
        errors.append([np.mean((g - truth)[inside] ** 2) for g in (own, alike.field(waves))])
    own, radial_error = np.sqrt(np.mean(errors, axis=0))
    assert own < 0.95 * radial_error
    # and each component's uncertainty is its own
    noise_part, missing = PosteriorVariance(prior, shape)(a)
    stated = np.sqrt((noise_part + missing)[:, 30:50, 30:50].mean(axis=(1, 2)))
    true = np.sqrt(
        np.mean([np.square(g - f)[:, 8:-8, 8:-8].mean(axis=(1, 2)) for g, f in zip(found, fields)], axis=0)
    )
    np.testing.assert_allclose(stated, true, rtol=0.25)


def test_noise_is_thought_larger_around_a_hole_only():
    information = np.ones((60, 80), np.float32)
    information[:3] = 0  # the lattice's edge is no hole
    assert (noise_factor_near_holes(information, 3.0) == 1).all()
    information[25:37, 30:42] = 0
    factor = noise_factor_near_holes(information, 3.0)
    assert factor[31, 28] > 2.5
    assert factor[31, 8] == pytest.approx(1.0, abs=1e-3)
    assert (np.diff(factor[31, 8:28]) >= -1e-6).all()


def test_what_is_missing_counts_as_far_as_the_spectrum_is_waves():
    prior = prior_of(steep_law, information=100.0)
    a = np.full((40, 50), 100.0, np.float32)
    noise, missing = PosteriorVariance(prior, a.shape)(a)
    same, less = PosteriorVariance(replace(prior, wave_fraction=0.1), a.shape)(a)
    np.testing.assert_array_equal(same, noise)
    np.testing.assert_allclose(less, 0.1 * missing, rtol=1e-5)


def test_a_hole_in_a_long_wave_adds_little_where_it_is_narrow_and_the_wave_where_it_is_wide():
    ky, kx = (np.pi * np.arange(n) / n for n in (60, 70))
    k = np.hypot(kx, ky[:, None])
    spectrum = np.where(k < 0.35, 1.0, 1e-6)
    added = hole_variance(spectrum, 0.05)
    without = 0.05 * np.mean(k < 0.35)  # the variance where there is no hole
    assert added[0].max() < 0.5 * without
    assert added[-1, -1] > 0.5 * spectrum.mean()
    assert (np.diff(added[:, -1]) > 0).all()
