"""Least squares over the cameras at the nodes."""

import numpy as np
import pytest

from wavefield.measurement.node_motion import solve_nodes

PARTS = np.array([0.5, 0.5, 1.0])


def variance(missing):
    """Variances of u, v, w from three cameras with little noise and what the prior removed, px^2."""
    rows = [[1.0, 0.0, slope] if i == 0 else [0.0, 1.0, 0.0] for slope in (-1.0, 0.0, 1.0) for i in (0, 1)]
    jacobian = np.reshape(np.float32(rows), (6, 3, 1))
    fields = [np.zeros((6, 1), np.float32) for _ in range(3)]
    noise, removed = np.full((6, 1), 1e-6, np.float32), np.repeat(np.float32(missing), 2)[:, None]
    out = np.empty((14, 1), np.float32)
    solve_nodes(jacobian, *fields, noise, removed, np.ones(6), np.ones(6), PARTS, np.zeros((3, 3)), out)
    return out[9:12, 0]


def test_what_all_cameras_miss_does_not_average_out():
    u, v, w = variance([0.01, 0.01, 0.01])
    assert u == pytest.approx(v, rel=1e-3)
    assert w == pytest.approx(2 * u, rel=1e-3)
    assert 0.005 < u < 0.01


def test_a_camera_that_misses_most_counts_by_its_weight():
    one_blind, none_blind = variance([0.01, 0.01, 1.0]), variance([0.01, 0.01, 0.01])
    assert (one_blind < 1.5 * none_blind).all()
