import numpy as np
import pytest
from measurement_cases import PIXEL

from wavefield.measurement import GridGeometry, Settings, diagnose


@pytest.fixture(scope="module")
def diagnosis(series, geometry, model):
    return diagnose({name: images[1:3] for name, images in series.frames.items()}, geometry, model, PIXEL)


def test_every_pair_gives_the_same_surface(series, diagnosis):
    assert set(diagnosis.z) == {("cam3", "cam1"), ("cam3", "cam2"), ("cam1", "cam2")}
    for values in diagnosis.difference.values():
        miss = values[series.inside]
        assert np.isfinite(miss).mean() > 0.8
        assert np.sqrt(np.nanmean(miss**2)) < 0.2 * PIXEL


def test_it_reports_how_noisy_the_images_are_and_which_waves_they_keep(diagnosis):
    assert set(diagnosis.noise) == {"z", "dx", "dy", "dz"}
    for name, value in diagnosis.noise.items():
        assert 0.002 < value / PIXEL < 0.2, name
    assert set(diagnosis.widths) == {"cam1", "cam2", "cam3"}
    assert all(0.01 < length < 0.1 for length in diagnosis.carried.values())


def test_the_table_gives_centimetres_and_pixels(diagnosis):
    rows = {row["name"]: row for row in diagnosis.table()}
    everybody = "eps' cam1-cam2-cam3"
    assert {"eps_y cam3-cam1", "sigma_z cam1-cam2", everybody, "z cam1-cam2 recombined - direct"} <= set(rows)
    row = rows["eps_y cam3-cam1"]
    assert row["cm"] == pytest.approx(100 * PIXEL * row["px"])
    assert rows[everybody]["cm"] is None
    assert 0 < rows[everybody]["px"] < 0.2


def test_two_cameras_have_no_second_opinion(series):
    geometry = GridGeometry(series.rig, series.grid, Settings(pairs=(("cam3", "cam1"),)))
    result = diagnose({name: images[1:3] for name, images in series.frames.items()}, geometry)
    assert list(result.z) == [("cam3", "cam1")]
    assert not result.difference
    assert not result.recombined
