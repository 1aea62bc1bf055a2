"""Probes that cannot be read, share no time with the frames, or contradict z of the cube are reported."""

import numpy as np
import pytest
import xarray as xr

from wavefield.quality.remarks import remark_on_probe_file, remark_on_probes
from wavefield.series import Experiment

SPAN = (0.0, 5.0)


def experiment(folder, table, more="", unit="mm"):
    (folder / "probes.csv").write_text(table)
    path = folder / "experiment.yaml"
    path.write_text(
        "name: tank\nframe_rate: 20\ncameras: {left: left/*.tif}\n"
        f"probes: {{file: probes.csv, unit: {unit}, places: {{p1: [0.1, 0.05]}}{more}}}\n"
    )
    return Experiment.load(path)


def table(times, heights):
    rows = "".join(f"{t:.3f},{h:.5f}\n" for t, h in zip(times, heights))
    return f"time,p1\n{rows}"


def test_probes_that_cannot_be_read_are_a_remark(tmp_path):
    (remark,) = remark_on_probe_file(experiment(tmp_path, "nothing\n"), SPAN)
    assert remark.code == "probe"
    assert "probes.csv" in remark.found


def test_probes_that_share_no_time_with_the_frames_are_a_remark(tmp_path):
    times = 3600 + np.arange(50) / 10
    (remark,) = remark_on_probe_file(experiment(tmp_path, table(times, np.sin(times))), SPAN)
    assert "from 3600 to 3604.9 s, the frames from 0 to 5 s" in remark.found
    assert not list(remark_on_probe_file(experiment(tmp_path, table(times, times), ", clock: -3600"), SPAN))


@pytest.fixture
def cube():
    """A wave along x."""
    time, y, x = (np.arange(100) + 0.5) / 20, np.arange(8) * 0.02, np.arange(12) * 0.02
    z = wave(time[:, None, None], x) * np.ones((1, len(y), 1))
    at = ("time", "y", "x")
    return xr.Dataset({"z": (at, z, {"units": "m"})}, {"time": time, "y": y, "x": x}, {"frame_rate": 20.0})


def wave(time, x):
    """Irregular waves that travel along x, m."""
    phases = np.random.default_rng(1).uniform(0, 2 * np.pi, 8)
    return sum(
        0.004 * np.cos(2 * np.pi * f * (time - x / 0.6) + phase)
        for f, phase in zip(np.linspace(0.7, 2.9, 8), phases)
    )


@pytest.mark.parametrize(
    ("factor", "late", "words"),
    [
        (1e3, 0.0, []),
        (-1e3, 0.0, ["falls where"]),
        (1.0, 0.0, ["times the elevation"]),
        (1e3, 0.2, ["clock is"]),
    ],
)
def test_probes_are_compared_with_z_of_the_cube(tmp_path, cube, factor, late, words):
    times = np.arange(-1, 7, 0.02)
    note = experiment(tmp_path, table(times, factor * wave(times - late, 0.1)))
    remarks = list(remark_on_probes(note, cube, SPAN))
    assert [word in one.found for word, one in zip(words, remarks, strict=True)] == [True] * len(words)
