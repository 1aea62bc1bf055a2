"""Runs from recordings whose files contain the times of their images."""

from itertools import pairwise

import cv2
import numpy as np
from cube_cases import FRAMES, HERE, far_apart

from tests.series.test_series_recordings import write_seq
from wavefield.images import read_image, write_image
from wavefield.pipeline import check, open_cube, run
from wavefield.quality.record import remark_on_recordings
from wavefield.series import Experiment

RATE = 20.0


def test_nothing_is_measured_across_images_that_all_cameras_dropped(own_tank, reference):
    folder = own_tank.parent
    kept = [n for n in range(FRAMES) if n not in (6, 7)]
    for number, name in enumerate(("cam1", "cam2", "cam3")):
        images = [read_image(folder / name / f"img_{n:05d}.tif") for n in kept]
        write_seq(folder / f"{name}.seq", 8, 1e9 + number + np.array(kept) / RATE, images, RATE)
    own_tank.write_text(own_tank.read_text().replace("/img_{frame:05d}.tif", ".seq"))
    assert "cam2: missing: frame 6-7" in str(check(own_tank, workflow=HERE))
    state = run(own_tank, workflow=HERE)
    assert state.failed_steps == (5, 6, 7)
    assert {bad.numbers for bad in state.bad_frames} == {(6, 7)}
    assert ("cam3", "missing frames") in {(r.subject, r.kind) for r in state.verdict.remarks}
    cube, good = open_cube(state.store).load(), open_cube(reference).load()
    np.testing.assert_array_equal(cube.time, good.time)
    # the sample steps beside the gap are others: of 16 cm of water each gives another spectrum
    for steps in (slice(0, 3), slice(11, 16)):
        assert far_apart(cube, good, steps, most=0.5) == []


def test_interlaced_images_are_named_and_others_are_not(tmp_path):
    def remarks(images):
        for k, image in enumerate(images):
            write_image(tmp_path / f"{k}.tif", image)
        (tmp_path / "e.yaml").write_text("name: e\nframe_rate: 10\ncameras: {a: '{frame}.tif'}\n")
        experiment = Experiment.load(tmp_path / "e.yaml")
        return [str(one) for one in remark_on_recordings(experiment, experiment.open_frames())]

    rng = np.random.default_rng(1)
    beads = cv2.GaussianBlur(rng.normal(size=(200, 400)).astype("f4"), (0, 0), 1.2)
    beads = np.clip(128 + 200 * beads + rng.normal(0, 4, beads.shape), 0, 255).astype("u1")
    moments = [np.ascontiguousarray(beads[:, 3 * k : 3 * k + 200]) for k in range(10)]
    combed = [np.where(np.arange(200)[:, None] % 2, one, two) for one, two in pairwise(moments)]
    mosaic = [one // 2 + (40 * (np.indices(one.shape).sum(0) % 2)).astype("u1") for one in moments]
    noise = [rng.integers(0, 255, (200, 200), np.uint8) for _ in range(10)]
    for images in (moments, mosaic, noise):
        assert remarks(images) == []
    (only,) = remarks(combed)
    assert "its images are interlaced" in only
