import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rig_cases import TERMS, field, random_camera

from wavefield.rig import Camera


@pytest.mark.parametrize("seed", range(3))
def test_projection_is_opencvs_with_all_terms(seed):
    camera = random_camera(seed, "skew")  # the one term OpenCV has not
    x, y, z = field(seed)
    K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    ref = cv2.projectPoints(np.stack([x, y, z], -1), cv2.Rodrigues(camera.R)[0], camera.T, K, camera.D)[0][
        :, 0
    ]
    X, Y = camera.project(x, y, z)
    assert max(abs(X - ref[:, 0]).max(), abs(Y - ref[:, 1]).max()) < 1e-9


@given(
    st.integers(0, 10_000), st.sampled_from([(), ("k2", "p1", "p2", "k3", "tau_x", "tau_y", "skew"), TERMS])
)
def test_pixel_to_plane_and_back(seed, without):
    camera = random_camera(seed, *without)
    rng = np.random.default_rng(seed)
    X, Y = rng.uniform(0, 1023, (2, 50))
    z = rng.uniform(-0.1, 0.1)
    back = camera.project(*camera.unproject(X, Y, z), z)
    assert max(abs(back[0] - X).max(), abs(back[1] - Y).max()) < 1e-9


@pytest.mark.parametrize("seed", range(3))
def test_jacobian_is_the_slope_of_the_projection(seed):
    camera, h = random_camera(seed), 1e-4
    for point in np.stack(field(seed, 5), -1):
        ends = [np.stack(camera.project(*(point + s * h * np.eye(3)).T)) for s in (1, -1)]
        np.testing.assert_allclose(camera.jacobian(*point), (ends[0] - ends[1]) / (2 * h), atol=1e-3)


def test_points_behind_and_rays_upward_give_nan():
    R = ((1, 0, 0), (0, -1, 0), (0, 0, -1))
    camera = Camera(1000, 1000, 500, 500, R, (0, 0, 4), (1000, 1000))
    assert np.isnan(camera.project(0, 0, 5.0)[0])
    assert not camera.sees(0, 0, 5.0)
    level = Camera(1000, 1000, 500, 500, ((1, 0, 0), (0, 0, -1), (0, 1, 0)), (0, 0, 0), (1000, 1000))
    assert np.isnan(level.unproject(500, 100, -1.0)[0])
    assert np.isfinite(level.unproject(500, 900, -1.0)[0])
