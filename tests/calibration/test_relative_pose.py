"""Cameras of which only the lenses are known are placed and levelled by natural texture of moving water."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sea_pictures import photograph, sea_rig, texture

from wavefield.calibration.level_on_water import level_on_water
from wavefield.calibration.relative_pose import match_features, place_second
from wavefield.commands.cli import main
from wavefield.errors import RigError
from wavefield.images import write_image
from wavefield.quality.remarks import remark_on_rest
from wavefield.rig import Rig
from wavefield.series import Experiment


@pytest.fixture(scope="module")
def sea(tmp_path_factory):
    cameras, folder = sea_rig(), tmp_path_factory.mktemp("sea")
    matches = []
    for k in range(4):
        images = [photograph(c, texture(k), 1.3 * k, n + 10 * k) for n, c in enumerate(cameras.values())]
        for name, image in zip(cameras, images):
            write_image(folder / f"{name}_{k}.png", image)
        matches.append(match_features(*images))
    return cameras, matches, folder


def test_the_twin_that_a_nearly_flat_sea_has_is_not_taken_for_the_second_camera():
    left, right = sea_rig().values()
    matches = []
    for k in range(2):
        images = [
            photograph(c, texture(200 + k), 1.3 * k, n + 10 * k + 200) for n, c in enumerate((left, right))
        ]
        matches.append(match_features(*images))
    both = tuple(np.concatenate([m[side] for m in matches]) for side in (0, 1))
    placed = place_second(left, right, both, float(np.linalg.norm(left.centre - right.centre)))
    assert np.degrees(np.arccos((np.trace(placed.R @ right.R.T) - 1) / 2)) < 0.1
    assert placed.centre == pytest.approx(right.centre, abs=0.02)


def test_the_command_places_and_levels_cameras_of_which_only_the_lenses_are_calibrated(sea, capsys):
    cameras, _, folder = sea
    lenses = {n: replace(c, rotation=np.eye(3), translation=np.zeros(3)) for n, c in cameras.items()}
    Rig(lenses).save(folder / "lenses.yaml")
    text = "name: sea\nframe_rate: 2.0\nrig: lenses.yaml\ncameras:\n"
    text += "".join(f'  {name}: {{images: "{name}_{{frame}}.png"}}\n' for name in cameras)
    (folder / "experiment.yaml").write_text(text)
    command = ["-q", "rig", "level", str(folder / "experiment.yaml"), "-o", str(folder / "rig.yaml")]
    assert main(command) == 1
    assert "state the distance between them" in capsys.readouterr().err
    distance = np.linalg.norm(cameras["left"].centre - cameras["right"].centre)
    assert main([*command, "--distance", f"{distance:.4f}"]) == 0
    assert "of 4 instants" in capsys.readouterr().out
    levelled = Rig.load(folder / "rig.yaml")
    remark = remark_on_rest(Experiment.load(folder / "experiment.yaml"), levelled)
    assert "no horizon was found" in remark.found
    assert remark.means == "z = 0 is the mean surface of moving water"
    assert levelled["right"].centre[2] == pytest.approx(cameras["right"].centre[2], abs=0.05)


def test_images_that_share_nothing_are_refused(sea):
    left, right = sea_rig().values()
    one, other = (photograph(left, texture(seed), 0.0, seed) for seed in (50, 60))
    with pytest.raises(RigError, match="features match between both cameras"):
        place_second(left, right, match_features(one, other), 2.0)


def test_a_rig_of_other_images_is_reported_as_that(sea):
    cameras, matches, _ = sea
    (first, one), (second, other) = cameras.items()
    rng = np.random.default_rng(0)
    turn = Rotation.from_rotvec(np.radians(rng.uniform(4.0, 8.0, 3) * rng.choice([-1, 1], 3))).as_matrix()
    rig = Rig({first: one, second: replace(other, rotation=turn @ other.R, translation=turn @ other.T)})
    with pytest.raises(RigError, match=r"only \d+ of \d{3,} matching features.*is the rig that of these"):
        level_on_water(rig, [{(first, second): pixels} for pixels in matches])


def test_a_rig_in_the_frame_of_a_camera_is_to_be_levelled():
    from wavefield.pipeline.prepare import refuse_own_frame

    cameras = sea_rig()
    refuse_own_frame(Rig(cameras), "rig.yaml")
    first = next(iter(cameras.values()))
    own = {
        name: replace(c, rotation=c.R @ first.R.T, translation=c.T - c.R @ first.R.T @ first.T)
        for name, c in cameras.items()
    }
    with pytest.raises(RigError, match="wavefield rig level"):
        refuse_own_frame(Rig(own), "stereo.yaml")
    lenses = {n: replace(c, rotation=np.eye(3), translation=np.zeros(3)) for n, c in cameras.items()}
    with pytest.raises(RigError, match=r"lenses.yaml contains lenses and no positions.*--distance METRES"):
        refuse_own_frame(Rig(lenses), "lenses.yaml")
