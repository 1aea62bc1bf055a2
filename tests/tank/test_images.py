"""Images: positions of spots, light and noise as set, reproducible by the seed."""

import numpy as np
import pytest

from wavefield.tank import Scene, Tank, paper_rig, rigs, sensor
from wavefield.tank.beads import carry

QUIET = {"read_noise": 0.0, "shot_noise": 0.0, "unevenness": 0.0, "background": 0.0, "bits": 16}


def small(**parts):
    base = {"rig": {"crop": 0.15}, "sea": {"shortest": 0.2, "period": 2.0}}
    return Scene.load("demo").with_(**{**base, **parts})


@pytest.mark.parametrize("sigma", [0.45, 0.65, 0.9])
def test_spots_have_their_places_and_their_light(sigma, rng):
    X, Y = np.meshgrid(np.arange(12, 190, 20.0), np.arange(12, 190, 20.0))
    X, Y = X + rng.uniform(-0.5, 0.5, X.shape), Y + rng.uniform(-0.5, 0.5, Y.shape)
    image = np.zeros((200, 200), np.float32)
    sensor.splat(image, X.ravel(), Y.ravel(), np.full(X.size, 1000.0), sigma)
    for x, y in zip(X.ravel(), Y.ravel(), strict=True):
        i, j = round(y), round(x)
        patch = image[i - 8 : i + 9, j - 8 : j + 9].astype(float)
        d = np.arange(-8, 9)
        assert patch.sum() == pytest.approx(1000.0, rel=1e-4)
        # sampling by pixels moves the centroid of a narrow spot, by no more than this
        allowed = np.exp(-2 * np.pi**2 * sigma**2) / np.pi + 1e-4
        assert j + (patch * d).sum() / patch.sum() == pytest.approx(x, abs=allowed)
        assert i + (patch * d[:, None]).sum() / patch.sum() == pytest.approx(y, abs=allowed)
        variance = (patch * (d - (x - j)) ** 2).sum() / patch.sum()
        assert variance == pytest.approx(
            sigma**2 + 1 / 12, rel=0.1 if sigma < 0.6 else 2e-3
        )  # the blur and the pixel


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


def test_paper_rig_has_the_paper_s_numbers():
    rig = paper_rig()
    assert [rig[n].size for n in rig] == [(1024, 1024), (1024, 1024), (2432, 1728)]
    centre = {n: rig[n].centre for n in rig}
    assert centre["cam1"][0] < 0 < centre["cam2"][0]
    assert rigs.pixel_footprint(rig["cam1"]) == pytest.approx((2.2e-3, 1.54e-3), rel=0.02)
    for name, angle in (("cam1", 45), ("cam2", 45), ("cam3", 0)):
        axis = rig[name].R[2]
        assert np.degrees(np.arccos(-axis[2])) == pytest.approx(angle, abs=0.01)
        assert rig[name].R @ rig[name].R.T == pytest.approx(np.eye(3), abs=1e-12)
        assert np.linalg.det(rig[name].R) == pytest.approx(1.0)


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


def test_jitter_takes_all_cameras_at_another_moment_and_truth_stays_on_the_frame_rate():
    even = Tank(small(light=QUIET, surface={"renewal": 0.0}))
    uneven = Tank(small(light=QUIET, surface={"renewal": 0.0}, timing={"jitter": 0.004}))
    departures = np.array([uneven.frame_time(k) - uneven.time(k) for k in range(200)])
    assert departures.std() == pytest.approx(0.004, rel=0.15)
    assert even.frame_time(7) == even.time(7)
    start = uneven.population.frame(0)
    x, _ = carry(uneven.basin, start.x, start.y, uneven.frame_time(0), uneven.frame_time(1))
    moved = uneven.population.frame(1).x
    stayed = np.abs(moved - x) < 0.3  # the others left the rectangle and came back on its other side
    assert stayed.mean() > 0.99
    assert moved[stayed] == pytest.approx(x[stayed], abs=1e-9)
    assert np.array_equal(even.truth(1).z, uneven.truth(1).z)
