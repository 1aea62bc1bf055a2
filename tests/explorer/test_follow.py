"""Following cameras that record: the newest complete frames, skipped frames, and the status lights."""

import copy
import os
import shutil
import time
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from bokeh.document import Document

from wavefield.errors import ExperimentError
from wavefield.explorer import live
from wavefield.explorer.follow import FollowPage
from wavefield.explorer.lights import arrival_lights, frame_features, red_lights
from wavefield.explorer.live import FolderWatch, Follower
from wavefield.images import write_image
from wavefield.series import Experiment
from wavefield.variables import AROUND, Quality

CAMERAS = ("cam1", "cam2", "cam3")


@pytest.fixture(scope="module")
def small_tank():
    """The rig of a small tank, and the images of seven frames by camera."""
    from wavefield.tank import Scene, Tank

    tank = Tank(Scene.load("demo").with_(rig={"crop": 0.2}, sea={"shortest": 0.15}))
    return tank.rig, [tank.render(number) for number in range(7)]


def record(folder, rig=None):
    """Write an experiment file whose cameras have not recorded anything yet."""
    folder.mkdir(exist_ok=True)
    if rig is not None:
        rig.save(folder / "rig.yaml")
    cameras = "\n".join(f'  {name}: "{name}/img_{{frame:05d}}.tif"' for name in CAMERAS)
    path = folder / "experiment.yaml"
    path.write_text(
        f"name: live\nframe_rate: 20\ncameras:\n{cameras}\n"
        "grid: {x: [-0.06, 0.06], y: [-0.06, 0.06], step: 0.01}\n"
    )
    return path


def write(folder, number, images):
    for name, image in images.items():
        write_image(folder / name / f"img_{number:05d}.tif", image)


def blurred(image):
    return cv2.GaussianBlur(image, (0, 0), 2.0)


def dimmed(image):
    dark = np.percentile(image, 0.1)
    return np.clip(dark + 0.1 * (image.astype(float) - dark), 0, 255).round().astype(np.uint8)


def without_beads(image):
    rng = np.random.default_rng(4)
    level, low = np.median(image), np.percentile(image, 5)
    return (
        np.clip(rng.normal(level, max(level - low, 1.0) / 1.6, image.shape), 0, 255).round().astype(np.uint8)
    )


def knocked(image):
    return np.roll(image, (9, 4), (0, 1))


FAULTS = {
    "a lens out of focus": (blurred, "focus"),
    "a lamp switched off": (dimmed, "brightness"),
    "beads gone": (without_beads, "seeding"),
    "a camera knocked": (knocked, "eps_y"),
}


@pytest.fixture(scope="module")
def followed(small_tank, tmp_path_factory):
    """A follower that has measured six good frames, and its folder; each test copies them."""
    rig, frames = small_tank
    folder = tmp_path_factory.mktemp("live")
    follower = Follower(Experiment.load(record(folder, rig)))
    assert not follower.poll()
    for number, images in enumerate(frames[:6]):
        write(folder, number, images)
        follower.poll()
    return follower, folder


def test_good_frames_turn_no_light(followed):
    follower, _ = followed
    assert follower.latest.number == 4
    assert follower.latest.measured == 5
    assert red_lights(follower.latest.lights) == []
    assert np.isfinite(follower.latest.fields["z"]).mean() > 0.8
    assert 0 <= follower.latest.delay < 60


def own_follower(followed, folder):
    """Return a copy of the follower in a copy of its folder."""
    follower, there = followed
    later = copy.copy(follower)
    shutil.copytree(there, folder / "live")
    later.experiment = Experiment.load(folder / "live" / "experiment.yaml")
    later.watch = FolderWatch(later.experiment)
    later._baseline = copy.deepcopy(follower._baseline)
    return later


@pytest.mark.parametrize("fault", FAULTS)
def test_the_right_light_turns(followed, small_tank, tmp_path, fault):
    later, (_, frames) = own_follower(followed, tmp_path), small_tank
    spoil, name = FAULTS[fault]
    for number in (6, 7):
        images = dict(frames[6])
        images["cam2"] = spoil(images["cam2"])
        if name == "brightness":  # a lamp lights all of them
            images = {camera: spoil(image) for camera, image in frames[6].items()}
        write(tmp_path / "live", number, images)
    assert later.poll()
    first = next(iter(red_lights(later.latest.lights)), None)
    lights = "\n".join(map(str, later.latest.lights))
    assert first is not None, lights
    assert first.name == name, lights
    if name != "brightness":
        assert "cam2" in first.camera


