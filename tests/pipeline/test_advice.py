"""What `check` advises where little is measured."""

from types import SimpleNamespace

import numpy as np
import pytest

from wavefield.pipeline import advice
from wavefield.store.verdict import Remark
from wavefield.variables import Quality

NOTHING = np.zeros((5, 8), int)  # quality of nodes in view that are not measured


def late(subject="cam3", weight="grave"):
    return Remark(subject, "late", weight, "its frames are late", "frames of the same moments", "correct it")


@pytest.fixture
def prepared(monkeypatch):
    """A run of three cameras whose pairs all contain the third."""
    monkeypatch.setattr(advice, "complete_steps", lambda series: np.array([True]))
    pairs = (("cam3", "cam1"), ("cam3", "cam2"))
    return SimpleNamespace(
        rig=("cam1", "cam2", "cam3"),
        geometry=SimpleNamespace(pairs=pairs),
        experiment=SimpleNamespace(surface=SimpleNamespace(pairs=pairs)),
        series={},
    )


def test_a_late_camera_that_all_pairs_contain_is_named_with_the_pair_that_does_without_it(prepared):
    words = advice.advise(prepared, NOTHING, [late()])
    assert "only 0 % measured: correct cam3 first" in words
    assert "every pair of `surface: pairs` contains cam3" in words
    assert "[cam1, cam2] would be such a pair" in words
    assert "rig" not in words


def test_nothing_is_reported_of_pairs_without_the_late_camera_or_that_are_not_named(prepared):
    prepared.geometry.pairs = (*prepared.geometry.pairs, ("cam1", "cam2"))
    assert advice.advise(prepared, NOTHING, [late()]).endswith("correct cam3 first, as stated below")
    prepared.experiment.surface = None
    assert "pairs" not in advice.advise(prepared, NOTHING, [late()])


def test_enough_needs_no_advice(prepared):
    assert advice.advise(prepared, NOTHING + Quality.MEASURED, [late()]) == ""


def test_only_grave_remarks_on_cameras_count(prepared):
    remarks = [late("rig"), late("cameras"), late("cam1", "remark"), late("cam1 and cam2"), late("cam2")]
    assert [one.subject for one in advice.grave_cameras(prepared, remarks)] == ["cam1 and cam2", "cam2"]
