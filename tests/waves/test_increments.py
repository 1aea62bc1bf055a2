"""Increments: structure functions and flatness of fields known exactly."""

import numpy as np
import pytest
import xarray as xr
from waves_cases import axes

import wavefield as wf
from wavefield.errors import CubeError


def field(values, dt=0.05, dx=0.02):
    t, y, x = axes(*values.shape, dt, dx)
    return xr.DataArray(values, {"time": t, "y": y, "x": x}, ("time", "y", "x"), attrs={"units": "m"})


@pytest.mark.parametrize("differences", [1, 2])
def test_increments_of_a_wave_are_those_of_a_sine(differences):
    k, omega, a = 2 * np.pi / 0.32, 2 * np.pi / 0.8, 0.01
    t, y, x = axes(640, 16, 96, 0.05, 0.02)
    wave = a * np.cos(k * x - omega * t[:, None, None] + 0 * y[:, None])
    found = wf.structure_functions(field(wave), differences=differences)
    factor = 4 ** (differences - 1) * 2 * a**2
    for name, lag, rate in (("time", found.lag_time, omega), ("x", found.lag_x, k)):
        expected = factor * np.sin(rate * lag / 2) ** (2 * differences)
        got = found[f"structure_{name}"].sel(order=2)
        np.testing.assert_allclose(got, expected, rtol=0.03, atol=0.003 * factor, err_msg=name)
        flat = found[f"flatness_{name}"].where(expected > 0.1 * factor, drop=True)
        np.testing.assert_allclose(flat, 1.5, atol=0.05, err_msg=name)


def test_increments_of_a_gaussian_field_have_flatness_three_within_their_errors():
    rng = np.random.default_rng(4)
    found = wf.structure_functions(field(rng.standard_normal((512, 24, 30))))
    for name in ("time", "x", "y"):
        off = (found[f"flatness_{name}"] - 3) / found[f"flatness_{name}_std"]
        assert float(np.abs(off).max()) < 4, name
        assert float((off**2).mean()) < 4, name
    np.testing.assert_allclose(found.structure_x.sel(order=2), 2, rtol=0.02)


def test_increments_without_blocks_are_refused():
    with pytest.raises(CubeError, match="choose a longer record"):
        wf.structure_functions(field(np.random.default_rng(0).standard_normal((12, 10, 10))))
    with pytest.raises(CubeError, match="choose 1 or 2"):
        wf.structure_functions(field(np.zeros((64, 10, 10))), differences=3)
