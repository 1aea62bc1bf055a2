"""Harmonics of displacements: water that is at a block in the first frame is elsewhere midway."""

from functools import partial

import numpy as np
import pytest

from tests.matching.matching_cases import particle_pair
from wavefield import matching
from wavefield.matching import MatchSettings
from wavefield.matching.kernels import BLOCK
from wavefield.matching.map_field import Modes
from wavefield.matching.spectrum import Prior, displacement_area
from wavefield.measurement.displacement import map_displacement

SIZE = 260  # px


class Water:
    """One to four short steep waves, sinusoidal by where the water is midway; px."""

    def __init__(self, seed, strain):
        rng = np.random.default_rng(seed)
        count = int(rng.integers(1, 5))
        k, direction = rng.uniform(0.13, 0.2, count), rng.uniform(0, np.pi) + rng.uniform(-0.4, 0.4, count)
        self.k = np.stack([k * np.cos(direction), k * np.sin(direction)])
        self.phase, size = rng.uniform(0, 2 * np.pi, count), rng.uniform(0.5, 1, count)
        self.moved = self.k / k * size / np.sqrt(np.sum(np.square(size * k)) / 2) * strain

    def midway(self, x, y):
        """Displacement of what is at places midway."""
        along = np.einsum("ij,i...->...j", self.k, [x, y])
        return np.einsum("ij,...j->i...", self.moved, np.cos(along + self.phase))

    def first(self, x, y, current=(0.0, 0.0)):
        """Displacement of what is at places in the first frame, on a current, px per frame."""
        u = np.zeros((2, *np.shape(x)))
        for _ in range(40):
            u = np.add(self.midway(x + u[0] / 2, y + u[1] / 2).T, current).T
        return u


def blocks():
    at = BLOCK * np.arange(SIZE // BLOCK) + 0.5 * (BLOCK - 1)
    return np.meshgrid(at, at)


def rms(field):
    return float(np.sqrt(np.mean(np.square(field[:, 6:-6, 6:-6]))))


def test_steep_short_waves_keep_their_harmonics():
    seed = 0
    water = Water(50 + seed, 0.2)
    images = particle_pair(water.first, (SIZE, SIZE), noise=0.01, seed=seed)
    images = [matching.prepare(image, MatchSettings.piv()) for image in images]
    k = np.linspace(0.04, 3.1, 40)
    power = 40.0 * np.exp(-np.square((k - 0.85) / 0.2)) + 1e-4
    modes = Modes(Prior.isotropic(k, power, 100.0, displacement_area(1.5)), (SIZE // BLOCK,) * 2)
    found = matching.match(*images)
    true = water.first(*blocks())
    with_them, without = (map_displacement(found, *images, modes, on) for on in (True, False))
    lost, kept = (rms(modes.field(one.waves) + one.harmonics - true) for one in (without, with_them))
    assert lost**2 - kept**2 > 0.5 * rms(true - water.midway(*blocks())) ** 2


@pytest.mark.parametrize("seed", range(2))
def test_a_current_however_fast_leaves_the_waves_as_exact_as_they_are(seed):
    water, rng = Water(70 + seed, 0.15), np.random.default_rng(seed)
    speed, towards = rng.uniform(15.0, 50.0), rng.uniform(0, 2 * np.pi)
    k = np.append(0.0, np.linspace(0.04, 3.1, 40))
    power = 40.0 * np.exp(-np.square((k - 0.85) / 0.2)) + np.where(k > 0, 1e-4, 1e7)
    modes = Modes(Prior.isotropic(k, power, 100.0, displacement_area(1.5)), (SIZE // BLOCK,) * 2)
    margin = int(np.ceil(speed / BLOCK)) + 6
    inside = np.s_[:, margin:-margin, margin:-margin]
    errors = []
    for current in ((0.0, 0.0), (speed * np.cos(towards), speed * np.sin(towards))):
        searched = [(float(np.floor(part - 8)), float(np.ceil(part + 8))) for part in current]
        settings = MatchSettings.piv(search_x=searched[0], search_y=searched[1])
        moved = partial(water.first, current=current)
        images = particle_pair(moved, (SIZE, SIZE), noise=0.01, seed=seed)
        images = [matching.prepare(image, settings) for image in images]
        found = map_displacement(matching.match(*images, settings), *images, modes, True)
        error = modes.field(found.waves) + found.edges + found.harmonics - moved(*blocks())
        errors.append(np.sqrt(np.mean(np.square(error[inside]))))
    assert errors[1] < 2.0 * errors[0] + 0.02, "px"
