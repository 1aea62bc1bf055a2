from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from solve_cases import MESH, nodes, views

from wavefield.calibration.bundle import (
    Whitener,
    fit,
    huber,
    layout,
    linearised,
    minimise,
    moved,
    normal_matrix,
    predict,
)
from wavefield.calibration.camera_start import calibrate_single
from wavefield.calibration.observations import Geometry, collect
from wavefield.rig.lens import LENS
from wavefield.tank.rigs import paper_rig

ALL = ("f", "aspect", "c", "k1", "k2", "p", "k3", "tilt")


@pytest.fixture(scope="module")
def problem():
    """Observations, and a geometry near the truth with every lens term at work."""
    observations = collect(views(seed=1), MESH)
    observations = observations.only(np.arange(len(observations)) % 5 == 0)
    rng = np.random.default_rng(0)
    rig = paper_rig()
    lens = np.array([[getattr(rig[name], term) for term in LENS] for name in rig])
    lens[:, 4:9] += 0.01 * rng.normal(size=(3, 5))
    lens[:, 9:11] += 0.01 * rng.normal(size=(3, 2))
    from solve_cases import poses

    where = poses(1)
    geometry = Geometry(
        lens,
        np.stack([rig[name].R for name in rig]),
        np.stack([rig[name].T for name in rig]),
        np.stack([where[p][0] for p in observations.poses]),
        np.stack([where[p][1] for p in observations.poses]),
        1e-3 * rng.normal(size=(len(observations.nodes), 3)),
    )
    return observations, geometry


def test_jacobian_against_differences(problem):
    o, geometry = problem
    plan = layout(o, [ALL] * 3, o.poses.index("flat"))
    rng = np.random.default_rng(1)
    x = 1e-3 * rng.normal(size=len(plan.names))
    pixel, J, by_node = linearised(geometry, plan, x, o)
    assert np.allclose(pixel, predict(moved(geometry, plan, x), o), atol=1e-9)
    for k, name in enumerate(plan.names):
        h = 1e-5
        up, down = x.copy(), x.copy()
        up[k] += h
        down[k] -= h
        slope = (predict(moved(geometry, plan, up), o) - predict(moved(geometry, plan, down), o)) / (2 * h)
        assert abs(J[..., k] - slope).max() < 1e-6 * max(1.0, abs(slope).max()), name
    start = moved(geometry, plan, x)
    for k in range(3):
        shift = np.zeros_like(start.offset)
        shift[:, k] = 1e-5
        slope = (
            predict(replace(start, offset=start.offset + shift), o)
            - predict(replace(start, offset=start.offset - shift), o)
        ) / 2e-5
        assert abs(by_node[..., k] - slope).max() < 1e-6 * abs(slope).max()


def test_minimum_is_scipys(problem):
    o, geometry = problem
    rng = np.random.default_rng(2)
    blunder = rng.random(len(o)) < 0.02
    o = replace(
        o, pixel=predict(geometry, o) + np.where(blunder[:, None], 3.0, 0.1) * rng.normal(size=(len(o), 2))
    )
    plan = layout(o, [("f", "k1")] * 3, o.poses.index("flat"))

    def residual(x):
        return ((predict(moved(geometry, plan, x), o) - o.pixel) / 0.1).ravel()

    def with_jacobian(x):
        pixel, J, _ = linearised(geometry, plan, x, o)
        return ((pixel - o.pixel) / 0.1).ravel(), J.reshape(-1, len(x)) / 0.1

    x0 = 1e-3 * rng.normal(size=len(plan.names))
    ours = minimise(residual, with_jacobian, x0, 4.0, 1e-14)[0]
    ref = least_squares(
        residual,
        x0,
        lambda x: with_jacobian(x)[1],
        loss="huber",
        f_scale=4.0,
        x_scale="jac",
        xtol=1e-15,
        ftol=1e-15,
    )
    std = 1 / np.sqrt(np.diag(ref.jac.T @ ref.jac))
    assert huber(residual(ours), 4.0) <= huber(residual(ref.x), 4.0) * (1 + 1e-9)
    assert abs((ours - ref.x) / std).max() < 1e-3


def test_whitening_is_the_fit_with_free_nodes():
    rng = np.random.default_rng(3)
    node = rng.integers(0, 7, 60)
    B = 500 * rng.normal(size=(60, 2, 3))
    r, J = rng.normal(size=120), rng.normal(size=(120, 4))
    whitener = Whitener(node, B, 1e-3)
    reduced = np.linalg.lstsq(whitener(J), whitener(r), rcond=None)[0]
    # the same with the nodes' offsets as parameters and their prior as observations
    full = np.zeros((120 + 21, 4 + 21))
    full[:120, :4] = J
    for k in range(60):
        full[2 * k : 2 * k + 2, 4 + 3 * node[k] : 7 + 3 * node[k]] = B[k]
    full[120:, 4:] = np.eye(21) / 1e-3
    solution = np.linalg.lstsq(full, np.append(r, np.zeros(21)), rcond=None)[0]
    assert reduced == pytest.approx(solution[:4], rel=1e-8)
    assert whitener.offsets(r - J @ reduced) == pytest.approx(solution[4:].reshape(7, 3), rel=1e-6)


@pytest.mark.slow
def test_stated_uncertainties_are_those_that_occur():
    """Errors of the fitted parameters over their stated uncertainty scatter by one."""
    rig = paper_rig()
    name = "cam1"
    z = []
    for seed in range(6):
        o = collect({name: views({name: rig[name]}, seed=seed, noise=0.05)[name]}, MESH)
        truth = rig[name]
        g = calibrate_single(o)
        start = Geometry(
            g.lens[None],
            *(np.stack([g.poses["flat"][k]]) for k in range(2)),
            np.stack([g.poses["flat"][0].T @ g.poses[p][0] for p in o.poses]),
            np.stack([g.poses["flat"][0].T @ (g.poses[p][1] - g.poses["flat"][1]) for p in o.poses]),
            np.zeros((len(o.nodes), 3)),
        )
        start.lens[:, 2:4] = 511.5
        found = fit(o, start, [("f", "k1", "tilt")], o.poses.index("flat"))
        std = np.sqrt(np.diag(found.covariance))
        lens = found.geometry.lens[0]
        z += [np.log(lens[0] / truth.fx) / std[0], (lens[4] - truth.k1) / std[1]]
        z += [(lens[9] - truth.tau_x) / std[2], (lens[10] - truth.tau_y) / std[3]]
        assert found.scale == pytest.approx(1.0, abs=0.05)
    assert 0.6 < np.sqrt(np.mean(np.square(z))) < 1.5


def test_nodes_are_numbered_once():
    o = collect(views(seed=0), MESH)
    assert len(np.unique(o.nodes, axis=0)) == len(o.nodes)
    assert set(map(tuple, o.nodes)) <= set(map(tuple, nodes()))


def test_the_normal_matrix_of_many_cameras_is_that_of_all_products():
    rng = np.random.default_rng(4)
    J, weight = np.zeros((1000, 200)), rng.uniform(0.2, 1.0, 1000)
    for k in range(0, 1000, 50):
        J[k : k + 50, rng.permutation(200)[:17]] = rng.normal(size=(50, 17))
    assert np.allclose(normal_matrix(J, weight), J.T @ (weight[:, None] * J), rtol=0, atol=1e-12)