def test_a_cable_pulled_turns_its_cameras_light_and_the_others_go_on(followed, small_tank, tmp_path):
    later = own_follower(followed, tmp_path)
    now = time.time()
    for name in CAMERAS:
        for number in range(6):
            path = tmp_path / "live" / name / f"img_{number:05d}.tif"
            os.utime(path, (now - 3, now - 3))
    for number in (6, 7):
        write(tmp_path / "live", number, {n: i for n, i in small_tank[1][6].items() if n != "cam1"})
    assert later.poll()
    first = next(iter(red_lights(later.latest.lights)), None)
    assert (first.name, first.camera) == ("synchronisation", "cam1")
    assert later.latest.number == 6


def test_cameras_that_all_stop_turn_a_light_each(small_tank, tmp_path, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(live, "time", SimpleNamespace(monotonic=lambda: now[0], time=time.time))
    folder = tmp_path / "live"
    follower = Follower(Experiment.load(record(folder)))

    def red():
        follower.poll()
        return [(light.name, light.camera) for light in red_lights(follower.latest.lights)]

    for number in range(3):
        write(folder, number, small_tank[1][number])
    assert red() == []
    now[0] += 1.5
    assert red() == []
    now[0] += 20
    assert follower._arrivals()[0].state == "good"  # a step that takes long to measure is no silence
    assert red() == [("arrival", name) for name in CAMERAS]
    page = FollowPage(follower)
    page.attach(Document())
    assert "arrival cam1, cam2, cam3" in page.words["verdict"].text
    assert "no new frame for 22 s" in page.words["verdict"].text
    write(folder, 3, {name: small_tank[1][3][name] for name in ("cam1", "cam3")})
    assert ("arrival", "cam2") in red()
    assert not {("arrival", "cam1"), ("arrival", "cam3")} & set(red())
    write(folder, 3, {"cam2": small_tank[1][3]["cam2"]})
    assert "arrival" not in dict(red())


def test_slow_cameras_have_not_stopped_and_those_that_never_began_have():
    silent = {"slow": 45.0, "gone": 80.0, "never": 80.0}
    lights = arrival_lights(silent, {"slow": 0.0, "gone": 0.0}, {"slow": 7, "gone": 7}, frame_rate=0.1)
    found = {light.camera: (light.state, light.words) for light in lights if light.name == "arrival"}
    assert found["slow"] == ("good", "frames arrive")
    assert found["gone"] == ("bad", "no new frame for 1 min 20 s")
    assert found["never"] == ("bad", "no new frame for 1 min 20 s, none yet")


def test_frames_that_come_too_fast_are_skipped_and_counted(small_tank, tmp_path):
    folder = tmp_path / "live"
    follower = Follower(Experiment.load(record(folder)))
    for number in range(3):
        write(folder, number, small_tank[1][number])
    follower.poll()
    for number in range(3, 7):
        write(folder, number, small_tank[1][number])
    follower.poll()
    assert (follower.latest.number, follower.latest.measured, follower.latest.skipped) == (5, 2, 3)


def test_a_frame_that_is_not_written_to_its_end_waits(small_tank, tmp_path):
    folder = tmp_path / "live"
    follower = Follower(Experiment.load(record(folder)))
    for number in range(3):
        write(folder, number, small_tank[1][number])
    path = folder / "cam2" / "img_00002.tif"
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    follower.poll()
    assert follower.latest.number == 0
    path.write_bytes(whole)
    follower.poll()
    assert follower.latest.number == 1


def test_without_a_rig_each_camera_is_judged_and_the_reason_is_given(small_tank, tmp_path):
    folder = tmp_path / "live"
    follower = Follower(Experiment.load(record(folder)))
    write(folder, 0, small_tank[1][0])
    write(folder, 1, small_tank[1][1])
    follower.poll()
    assert "rig" in follower.latest.trouble
    assert follower.latest.fields == {}
    assert {light.name for light in follower.latest.lights} == {
        "arrival", "synchronisation", "brightness", "saturation", "seeding", "focus",
    }  # fmt: skip
    page = FollowPage(follower)
    page.attach(Document())
    assert "Waiting for the first measured step" in page.words["verdict"].text
    assert "Sound" not in page.words["verdict"].text
    assert "nothing measured yet" in page.words["state"].text


def test_following_leaves_no_trace(followed):
    _, folder = followed
    names = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    frames = {f"{name}/img_{number:05d}.tif" for name in CAMERAS for number in range(6)}
    assert names == frames | {"experiment.yaml", "rig.yaml"}


def test_saturation_is_the_fraction_of_white_pixels():
    image = np.full((120, 120), 20, np.uint8)
    image[:, :30] = 255
    assert frame_features(image).saturated == pytest.approx(0.25)
    assert frame_features((image // 2).astype(np.uint8)).saturated == 0.0


def test_the_page_shows_map_lights_and_cameras(followed):
    follower, _ = followed
    page, document = FollowPage(follower), Document()
    assert page.map.sizing_mode == "scale_width"  # else a phone shows a map of 600 px, mostly empty
    page.attach(document)
    expected = 100 * follower.latest.fields["w"]
    np.testing.assert_allclose(page.sources["image"].data["image"][0], expected, rtol=1e-6)
    assert "frame 4; measured 5, skipped 0" in page.words["state"].text
    assert page.words["lights"].text.count("<tr>") == 12
    assert page.cameras["cam1"].source.data["image"]
    document.to_json()


def test_what_is_masked_is_masked_while_following(small_tank, tmp_path):
    rig, frames = small_tank
    path = record(tmp_path / "live", rig)
    path.write_text(
        path.read_text() + "mask: {water: {polygon: [[-0.03, -0.03], [0.03, -0.03], [0.0, 0.03]]}}\n"
    )
    follower = Follower(Experiment.load(path))
    for number in range(3):
        write(path.parent, number, frames[number])
    follower.poll()
    assert follower.latest.trouble == ""
    masked = (follower.latest.fields["quality"] & int(Quality.MASKED)) != 0
    assert 0 < masked.sum() < masked.size / 2
    np.testing.assert_array_equal(np.isnan(follower.latest.fields["w"]), masked)


def with_background(folder, small_tank, background):
    """Return a follower of five frames with a fixed background, and its folder."""
    rig, frames = small_tank
    path = record(folder, rig)
    draws = np.random.default_rng(8)
    for name in CAMERAS:
        shape = frames[0][name].shape
        floor = np.where(draws.random(shape) > 0.97, 90, 0).astype(np.uint8)
        for number in range(3):
            write(folder, number, {name: np.minimum(frames[number][name], 150) + floor})
        write_image(folder / "background" / f"{name}.tif", background(floor))
    path.write_text(path.read_text() + 'background: "background/{camera}.tif"\n')
    follower = Follower(Experiment.load(path))
    follower.poll()
    return follower


def test_a_background_is_subtracted_as_in_a_run_before_a_step_is_measured(small_tank, tmp_path, monkeypatch):
    from wavefield.measurement import measure

    def spy(images, *rest):
        seen.append(images)
        return measure(images, *rest)

    seen = []
    monkeypatch.setattr(live, "measure", spy)
    follower = with_background(tmp_path, small_tank, lambda floor: floor)
    series = follower.experiment.open_frames()
    for name in CAMERAS:
        for number in (1, 2):
            np.testing.assert_array_equal(seen[0][name][AROUND + number - 1], series[name].read(number).image)


def test_a_background_of_other_images_is_named_and_nothing_is_measured(small_tank, tmp_path):
    follower = with_background(tmp_path, small_tank, lambda floor: floor[1:])
    assert "run `wavefield background experiment.yaml` again" in follower.latest.trouble
    assert follower.latest.fields == {}


def test_following_without_the_background_that_is_named_is_refused_as_a_run_is(tmp_path):
    path = record(tmp_path)
    path.write_text(path.read_text() + 'background: "background/{camera}.tif"\n')
    with pytest.raises(ExperimentError, match=r"`wavefield background experiment\.yaml` writes it"):
        Follower(Experiment.load(path))
