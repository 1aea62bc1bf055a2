"""A camera that is knocked while it records."""

from dataclasses import replace

import numpy as np
import pytest
from cube_cases import HERE, KNOCKED

from wavefield.pipeline import Workflow, check, open_cube, run
from wavefield.quality.camera_motion import camera_motion
from wavefield.quality.cameras import rms_over_field
from wavefield.rig import Rig

CORRECT = Workflow(cluster="none", settings={"vibration": "correct"}, steps_per_block=4)


def test_a_camera_knocked_in_mid_record_is_dated(knocked, tmp_path):
    verdict = run(knocked, tmp_path / "cube.zarr", workflow=HERE).verdict
    (knock,) = [remark for remark in verdict.remarks if remark.kind == "moved" and "frame" in remark.values]
    assert knock.values["frame"] == KNOCKED
    assert knock.values["px"] == pytest.approx(0.25, abs=0.04)  # mean of two pairs; .01 degrees in one
    assert f"knocked between frames {KNOCKED - 1} and {KNOCKED}" in str(knock)


def test_and_is_turned_back_where_that_is_asked_for(knocked, tmp_path):
    state = run(knocked, tmp_path / "cube.zarr", workflow=CORRECT)
    assert not [
        remark for remark in state.verdict.remarks if remark.kind == "moved" and "frame" in remark.values
    ]
    left = camera_motion(open_cube(state.store)).coefficients
    assert max(rms_over_field(one) for one in left) < 0.03


def test_cameras_that_are_not_in_a_row_are_not_turned_back(tank):
    rig = Rig.load(tank.with_name("rig.yaml"))
    turn = np.deg2rad(60)  # about the vertical
    R = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    around = rig.moved(R, (0.0, 0.0, 0.0))
    found = check(tank, replace(rig, cameras={**rig.cameras, "cam1": around["cam1"]}), CORRECT)
    assert not found.ready
    assert "`vibration: correct` is for cameras in a row" in found.problems[0]
    assert "60 degrees apart" in found.problems[0] or "120 degrees" in found.problems[0]
