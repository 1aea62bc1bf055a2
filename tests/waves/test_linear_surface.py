"""Bound waves are removed from an elevation: second-order seas and exact waves whose linear part is known."""

import numpy as np
import pytest
import xarray as xr
from exact_waves import SteadyWave
from independent_seas import forced_sea

import wavefield as wf
from wavefield.errors import CubeError

GRAVITY_WAVES = {"surface_tension_over_density": 1e-12}


def second_order_sea(seed, depths=(0.2, 0.4, 5.0)):
    rng = np.random.default_rng([seed, 5])
    speed, towards, scale = rng.uniform(0, 0.25), rng.uniform(-np.pi, np.pi), rng.uniform(0.4, 1.6)
    depth, current = float(rng.choice(depths)), (speed * np.cos(towards), speed * np.sin(towards))
    free, forced = forced_sea(seed, depth, current, rng.uniform(1.8, 2.4), steps=160)
    free, forced = scale * free, scale**2 * forced
    z = (free + forced).assign_attrs(units="m")
    return xr.Dataset({"z": z}, attrs=GRAVITY_WAVES | {"water_depth": depth}), free, current


def errors_of(seed):
    """Errors over standard uncertainties, by quantity."""
    cube, free, current = second_order_sea(seed)
    found = wf.linear_surface(cube, current=current)
    return {"z": (found.z_linear - free).values / float(found.linear_std)}


def test_the_linear_part_of_second_order_seas_is_found_within_its_uncertainty():
    within = []
    for seed in range(200, 206):
        cube, free, current = second_order_sea(seed)
        found = wf.linear_surface(cube, current=current)
        error = (found.z_linear - free).values
        there = np.isfinite(error)
        bound = (cube.z - free).values[there]
        assert error[there].std() < 0.45 * bound.std(), seed
        within.append((abs(error[there]) < float(found.linear_std)).mean())
        assert there.any(axis=(1, 2)).mean() > 0.7
        np.testing.assert_allclose(
            (found.z_linear + found.z_bound).values[there], cube.z.values[there], atol=1e-7
        )
    assert 0.55 < np.mean(within) < 0.85


@pytest.mark.parametrize(("steepness", "left"), [(0.1, 0.1), (0.2, 0.2), (0.3, 0.3)])
@pytest.mark.parametrize("current", [(0.0, 0.0), (0.15, 0.1)])
def test_the_second_harmonic_of_exact_waves_goes(steepness, left, current):
    wave = SteadyWave(steepness, 0.5, 0.4, current)
    t, y, x = np.arange(128) * 0.05, np.arange(50) * 0.02, np.arange(80) * 0.02
    z = wave.fields(t, y, x)["z"]
    cube = xr.Dataset({"z": (("time", "y", "x"), z, {"units": "m"})}, {"time": t, "y": y, "x": x})
    found = wf.linear_surface(cube.assign_attrs(GRAVITY_WAVES), current=current)
    there = np.isfinite(found.z_linear.values)
    heading = np.array([np.cos(0.4), np.sin(0.4)])
    place = heading[0] * x + heading[1] * y[:, None]
    phase = 4 * np.pi * (place - (wave.speed + heading @ current) * t[:, None, None])[there]
    terms = [f(n * phase) for n in (1, 2, 3) for f in (np.cos, np.sin)]

    def harmonics(values):
        fitted = np.linalg.lstsq(np.column_stack([*terms, np.ones(phase.size)]), values[there], rcond=None)[0]
        return np.hypot(fitted[:6:2], fitted[1:6:2])

    before, after = harmonics(z), harmonics(found.z_linear.values)
    assert after[1] < left * before[1]
    assert after[0] == pytest.approx(before[0], rel=0.02)


def test_shallow_steep_or_missing_waves_are_refused():
    shallow, _, current = second_order_sea(101, depths=(0.05,))
    with pytest.raises(CubeError, match="second-order theory does not hold"):
        wf.linear_surface(shallow, current=current)
    sea, _, _ = second_order_sea(1)
    steep = SteadyWave(0.4, 0.5).fields(sea.time.values, sea.y.values, sea.x.values)["z"]
    for cube, words in (
        (sea.assign(z=sea.z.copy(data=steep)), "does not hold"),
        (sea.isel(time=slice(0, 16)), "longer than two mean periods"),
        (sea.isel(x=slice(0, 16)), "bound waves need 1.5 of them"),
        (sea * 0, "no waves"),
        (sea.rename(z="w"), "no 'z'"),
    ):
        with pytest.raises(CubeError, match=words):
            wf.linear_surface(cube)
