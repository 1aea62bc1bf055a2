"""Nonlinear quantities are relative to the mean current: the linear part U . grad z is not among them."""

import dask
import numpy as np
import pytest
from independent_seas import LatticeSea
from waves_cases import cube

import wavefield.waves as wv
from wavefield.waves.current import delayed_current

_RATE, _STEPS, _NODES, _STEP = 20.0, 320, 40, 0.03  # Hz, steps, nodes along a side, m
_GRAVITY = 9.81


def linear_sea(seed, speed, angle, depth):
    """Exact linear waves of random directions on a uniform current: fields at the nodes."""
    rng = np.random.default_rng(seed)
    k = rng.uniform(6, 30, 40)
    direction = rng.uniform(0, 2 * np.pi, k.size)
    kx, ky = k * np.cos(direction), k * np.sin(direction)
    sigma = np.sqrt(_GRAVITY * k * np.tanh(k * depth))
    current = speed * np.cos(angle), speed * np.sin(angle)
    amplitude = 0.08 / k * np.sqrt(1 / k.size) * np.exp(2j * np.pi * rng.random(k.size))
    t, axis = np.arange(_STEPS) / _RATE, np.arange(_NODES) * _STEP
    rows, columns = np.exp(1j * np.outer(ky, axis)), np.exp(1j * np.outer(kx, axis))
    omega = sigma + kx * current[0] + ky * current[1]
    turns = np.exp(-1j * np.outer(t, omega))

    def field(factor):
        return np.einsum("tn,ny,nx->tyx", turns * (amplitude * factor), rows, columns, optimize=True).real

    swing = sigma / np.tanh(k * depth)
    fields = {
        "z": field(1),
        "z_t": field(-1j * omega),
        "u": current[0] + field(swing * kx / k),
        "v": current[1] + field(swing * ky / k),
        "w": field(-1j * sigma),
    }
    made = cube(fields, t, axis, axis, "f8", water_depth=depth, frame_rate=_RATE)
    return made.assign_coords(path_frames=np.uint8(4)), current


@pytest.mark.slow
def test_waves_are_not_taken_for_a_current():
    # 0.09 mm/s of them passed for coherence of z_t with u . grad z
    sea = LatticeSea(side=200, shape=(640, 24, 30), current=(0.1, 0.05))
    drawn = [sea.cube(draw, ("z", "u", "v")) for draw in range(2)]
    found = [dask.compute(delayed_current(one, wv.find_record(one)))[0][0] for one in drawn]
    assert np.sqrt(np.mean((np.array(found) - sea.current) ** 2)) < 3e-5


def test_the_stored_mean_current_and_ratio_are_those_of_the_sea():
    sea, current = linear_sea(3, 0.3, 2.0, 0.5)
    found = wv.analyze(sea, segment=64)["kinematics"]
    np.testing.assert_allclose([found.mean_current_x, found.mean_current_y], current, atol=0.005)
    inner = found.to_dataset().sel(k=slice(10, 25))
    assert (inner.low_nonlinear_ratio_k < 1).all()
    assert (inner.high_nonlinear_ratio_k > 1).all()
    still = wv.analyze(linear_sea(3, 0.0, 2.0, 0.5)[0], segment=64)["kinematics"]
    assert float(found.nonlinear_fraction) == pytest.approx(float(still.nonlinear_fraction), rel=0.05)
