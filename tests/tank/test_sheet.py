"""Particles of a simulated light sheet move with its flow, and its truth is exact."""

import numpy as np
import pytest

from wavefield.tank import Scene, Tank


@pytest.fixture(scope="module")
def tank():
    changes = {"rig": {"size": [320, 240]}, "surface": {"height": 0.001, "tilt": [2.0, -1.0]}}
    grid = {"x": (-0.02, 0.02), "y": (-0.015, 0.015), "step": 0.002}
    return Tank(Scene.load("sheet").with_(frames=4, grid=grid, **changes))


def own_frame(tank, beads):
    from wavefield.tank.light_sheet_scene import plane

    axes, origin = plane(tank.scene.surface)
    return axes.T @ (np.stack([beads.x, beads.y, beads.z]) - origin[:, None])


def test_the_flow_has_its_strength_and_no_divergence(tank):
    flow, settings = tank.population.flow, tank.scene.surface
    x, y = np.meshgrid(np.linspace(*tank.x, 200), np.linspace(*tank.y, 160))
    u, v, w = flow(x, y)
    assert np.sqrt(0.5 * np.mean(u**2 + v**2)) == pytest.approx(settings.speed, rel=0.02)
    assert np.std(w) == pytest.approx(settings.speed_across, rel=0.05)
    e = 1e-5
    divergence = flow(x + e, y)[0] - flow(x - e, y)[0] + flow(x, y + e)[1] - flow(x, y - e)[1]
    assert np.abs(divergence / (2 * e)).max() < 1e-4 * settings.speed / 0.005


def test_particles_move_with_the_flow_and_leave_the_light(tank):
    first, second = (tank.population.frame(k) for k in (0, 1))
    a, b = own_frame(tank, first), own_frame(tank, second)
    u, v, w = tank.population.flow(*(0.5 * (a + b))[:2])
    stays = np.all(np.abs(b - a) < [[0.01], [0.01], [5e-4]], axis=0)
    assert stays.mean() > 0.8
    for moved, speed in zip((b - a)[:, stays], (u, v, w), strict=True):
        assert moved * tank.scene.frame_rate == pytest.approx(speed[stays], abs=1.5e-3)
    bright = first.brightness.mean(axis=0) > 1e-2
    assert np.abs(a[2, bright]).max() < tank.scene.surface.thickness
    # as many as before are in the light, others in part
    light = [np.abs(c[2]) < 0.5 * tank.scene.surface.thickness for c in (a, b)]
    assert light[1].sum() == pytest.approx(light[0].sum(), rel=0.05)
    assert (light[0] & ~light[1]).sum() > 0.05 * light[0].sum()


def test_truth_is_that_of_the_flow(tank):
    truth, dt = tank.truth(1), 1.0 / tank.scene.frame_rate
    x, y = np.meshgrid(tank.scene.grid.x_nodes, tank.scene.grid.y_nodes)
    for name, exact in zip("uvw", tank.population.flow(x, y), strict=True):
        np.testing.assert_array_equal(getattr(truth, name), exact)
    assert truth.dx == pytest.approx(truth.u * dt, abs=2e-5)
    assert not truth.z.any()
