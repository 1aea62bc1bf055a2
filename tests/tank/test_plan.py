"""The errors that a plan predicts follow light and beads."""

import pytest

import wavefield as wf
from wavefield.errors import ExperimentError

SMALL = {"rig": {"crop": 0.16}, "grid": {"x": (-0.1, 0.1), "y": (-0.07, 0.07), "step": 0.01}}


def test_a_plan_states_errors_and_noise_makes_them_larger():
    plain = wf.plan(**SMALL)
    noisy = wf.plan(**SMALL, light={"read_noise": 6.0, "shot_noise": 0.4})
    assert list(plain.quantity.values) == ["z", "u dt", "v dt", "w dt"]
    assert (plain.error < 0.1).all()
    assert (noisy.error > 1.2 * plain.error).all()
    assert (noisy.stated > plain.stated).all()
    assert float(plain.measured) > 0.95
    assert plain.attrs["pixel_size"] == pytest.approx(1.8e-3, rel=0.2)


def test_a_plan_takes_other_cameras_and_refuses_unknown_settings():
    rig = wf.Scene.load("demo").with_(rig={"crop": 0.16}).build_rig()
    assert (wf.plan(rig=rig, grid=SMALL["grid"]).error < 0.1).all()
    with pytest.raises(ExperimentError, match="beeds"):
        wf.plan(beeds=3)
