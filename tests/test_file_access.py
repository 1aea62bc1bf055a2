"""Pipes in place of files are refused at once."""

import os
import threading

import pytest

from wavefield.calibration.points import read_points
from wavefield.errors import WavefieldError
from wavefield.images import read_image
from wavefield.pipeline import Workflow
from wavefield.rig import Rig
from wavefield.series import Experiment
from wavefield.series.clocks import read_time_stamps
from wavefield.series.probes import read_probes
from wavefield.series.readers import FrameEntry, count_images, read_entry

READERS = {
    "image.tif": [read_image, count_images, lambda path: read_entry(FrameEntry("images", str(path), 1))],
    "image.png": [read_image],
    "image.im7": [read_image],
    "film.avi": [count_images],
    "record.cine": [count_images],
    "record.seq": [count_images],
    "experiment.yaml": [Experiment.load],
    "workflow.yaml": [Workflow.load],
    "rig.yaml": [Rig.load],
    "rig.xml": [Rig.load],
    "points.csv": [read_points],
    "probes.csv": [read_probes],
    "times.txt": [lambda path: read_time_stamps(path, "cam1")],
}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes with names")
@pytest.mark.parametrize("name", READERS)
def test_a_pipe_in_place_of_a_file_is_refused_at_once(tmp_path, name):
    path = tmp_path / name
    os.mkfifo(path)
    ended = []

    def attempt():
        for read in READERS[name]:
            try:
                read(path)
            except WavefieldError as error:
                ended.append(str(error))

    thread = threading.Thread(target=attempt, daemon=True)
    thread.start()
    thread.join(20)
    assert not thread.is_alive()
    assert [f"{path} is a pipe" in error for error in ended] == [True] * len(READERS[name])
