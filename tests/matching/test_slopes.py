"""Slopes of displacements within blocks."""

import numpy as np
import pytest

from wavefield.matching.blocks import slopes
from wavefield.matching.kernels import BLOCK

VARIANCE = 5.0


def drawn_wave(seed):
    """Wavenumber (2,), rad per px, of five to twelve blocks in any direction, and a phase."""
    rng = np.random.default_rng(seed)
    length, towards = BLOCK * rng.uniform(5, 12), rng.uniform(0, 2 * np.pi)
    return 2 * np.pi / length * np.array([np.cos(towards), np.sin(towards)]), rng.uniform(0, 2 * np.pi)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("variance", [0.0, VARIANCE])
def test_slopes_of_waves_down_to_five_blocks_are_those_before_blocks_average_them(seed, variance):
    k, phase = drawn_wave(seed)
    y, x = np.mgrid[:40, :50] * float(BLOCK)
    phases = k[0] * x + k[1] * y + phase
    field = np.exp(-0.5 * variance * np.sum(k**2)) * np.sin(phases)
    found = slopes(field, -2 * field, variance)
    exact = np.stack([k[0], k[1], -2 * k[0], -2 * k[1]])[:, None, None] * np.cos(phases)
    inside = np.s_[:, 5:-5, 5:-5]
    size = np.sqrt(np.mean(np.square(exact[:2]).sum(axis=0)))
    assert np.abs(found - exact)[:2][inside].max() < 0.07 * np.sqrt(2) * size
    np.testing.assert_allclose(found[2:], -2 * found[:2], atol=1e-6)


@pytest.mark.parametrize("variance", [0.0, VARIANCE])
def test_slopes_of_a_plane_are_exact_up_to_its_edges(variance):
    y, x = np.mgrid[:9, :12] * float(BLOCK)
    found = slopes(0.3 * x - 0.2 * y, 0.1 * y, variance)
    expected = np.array([0.3, -0.2, 0.0, 0.1])
    np.testing.assert_allclose(found, np.broadcast_to(expected[:, None, None], found.shape), atol=1e-5)
