"""A camera that is knocked while it records."""

import pytest
from cube_cases import HERE, KNOCKED

from wavefield.pipeline import run


def test_a_camera_knocked_in_mid_record_is_dated(knocked, tmp_path):
    verdict = run(knocked, tmp_path / "cube.zarr", workflow=HERE).verdict
    (knock,) = [remark for remark in verdict.remarks if remark.kind == "moved" and "frame" in remark.values]
    assert knock.values["frame"] == KNOCKED
    assert knock.values["px"] == pytest.approx(0.25, abs=0.04)  # mean of two pairs; .01 degrees in one
    assert f"knocked between frames {KNOCKED - 1} and {KNOCKED}" in str(knock)
