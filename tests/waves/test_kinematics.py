import dask
import numpy as np
import pytest
import xarray as xr
from waves_cases import axes, cube, linear_cube, random_waves, relation

import wavefield.waves as wv
from wavefield.waves.cross import cross_spectra
from wavefield.waves.gains import elevation_from_w
from wavefield.waves.record import whole_record


def displaced(waves, now, dt, gx, gy, rounds=8):
    """Ends of the displacements over dt whose middles are at the nodes."""
    x0, y0 = gx, gy
    for _ in range(rounds):
        x1, y1 = waves.move(x0, y0, now - dt / 2, now + dt / 2, 4)
        x0, y0 = gx - (x1 - x0) / 2, gy - (y1 - y0) / 2
    return x0, y0, *waves.move(x0, y0, now - dt / 2, now + dt / 2, 4)


def measured(waves, t, y, x, dt):
    """Fields at mid-times t as measured: of the water whose path has its middle at each node."""
    start, end = (waves.on_grid(t + i * dt / 2, y, x, "z")["z"] for i in (-1, 1))
    moved = []
    for now in t:
        x0, y0, x1, y1 = displaced(waves, now, dt, *np.meshgrid(x, y))
        z0, z1 = waves.at(x0, y0, now - dt / 2)[0], waves.at(x1, y1, now + dt / 2)[0]
        moved.append((x1 - x0, y1 - y0, z1 - z0))
    u, v, w = np.array(moved).swapaxes(0, 1) / dt
    return waves.on_grid(t, y, x, "z") | {"z_t": (end - start) / dt, "u": u, "v": v, "w": w}


def test_the_residual_of_displacements_of_an_exact_sea_is_small():
    waves = random_waves(seed=5, n=150, lowest=1.0, highest=5.0, sigma=0.015)
    t, y, x = axes(3, 14, 16, 0.05, 0.01)
    residual, nonlinear = [], []
    for later in np.arange(5) * 3.7:
        out = wv.kinematics(cube(measured(waves, t + later, y, x, 0.05), t, y, x, "f8"), (0.0, 0.0))
        out = out.isel(y=slice(3, -3), x=slice(3, -3))
        residual.append(float((out.residual**2).mean()))
        nonlinear.append(float((out.nonlinear**2).mean()))
    assert np.sqrt(np.mean(residual) / np.mean(nonlinear)) < 0.18


def test_vorticity_and_divergence_of_a_known_flow():
    t, y, x = axes(3, 20, 24, 0.05, 0.02)
    gy, gx = np.meshgrid(y, x, indexing="ij")
    flow = {"u": 0.3 * gx - 2.0 * gy, "v": 1.0 * gx + 0.5 * gy}
    fields = {n: np.broadcast_to(flow.get(n, 0 * gx), (3, 20, 24)) for n in ("z", "z_t", "u", "v", "w")}
    out = wv.kinematics(cube(fields, t, y, x, "f8"))
    np.testing.assert_allclose(out.vorticity, 3.0, rtol=1e-9)
    np.testing.assert_allclose(out.divergence, 0.8, rtol=1e-9)


def test_a_lazy_cube_gives_lazy_kinematics():
    made = linear_cube(random_waves(n=20), 4, 22, 26, dtype="f8")
    out = wv.kinematics(made.chunk({"time": 2, "y": 20}))
    assert dask.is_dask_collection(out)
    xr.testing.assert_allclose(out.compute(), wv.kinematics(made), rtol=1e-12)


def test_averaged_elevation_loses_cos_squared_and_integrated_w_gives_it_back():
    sea = linear_cube(random_waves(n=300, highest=5.0, power=2), 1026, 24, 32, dx=0.03, dtype="f8")
    record = whole_record(sea)
    ring = cross_spectra(sea, ("z", "w"), segment=256, record=record)
    mean = (sea.z + sea.z.shift(time=-1)).isel(time=slice(0, -1)) / 2
    averaged = wv.komega(mean.assign_attrs(units="m"), segment=256)
    E_z, E_w = (ring.E.sel(quantity=name, drop=True).sum("k") for name in ("z", "w"))
    E_mean = averaged.E.sum("k")
    band = (E_z.frequency > 1.3) & (E_z.frequency < 4.7)
    E_mean = E_mean.assign_coords(omega=E_z.omega)
    gain = (E_mean / E_z / np.cos(E_z.omega * 0.05 / 2) ** 2)[band]
    back = (E_w * elevation_from_w(E_w.omega, 0.05) / E_z)[band]
    # single lines apart: a window mixes them, and w weighs each wave by its own frequency
    for ratio, line in ((gain, 0.02), (back, 0.04)):
        assert np.abs(ratio.mean() - 1) < 0.002
        assert np.abs(ratio - 1).max() < line
        quarters = [
            float(np.average(r, weights=e)) for r, e in zip(np.split(ratio, 4), np.split(E_z[band], 4))
        ]
        np.testing.assert_allclose(quarters, 1, atol=0.005)


def test_elevation_beside_the_mean_flow_goes_to_frame_time_on_a_current():
    """Free waves, z from six frames that move with the current: E_z is that of the sea at the nodes."""
    rng, current = np.random.default_rng(7), (0.5, -0.3)
    dt, steps, (_, y, x) = 0.05, 192, axes(2, 24, 30, 0.05, 0.02)
    k, angle = rng.uniform(25.0, 90.0, 40), rng.uniform(0, 2 * np.pi, 40)
    kx, ky, a = k * np.cos(angle), k * np.sin(angle), 1e-3 * np.exp(2j * np.pi * rng.random(40))
    carried = kx * current[0] + ky * current[1]

    def height(t, shift):
        turned = np.exp(-1j * np.outer(t, relation(k, 50.0) + carried)) * a * np.exp(1j * carried * shift)
        return np.einsum(
            "tn,yn,xn->tyx", turned, np.exp(1j * np.outer(y, ky)), np.exp(1j * np.outer(x, kx))
        ).real

    t = (np.arange(steps) + 0.5) * dt
    z = sum(
        weight * height(t + n * dt, n * dt)
        for weight, n in zip(np.array([3, -25, 150, 150, -25, 3]) / 256, np.arange(-2.5, 3))
    )
    none = np.zeros_like(z)
    made = cube({"z": z, "z_t": none, "u": none, "v": none, "w": none}, t, y, x, "f8", frame_rate=20.0)
    made = made.assign_coords(path_frames=np.uint8(4))
    exact = wv.komega(cube({"z": height(t - dt / 2, 0.0)}, t, y, x, "f8").z, segment=64).E
    found = cross_spectra(made, ("z",), segment=64).E.sel(quantity="z")
    assert float(found.sum() / exact.sum()) == pytest.approx(1.0, abs=0.01)
    # left as it is, it lacks the short waves
    raw = wv.komega(made.z, segment=64).E
    assert float(raw.sum() / exact.sum()) < 0.98
