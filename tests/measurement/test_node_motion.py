import numpy as np
import pytest

from wavefield.measurement.velocity import solve_nodes

PARTS = np.array([0.5, 0.5, 1.0])


def solved(moved, noise, missing=0.0):
    """Motion, its variance, chi^2 and the factor on noise from cameras in a row; fields (2 N, nodes), px."""
    moved = np.asarray(moved, np.float32)
    rows, nodes = moved.shape
    slopes = np.repeat(np.linspace(-1.0, 1.0, rows // 2), 2)
    at = [[1.0, 0.0, slope] if i % 2 == 0 else [0.0, 1.0, 0.0] for i, slope in enumerate(slopes)]
    jacobian = np.repeat(np.float32(at)[:, :, None], nodes, axis=2)
    noise, removed = (
        np.ascontiguousarray(np.broadcast_to(np.float32(v), moved.shape)) for v in (noise, missing)
    )
    out, none = np.empty((16, nodes), np.float32), np.zeros_like(moved)
    solve_nodes(jacobian, moved, none, none, noise, removed, PARTS, np.zeros((rows // 2, 3)), out)
    return out[:3], out[15] * out[9:12] + PARTS[:, None] * out[12], out[14], out[15]


@pytest.mark.parametrize("cameras", [2, 3, 4])
def test_nodes_at_which_cameras_contradict_each_other_are_less_certain(cameras):
    rng = np.random.default_rng(cameras)
    noise = rng.normal(0.0, 0.1, (2 * cameras, 50_000))
    even, of_even, chi2, factor = solved(noise, 0.01)
    assert chi2.mean() == pytest.approx(1.0, abs=0.03)
    assert factor.min() == 1.0
    within = (np.abs(even) < np.sqrt(of_even)).mean()
    assert 0.68 < within < 0.75, "even noise is stated little larger"
    # a fifth of the nodes have four times the noise that the record has on the mean
    found, stated, _, _ = solved(noise * np.where(rng.random(50_000) < 0.2, 4.0, 1.0), 0.01)
    beyond, without = ((np.abs(found) > 5.0 * np.sqrt(part)).mean() for part in (stated, of_even))
    assert without > 0.03
    assert beyond < (0.5 if cameras == 2 else 0.1) * without
