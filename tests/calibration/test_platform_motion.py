"""Frames of a platform that rolls and pitches, turned level by the horizon."""

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.ndimage import gaussian_filter

import wavefield as wf
from wavefield.commands.level_command import level as command
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
    wf.simulate(scene(), folder / "raw")
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


def test_turned_frames_are_those_of_a_platform_at_rest(swaying):
    folder, moved = swaying
    still = Tank(scene(sway=0.0))
    written = Experiment.load(moved.experiment)
    assert list(written.open_frames()) == ["left", "right"]
    below = slice(90, 230)  # the horizon is at row 44
    for frame in range(3):
        for name, exact in still.render(frame).items():
            paths = (folder / kind / name / f"img_{frame:05d}.tif" for kind in ("level", "raw"))
            smooth = [
                gaussian_filter(image.astype(float), 2.0)[below, 25:-25].ravel()
                for image in (exact, *map(read_image, paths))
            ]
            alike = np.corrcoef(smooth)[0]
            assert alike[1] > 0.8
            assert alike[1] > alike[2] + 0.2


def test_without_a_horizon_nothing_is_turned(tmp_path):
    wf.simulate(scene(pitch=50.0), tmp_path / "raw")
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
    assert (tmp_path / "level" / "experiment.yaml").exists()
    again = CliRunner().invoke(command, words)
    assert "is not empty" in str(again.exception)
