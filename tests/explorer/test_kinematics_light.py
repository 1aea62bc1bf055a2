"""The light for the kinematics: fields that continue each other are good, others are not."""

import numpy as np
import pytest

from wavefield.explorer.lights import step_lights, summarize_step
from wavefield.variables import Quality

X, Y = np.meshgrid(np.arange(40) * 0.01, np.arange(30) * 0.01)
RATE = 20.0
PHASE = 30.0 * X + 10.0 * Y


def fields(factor=1.0, std=2e-3):
    """One step of a wave, with w too large by a factor."""
    k, amplitude = float(np.hypot(30.0, 10.0)), 4e-3
    omega = np.sqrt(9.81 * k)
    z, w = amplitude * np.cos(PHASE), factor * amplitude * omega * np.sin(PHASE)
    u, v = (amplitude * omega * part / k * np.cos(PHASE) for part in (30.0, 10.0))
    z_x, z_y = (-amplitude * part * np.sin(PHASE) for part in (30.0, 10.0))
    z_t = amplitude * omega * np.sin(PHASE) - u * z_x - v * z_y
    noise = np.random.default_rng(1).normal(0, std, X.shape)
    out = {"z": z, "u": u, "v": v, "w": w + noise, "z_t": z_t, "eps_piv": np.full(X.shape, 0.02)}
    out |= {f"{name}_std": np.full(X.shape, std) for name in ("u", "v", "w")}
    out["z_std"] = np.full(X.shape, 0.5 * std / RATE)
    return out | {"quality": np.full(X.shape, int(Quality.MEASURED), np.uint16)}


@pytest.mark.parametrize(("factor", "state"), [(1.0, "good"), (1.07, "doubtful"), (1.4, "bad")])
def test_water_that_does_not_move_with_its_surface_has_a_light(factor, state):
    lights = {
        one.name: one for one in step_lights(summarize_step(fields(factor), X, Y, (-0.05, 0.05), RATE), None)
    }
    assert lights["kinematics"].state == state, lights["kinematics"].words


def test_a_step_of_which_nothing_is_measured_has_no_verdict_on_its_kinematics():
    nothing = fields() | {"z": np.full(X.shape, np.nan)}
    lights = {one.name: one for one in step_lights(summarize_step(nothing, X, Y, (-0.05, 0.05), RATE), None)}
    assert lights["kinematics"].state == "unknown"
