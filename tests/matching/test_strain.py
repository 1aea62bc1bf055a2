"""Beads move with the displacement but are not strained by it."""

import os
import subprocess
import sys

import numpy as np
import pytest
from matching_cases import interior, particle_pair, truth

from wavefield.matching import MatchSettings, blocks, match, prepare
from wavefield.matching.pyramid import reevaluate

F = np.float32
SHAPE = (300, 340)
SETTINGS = MatchSettings.piv()


def strained(x, y):
    """Stretched, turned and sheared by 6 %."""
    k = 2 * np.pi / 300
    return 3 * np.sin(k * (x + 0.5 * y)), 3 * np.sin(k * (y - 0.7 * x))


@pytest.mark.parametrize("sigma", [0.6, 0.9])
def test_scores_of_beads_scatter_less_in_a_strained_flow(sigma, monkeypatch):
    a, b = (prepare(image, SETTINGS) for image in particle_pair(strained, SHAPE, sigma=sigma))
    d = match(a, b, SETTINGS)
    exact = [f.astype(F) for f in truth(d, strained)]
    inside = interior(d, SHAPE) & d.valid
    scatter = []
    for instead in (blocks.subtract_strain, lambda *nothing: None):
        monkeypatch.setattr("wavefield.matching.pyramid.subtract_strain", instead)
        seen = reevaluate(a, b, *exact, SETTINGS)
        scores = seen.score[:, inside] / seen.hessian[[0, 2]][:, inside].mean(1)[:, None]
        scatter.append(scores.std(axis=1))
    assert (scatter[0] < 0.65 * scatter[1]).all()


SUMS = """
import hashlib
import numpy as np
from wavefield.matching.kernels import gradient_moments, strain_moments, work_space
image = np.random.default_rng(1).standard_normal((116, 136)).astype(np.float32)
work = work_space(24)
first, second = np.empty((9, 20, 24), np.float32), np.empty((8, 20, 24), np.float32)
gradient_moments(image, work, first)
strain_moments(image, work, second)
print(hashlib.sha256(first.tobytes() + second.tobytes()).hexdigest())
"""


@pytest.mark.slow
def test_a_process_that_compiles_adds_in_the_order_of_those_that_read_what_it_kept(tmp_path):
    place = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    found = [
        subprocess.run([sys.executable, "-c", SUMS], env=place, capture_output=True, text=True, check=True)
        for _ in range(2)
    ]
    assert any(tmp_path.rglob("*.nbc")), "nothing was kept"
    assert found[0].stdout == found[1].stdout != ""
