"""Wrong files, numbers and names are reported in one sentence with the file and a remedy, and an exit status.

One row per kind. To add one: a name, a function that spoils the laboratory's folder, the command, the exit
status, and words that the sentence must contain.
"""
# ruff: noqa: E501

import re
import shutil

import cv2
import numpy as np
import pytest
import tifffile
import yaml

from wavefield.commands.cli import main
from wavefield.tank import paper_rig

NOTE = """\
name: lab
frame_rate: 20.0
cameras:
  cam1: {images: "cam1/img_{frame:03d}.tif"}
  cam2: {images: "cam2/img_{frame:03d}.tif"}
  cam3: {images: "cam3/img_{frame:03d}.tif"}
calibration:
  target: {kind: strings, mesh: 0.1}
  tilted: "calib/{camera}/tilt_*.tif"
rig: rig.yaml
grid: {x: [-0.6, 0.6], y: [-0.4, 0.4], step: 0.02}
water: {depth: 0.7}
probes: probes.csv
"""


@pytest.fixture(scope="module")
def pattern(tmp_path_factory):
    """A laboratory's folder: almost empty images, a rig, an experiment file."""
    folder = tmp_path_factory.mktemp("lab") / "lab"
    rig = paper_rig(0.1)
    rng = np.random.default_rng(1)
    for name, camera in rig.cameras.items():
        (folder / name).mkdir(parents=True)
        width, height = camera.size
        for k in range(3):
            image = cv2.GaussianBlur(rng.integers(0, 255, (height, width), dtype=np.uint8), (0, 0), 1.0)
            tifffile.imwrite(folder / name / f"img_{k:03d}.tif", image)
    rig.save(folder / "rig.yaml")
    (folder / "experiment.yaml").write_text(NOTE)
    (folder / "here.yaml").write_text("cluster: none\n")  # workers take seconds to start
    (folder / "probes.csv").write_text("time,p1\n0,0.01\n0.1,0.02\n")
    return folder


@pytest.fixture
def lab(pattern, tmp_path):
    shutil.copytree(pattern, tmp_path / "lab")
    return tmp_path / "lab"


def note(old, new):
    def spoil(lab):
        path = lab / "experiment.yaml"
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))

    return spoil


def mask(image):
    def spoil(lab):
        cv2.imwrite(str(lab / "m.png"), image)
        note("rig:", "mask: {cam1: m.png}\nrig:")(lab)

    return spoil


def write(name, content):
    def spoil(lab):
        path = lab / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())

    return spoil


def lose(name):
    def spoil(lab):
        path = lab / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()

    return spoil


def rig_entry(**entries):
    def spoil(lab):
        data = yaml.safe_load((lab / "rig.yaml").read_text())
        data["cameras"]["cam1"] |= entries
        (lab / "rig.yaml").write_text(yaml.safe_dump(data))

    return spoil


def nothing(lab):
    pass


def in_the_way(lab):
    (lab / "cube.zarr").mkdir()
    (lab / "cube.zarr" / "precious.txt").write_text("mine")


def file_in_the_way(lab):
    (lab / "out").write_text("a file")


EXP = "experiment.yaml"
BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join(9 * ['*' + a])}]\n" for a, b in zip("abcdefgh", "bcdefghi")
)

