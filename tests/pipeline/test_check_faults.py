"""Some of the faults and of the sound experiments of `benchmarks.faults`."""

import shutil

import pytest

from benchmarks.faults import FAULTS, SOUND, free_bytes, outcome, write_experiment
from wavefield.pipeline import check

REFUSED = {
    "grid in centimetres": "`grid` is in metres: the cameras see {x: [",
    "grid in inches": "% of the grid in common view",
    "bead_height in millimetres": "bead_height of 0.4 m does not fit below cameras",
    "the first frame of another size": "rig.yaml was made for images of cam1 of 256 x 256 px, but these have",
    "density in g cm-3": "water.density should be greater than or equal to 400",
}
FOUND = {
    "grid of four times the field": "of the grid's nodes",
    "no room on the disk": "Free some space",
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return write_experiment(tmp_path_factory.mktemp("check") / "whole", 300).parent


@pytest.fixture
def lab(whole, tmp_path):
    shutil.copytree(whole, tmp_path / "lab")
    return tmp_path / "lab"


@pytest.mark.parametrize("name", REFUSED)
def test_faults_that_prevent_a_run_are_refused_with_the_remedy(lab, name):
    FAULTS[name](lab)
    status, words = outcome(lab / "experiment.yaml")
    assert status == 1
    assert REFUSED[name] in words


def test_several_faults_at_once_are_all_named(lab, monkeypatch):
    monkeypatch.setattr("wavefield.pipeline.checking.shutil.disk_usage", free_bytes)
    for name in FOUND:
        FAULTS[name](lab)
    status, words = outcome(lab / "experiment.yaml")
    assert status == 3
    for sentence in FOUND.values():
        assert sentence in words


def test_sound_experiments_raise_no_alarm(lab):
    for title, _, change in SOUND:
        if title in ("float images", "a grid wider than what is seen"):
            change(lab)
    status, words = outcome(lab / "experiment.yaml")
    assert status == 0, words


def test_a_record_of_which_one_step_is_tried_has_no_frame_to_compare_clocks_at(tmp_path):
    found = check(write_experiment(tmp_path / "short", 300, frames=3))
    assert found.problems == ()
    assert found.clocks.startswith("not determined")
