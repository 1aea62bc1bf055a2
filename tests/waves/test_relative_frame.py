"""Nonlinear quantities are relative to the mean current: the linear part U . grad z is not among them."""

import numpy as np
import pytest
from waves_cases import Waves, cube

import wavefield.waves as wv


def linear_sea(current):
    """Exact linear waves of random directions on a uniform current: fields at the nodes."""
    rng = np.random.default_rng(3)
    k, angle = rng.uniform(6, 30, 40), rng.uniform(0, 2 * np.pi, 40)
    a = 0.08 / k * np.sqrt(1 / 40) * np.exp(2j * np.pi * rng.random(40))
    waves = Waves(k * np.cos(angle), k * np.sin(angle), a, 0.5, current)
    t, axis = np.arange(320) / 20, np.arange(40) * 0.03
    fields = waves.on_grid(t, axis, axis, "z", "z_t", "z_x", "z_y", "u", "v")
    z_x, z_y = fields.pop("z_x"), fields.pop("z_y")
    fields["w"] = fields["z_t"] + current[0] * z_x + current[1] * z_y
    fields["u"], fields["v"] = fields["u"] + current[0], fields["v"] + current[1]
    made = cube(fields, t, axis, axis, "f8", water_depth=0.5, frame_rate=20.0)
    return made.assign_coords(path_frames=np.uint8(4))


def test_the_mean_current_and_the_nonlinear_ratio_are_those_of_the_sea():
    current = 0.3 * np.cos(2.0), 0.3 * np.sin(2.0)
    found = wv.analyze(linear_sea(current), segment=64)["kinematics"]
    np.testing.assert_allclose([found.mean_current_x, found.mean_current_y], current, atol=0.005)
    inner = found.to_dataset().sel(k=slice(10, 25))
    assert (inner.low_nonlinear_ratio_k < 1).all()
    assert (inner.high_nonlinear_ratio_k > 1).all()
    still = wv.analyze(linear_sea((0.0, 0.0)), segment=64)["kinematics"]
    assert float(found.nonlinear_fraction) == pytest.approx(float(still.nonlinear_fraction), rel=0.05)
