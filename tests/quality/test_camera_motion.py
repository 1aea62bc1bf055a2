"""Cameras that are knocked, vibrate or are delayed are named and measured; steady cameras are not."""

import re

import numpy as np
import pytest
import yaml
from cube_cases import HERE

from benchmarks.faults import write_experiment
from wavefield.pipeline import check
from wavefield.quality.camera_motion import (
    Delay,
    Sample,
    Synchrony,
    camera_motion,
    find_jump,
    find_knock,
    regress,
    remarks_on_clocks,
    vibration_rms,
)
from wavefield.quality.cameras import rms_over_field
from wavefield.quality.remarks import SIGNIFICANCE
from wavefield.store.cube import open_cube


@pytest.fixture
def cube(reference):
    """The small tank's cube, loaded; tests add errors to its eps_y."""
    return open_cube(reference).load()


def add(cube, what):
    """Add an error in px to eps_y, one value per step (n,) or per node (n, ny, nx)."""
    what = np.broadcast_to(np.asarray(what).T, cube.eps_y.shape[::-1]).T
    cube.eps_y.values += (what * cube.attrs["pixel_size"]).astype("float32")


def test_a_knock_is_dated_to_the_frame_and_measured(cube):
    steps = np.arange(16)
    add(cube, np.where(steps > 8, 0.45, np.where(steps == 8, 0.225, 0.0)))  # step 8 has one frame of each
    found = camera_motion(cube)
    frame, size = find_knock(found)
    assert frame == 9
    assert size == pytest.approx(0.45, abs=0.03)


def test_a_shaking_camera_is_measured_tilt_and_roll_alike(cube):
    still = vibration_rms(camera_motion(cube))[0]
    rng = np.random.default_rng(2)
    x = np.linspace(-1, 1, 9)
    add(cube, 0.2 * rng.standard_normal(16)[:, None, None] + 0.3 * rng.standard_normal((16, 1, 1)) * x)
    rms, std = vibration_rms(camera_motion(cube))
    assert still < 0.05
    assert rms == pytest.approx(np.sqrt(0.2**2 + 0.3**2 / 3), rel=0.4)
    assert 0 < std < rms / 2


def test_a_steady_record_has_no_knock(cube):
    found = camera_motion(cube)
    assert len(found.steps) == 16
    assert find_knock(found) is None


def test_a_slow_drift_and_waves_are_no_knock():
    t = np.linspace(0, 1, 200)[:, None]
    assert find_jump(np.hstack([0.2 * np.sin(60 * t), 0 * t, 0 * t])) is None
    assert rms_over_field(np.array([0.3, 0.0, 0.0])) == pytest.approx(0.3)


def samples(delay, rng, instants=10, shake=0.3):
    out = []
    for _ in range(instants):
        x, y = rng.uniform(-1, 1, (2, 300))
        design = np.stack([np.ones(300), x, y], axis=-1)
        velocity = np.sin(5 * x + 3 * y + rng.uniform(0, 6)) + 0.3 * rng.standard_normal(300)
        miss = delay * velocity + design @ (shake * rng.standard_normal(3)) + 0.03 * rng.standard_normal(300)
        miss[:6] += 3.0  # wrong matches
        out.append(Sample(miss, velocity, design))
    return out


def test_a_delay_is_found_whatever_the_cameras_shake():
    rng = np.random.default_rng(5)
    misses = []
    for _ in range(40):
        found, std = regress(samples(0.004, rng))
        misses.append((found - 0.004) / std)
        assert std < 0.002
    assert np.std(misses) == pytest.approx(1.0, abs=0.35)  # the uncertainty holds
    assert regress(samples(0.004, rng, instants=1)) is None


def test_instants_that_show_the_same_beads_do_not_make_a_delay_more_certain_than_one():
    """In short records the beads hardly move, and waves longer than the field hardly change."""
    rng = np.random.default_rng(0)
    misses = []
    for _ in range(200):
        x, y = rng.uniform(-1, 1, (2, 30))
        design, noise = np.stack([np.ones(30), x, y], axis=-1), 0.03 * rng.standard_normal(30)
        phase, k = rng.uniform(0, 6), rng.uniform(1, 3, 2)
        velocities = [np.sin(k[0] * x + k[1] * y + phase + 0.1 * n) for n in range(4)]
        found, std = regress([Sample(0.1 * v + noise, v, design) for v in velocities])
        misses.append((found - 0.1) / std)
    assert 0.7 < np.sqrt(np.mean(np.square(misses))) < 1.3
    assert np.mean(np.abs(misses) > SIGNIFICANCE) < 0.02


def test_no_delay_follows_from_a_specimen_that_hardly_moves():
    rng = np.random.default_rng(6)
    found, design = [], np.stack([np.ones(40), *rng.uniform(-1, 1, (2, 40))], axis=-1)
    for _ in range(20):
        noise = rng.normal(0, 0.01, (8, 2, 40))  # px: of the matching, part of it common to miss and velocity
        still = [Sample(miss + 1.4 * moved, moved, design) for miss, moved in noise]
        assert regress(still) is None
        delay, std = regress([Sample(s.eps_y, 100.0 * s.velocity, design) for s in still])
        found.append(abs(delay) > SIGNIFICANCE * std)
    assert np.mean(found) > 0.5, "by its own uncertainty it would be significant"


def test_a_delay_that_matters_is_a_remark():
    found = {"cam1": Delay(0.0, 0.0), "cam2": Delay(2e-3, 1e-5), "cam3": Delay(-2e-3, 1e-3)}
    (remark,) = remarks_on_clocks(Synchrony(found, 100.0))
    assert (remark.subject, remark.kind, remark.weight) == ("cam2", "delayed", "remark")
    assert "taken 2.000 ms later than the others' (+- 0.010 ms)" in str(remark)
    assert list(remarks_on_clocks(Synchrony(found, 10.0))) == [], "the water hardly moves meanwhile"


def test_a_delay_is_seen_in_images_by_check(tmp_path):
    found = check(write_experiment(tmp_path / "late", faults={"cam2": {"delay": 2e-3}}), workflow=HERE)
    (late,) = [one for one in found.verdict.remarks if one.weight != "note"]
    assert (late.subject, late.kind) == ("cam2", "delayed")
    assert late.values["delay"] == pytest.approx(2e-3, abs=3 * late.values["std"])
    assert late.values["std"] < 4e-4
    assert re.search(r"cam2 is [12]\.\d+ \+- .* ms later", found.clocks)


@pytest.mark.slow
@pytest.mark.parametrize("stated", [False, True])
def test_a_rolling_shutter_is_seen_in_images_unless_it_is_stated(stated, tmp_path):
    row_time = 2e-5
    faults = {name: {"row_time": row_time} for name in ("cam1", "cam2", "cam3")}
    path = write_experiment(tmp_path / "rolling", rig={"crop": 0.5}, faults=faults)
    data = yaml.safe_load(path.read_text()) | {"grid": "auto"}
    if stated:
        for camera in data["cameras"].values():
            camera["row_time"] = row_time
    path.write_text(yaml.safe_dump(data))
    found = [one for one in check(path, workflow=HERE).verdict.remarks if one.weight != "note"]
    assert [one.kind for one in found] == ([] if stated else ["rolling shutter"])
    for one in found:
        assert one.values["row_time"] == pytest.approx(row_time, abs=3.5 * one.values["std"])
