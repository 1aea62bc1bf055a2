from types import SimpleNamespace

import numpy as np
import pytest
from measurement_cases import RATE

from wavefield.grid import Grid
from wavefield.measurement import GridGeometry, measure
from wavefield.measurement.error_budget import WaveRings, changed_waves, lost_by_elevation
from wavefield.tank import Scene, Tank
from wavefield.variables import Quality

TIMES = np.arange(6) - 2.5
LENGTHS = (0.7, 0.4, 0.2, 0.13, 0.1)


def sea(rate, t, waves):
    x, y = np.meshgrid(np.arange(100) * 0.01, np.arange(80) * 0.01)
    z = np.zeros(x.shape)
    for length, height, angle, shift in waves:
        k = 2 * np.pi / length
        omega = np.sqrt(9.81 * k) / rate  # per frame
        phase = k * (np.cos(angle) * x + np.sin(angle) * y) - omega * t + shift
        z += height * np.cos(phase)
    return z


def rings(rate, waves):
    """The same waves as rings."""
    k = np.array([2 * np.pi / length for length, *_ in waves])
    variance = np.array([0.5 * height**2 for _, height, *_ in waves])
    return WaveRings(k, variance, np.sqrt(9.81 * k) / rate)


@pytest.mark.parametrize("rate", [10.0, 20.0])
@pytest.mark.parametrize("jitter", [0.0, 0.1])
def test_what_frames_cannot_follow_is_foreseen(rate, jitter):
    rng = np.random.default_rng(3)
    waves = [(length, 0.002 * length, *rng.uniform(0, 6, 2)) for length in LENGTHS]
    times = TIMES + jitter * rng.uniform(-1, 1, 6)
    polynomial = np.linalg.solve(np.vander(times, increasing=True).T, np.eye(6)[0])
    parabola = np.array([0, 0, *np.linalg.solve(np.vander(times[2:5], increasing=True).T, np.eye(3)[0]), 0])
    lost = {6: [], 3: []}
    for t in np.arange(8) * 2.3:
        z = np.array([sea(rate, t + s, waves) for s in times])
        for frames, weights in ((6, polynomial), (3, parabola)):
            lost[frames].append(np.mean((np.tensordot(weights, z, 1) - sea(rate, t, waves)) ** 2))
    for frames, squares in lost.items():
        stated = lost_by_elevation(rings(rate, waves), frames, times)
        assert stated == pytest.approx(np.mean(squares), rel=0.3)


def test_waves_that_start_within_the_frames_are_stated_and_steady_ones_are_not():
    waves, noise = rings(20.0, [(0.3, 0.01, 0, 0), (0.12, 0.002, 0, 0)]), 1e-10
    now = np.linspace(0, 30, 400)[:, None]

    def z(t, height):
        return sum(
            height(t) * np.sqrt(2 * variance) * np.cos(phase * (now + t) + n)
            for n, (_, variance, phase) in enumerate(zip(*waves))
        )

    def stated(height):
        frames = z(TIMES, height)
        six, four = (frames @ np.array(w) for w in ((3, -25, 150, 150, -25, 3), (0, -1, 9, 9, -1, 0)))
        departure = float(np.mean(np.square(six / 256 - four / 16)))
        surface = SimpleNamespace(noise=np.full((1, 1), noise))
        estimate = SimpleNamespace(mid_time=SimpleNamespace(departure=departure), nearest=(surface, surface))
        error = six / 256 - z(np.zeros(1), height)[:, 0]
        return changed_waves(estimate, waves, TIMES), float(np.sqrt(np.mean(np.square(error))))

    assert stated(np.ones_like)[0] == 0.0
    for start in (-4.0, -2.5, 0.0, 0.5):  # over 0.25 s

        def height(t, start=start):
            part = np.clip((t - start) / 5, 0, 1)
            return part**2 * (3 - 2 * part)

        change, error = stated(height)
        std = np.sqrt(change + lost_by_elevation(waves, 6, TIMES) + noise)
        assert error < 5 * std
        assert std < 10 * max(error, np.sqrt(noise))


def test_the_stated_uncertainty_is_the_sum_of_the_terms(series, geometry, model):
    found = measure(series.block(), geometry, RATE, model, terms=True)
    terms = found.pop("uncertainty_terms")[0]
    inside = series.inside
    for n, name in enumerate("zuvw"):
        scale = 1.0 if name == "z" else RATE
        total = scale * np.sqrt(np.square(terms[:, n]).sum(axis=0))
        np.testing.assert_allclose(total[inside], found[f"{name}_std"][0][inside], rtol=1e-5)
    assert (terms[0][:, inside].mean(axis=1) > terms[2][:, inside].mean(axis=1)).all(), (
        "noise is more than what frames leave out here"
    )


@pytest.mark.slow
def test_uncertainties_hold_for_short_steep_waves():
    sea = {"kind": "random", "rms": 0.0009, "spectrum": {"kind": "power", "peak": 1.0, "exponent": 3.0}}
    sea |= {"shortest": 0.06, "longest": 0.09, "period": 1.0}
    grid = {"x": (-0.2, 0.2), "y": (-0.15, 0.15), "step": 0.01}
    scene = Scene.load("demo").with_(seed=3, rig={"crop": 0.26}, frames=6, sea=sea, grid=grid)
    tank = Tank(scene)
    images = {name: [tank.render(k)[name] for k in range(6)] for name in tank.rig}
    cube = measure(images, GridGeometry(tank.rig, Grid(**grid)), scene.frame_rate)
    truth = vars(tank.truth(2))
    measured = (cube["quality"][0] & Quality.MEASURED) > 0
    for name in "zuvw":
        ratio = np.abs(cube[name][0] - truth[name])[measured] / cube[f"{name}_std"][0][measured]
        assert np.mean(ratio < 1) > 0.5, name
        assert np.mean(ratio > 5) < 0.01, name
