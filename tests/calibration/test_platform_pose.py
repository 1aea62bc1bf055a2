"""Two cameras on a platform, lenses and a baseline alone: the horizon and the mean surface place them."""

from dataclasses import replace

import numpy as np
import pytest
from rendering import camera_at
from scipy.spatial.transform import Rotation

from wavefield.calibration.level_on_water import level_on_water
from wavefield.calibration.platform import find_horizon
from wavefield.calibration.relative_pose import match_features, place_second
from wavefield.errors import RigError
from wavefield.pipeline.prepare import refuse_own_frame
from wavefield.rig import Rig
from wavefield.tank import Scene, Tank

INSTANTS = 4


@pytest.fixture(scope="module")
def platform():
    """Exact cameras, and images of each at instants that have nothing in common."""
    scene = Scene.load("sea").with_(rig={"focal": 380.0, "size": (400, 300)}, sea={"shortest": 2.0})
    tanks = [Tank(scene.with_(seed=40 + k)) for k in range(INSTANTS)]
    rig = tanks[0].rig
    return rig, {name: [tank.draw(name, 0, None) for tank in tanks] for name in rig}


@pytest.fixture(scope="module")
def placed(platform):
    rig, images = platform
    matches = [match_features(*both) for both in zip(*images.values(), strict=True)]
    lenses = {n: replace(c, rotation=np.eye(3), translation=np.zeros(3)) for n, c in rig.cameras.items()}
    both = tuple(np.concatenate([m[side] for m in matches]) for side in (0, 1))
    lenses["right"] = place_second(lenses["left"], lenses["right"], both, 2.5)
    return Rig(lenses), [{("left", "right"): m} for m in matches]


def tilt_error(found, true):
    """Of the vertical in a camera's own frame, degrees."""
    return np.degrees(np.arccos(np.clip(found.R[:, 2] @ true.R[:, 2], -1, 1)))


def test_the_twin_that_a_nearly_flat_sea_has_is_not_taken_for_the_second_camera():
    left, right = (camera_at((480, 360), 55.0, turn, 0.0, 12.0, 800.0) for turn in (175.0, 185.0))
    distance = float(np.linalg.norm(left.centre - right.centre))
    for seed in range(8):
        rng = np.random.default_rng(seed)
        x, y = left.unproject(*rng.uniform(20, 340, (2, 400)))
        z = 0.03 * np.sin(1.5 * x + 0.7 * y) * np.cos(0.4 * x - 1.9 * y + seed)
        seen = right.sees(x, y, z, 5.0)
        pixels = [np.stack(c.project(x, y, z), -1)[seen] for c in (left, right)]
        placed = place_second(left, right, tuple(p + rng.normal(0, 0.3, p.shape) for p in pixels), distance)
        assert np.degrees(np.arccos((np.trace(placed.R @ right.R.T) - 1) / 2)) < 1.0  # the twin's is 14 off


def test_images_that_share_nothing_are_refused(platform):
    rig, images = platform
    with pytest.raises(RigError, match="features match between both cameras"):
        place_second(*rig.cameras.values(), match_features(images["left"][0], images["right"][1]), 2.5)


def test_a_rig_of_other_images_is_reported_as_that(platform, placed):
    rig, matches = platform[0], placed[1]
    rng = np.random.default_rng(0)
    turn = Rotation.from_rotvec(np.radians(rng.uniform(4.0, 8.0, 3) * rng.choice([-1, 1], 3))).as_matrix()
    right = rig["right"]
    other = Rig(rig.cameras | {"right": replace(right, rotation=turn @ right.R, translation=turn @ right.T)})
    with pytest.raises(RigError, match=r"only \d+ of \d{3,} matching features.*is the rig that of these"):
        level_on_water(other, matches)


def test_a_rig_in_the_frame_of_a_camera_is_to_be_levelled(platform):
    cameras = platform[0].cameras
    refuse_own_frame(Rig(cameras), "rig.yaml")
    first = cameras["left"]
    own = {
        name: replace(c, rotation=c.R @ first.R.T, translation=c.T - c.R @ first.R.T @ first.T)
        for name, c in cameras.items()
    }
    with pytest.raises(RigError, match="wavefield rig level"):
        refuse_own_frame(Rig(own), "stereo.yaml")
    lenses = {n: replace(c, rotation=np.eye(3), translation=np.zeros(3)) for n, c in cameras.items()}
    with pytest.raises(
        RigError, match=r"lenses.yaml contains lenses but no camera positions.*--distance METRES"
    ):
        refuse_own_frame(Rig(lenses), "lenses.yaml")


def test_no_horizon_is_found_where_there_is_none(platform):
    rig, images = platform
    for name, camera in rig.cameras.items():
        below = [image[40:] for image in images[name]]
        lower = replace(camera, cy=camera.cy - 40, size=(400, 260))
        assert find_horizon(np.mean(below, axis=0), lower) is None
    rng = np.random.default_rng(0)
    assert find_horizon(rng.normal(100, 2.5, (300, 400)), rig["left"]) is None


@pytest.mark.parametrize("seen", [True, False])
def test_lenses_and_a_baseline_place_and_level_the_cameras(platform, placed, seen):
    true, images = platform
    rig, matches = placed
    horizons = (
        {name: find_horizon(np.mean(images[name], axis=0), true[name]) for name in true} if seen else {}
    )
    found = level_on_water(rig, matches, horizons, 2.5)
    worst = max(tilt_error(found.rig[name], true[name]) for name in true)
    assert worst < (0.06 if seen else 0.3)
    assert worst < 4 * found.tilt_std
    assert found.tilt_std < (0.2 if seen else 1.0)
    assert found.height == pytest.approx(12.0, rel=0.02)
    assert abs(found.height - 12.0) < 4 * found.height_std
    assert ("the horizon in left, right" in found.sentence) == seen
    apart = np.linalg.norm(found.rig["left"].centre - found.rig["right"].centre)
    assert apart == pytest.approx(2.5, abs=1e-9)


def test_an_edge_that_the_water_contradicts_is_no_horizon(platform, placed):
    rig, matches = placed
    true, images = platform
    roof = {
        name: find_horizon(np.mean(images[name], axis=0), true[name]) + np.array([0.0, 60.0]) for name in true
    }
    found = level_on_water(rig, matches, roof, 2.5)
    assert "was not used" in found.sentence
    assert max(tilt_error(found.rig[name], true[name]) for name in true) < 0.3


def test_one_instant_gives_no_uncertainty_of_the_height(platform, placed):
    rig, matches = placed
    true, images = platform
    found = level_on_water(rig, matches[:1], {}, 2.5)
    assert np.isnan([found.tilt_std, found.height_std]).all()
    assert "nan" not in found.sentence
    assert "one instant gives no uncertainty of the tilt and the height" in found.sentence
    horizons = {name: find_horizon(np.mean(images[name], axis=0), true[name]) for name in true}
    seen = level_on_water(rig, matches[:1], horizons, 2.5)
    assert max(tilt_error(seen.rig[name], true[name]) for name in true) < 2 * seen.tilt_std
    assert "no uncertainty of the height" in seen.sentence
