"""Free and bound waves on second-order seas, whose bound waves are known exactly."""

import dataclasses

import numpy as np
import pytest
import xarray as xr
from independent_seas import forced_sea, sharma_dean
from waves_cases import second_order_sea

import wavefield.waves as wv
from wavefield.errors import CubeError
from wavefield.tank.sea import Sea
from wavefield.waves.nonlinear.forced_waves import forced_elevation


def fields(sea: Sea, steps, ny, nx, dx):
    t, y, x = np.arange(steps) * 0.05, np.arange(ny) * dx, np.arange(nx) * dx
    z = np.stack([sea.on_grid(x, y, now, ("z",))["z"] for now in t]).astype("f4")
    return xr.DataArray(z, {"time": t, "y": y, "x": x}, ("time", "y", "x"), attrs={"units": "m"})


@pytest.fixture(scope="module", params=[(0.0, 0.0), (0.1, 0.05)])
def sea(request):
    """Whole elevation, that of the free waves, and the current."""
    made = second_order_sea(seed=3, n=90, current=request.param)
    shape = 288, 48, 60, 0.03
    return fields(made, *shape), fields(dataclasses.replace(made, bound=0), *shape), request.param


def bound_part(whole, free):
    return (whole - free).assign_attrs(whole.attrs)


def test_the_fraction_of_bound_waves_is_that_of_the_second_order_sea(sea):
    whole, free, current = sea
    S = wv.spectrum(whole, segment=192)
    true = float(wv.spectrum(bound_part(whole, free), segment=192).E[2:].sum() / S.E[2:].sum())
    found = wv.free_and_bound(S.E, 0.7, current=current, dof=float(S.dof))
    assert float(found.bound_fraction) == pytest.approx(true, rel=0.05)
    assert abs(float(found.bound_fraction) - true) < 2 * float(found.bound_fraction_std)
    assert float(found.harmonic_fraction) > 0.5 * true
    step = float(S.omega[1])
    total = float((found.E_free + found.E_bound).sum()) * step
    assert total == pytest.approx(float(wv.total(S.E[2:])), rel=0.002)
    # noise that is white in time is not taken for bound waves
    rng = np.random.default_rng(1)
    noisy = whole + 0.0003 * rng.standard_normal(whole.shape, dtype="f4")
    S = wv.spectrum(noisy.assign_attrs(whole.attrs), segment=192)
    again = wv.free_and_bound(S.E, 0.7, current=current, dof=float(S.dof))
    assert float(again.bound_fraction) == pytest.approx(true, rel=0.07)
    assert float(again.noise_fraction) > 3e-4


def test_a_linear_sea_has_no_bound_waves(sea):
    _, free, current = sea
    S = wv.spectrum(free, segment=192)
    found = wv.free_and_bound(S.E, 0.7, current=current, dof=float(S.dof))
    assert float(found.bound_fraction) < 2e-4
    assert float(found.bound_fraction) < 2 * float(found.bound_fraction_std)


def test_filtered_fields_are_the_free_and_the_bound_waves(sea):
    whole, free, current = sea
    split = wv.free_and_bound(wv.spectrum(whole, segment=192).E, 0.7, current=current)
    found = wv.free_and_bound_fields(whole.to_dataset(name="z"), split, segment=96)
    inside = np.isfinite(found.z_free)
    assert float(inside.mean()) > 0.2
    true = bound_part(whole, free)
    assert float(((found.z_free - free).where(inside) ** 2).mean()) < 0.3 * float(
        (true.where(inside) ** 2).mean()
    )
    assert float(xr.corr(found.z_bound, true.where(inside))) > 0.85
    np.testing.assert_allclose(
        (found.z_free + found.z_bound).where(inside, 0), whole.where(inside, 0), atol=1e-6
    )


@pytest.mark.parametrize(("depth", "sign"), [(0.12, 1), (0.12, -1), (0.7, 1), (50.0, 1), (50.0, -1)])
def test_forced_waves_are_those_of_sharma_and_dean(depth, sign):
    rng = np.random.default_rng(4)
    k, angle = rng.uniform(4, 20, 12), rng.uniform(-np.pi, np.pi, 12)
    x, y, sigma = k * np.cos(angle), k * np.sin(angle), np.sqrt(9.81 * k * np.tanh(k * depth))
    i, j = np.triu_indices(k.size, 1)
    found = forced_elevation((x[i], y[i], sigma[i]), (x[j], y[j], sigma[j]), sign, depth, 0.0)
    expected = sharma_dean(x, y, depth, sign)[i, j] / 2
    there = found != 0
    assert there.mean() > 0.7
    np.testing.assert_allclose(found[there], expected[there], rtol=2e-3, atol=2e-3 * np.abs(expected).max())


@pytest.mark.parametrize(("seed", "depth", "current"), [(5, 0.2, (0.0, 0.0)), (8, 0.35, (0.05, 0.0))])
def test_bound_waves_of_a_small_window_in_shallow_water(seed, depth, current):
    free, forced = forced_sea(seed, depth, current, side=1.4)
    rng = np.random.default_rng(seed)
    noise = 1e-4 * rng.standard_normal(free.shape, dtype="f4")
    S, true, linear = (
        wv.spectrum(z.assign_attrs(units="m"), segment=120)
        for z in (free + forced + noise, forced, free + noise)
    )
    share = float(
        true.E[2:].sum() / wv.spectrum((free + forced).assign_attrs(units="m"), segment=120).E[2:].sum()
    )
    split = {"gamma": 0.0, "current": current}
    found = wv.free_and_bound(S.E, depth, dof=float(S.dof), **split)
    assert float(found.bound_fraction) == pytest.approx(share, rel=0.15)
    assert abs(float(found.bound_fraction) - share) < 2 * float(found.bound_fraction_std)
    nothing = wv.free_and_bound(linear.E, depth, dof=float(S.dof), **split)
    assert abs(float(nothing.bound_fraction)) < 2 * float(nothing.bound_fraction_std)


def test_a_window_that_cannot_part_bound_from_free_waves_is_refused():
    free, forced = forced_sea(7, 0.12, (0.0, 0.0), side=1.0)
    S = wv.spectrum((free + forced).assign_attrs(units="m"), segment=120)
    with pytest.raises(CubeError, match="choose a larger area"):
        wv.free_and_bound(S.E, 0.12, gamma=0.0)
