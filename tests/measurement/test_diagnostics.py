import numpy as np
import pytest
from measurement_cases import PIXEL

from wavefield.measurement import GridGeometry, Settings
from wavefield.measurement.diagnostics import diagnose


@pytest.fixture(scope="module")
def diagnosis(series, geometry, model):
    return diagnose({name: images[1:3] for name, images in series.frames.items()}, geometry, model)


def test_every_pair_gives_the_same_surface(series, diagnosis):
    assert set(diagnosis.z) == {("cam3", "cam1"), ("cam3", "cam2"), ("cam1", "cam2")}
    differences = [values for quantity, _, _, values in diagnosis.errors() if quantity == "z"]
    assert len(differences) == 3
    for values in differences:
        miss = values[series.inside]
        assert np.isfinite(miss).mean() > 0.8
        assert np.sqrt(np.nanmean(miss**2)) < 0.2 * PIXEL


def test_two_cameras_have_no_second_opinion(series):
    geometry = GridGeometry(series.rig, series.grid, Settings(pairs=(("cam3", "cam1"),)))
    result = diagnose({name: images[1:3] for name, images in series.frames.items()}, geometry)
    assert list(result.z) == [("cam3", "cam1")]
    assert not result.recombined
