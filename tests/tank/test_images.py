"""Images: beads where the camera puts them, noise as set, the same for the same seed."""

import numpy as np
import pytest

from wavefield.tank import Scene, Tank, sensor

QUIET = {"read_noise": 0.0, "shot_noise": 0.0, "unevenness": 0.0, "background": 0.0, "bits": 16}


def small(**parts):
    base = {"rig": {"crop": 0.15}, "sea": {"shortest": 0.2, "period": 2.0}}
    return Scene.load("demo").with_(**{**base, **parts})


def test_beads_appear_where_the_camera_projects_them():
    tank = Tank(small(light=QUIET, surface={"density": 600, "one_camera": 0.0}))
    beads = tank.population.frame(2)
    images = tank.render(2)
    checked = 0
    for name, camera in tank.rig.cameras.items():
        X, Y = camera.project(beads.x, beads.y, beads.z)
        apart = np.hypot(X[:, None] - X, Y[:, None] - Y) + 1e9 * np.eye(X.size)
        lone = (apart.min(axis=1) > 14) & camera.sees(beads.x, beads.y, beads.z, 8)
        for x, y in zip(X[lone], Y[lone], strict=True):
            i, j = round(y), round(x)
            patch = images[name][i - 5 : i + 6, j - 5 : j + 6].astype(float)
            d = np.arange(-5, 6)
            assert j + (patch * d).sum() / patch.sum() == pytest.approx(x, abs=0.01)
            assert i + (patch * d[:, None]).sum() / patch.sum() == pytest.approx(y, abs=0.01)
            checked += 1
    assert checked > 20


def test_same_seed_same_images_and_another_seed_others():
    scene = small()
    first, again = Tank(scene), Tank(scene)
    again.render(0)  # what was drawn before does not matter
    a, b, c = first.render(3), again.render(3), Tank(scene.with_(seed=2)).render(3)
    for name in a:
        assert np.array_equal(a[name], b[name])
        assert not np.array_equal(a[name], c[name])
    # and one camera alone is the same as all together
    assert np.array_equal(first.render(3, ["cam2"])["cam2"], a["cam2"])


def test_noise_has_the_strength_that_is_set():
    light = np.full((400, 400), 100.0, np.float32)
    rng = np.random.default_rng(0)
    image = sensor.expose(light, read=2.0, shot=0.05, bits=16, rng=rng) / 257.0
    assert image.mean() == pytest.approx(100.0, abs=0.05)
    assert image.std() == pytest.approx(np.sqrt(4 + 5), rel=0.02)
    eight = sensor.expose(light, read=2.0, shot=0.05, bits=8, rng=rng)
    assert eight.dtype == np.uint8
    assert eight.std() == pytest.approx(np.sqrt(9 + 1 / 12), rel=0.02)


def test_full_scale_clips_and_darkness_does_not_wrap():
    light = np.array([[-50.0, 0.0, 254.6, 1e6]], np.float32)
    rng = np.random.default_rng(0)
    assert sensor.expose(light, 0.0, 0.0, 8, rng).tolist() == [[0, 0, 255, 255]]
    assert sensor.expose(light, 0.0, 0.0, 16, rng)[0, -1] == 65535


def test_faults_change_what_a_camera_records_and_nothing_else():
    sound = Tank(small())
    faults = {"cam1": {"late": 1, "mirrored": True}, "cam2": {"shift": (7.0, -3.0)}}
    broken = Tank(small(light=QUIET, faults=faults))
    quiet = Tank(small(light=QUIET))
    now, before, seen = quiet.render(2), quiet.render(1), broken.render(2)
    assert np.array_equal(seen["cam1"], before["cam1"][:, ::-1])
    moved, still = seen["cam2"][10:-10, 17:-3], now["cam2"][13:-7, 10:-10]
    assert moved.astype(float) == pytest.approx(still.astype(float), abs=10)  # of 65535
    assert np.array_equal(seen["cam3"], now["cam3"])
    assert np.array_equal(
        broken.render(0)["cam1"], quiet.render(0)["cam1"][:, ::-1]
    )  # its first image, twice
    swapped = Tank(small(faults={"cam1": {"shows": "cam2"}, "cam2": {"shows": "cam1"}}))
    assert np.array_equal(swapped.render(0)["cam1"], sound.render(0)["cam2"])
    assert np.array_equal(swapped.target_image("flat", "cam1"), sound.target_image("flat", "cam1"))
