"""Frames of a platform that rolls and pitches, turned level by the horizon."""

import re

import numpy as np
import pytest
from click.testing import CliRunner

import wavefield as wf
from wavefield.calibration import platform
from wavefield.calibration.horizon import find_horizon
from wavefield.commands.rig_commands import level as command
from wavefield.errors import RigError
from wavefield.images import read_image
from wavefield.series import Experiment
from wavefield.tank import Tank

SWAY = 2.0  # degrees


def scene(**changes):
    sea = {"rms": 0.02, "shortest": 4.0, "period": 50.0}
    rig = {"height": 12.0, "pitch": 15.0, "focal": 280.0, "size": (320, 240), "sway": SWAY}
    return wf.Scene.load("sea").with_(frames=3, frame_rate=1.0, seed=4, rig=rig | changes, sea=sea)


@pytest.fixture(scope="module")
def swaying(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sea")
    wf.simulate(scene(), folder / "raw", workers=1)
    moved = wf.level_frames(
        folder / "raw" / "experiment.yaml", folder / "level", folder / "raw/truth/rig.yaml"
    )
    return folder, moved


def test_roll_and_pitch_of_every_frame_are_those_simulated(swaying):
    _, moved = swaying
    tank = Tank(scene())
    for frame, tilt in enumerate(moved.tilt):
        up = tank.rig_at(frame)["left"].R.T @ tank.rig["left"].R  # turned back
        exact = np.degrees([up[2, 1], -up[2, 0]])
        assert np.abs(tilt - exact).max() < 3 * moved.tilt_std + 0.01
    assert np.abs(moved.tilt).max() > 0.5 * SWAY
    assert 0.005 < moved.tilt_std < 0.05
    assert "3 of 3 frames show the horizon" in moved.sentence


def test_turned_frames_are_an_experiment_of_their_own(swaying):
    folder, moved = swaying
    series = Experiment.load(moved.experiment).open_frames()
    assert {name: len(one) for name, one in series.items()} == {"left": 3, "right": 3}
    raw = read_image(folder / "raw" / "left" / "img_00001.tif")
    level = series["left"].read(1).image
    assert level.dtype == raw.dtype
    camera = moved.rig["left"]
    rows = find_horizon([level], camera)[:, 1]
    exact = Tank(scene()).rig["left"]
    far = exact.project(*np.array([[0.0, 1e5, -700.0]]).T)[1]
    assert abs(np.median(rows) - far[0]) < 3.0


def test_without_a_horizon_nothing_is_turned(tmp_path):
    wf.simulate(scene(pitch=50.0), tmp_path / "raw", workers=1)
    with pytest.raises(RigError, match="no frame shows the horizon"):
        wf.level_frames(
            tmp_path / "raw" / "experiment.yaml", tmp_path / "level", tmp_path / "raw/truth/rig.yaml"
        )
    assert not (tmp_path / "level").exists()


def test_the_command_writes_a_level_experiment_and_never_over_another(swaying, tmp_path):
    folder, _ = swaying
    words = [
        str(folder / "raw" / "experiment.yaml"),
        "--rig",
        str(folder / "raw/truth/rig.yaml"),
        "--frames",
        "3",
    ]
    words += ["-o", str(tmp_path / "rig.yaml"), "--each-frame", str(tmp_path / "level")]
    done = CliRunner().invoke(command, words)
    assert done.exit_code == 0, done.output
    assert "were turned level" in done.output
    assert re.search(r"the cameras roll and pitch by \d\.\d+ degrees .*--each-frame", done.output)
    assert (tmp_path / "level" / "experiment.yaml").exists()
    again = CliRunner().invoke(command, words)
    assert "is not empty" in str(again.exception)


def test_cameras_at_rest_are_not_reported_to_sway():
    tank = Tank(scene(sway=0.0))
    images = [tank.draw("left", frame, None) for frame in range(3)]
    assert platform.sway(images, tank.rig["left"]) < 0.02
