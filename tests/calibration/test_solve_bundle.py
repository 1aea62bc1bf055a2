import numpy as np
import pytest
from solve_cases import MESH, views

from wavefield.calibration.bundle import fit, normal_matrix
from wavefield.calibration.camera_start import calibrate_single
from wavefield.calibration.observations import Geometry, collect
from wavefield.tank.rigs import paper_rig


@pytest.mark.slow
def test_stated_uncertainties_are_those_that_occur():
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


def test_the_normal_matrix_of_many_cameras_is_that_of_all_products():
    rng = np.random.default_rng(4)
    J, weight = np.zeros((1000, 200)), rng.uniform(0.2, 1.0, 1000)
    for k in range(0, 1000, 50):
        J[k : k + 50, rng.permutation(200)[:17]] = rng.normal(size=(50, 17))
    assert np.allclose(normal_matrix(J, weight), J.T @ (weight[:, None] * J), rtol=0, atol=1e-12)
