"""Experiment files, probes and images with random (reproducible) faults: one sentence, or a sound result.

No traceback, no hang, and no impossible value: numbers read from a spoiled file are finite, positive where
they must be, and of the size of the others.
"""

import random
import signal
import warnings
from contextlib import contextmanager

import cv2
import numpy as np
import pytest
import tifffile
from spoil import spoil_bytes, spoil_text
from test_bad_input import NOTE

from wavefield.errors import WavefieldError
from wavefield.pipeline import Workflow
from wavefield.pipeline.prepare import make_settings
from wavefield.rig import Rig
from wavefield.series import Experiment
from wavefield.series.probes import read_probes
from wavefield.series.readers import close_files
from wavefield.tank import paper_rig
from wavefield.variables import FrameFault

pytestmark = pytest.mark.slow
LONGEST = 10  # s of this process, however busy the machine


@contextmanager
def read_within_reason(name=""):
    """Check that an error raised inside comes soon and is one sentence with the name; ignore warnings."""

    def ring(number, frame):
        raise AssertionError(f"it takes longer than {LONGEST} s")

    before = signal.signal(signal.SIGPROF, ring)
    signal.setitimer(signal.ITIMER_PROF, LONGEST)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except WavefieldError as error:
        words = str(error)
        assert name in words
        assert "\n" not in words.strip(), words
        assert len(words) < 1000
        assert "Traceback" not in words
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Images that are read, a rig."""
    path = tmp_path_factory.mktemp("lab")
    rig = paper_rig(0.1)
    rng = np.random.default_rng(1)
    for name, camera in rig.cameras.items():
        (path / name).mkdir()
        for k in range(3):
            grey = rng.integers(0, 255, camera.size[::-1], dtype=np.uint8)
            tifffile.imwrite(path / name / f"img_{k:03d}.tif", cv2.GaussianBlur(grey, (0, 0), 1.0))
    rig.save(path / "rig.yaml")
    (path / "probes.csv").write_text("time,p1\n0,0.01\n0.1,0.02\n")
    return path


def as_prepared(path):
    """Read everything that a run reads before the first step, and check its values."""
    experiment = Experiment.load(path)
    series = experiment.open_frames()
    rig = experiment.load_rig(None, series)
    grid = experiment.choose_grid(rig)
    make_settings(experiment, Workflow())
    assert 0 < experiment.frame_rate < np.inf
    assert len({len(s) for s in series.values()}) == 1
    assert np.isfinite(experiment.frame_times(next(iter(series.values())))).all()
    assert {name: s.shape for name, s in series.items()} == {n: rig[n].size[::-1] for n in series if n in rig}
    assert set(experiment.measuring_cameras) <= set(rig)
    assert np.isfinite([*grid.x, *grid.y, grid.step]).all()
    assert 1 < grid.shape[0] * grid.shape[1] < 1e8
    assert all(np.isfinite(v) for v in experiment.water.attributes().values())
    if experiment.probes:
        assert np.isfinite(experiment.read_probes().time).all()


def test_spoiled_lab_notes(folder):
    """Sixty experiment files with one to four mistakes each."""
    read = 0
    for seed in range(60):
        path = folder / f"note_{seed}.yaml"
        path.write_bytes(spoil_text(NOTE, random.Random(seed)))
        with read_within_reason():
            as_prepared(path)
            read += 1
    assert read < 50  # most mistakes matter


def test_spoiled_probes(folder):
    note = "time,p1,p2\n" + "".join(f"{k / 100},{k % 7},{-k % 5}\n" for k in range(30))
    for seed in range(30):
        path = folder / f"probes_{seed}.csv"
        path.write_bytes(spoil_text(note, random.Random(1000 + seed)))
        with read_within_reason(path.name):
            found = read_probes(path, unit="mm")
            assert (np.diff(found.time) > 0).all()
            assert float(found.elevation.std()) < 1.0


@pytest.mark.parametrize("ending", [".tif", ".png"])
def test_spoiled_images(folder, ending):
    """Five rounds of five images each, one in five of a record."""
    there = tifffile.imread(folder / "cam1" / "img_000.tif")
    whole = cv2.imencode(ending, there)[1].tobytes()
    spot = folder / f"spoiled{ending[1:]}"
    spot.mkdir()
    for seed in range(25):
        name = f"img_{seed:03d}{ending}"
        (spot / name).write_bytes(whole if seed % 5 == 0 else spoil_bytes(whole, random.Random(seed)))
    path = folder / f"images_{ending[1:]}.yaml"
    path.write_text(f'name: a\nframe_rate: 20\ncameras: {{cam1: "{spot.name}/img_{{frame:03d}}{ending}"}}\n')
    with read_within_reason():
        (series,) = Experiment.load(path).open_frames().values()
        bad = 0
        for k in range(len(series)):
            frame = series.read(k)
            if frame.image is None:
                assert frame.fault in list(FrameFault)
                assert "\n" not in frame.message
                bad += 1
            else:
                assert (frame.image.shape, str(frame.image.dtype)) == (there.shape, "uint8")
        close_files()
    assert bad >= 5


def test_spoiled_rigs(folder):
    whole = (folder / "rig.yaml").read_text()
    for seed in range(30):
        path = folder / f"rig_{seed}.yaml"
        path.write_bytes(spoil_text(whole, random.Random(2000 + seed)))
        with read_within_reason(path.name):
            for camera in Rig.load(path).cameras.values():
                assert np.isfinite([*np.ravel(camera.R), *camera.T, camera.fx, camera.fy]).all()
