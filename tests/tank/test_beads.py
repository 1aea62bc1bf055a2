"""Beads follow the water exactly and fill what the cameras see."""

import numpy as np
import pytest

from wavefield.grid import Grid
from wavefield.tank import Scene, Sea, Tank
from wavefield.tank.beads import carry
from wavefield.tank.sea import Basin
from wavefield.tank.truth import truth

SMALL = {"rig": {"crop": 0.2}, "grid": {"x": (-0.1, 0.1), "y": (-0.1, 0.1), "step": 0.02}}


def small(**parts):
    return Scene.load("demo").with_(**{**SMALL, "sea": {"shortest": 0.12, "period": 2.0}, **parts})


@pytest.fixture(scope="module")
def steep():
    return Tank(small(sea={"rms": 0.018, "shortest": 0.12, "period": 2.0, "order": 2, "interacting": 40}))


def test_quick_reading_is_exact_to_a_millionth(steep, rng):
    x, y = rng.uniform(-0.2, 0.2, (2, 300))
    names = ("z", "z_x", "z_y", "z_t", "u", "v")
    exact = steep.sea.at(x, y, 0.37, names)
    quick = steep.basin.snapshot(0.37, names)(x, y)
    for name, values in zip(names, quick, strict=True):
        assert np.abs(values - exact[name]).max() < 1e-6 * np.abs(exact[name]).max()


def test_path_agrees_with_tiny_steps_and_leads_back(steep, rng):
    x, y = rng.uniform(-0.15, 0.15, (2, 50))
    ax, ay = carry(steep.basin, x, y, 0.0, 0.05)
    bx, by = x, y
    for i in range(80):  # fourth order with a twentieth of the step
        bx, by = carry(steep.basin, bx, by, i * 0.05 / 80, (i + 1) * 0.05 / 80)
    assert np.hypot(ax - bx, ay - by).max() < 2e-7  # metres
    cx, cy = carry(steep.basin, ax, ay, 0.05, 0.0)
    assert np.hypot(cx - x, cy - y).max() < 2e-7


def test_truth_gives_both_rates_and_small_steps_bring_them_together(steep):
    grid = Grid(x=(-0.1, 0.1), y=(-0.05, 0.05), step=0.05)
    long, short = truth(steep.basin, grid, 0.4, 0.05), truth(steep.basin, grid, 0.4, 0.0005)
    assert long.z_t == pytest.approx((long.z_end - long.z_start) / 0.05)
    assert np.abs(long.z_t - long.z_rate).max() > 1e-3
    assert short.z_t == pytest.approx(short.z_rate, abs=1e-5)
    for displacement_, velocity in ((short.dx, short.u), (short.dy, short.v), (short.dz, short.w)):
        assert displacement_ / 0.0005 == pytest.approx(velocity, abs=1e-4)


def test_beads_drift_with_the_current_and_with_the_waves():
    k, a = 8.0, 0.02
    sea = Sea([k], [0.0], [a], depth=10.0, surface_tension=0.0, current=(0.1, 0.0), bound=1)
    period = 2 * np.pi / sea.sigma[0]
    basin = Basin(sea, (-1.0, 3.0), (-0.2, 0.2))
    x, _ = carry(basin, np.zeros(1), np.zeros(1), 0.0, 4 * period)
    stokes = a * a * k * sea.sigma[0]
    assert (x[0] / (4 * period) - 0.1) == pytest.approx(stokes, rel=0.2)


def test_density_is_as_set_and_beads_fill_every_view():
    tank = Tank(small(frames=30))
    for frame in (0, 12):
        beads = tank.population.frame(frame)
        for name, camera in tank.rig.cameras.items():
            visible = camera.sees(beads.x, beads.y, beads.z)
            X, Y = camera.project(beads.x[visible], beads.y[visible], beads.z[visible])
            w, h = camera.size
            counts, *_ = np.histogram2d(X, Y, bins=3, range=[(0, w), (0, h)])
            assert counts.min() > 0.5 * counts.mean(), name
    inside = (np.abs(beads.x) < 0.1) & (np.abs(beads.y) < 0.1)
    assert inside.sum() / 0.04 == pytest.approx(1.1e4, rel=0.2)


def test_holes_have_no_beads_and_clusters_have_more_neighbours():
    bare = Tank(small(surface={"holes": 1, "hole_diameter": 0.08}))
    beads = bare.population.frame(0)
    grid = np.linspace(-0.1, 0.1, 41)
    distance = np.hypot(beads.x[:, None] - np.repeat(grid, 41), beads.y[:, None] - np.tile(grid, 41)).min(
        axis=0
    )
    assert distance.max() > 0.035
    plain, crowded = (Tank(small(surface={"clustered": c})).population.frame(0) for c in (0.0, 0.6))

    def neighbours(b):
        d = np.hypot(b.x[:500, None] - b.x, b.y[:500, None] - b.y)
        return (d < 0.003).sum(axis=1).mean()

    assert neighbours(crowded) > 2 * neighbours(plain)


def test_share_of_beads_visible_in_one_camera_only():
    beads = Tank(small(surface={"one_camera": 0.3})).population.frame(0)
    cameras = (beads.brightness > 0).sum(axis=0)
    assert set(cameras) == {1, 3}
    assert np.mean(cameras == 1) == pytest.approx(0.3, abs=0.03)


def test_long_records_stay_seeded_under_a_current():
    tank = Tank(small(sea={"current": (0.3, 0.1), "shortest": 0.3, "period": 2.0}))
    beads = tank.population.frame(60)
    assert ((beads.x >= tank.x[0]) & (beads.x <= tank.x[1])).all()
    inside = (np.abs(beads.x) < 0.15) & (np.abs(beads.y) < 0.1)
    assert inside.sum() / 0.06 == pytest.approx(1.1e4, rel=0.2)
