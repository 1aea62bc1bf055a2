import cv2
import mpmath
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


def project_in_50_digits(camera, x, y, z):
    R = [[mpmath.mpf(v) for v in row] for row in camera.rotation]
    T = [mpmath.mpf(v) for v in camera.translation]
    xc, yc, zc = (R[i][0] * x + R[i][1] * y + R[i][2] * z + T[i] for i in range(3))
    a, b = xc / zc, yc / zc
    r2 = a * a + b * b
    radial = 1 + camera.k1 * r2 + camera.k2 * r2**2 + camera.k3 * r2**3
    u = a * radial + 2 * camera.p1 * a * b + camera.p2 * (r2 + 2 * a * a)
    v = b * radial + camera.p1 * (r2 + 2 * b * b) + 2 * camera.p2 * a * b
    cx, sx = mpmath.cos(camera.tau_x), mpmath.sin(camera.tau_x)
    cy, sy = mpmath.cos(camera.tau_y), mpmath.sin(camera.tau_y)
    rot = mpmath.matrix([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]]) * mpmath.matrix(
        [[1, 0, 0], [0, cx, sx], [0, -sx, cx]]
    )
    w = mpmath.matrix([[rot[2, 2], 0, -rot[0, 2]], [0, rot[2, 2], -rot[1, 2]], [0, 0, 1]]) * rot
    w = w * mpmath.matrix([u, v, 1])
    u, v = w[0] / w[2], w[1] / w[2]
    return camera.fx * u + camera.skew * v + camera.cx, camera.fy * v + camera.cy


@pytest.mark.parametrize("seed", range(3))
def test_jacobian_against_fifty_digits(seed):
    camera = random_camera(seed)
    for point in np.stack(field(seed, 5), -1):
        J = camera.jacobian(*point)
        with mpmath.workdps(50):
            h = mpmath.mpf(10) ** -20
            for j in range(3):
                lo, hi = ([mpmath.mpf(v) for v in point] for _ in range(2))
                lo[j] -= h
                hi[j] += h
                a, b = project_in_50_digits(camera, *lo), project_in_50_digits(camera, *hi)
                exact = np.array([float((b[i] - a[i]) / (2 * h)) for i in range(2)])
                assert abs(J[:, j] - exact).max() < 1e-8 * np.abs(J).max()


def test_points_behind_and_rays_upward_give_nan():
    R = ((1, 0, 0), (0, -1, 0), (0, 0, -1))
    camera = Camera(1000, 1000, 500, 500, R, (0, 0, 4), (1000, 1000))
    assert np.isnan(camera.project(0, 0, 5.0)[0])
    assert not camera.sees(0, 0, 5.0)
    level = Camera(1000, 1000, 500, 500, ((1, 0, 0), (0, 0, -1), (0, 1, 0)), (0, 0, 0), (1000, 1000))
    assert np.isnan(level.unproject(500, 100, -1.0)[0])
    assert np.isfinite(level.unproject(500, 900, -1.0)[0])
