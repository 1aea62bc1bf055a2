"""The experiment file: what it may contain, and how mistakes are reported."""

import pytest
from series_cases import write_experiment, write_frames

from wavefield.errors import ExperimentError, RigError
from wavefield.series import Experiment
from wavefield.tank import paper_rig

LAB_NOTE = """\
name: coriolis-07
frame_rate: 20.0                     # Hz
cameras:
  cam1: {images: "cam1/img_{frame:05d}.tif"}
  cam2: {images: "cam2/img_{frame:05d}.tif"}
  cam3: {images: "cam3/img_{frame:05d}.tif"}
calibration:
  target: {kind: strings, mesh: 0.10, origin_mark: disc, x_mark: small disc}
  tilted: "calib/{camera}/tilt_*.tif"
  flat:   "calib/{camera}/flat.tif"
rig: rig.yaml
surface: {pairs: [[cam3, cam1], [cam3, cam2]]}
velocity: {cameras: [cam1, cam2]}
grid: {x: [-1.0, 1.0], y: [-0.75, 0.75], step: 0.01}
water: {depth: 0.70}
probes: probes.csv
"""


def load(tmp_path, text):
    path = tmp_path / "experiment.yaml"
    path.write_text(text)
    return Experiment.load(path)


def complaint(tmp_path, text):
    with pytest.raises(ExperimentError) as caught:
        load(tmp_path, text)
    return str(caught.value)


def test_a_lab_note_is_read(tmp_path):
    note = load(tmp_path, LAB_NOTE)
    assert note.name == "coriolis-07"
    assert note.cameras["cam2"].images == "cam2/img_{frame:05d}.tif"
    assert note.calibration.target["mesh"] == 0.10
    assert note.surface.pairs == [("cam3", "cam1"), ("cam3", "cam2")]
    assert note.water.depth == 0.7
    assert note.choose_grid(paper_rig()).shape == (151, 201)
    assert note.measuring_cameras == ["cam1", "cam2", "cam3"]
    assert note.resolve("rig.yaml") == tmp_path / "rig.yaml"


@pytest.mark.parametrize(
    ("old", "new", "line", "expected"),
    [
        ("frame_rate: 20.0 ", "frame_rate: -1 ", 2, "frame_rate should be greater than or equal to 0.0001"),
        ("step: 0.01", "stop: 0.01", 14, "did you mean 'step'?"),
        ("step: 0.01", "step: 0", 14, "grid.step should be greater than 0"),
        (", y: [-0.75, 0.75]", "", 14, "give both x and y"),
        ("[cam3, cam2]]", "[cam3]]", 12, "surface.pairs"),
        ("[[cam3, cam1], ", "[[cam3, cam3], ", None, "pairs 'cam3' with itself"),
        ("probes: probes.csv", "colour: blue", 16, "colour is not a known key; known keys here: name"),
        ("probes: probes.csv", "rig: other.yaml", 16, "'rig' is there twice (first on line 11); remove one"),
        ("  cam2: {images:", "  cam2: {image:", 5, "did you mean 'images'?"),
        ("surface: {", "surface: [", 12, "check indentation"),
        ("depth: 0.70", "depth: deep", 15, "water.depth should be a number"),
    ],
)
def test_mistakes_are_named_with_line_and_remedy(tmp_path, old, new, line, expected):
    assert old in LAB_NOTE
    message = complaint(tmp_path, LAB_NOTE.replace(old, new))
    assert expected in message
    assert "experiment.yaml" in message
    if line:
        assert f"line {line}" in message
    assert "\n" not in message


def test_rig_must_be_there_and_fit(tmp_path):
    write_frames(tmp_path / "a", range(2))
    write_frames(tmp_path / "b", range(2))
    cameras = "cam1: a/img_{frame}.tif\ncam2: b/img_{frame}.tif"
    note = Experiment.load(write_experiment(tmp_path, cameras))
    with pytest.raises(
        RigError, match=r"names no rig and there is no rig.yaml beside it; run `wavefield calibrate"
    ):
        note.load_rig()
    note = Experiment.load(write_experiment(tmp_path, cameras, "rig: rig.yaml\n"))
    with pytest.raises(RigError, match=r"rig\.yaml"):
        note.load_rig()
    paper_rig().save(tmp_path / "rig.yaml")
    with pytest.raises(RigError, match="cam1 of 1024 x 1024 px, but these have 8 x 6"):
        note.load_rig(series=note.open_frames())
    assert set(note.load_rig()) == {"cam1", "cam2", "cam3"}
    note = Experiment.load(
        write_experiment(tmp_path, "left: a/img_{frame}.tif\ncam2: b/img_{frame}.tif", "rig: rig.yaml\n")
    )
    with pytest.raises(RigError, match="has no camera left"):
        note.load_rig()


def test_water_level_moves_the_rig(tmp_path):
    paper_rig().save(tmp_path / "rig.yaml")
    note = Experiment.load(
        write_experiment(
            tmp_path,
            "cam1: a/img_{frame}.tif\ncam2: b/img_{frame}.tif",
            "rig: rig.yaml\nwater: {level: 0.1}\n",
        )
    )
    before, after = paper_rig()["cam1"].centre, note.load_rig()["cam1"].centre
    assert after[2] == pytest.approx(before[2] - 0.1)


def test_a_file_of_another_kind_gets_one_sentence_and_a_block_is_not_compared_with_a_word(tmp_path):
    path = tmp_path / "experiment.yaml"
    path.write_text("cluster: local\nworkers: 3\nmemory: 2 GB\naddress: x\npacking: int16\ntime_limit: 3h\n")
    with pytest.raises(ExperimentError) as caught:
        Experiment.load(path)
    printed = str(caught.value)
    assert printed.count("known keys here") == 1
    assert printed.endswith("and 2 more: is it a file of this kind at all?")
    path.write_text(
        'name: lab\nframe_rate: 20\ncameras: {a: "{frame}.tif"}\ngrid: {x: [1, -1], y: [-1, 1], step: 0.1}\n'
    )
    with pytest.raises(ExperimentError, match="less than one step") as caught:
        Experiment.load(path)
    assert "'auto'" not in str(caught.value)


def test_an_automatic_grid_keeps_the_elevations_of_the_settings_in_view(tmp_path):
    auto = LAB_NOTE.replace("grid: {x: [-1.0, 1.0], y: [-0.75, 0.75], step: 0.01}", "grid: auto")
    rig = paper_rig()
    widths = {}
    for stated in ("z_range: [-0.3, 0.3]", "z_range: [0.0, 0.01]", "sheet_thickness: 0.01"):
        x0, x1 = load(tmp_path, auto + f"settings: {{{stated}}}\n").choose_grid(rig).x
        widths[stated] = x1 - x0
    usual = load(tmp_path, auto)
    x0, x1 = usual.choose_grid(rig).x
    assert widths["z_range: [-0.3, 0.3]"] < x1 - x0 < widths["z_range: [0.0, 0.01]"]
    assert widths["sheet_thickness: 0.01"] >= widths["z_range: [0.0, 0.01]"]
    assert usual.choose_grid(rig, {"z_range": (-0.3, 0.3)}).x[1] < x1
