"""The first calls of a new user: estimators take what they can, and refuse the rest in a sentence."""

import numpy as np
import pytest
import xarray as xr
from waves_cases import linear_cube, random_waves

import wavefield as wf
from wavefield import waves as wv
from wavefield.errors import WavefieldError
from wavefield.variables import find
from wavefield.waves.spectra import total

FIELD = ("E_k", "E_omega", "komega", "spectrum", "structure_functions")
CUBE = ("coherence", "kinematics", "statistics", "plane_coherence")
MORE = ("crest_statistics", "fit_dispersion", "directions", "phase_average", "analyze")
STILL = (0.0, 0.0)
ESTIMATORS = {name: getattr(wf, name, None) or getattr(wv, name) for name in FIELD + CUBE + MORE}
ARGUMENTS = {
    "directions": {"frequency": [2.0], "current": STILL},
    "phase_average": {"period": 0.6, "phases": 8},
}


@pytest.fixture(scope="module")
def inputs():
    cube = linear_cube(random_waves(7, n=40), 128, 16, 20, dx=0.04)
    return {
        "field": cube.w,
        "cube": cube,
        "no w": cube[["z"]],
        "spectrum": wf.spectrum(cube.w, segment=32),
        "komega": wf.komega(cube.w, segment=32),
        "array": cube.w.values,
        "path": "not/there.zarr",
    }


@pytest.mark.parametrize("kind", ["field", "cube", "no w", "spectrum", "komega", "array", "path"])
@pytest.mark.parametrize("name", ESTIMATORS)
def test_an_estimator_computes_or_states_in_one_sentence_what_it_needs(inputs, name, kind):
    try:
        found = ESTIMATORS[name](inputs[kind], **ARGUMENTS.get(name, {}))
    except WavefieldError as error:
        text = str(error)
        assert 20 < len(text) < 400
        assert "\n" not in text
        computed = False
    else:
        assert isinstance(found, xr.Dataset | xr.DataTree)
        computed = True
    if name in FIELD:
        takes = {"field", "komega"} if name.startswith("E_") else {"field"}
        assert computed == (kind in takes)
    if name == "directions" and kind in ("field", "cube", "spectrum"):
        assert computed
    if kind in ("array", "path"):
        assert not computed


def test_a_variable_and_its_spectrum_keep_the_depth_of_their_cube(inputs):
    z, w = inputs["cube"].z, inputs["cube"].w
    shallow = wf.cube(z, w=w, velocity="instantaneous", depth=0.05)
    spectrum = wf.spectrum(shallow.w)
    by_input = [
        wf.directions(one, [1.5, 2.0], current=STILL) for one in (shallow, shallow.w, spectrum, spectrum.E)
    ]
    for found in by_input[2:]:
        np.testing.assert_array_equal(found.D, by_input[1].D)
    # of a cube the elevation is integrated from w
    np.testing.assert_allclose(by_input[0].D, by_input[1].D, atol=0.05)
    deep = wf.directions(wf.cube(z, w=w, velocity="instantaneous").w, [1.5, 2.0], current=STILL)
    assert not np.allclose(deep.D, by_input[0].D)
    assert wf.komega(shallow.w[:, 2:]).water_depth == 0.05


def test_every_angle_states_its_unit(inputs):
    """Radians, but for the directional spectrum in the convention of oceanographers, which states degrees."""
    found = wf.directions(inputs["cube"], [2.0], current=STILL)
    names = ("theta", "direction", "direction_std", "spread", "spread_std")
    assert {found[n].attrs["units"] for n in names} == {find("ridge_angle", "dispersion").units} == {"rad"}
    assert found["dir"].attrs["units"] == "degree"
    assert found["efth"].attrs["units"] == "m2 s degree-1"


def test_sums_of_the_spectrum_over_k_and_over_omega_hold_the_same_variance(inputs):
    energy = wf.komega(inputs["field"])
    both = wf.E_k(energy), wf.E_omega(energy)
    variances = [float(total(one.E)) for one in both]
    assert variances[0] == pytest.approx(variances[1], rel=1e-9)
    assert all(bool((one.low < 1).all() and (one.high > 1).all()) for one in both)
