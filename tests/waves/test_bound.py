"""Free and bound waves on second-order seas, whose bound waves are known exactly."""

import dataclasses

import numpy as np
import pytest
import xarray as xr
from waves_cases import second_order_sea

import wavefield.waves as wv
from wavefield.tank.sea import Sea


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