TABLE = [
    # -- the lab note
    ("no lab note", lose(EXP), ["run", EXP], 2, "does not exist"),
    ("an image for a lab note", nothing, ["run", "cam1/img_000.tif"], 1, "img_000.tif"),
    ("not UTF-8", write(EXP, b"name: \xff\xfe\xfa"), ["run", EXP], 1, "not UTF-8 text"),
    ("an alias bomb", write(EXP, BOMB), ["run", EXP], 1, "aliases"),
    ("a mistyped key", note("frame_rate", "frame_rat"), ["run", EXP], 1, "line 2: .*did you mean 'frame_rate'"),
    ("endless frame rate", note("20.0", ".inf"), ["run", EXP], 1, "finite"),
    ("no cameras", note(NOTE[NOTE.index("  cam1") : NOTE.index("calib")], ""), ["run", EXP], 1, "cameras"),
    ("a pair of strangers", note("rig:", "surface: {pairs: [[cam1, cam9]]}\nrig:"), ["run", EXP], 1, "names 'cam9'"),
    ("frames backwards", note("rig:", "frames: {first: 9, last: 2}\nrig:"), ["run", EXP], 1, "frames runs from 9"),
    ("an unknown setting", note("rig:", "settings: {sharpness: 3}\nrig:"), ["run", EXP], 1, "sharpness is not a known"),
    # -- the grid
    ("a mask of a stranger", note("rig:", "mask: {cam9: m.png}\nrig:"), ["run", EXP], 1, "mask names 'cam9', but there are cam1, cam2, cam3, water"),
    ("a mask that is not there", note("rig:", "mask: {cam1: m.png}\nrig:"), ["run", EXP], 1, "mask of cam1: .*m.png: no such image"),
    ("a mask of another size", mask(np.zeros((9, 9), np.uint8)), ["run", EXP], 1, "mask of cam1: .*m.png is 9 x 9 px, but"),
    ("a grid in millimetres", note("[-0.6, 0.6], y: [-0.4, 0.4]", "[-1e6, 1e6], y: [-1e6, 1e6]"), ["run", EXP], 1, "nodes"),
    ("a grid that nobody sees", note("x: [-0.6, 0.6]", "x: [90.0, 90.6]"), ["run", EXP], 1, "have 0 % of the grid in common view"),
    # -- the images
    ("no folder of images", lose("cam2"), ["run", EXP], 1, "cam2"),
    ("a broken pattern", note("cam2/img_{frame:03d}", "cam2/img_{frame"), ["run", EXP], 1, "cam2"),
    ("text for images", lambda lab: [p.write_text("no image") for p in (lab / "cam1").iterdir()], ["run", EXP], 1, "img_00"),
    ("images of another size", lambda lab: [cv2.imwrite(str(p), np.eye(9, dtype=np.uint8) * 99) for p in (lab / "cam1").iterdir()], ["run", EXP], 1, "rig"),
    # -- the rig
    ("no rig", lose("rig.yaml"), ["run", EXP], 1, "rig.yaml"),
    ("a rig with NaN", rig_entry(fx=float("nan")), ["run", EXP], 1, "rig.yaml"),
    # -- the target
    ("no target images", nothing, ["calibrate", EXP, "-o", "new.yaml"], 1, "calib"),
    ("no calibration block", note(NOTE[NOTE.index("calib") : NOTE.index("rig:")], ""), ["calibrate", EXP, "-o", "n.yaml"], 1, "nothing to calibrate"),
    # -- the workflow
    ("no workflow", nothing, ["run", EXP, "--workflow", "none.yaml"], 2, "none.yaml"),
    ("an unknown cluster", write("w.yaml", "cluster: cloud"), ["run", EXP, "--workflow", "w.yaml"], 1, "line 1: cluster"),
    ("a strange time limit", write("w.yaml", "time_limit: soon"), ["run", EXP, "--workflow", "w.yaml"], 1, "no.? ?.*duration"),
    # -- stores and files to write
    ("something else is there", in_the_way, ["run", EXP], 1, "cube"),
    ("a file for a folder", file_in_the_way, ["run", EXP, "-o", "out/cube.zarr"], 1, "cannot be written"),
    ("status of no cube", nothing, ["status", "cam1"], 1, "not a cube|cannot be opened"),
    ("export to a spreadsheet", nothing, ["export", "cam1", "a.xlsx"], 2, "NetCDF"),
    # -- catalogs and scenes
    ("a run that a catalog lacks", lambda lab: main(["-q", "catalog", "add", "c.yaml", EXP]), ["run", "c.yaml", "run9"], 1, "no run 'run9'"),
    ("entries of no catalog", nothing, ["run", EXP, "run9"], 2, "not a catalog"),
    ("a scene that there is not", nothing, ["simulate", "ocean", "sea"], 1, "no such scene"),
]  # fmt: skip


def files(lab):
    return {p.relative_to(lab): p.read_bytes() for p in lab.rglob("*") if p.is_file()}


@pytest.mark.parametrize(
    ("spoil", "words", "status", "expected"), [row[1:] for row in TABLE], ids=[row[0] for row in TABLE]
)
def test_bad_input_is_one_sentence_with_file_and_remedy(
    lab, monkeypatch, capsys, spoil, words, status, expected
):
    monkeypatch.chdir(lab)
    spoil(lab)
    before = files(lab)
    capsys.readouterr()
    here = ["--workflow", "here.yaml"] if words[0] == "run" and "--workflow" not in words else []
    assert main(["-q", *words, *here]) == status
    printed = capsys.readouterr().err
    assert re.search(expected, printed), printed
    assert "Traceback" not in printed
    assert "did not foresee" not in printed
    if status == 1:
        assert printed.startswith("wavefield: ")
        assert printed.count("\n") == 1
    after = files(lab)
    assert {path: after.get(path) for path in before} == before  # nothing is lost
    left = {str(path) for path in set(after) - set(before)}
    assert not {path for path in left if path.endswith((".partial", ".lock"))}, left
