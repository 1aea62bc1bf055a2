"""Waves are stated more uncertain in the part of a field where they are higher, less where it is calm."""

import numpy as np
import pytest

from wavefield.matching import Modes, Prior
from wavefield.measurement.elevation import local_share

SHAPE = 70, 90
INFORMATION = np.ones(SHAPE, np.float32)


def short_waves(seed):
    """Random waves of 4 to 8 blocks, of variance 1."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    out = np.zeros(SHAPE)
    for _ in range(200):
        k, angle, phase = 2 * np.pi / rng.uniform(4, 8), *rng.uniform(0, 2 * np.pi, 2)
        out += 0.1 * np.cos(k * (np.cos(angle) * x + np.sin(angle) * y) + phase)
    return out


@pytest.mark.parametrize("seed", range(3))
def test_what_is_missing_of_short_waves_is_more_where_they_are_higher(seed):
    modes = Modes(Prior.isotropic((0.1, 1.0, 3.0), (5.0, 1.0, 0.2), 1.0), SHAPE)
    even = short_waves(seed)
    shares = local_share(modes, modes.waves(even[None].astype(np.float32)), INFORMATION)
    assert shares.min() >= 0.5
    assert shares.mean() == pytest.approx(1.0, abs=0.1), "chance alone"
    x = np.arange(SHAPE[1]) / SHAPE[1]
    envelope = np.sin(0.5 * np.pi * x) ** 2
    shares = local_share(modes, modes.waves((envelope * even)[None].astype(np.float32)), INFORMATION)
    rough = shares[:, x > 0.85].mean()
    assert rough == pytest.approx(1.0 / np.mean(envelope**2), rel=0.35)
    assert (shares[:, x < 0.3] == 0.5).all()


def test_still_water_has_the_same_everywhere():
    modes = Modes(Prior.isotropic((0.1, 3.0), (1e-12, 1e-12), 1.0), SHAPE)
    assert (local_share(modes, np.zeros((1, *modes.shape), np.float32), INFORMATION) == 1.0).all()
