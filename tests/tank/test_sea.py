"""The sea obeys the kinematic condition exactly, the dispersion relation, and the Stokes drift."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wavefield.tank import Scene, Sea
from wavefield.tank.scene_parts import PowerLaw, RandomSea
from wavefield.water import GAMMA, dispersion

DEEP = 10.0


def random_sea(seed=0, rms=0.014, peak=1.2, bound=0, **settings):
    model = RandomSea(
        kind="random",
        rms=rms,
        spectrum={"kind": "power", "peak": peak},
        order=2 if bound else 1,
        interacting=bound or 300,
        **{"shortest": 0.08, "period": 4.0, "depth": 0.7, "surface_tension": 7.2e-5, **settings},
    )
    return model.build(seed)


def numerical_rate(sea, name, x, y, t, h=1e-3):
    """Return the time derivative by a fourth-order difference."""
    f = [sea.at(x, y, t + i * h, (name,))[name] for i in (-2, -1, 1, 2)]
    return (f[0] - 8 * f[1] + 8 * f[2] - f[3]) / (12 * h)


@pytest.mark.parametrize("bound", [0, 40])
def test_vertical_velocity_keeps_the_water_on_the_surface(bound, rng):
    sea = random_sea(bound=bound, current=(0.05, -0.02))
    x, y = rng.uniform(-1, 1, (2, 200))
    f = sea.at(x, y, 0.7)
    assert np.abs(f["w"] - (f["z_t"] + f["u"] * f["z_x"] + f["v"] * f["z_y"])).max() < 1e-12
    # the derivatives are those of z itself
    assert numerical_rate(sea, "z", x, y, 0.7) == pytest.approx(f["z_t"], abs=1e-8)
    h = 1e-4
    z_x = (sea.at(x + h, y, 0.7, ("z",))["z"] - sea.at(x - h, y, 0.7, ("z",))["z"]) / (2 * h)
    assert z_x == pytest.approx(f["z_x"], abs=2e-5)


@given(
    wavelength=st.floats(0.03, 3.0),
    angle=st.floats(0, 2 * np.pi),
    depth=st.floats(0.1, 5.0),
)
def test_single_wave_obeys_dispersion_with_current_and_moves_with_its_vector(wavelength, angle, depth):
    k = 2 * np.pi / wavelength
    kx, ky = k * np.cos(angle), k * np.sin(angle)
    current = (0.04, -0.02)
    sea = Sea([kx], [ky], [0.01], depth=depth, current=current)
    omega = np.sqrt((9.81 * k + GAMMA * k**3) * np.tanh(k * depth)) + kx * current[0] + ky * current[1]
    x, y, t = 0.3, -0.2, 1.7
    expected = 0.01 * np.cos(kx * x + ky * y - omega * t)
    assert sea.at(x, y, t, ("z",))["z"] == pytest.approx(expected, abs=1e-9)


def test_second_order_solution_satisfies_the_dynamic_condition_in_finite_depth():
    """The residual of the dynamic condition decreases as the cube of the amplitude."""
    # no force acts along the surface: (Du/Dt, Dv/Dt) + (g + Dw/Dt) grad z = gamma grad(curvature)
    depth, gamma, start, h = 0.3, 7.2e-5, 0.4, 1e-3
    x, y = np.random.default_rng(0).uniform(-1, 1, (2, 50))

    def velocity_of_particles(sea, time):
        px, py, steps = x, y, 4
        step = (time - start) / steps
        for now in start + step * np.arange(steps):
            first = sea.at(px, py, now, ("u", "v"))
            half = sea.at(px + step / 2 * first["u"], py + step / 2 * first["v"], now + step / 2, ("u", "v"))
            px, py = px + step * half["u"], py + step * half["v"]
        f = sea.at(px, py, time)
        return np.array([f["u"], f["v"], f["w"]])

    def curvature(sea, px, py):
        shifts = [(0, 0), (h, 0), (-h, 0), (0, h), (0, -h)]
        z = [sea.at(px + a, py + b, start, ("z",))["z"] for a, b in shifts]
        return (sum(z[1:]) - 4 * z[0]) / h**2

    def residual(scale, bound):
        kx, ky = np.array([5.0, 3.0]), np.array([0.0, 4.5])
        sea = Sea(kx, ky, scale * np.array([0.01, 0.008]), depth, gamma, bound=bound)
        du, dv, dw = (velocity_of_particles(sea, start + h) - velocity_of_particles(sea, start - h)) / (2 * h)
        f = sea.at(x, y, start)
        tension_x = gamma * (curvature(sea, x + h, y) - curvature(sea, x - h, y)) / (2 * h)
        tension_y = gamma * (curvature(sea, x, y + h) - curvature(sea, x, y - h)) / (2 * h)
        along_x = du + f["z_x"] * (9.81 + dw) - tension_x
        along_y = dv + f["z_y"] * (9.81 + dw) - tension_y
        return np.sqrt(np.mean(along_x**2 + along_y**2))

    # a linear sea is wrong at second order of the amplitude, this one at third
    assert residual(1.0, 0) / residual(0.5, 0) == pytest.approx(4, rel=0.1)
    assert residual(1.0, 2) / residual(0.5, 2) == pytest.approx(8, rel=0.1)


def test_random_sea_has_its_rms_and_its_spectrum():
    sea = random_sea(seed=3, period=6.0)
    assert np.sqrt(0.5 * np.sum(np.abs(sea.amplitude) ** 2)) == pytest.approx(0.014, rel=1e-12)
    x = np.arange(0, 6, 0.02)
    z = sea.on_grid(x, x, 0.0, ("z",))["z"]
    assert abs(z.mean()) < 1e-9  # whole periods
    # energy above and below 2 Hz as the shape has it, mean over seeds
    k_two = 16.0
    shares = []
    for seed in range(8):
        s = random_sea(seed=seed, period=6.0)
        power = np.abs(s.amplitude) ** 2
        shares.append(power[s.k > k_two].sum() / power.sum())
    f = np.linspace(0.35, dispersion(2 * np.pi / 0.08, 0.7) / (2 * np.pi), 4000)
    density = PowerLaw(kind="power", peak=1.2)(f)
    above = f > dispersion(k_two, 0.7) / (2 * np.pi)
    assert np.mean(shares) == pytest.approx(density[above].sum() / density.sum(), rel=0.15)


def test_spreading_sends_the_waves_in_the_main_direction():
    sea = random_sea(spread=20.0)
    power = np.abs(sea.amplitude) ** 2
    assert np.sum(power * sea.kx / sea.k) / power.sum() > 0.9
    even = random_sea(spread=0.0)
    power = np.abs(even.amplitude) ** 2
    assert abs(np.sum(power * even.kx / even.k)) / power.sum() < 0.2


def test_added_waves_come_on_top_of_the_sea():
    wave = {"wavelength": 0.2, "amplitude": 0.001, "direction": 90.0, "phase": 30.0}
    scene = Scene.load("demo").with_(sea={"shortest": 0.3})
    plain, more = scene.build_sea(), scene.with_(sea={"added": [wave]}).build_sea()
    x, y = np.array([0.0, 0.1]), np.array([0.02, 0.05])
    k, t = 2 * np.pi / 0.2, 0.3
    expected = 0.001 * np.cos(k * y - dispersion(k, 0.7) * t + np.radians(30.0))
    assert more.at(x, y, t)["z"] - plain.at(x, y, t)["z"] == pytest.approx(expected, abs=1e-9)
