import json

import pytest

from wavefield import matching
from wavefield.errors import ExperimentError
from wavefield.measurement import Settings


def test_settings_survive_a_recipe():
    settings = Settings(
        pairs=(("cam3", "cam1"),),
        velocity_cameras=("cam1", "cam2"),
        z_range=(-0.02, 0.03),
        piv=matching.MatchSettings.stereo(),
    )
    assert Settings.from_dict(json.loads(json.dumps(settings.to_dict()))) == settings
    assert Settings.from_dict({}) == Settings()
    assert hash(settings) == hash(Settings.from_dict(settings.to_dict()))


def test_part_of_a_matching_is_enough():
    settings = Settings.from_dict({"piv": {"window": 20.0}})
    assert settings.piv.window == 20.0
    assert settings.piv.smoother_sigma == Settings().piv.smoother_sigma


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"pears": []}, "settings.pears is not a known key; did you mean 'pairs'"),
        ({"pairs": [["cam1", "cam1"]]}, "not a pair"),
        ({"pairs": "cam1"}, "settings.pairs should be a valid tuple, not 'cam1'"),
        ({"velocity_cameras": ["cam1"]}, "at least two"),
        ({"z_range": [0.1, -0.1]}, "lowest elevation comes first"),
        ({"preset": "slow"}, "choose one of floating, sheet, texture, not 'slow'"),
        ({"pixel": 0.0}, "above 0 m"),
        ({"eps_limit": -1.0}, "eps_limit must be 0 or more"),
        ({"piv": {"window": -3.0}}, "window"),
        ({"piv": {"iterations": []}}, "iterations"),
        ({"piv": {"iterations": [3, 0]}}, "iterations"),
        ({"piv": {"smoother_sigma": -1}}, "smoother_sigma"),
        ({"stereo": {"search_x": [5, -5]}}, "search_x"),
        ({"stereo": {"search_x": None}}, "search_x"),
        ({"piv": {"normalization": float("nan")}}, "normalization"),
    ],
)
def test_wrong_settings_are_named(data, message):
    with pytest.raises(ExperimentError, match=message):
        Settings.from_dict(data)
