"""Random cameras and points for the tests of this room."""

import numpy as np

from wavefield.rig import Camera

TERMS = ("k1", "k2", "p1", "p2", "k3", "tau_x", "tau_y", "skew")


def random_camera(seed, *without):
    rng = np.random.default_rng(seed)
    aim = np.array([*rng.uniform(-0.3, 0.3, 2), 0.0])
    centre = np.array([*rng.uniform(-2.5, 2.5, 2), rng.uniform(3.0, 5.0)])
    z = (aim - centre) / np.linalg.norm(aim - centre)
    x = np.cross(z, rng.normal(size=3))
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z])
    terms = {
        "k1": rng.uniform(-0.2, 0.1),
        "k2": rng.uniform(-0.1, 0.1),
        "p1": rng.uniform(-2e-3, 2e-3),
        "p2": rng.uniform(-2e-3, 2e-3),
        "k3": rng.uniform(-0.1, 0.1),
        "tau_x": rng.uniform(-0.1, 0.1),
        "tau_y": rng.uniform(-0.1, 0.1),
        "skew": rng.uniform(-3.0, 3.0),
    }
    for name in without:
        terms[name] = 0.0
    f = rng.uniform(2000.0, 4000.0)
    c = rng.uniform(450.0, 570.0, 2)
    return Camera(f, f * rng.uniform(0.98, 1.02), c[0], c[1], R, -R @ centre, (1024, 1024), **terms)


def field(seed, n=200):
    rng = np.random.default_rng(seed + 1000)
    return (*rng.uniform(-0.5, 0.5, (2, n)), rng.uniform(-0.1, 0.1, n))


def random_fisheye(seed, *without):
    """A camera whose fisheye lens shows 100 to 200 degrees along the sides of its image."""
    rng = np.random.default_rng(seed + 7000)
    plain = random_camera(seed, *TERMS)
    f = 512.0 / np.radians(rng.uniform(50.0, 100.0))
    terms = {
        "k1": rng.uniform(-0.03, 0.05),
        "k2": rng.uniform(-0.005, 0.01),
        "k3": rng.uniform(-0.001, 0.003),
        "k4": rng.uniform(-0.0002, 0.0005),
        "skew": rng.uniform(-2.0, 2.0),
    }
    for name in without:
        terms[name] = 0.0
    fy = f * rng.uniform(0.99, 1.01)
    c = rng.uniform(490.0, 530.0, 2)
    return Camera(f, fy, c[0], c[1], plain.R, plain.T, plain.size, fisheye=True, **terms)
