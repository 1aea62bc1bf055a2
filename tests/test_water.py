"""The dispersion relation of free waves and what follows from it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wavefield import water
from wavefield.errors import CubeError
from wavefield.series.experiment_parts import WaterSection


@given(st.floats(0.5, 400), st.floats(0.05, 5))
def test_wavenumber_inverts_the_relation(k, depth):
    assert float(water.wavenumber(water.dispersion(k, depth), depth)) == pytest.approx(k, rel=1e-9)


@given(st.floats(0.5, 400), st.sampled_from([0.02, 0.3, 5.0, np.inf]))
def test_the_group_velocity_is_the_slope_of_the_relation(k, depth):
    step = 1e-4 * k
    slope = (water.dispersion(k + step, depth) - water.dispersion(k - step, depth)) / (2 * step)
    assert float(water.group_velocity(k, depth)) == pytest.approx(float(slope), rel=1e-6)


@pytest.mark.parametrize("depth", [0.0, -1.0, np.nan])
def test_a_depth_that_is_none_is_refused(depth):
    with pytest.raises(CubeError, match="depth of the water"):
        water.dispersion(1.0, depth)


def test_the_experiment_states_what_its_water_is():
    assert WaterSection(depth=0.7).attributes() == {"water_depth": 0.7}
    soapy = WaterSection(surface_tension=0.03, density=998.0).attributes()
    assert soapy["surface_tension_over_density"] == pytest.approx(3.006e-5, rel=1e-3)
