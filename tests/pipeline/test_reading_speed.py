"""How fast a run needs to read, and how fast its disk is."""

import os

import numpy as np
import pytest
from cube_cases import write_tank

import wavefield as wf
from wavefield.images import write_image
from wavefield.pipeline.reading_speed import ReadingSpeed, measure_reading_speed
from wavefield.series import Experiment

FRAMES, SHAPE = 5, (500, 800)


@pytest.fixture
def series(tmp_path):
    """Two cameras with images of .4 MB."""
    for camera in ("a", "b"):
        for number in range(FRAMES):
            write_image(tmp_path / camera / f"{number:03d}.tif", np.full(SHAPE, number, np.uint8))
    (tmp_path / "experiment.yaml").write_text(
        "name: two\nframe_rate: 20\ncameras:\n"
        '  a: {images: "a/{frame:03d}.tif"}\n  b: {images: "b/{frame:03d}.tif"}\n'
    )
    return Experiment.load(tmp_path / "experiment.yaml").open_frames()


def test_a_step_reads_a_frame_of_each_camera_and_a_block_five_more(series, tmp_path):
    image = (tmp_path / "a" / "000.tif").stat().st_size
    found = measure_reading_speed(series, chunk_steps=30, step_seconds=0.5, workers=4)
    assert found.step_bytes == pytest.approx(2 * image * (1 + 5 / 30))
    assert found.worker_rate == pytest.approx(2 * 2 * image * (1 + 5 / 30))
    assert found.disk_rate is None or found.disk_rate > 0
    for camera in ("a", "b"):
        for number in range(FRAMES):
            os.truncate(tmp_path / camera / f"{number:03d}.tif", 0)
    assert measure_reading_speed(series, chunk_steps=30, step_seconds=0.5, workers=4) is None


def test_the_disk_is_the_limit_where_workers_need_more_than_a_reader_gets():
    enough = ReadingSpeed(6e6, 50e6, 4, 400e6)
    assert not enough.limited
    assert str(enough) == (
        "reading: each worker reads 50 MB/s, 4 workers 200 MB/s; one reader gets 400 MB/s from the disk of "
        "the "
        "images"
    )
    short = ReadingSpeed(6e6, 50e6, 40, 400e6)
    assert short.limited
    assert short.enough_for == 8
    assert "40 workers 2.0 GB/s" in str(short)
    assert "beyond 8 workers the disk is the limit" in str(short)
    unknown = ReadingSpeed(6e6, 50e6, 1)
    assert not unknown.limited
    assert str(unknown) == "reading: each worker reads 50 MB/s"


def test_check_reports_what_a_worker_reads(tmp_path):
    found = wf.check(write_tank(tmp_path, 6), workflow=wf.Workflow(cluster="local", workers=3))
    assert "reading: each worker reads" in str(found)
    assert "3 workers" in str(found.cost.reading)
    assert found.to_dict()["cost"]["reading"]["workers"] == 3
