"""Images: spots where the camera puts them, light and noise as set, the same for the same seed."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from wavefield.tank import Scene, Tank, paper_rig, rigs, sensor, texture
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


def test_rays_meet_the_surface_and_the_texture_is_read_along_them():
    scene = small(
        surface={"kind": "texture", "contrast": 40.0},
        light=QUIET,
        sea={"kind": "single", "amplitude": 0.03, "wavelength": 0.5},
    )
    tank = Tank(scene)
    snapshot = tank.basin.snapshot(0.0, ("z", "z_x", "z_y"))
    images = tank.render(0)
    sampled = {}
    for name, camera in tank.rig.cameras.items():
        seen = texture.meet(camera, snapshot, tank.sea.reach)
        x, y = seen.x, seen.y
        z = tank.sea.at(x, y, 0.0, ("z",))["z"]
        X, Y = camera.project(x, y, z)
        columns, rows = np.meshgrid(np.arange(camera.size[0]), np.arange(camera.size[1]))
        assert np.hypot(X - columns, Y - rows).max() < 1e-3
        sampled[name] = images[name].astype(float)
    # two cameras see the same grey at the same place of the water
    rng = np.random.default_rng(1)
    px, py = rng.uniform(-0.08, 0.08, (2, 500))
    pz = tank.sea.at(px, py, 0.0, ("z",))["z"]
    grey = [
        map_coordinates(sampled[n], camera.project(px, py, pz)[::-1], order=5)
        for n, camera in tank.rig.cameras.items()
    ]
    assert np.corrcoef(grey)[0].min() > 0.98
    assert images["cam3"].std() / 257 == pytest.approx(40.0, rel=0.25)


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


def test_a_late_shutter_takes_the_same_beads_a_moment_later():
    tank = Tank(small(light=QUIET, surface={"renewal": 0.0}))
    between = Tank(small(light=QUIET, surface={"renewal": 0.0}, faults={"cam2": {"delay": 0.05}}))
    seen, next_frame = between.render(1), tank.render(2)
    assert np.corrcoef(seen["cam2"].ravel(), next_frame["cam2"].ravel())[0, 1] > 0.999
    assert np.array_equal(seen["cam1"], tank.render(1)["cam1"])


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


def test_a_rolling_shutter_takes_lower_rows_later():
    still = small(light=QUIET, surface={"renewal": 0.0}, sea={"current": (0.4, 0.0)})
    rows = still.build_rig()["cam3"].size[1]
    rolling = still.with_(faults={"cam3": {"row_time": 0.02 / rows}})
    beads = Tank(still).population.frame(0)
    here = np.stack(Tank(still).rig["cam3"].project(beads.x, beads.y, beads.z))
    tank = Tank(rolling)
    there = np.stack(tank._rolling(tank.rig["cam3"], beads, 0, 0.02 / rows))
    inside = (here[1] > 5) & (here[1] < rows - 5) & (here[0] > 5)
    expected = 0.4 * 0.02 * (here[1] - (rows - 1) / 2) / rows / rigs.pixel_footprint(tank.rig["cam3"])[0]
    moved = (there - here)[0][inside]
    # waves move the beads, too: the mean motion is the current's
    assert np.polyfit(expected[inside], moved, 1)[0] == pytest.approx(1.0, abs=0.3)
    assert not np.array_equal(tank.render(0)["cam3"], Tank(still).render(0)["cam3"])


def test_a_camera_turns_when_it_is_knocked_and_not_before():
    knocked = Tank(small(light=QUIET, faults={"cam3": {"turned": (0.05, 0.0, 0.0), "since": 1}}))
    sound = Tank(small(light=QUIET))
    assert np.array_equal(knocked.render(0)["cam3"], sound.render(0)["cam3"])
    image, before = (t.render(1)["cam3"].astype(float) for t in (knocked, sound))
    shift = np.radians(0.05) * sound.rig["cam3"].fy  # px, along the rows
    rows = np.arange(image.shape[0] - 8)
    moved = [map_coordinates(before[:, k], [rows + s], order=3) for k in (50, 90) for s in (shift, -shift)]
    close = [np.abs(image[: len(rows), k] - m).mean() for k, m in zip((50, 50, 90, 90), moved)]
    assert min(close[:2]) < 0.3 * max(close[:2])


@pytest.mark.parametrize("surface", [{"density": 600}, {"kind": "texture"}])
def test_defocus_widens_what_is_seen_and_keeps_its_light(surface):
    scene = small(light=QUIET, surface=surface)
    sharp = Tank(scene).render(0)["cam1"].astype(float)
    soft = Tank(scene.with_(faults={"cam1": {"defocus": 2.0}})).render(0)["cam1"].astype(float)
    assert soft.mean() == pytest.approx(sharp.mean(), rel=0.02)
    assert soft.std() < 0.7 * sharp.std()
    inner = np.s_[10:-10, 10:-10]
    assert soft[inner] == pytest.approx(gaussian_filter(sharp, 2.0)[inner], abs=0.02 * np.ptp(sharp))
