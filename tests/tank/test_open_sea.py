"""The open sea from a platform: each pixel shows the exact water surface."""

import numpy as np
import pytest
from scipy import ndimage

from wavefield.tank import Scene, Tank, texture

SMALL = {"focal": 190.0, "size": (200, 150)}


@pytest.fixture(scope="module")
def tank():
    return Tank(Scene.load("sea").with_(rig=SMALL, sea={"shortest": 3.0}))


@pytest.mark.parametrize("name", ["left", "right"])
def test_pixels_show_the_first_water_on_their_sight_lines(tank, name):
    camera = tank.rig[name]
    seen = texture.visible_water(camera, tank.basin.snapshot(0.0, ("z", "z_x", "z_y")), tank.sea.reach)
    known = np.isfinite(seen.z)
    assert 0.5 < known.mean() < 0.8  # the rest is sky, or beyond the waves
    row, column = np.nonzero(known)
    X, Y = camera.project(seen.x[known], seen.y[known], seen.z[known])
    assert np.hypot(X - column, Y - row).max() < 1e-6
    off = np.abs(tank.basin.snapshot(0.0)(seen.x[known], seen.y[known])[0] - seen.z[known])
    assert np.quantile(off, 0.995) < 1e-4  # the rest are edges of hidden water


def test_the_horizon_is_where_the_dip_puts_it(tank):
    image, camera = tank.draw("left", 0, None).astype(float), tank.rig["left"]
    smooth = ndimage.gaussian_filter(image, 1.0)
    for column in (20, 100, 180):
        row = int(np.argmax(np.abs(np.diff(smooth[:20, column]))))
        a, b = camera.tangents(float(column), row + 0.5)
        ray = np.array([a, b, 1.0]) @ camera.R
        down = -np.degrees(np.arcsin(ray[2] / np.linalg.norm(ray)))
        assert down == pytest.approx(np.degrees(texture.horizon_dip(12.0)), abs=0.25)


def test_foam_is_carried_by_the_water(tank):
    drift = tank._drift_since_start(2)
    x, y = np.array([0.0, 4.0]), np.array([22.0, 25.0])
    first = x + drift[0].ev(y, x), y + drift[1].ev(y, x)
    from wavefield.tank.beads import carry

    there = carry(tank.basin, *first, tank.time(0), tank.time(2))
    assert np.hypot(there[0] - x, there[1] - y).max() < 2e-3
    assert np.hypot(first[0] - x, first[1] - y).min() > 1e-2
