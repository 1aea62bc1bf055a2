"""A faulty camera gives the same exit status and words in check, run, status and report."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from wavefield.commands.cli import main
from wavefield.images import read_image, write_image
from wavefield.matching.spectrum import Prior
from wavefield.measurement.error_budget import fast_waves
from wavefield.quality.remarks import (
    remark_on_cameras_left_out,
    remark_on_unresolved_waves,
)
from wavefield.variables import Quality
from wavefield.water import dispersion


@pytest.fixture
def lab(knocked, tmp_path):
    """The first frames of a sound record of the wider tank, and a workflow of plain settings."""
    shutil.copytree(knocked.parent, tmp_path / "lab")
    path = tmp_path / "lab" / "experiment.yaml"
    path.write_text(path.read_text() + "frames: {last: 4}\n")
    (path.parent / "here.yaml").write_text("cluster: none\n")
    return path


def mirror(image):
    return np.ascontiguousarray(image[:, ::-1])


def blank(image):
    return np.full_like(image, 7)


def change(lab, camera, how):
    for file in (lab.parent / camera).glob("*.tif"):
        write_image(file, how(read_image(file)))


def test_a_mirrored_camera_is_named_by_every_command_and_stops_check_and_run(lab, capsys, undrawn):
    change(lab, "cam2", mirror)
    here, cube = ["--workflow", str(lab.with_name("here.yaml"))], str(lab.with_name("cube.zarr"))

    def printed(*words, status):
        assert main(["-q", *words]) == status
        return capsys.readouterr().out

    found = json.loads(printed("check", str(lab), "--json", *here, status=3))["verdict"]
    assert found["verdict"] == "not to be trusted"
    assert (found["remarks"][0]["subject"], found["remarks"][0]["kind"]) == ("cam2", "mirrored")
    assert "cam2 mirrored" in printed("run", str(lab), *here, status=3)
    assert printed("status", cube, status=3).startswith("verdict: not to be trusted: cam2 mirrored")
    printed("report", cube, status=0)
    page = lab.with_name("report.html").read_text()
    assert "Verdict: not to be trusted: cam2 mirrored" in page
    assert "Correct its images" in page


def test_the_verdict_names_a_camera_without_which_much_was_measured():
    quality = np.full((2, 10, 10), int(Quality.MEASURED), np.uint16)
    quality[:, :, :3] |= np.uint16(Quality.without(1))
    quality[0, 0, 9] |= np.uint16(Quality.without(2))  # not worth a word
    (remark,) = remark_on_cameras_left_out(quality, ["left", "middle", "right"])
    assert (remark.subject, remark.kind) == ("middle", "left out")
    assert remark.weight == "remark"
    assert "30.0 % of the nodes were measured without middle" in remark.found


def test_a_run_in_which_nothing_could_be_measured_failed(lab, capsys):
    change(lab, "cam3", blank)
    change(lab, "cam1", blank)
    here = ["--workflow", str(lab.with_name("here.yaml"))]
    assert main(["-q", "check", str(lab), *here]) == 1
    assert capsys.readouterr().out.startswith("verdict: not ready")
    assert main(["-q", "run", str(lab), *here]) == 1
    assert "record failed steps" in capsys.readouterr().out
    assert main(["-q", "status", str(lab.with_name("cube.zarr"))]) == 1


def test_waves_that_are_not_measured_are_remarked_upon_by_their_share():
    assert list(remark_on_unresolved_waves(0.05, 0.02, "They are short", "Come closer")) == []
    (remark,) = remark_on_unresolved_waves(0.4, 0.02, "They are short", "Come closer")
    assert str(remark).startswith("surface: waves of 2 cm and less have 40 % of the variance of w. They are")


@pytest.mark.parametrize("seed", range(2))
def test_waves_that_turn_by_more_than_half_a_turn_between_frames_are_fast(seed):
    rng = np.random.default_rng(seed)
    pixel, k = float(rng.uniform(1e-3, 3e-3)), np.linspace(0.05, 2.0, 40)
    found = Prior.isotropic(k, k**-2.0, 1.0)
    detected, none = replace(found, detected=((True,) * 40,)), replace(found, detected=((False,) * 40,))
    ring = int(rng.integers(10, 35))
    half_a_turn = float(dispersion(k[ring] / (5.0 * pixel))) / np.pi
    share, length = fast_waves(detected, pixel, 0.99 * half_a_turn)
    assert length == pytest.approx(2.0 * np.pi * 5.0 * pixel / k[ring])
    slower, shorter = fast_waves(detected, pixel, 1.01 * half_a_turn)
    assert share > slower
    assert length > shorter
    assert fast_waves(none, pixel, 0.5 * half_a_turn) == (0.0, 0.0)
