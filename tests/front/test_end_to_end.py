"""From a scene to a report with the commands alone, on a small tank."""

import io
import re
import shutil
from contextlib import redirect_stdout

import pytest
import yaml
from test_cli import examples_of

from wavefield.commands.cli import main
from wavefield.commands.demo import comparison

SCENE = {
    "name": "puddle", "frames": 18, "rig": {"crop": 0.3},
    "grid": {"x": [-0.24, 0.24], "y": [-0.18, 0.18], "step": 0.01},
    "sea": {"kind": "random", "rms": 0.01, "shortest": 0.08, "period": 2.0,
            "spectrum": {"kind": "power", "peak": 1.2, "exponent": 7}},
    "calibration": {"tilted": 4, "target": {"kind": "strings", "mesh": 0.04, "origin_disc": 0.02,
                                            "x_disc": 0.013, "half": 10}},
}  # fmt: skip
WORKFLOW = {"cluster": "none"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory, without_pixels):
    """The folder with all files that the commands write."""
    here = tmp_path_factory.mktemp("puddle")
    (here / "scene.yaml").write_text(yaml.safe_dump(SCENE))
    (here / "workflow.yaml").write_text(yaml.safe_dump(WORKFLOW))
    tank = here / "tank"
    experiment = str(tank / "experiment.yaml")
    for words in (
        ["simulate", str(here / "scene.yaml"), str(tank)],
        ["calibrate", experiment],
        ["check", experiment, "--workflow", str(here / "workflow.yaml"), "--pairs"],
        ["run", experiment, "--workflow", str(here / "workflow.yaml")],
        ["analyze", str(tank)],  # a folder stands for its cube
        ["report", experiment],
    ):
        with redirect_stdout(io.StringIO()) as printed, without_pixels():
            assert main(["-q", *words]) == 0, f"wavefield {' '.join(words)}"
        (here / f"{words[0]}.txt").write_text(printed.getvalue())
    return tank


@pytest.fixture
def checked(folder):
    """The output of `wavefield check --pairs`."""
    return (folder.parent / "check.txt").read_text()


def test_errors_are_below_the_papers(folder):
    table = comparison(folder / "cube.zarr", folder)
    found = {m[1]: float(m[3]) for m in re.finditer(r"^\s+(z|[uvw] dt)\s+([\d.]+)\s+([\d.]+)", table, re.M)}
    assert set(found) == {"z", "u dt", "v dt", "w dt"}
    assert max(found.values()) < 0.13, table
    assert "100.0 % of these nodes" in table


def test_report_has_every_part(folder):
    text = (folder / "report.html").read_text(encoding="utf-8")
    for anchor in [
        *("result", "what-needs-attention", "elevation-and-wave-probes", "run-summary", "set-up"),
        *("distributions", "spectra", "nonlinear-term-and-coherence", "accuracy"),
        *("coverage-and-faults", "calibration", "recipe"),
    ]:
        assert f'<section id="{anchor}"' in text
    assert "Not in this report" not in text
    for words in ("Against the exact fields", "probes, stereo", "z cam1-cam2 recombined − direct"):
        assert words in text


def test_run_again_measures_nothing_and_status_agrees(folder, capsys):
    before = (folder / "cube.zarr" / "zarr.json").stat().st_mtime_ns
    workflow = str(folder.parent / "workflow.yaml")
    assert main(["-q", "run", str(folder / "experiment.yaml"), "--workflow", workflow]) == 0
    assert (folder / "cube.zarr" / "zarr.json").stat().st_mtime_ns == before
    assert "Nothing to do: all 17 steps of" in capsys.readouterr().out
    assert main(["status", str(folder)]) == 0  # the cube of a folder
    out = capsys.readouterr().out
    assert "17 of 17 steps (100 %)" in out
    assert out.endswith(f"Next: wavefield look {folder / 'cube.zarr'}\n")  # waves and report are there
    assert not (folder / "waves.log").exists()  # one process analysed it


def test_calibrate_prints_what_shows_a_wrong_mesh(folder):
    printed = (folder.parent / "calibrate.txt").read_text()
    assert re.search(r"Distance from the target's origin: cam1 4\.\d\d m, cam2 4\.\d\d m", printed)
    assert re.search(r"On the water a pixel is 1\.\d mm; all cameras see x -0\.\d+ to 0\.\d+ m", printed)


def test_check_reports_that_the_cameras_agree(checked):
    assert checked.startswith("verdict: sound\n")
    assert re.search(r"patches matched: cam1-cam2 \d+ %, epipolar error 0.0\d px", checked)


def test_check_compares_the_pairs_of_cameras(folder, checked):
    out = checked
    found = dict(re.findall(r"^    (\S.*?)\s+(?:[\d.]+ cm )?([\d.]+) px$", out, re.M))
    assert {"eps_y cam3-cam1", "sigma_z cam1-cam2", "z_recombined cam1-cam2"} <= set(found)
    assert 0 < float(found["eps_piv cam1-cam2"]) < 0.2
    assert re.search(r"standard uncertainty.* z 0\.\d+, dx 0\.\d+, dy 0\.\d+, dz 0\.\d+\n", out)
    assert re.search(r"half the amplitude is kept, cm: z \d+\.\d, u \d+\.\d, v \d+\.\d, w \d+\.\d\n", out)
    report = (folder / "report.html").read_text(encoding="utf-8")
    assert report.count("recombined \u2212 direct") == 2  # words for those who do not see, a row of a table


def test_demo_gives_the_commands_of_the_readme_and_stops_where_one_fails(monkeypatch, tmp_path, capsys):
    import wavefield.commands.demo
    from wavefield.errors import WavefieldError

    given = []
    monkeypatch.setattr(wavefield.commands.demo, "comparison", lambda store, directory: "the table")
    wavefield.commands.demo.run_demo(tmp_path, lambda words: given.append(words) or 0)
    assert [words[0] for words in given] == ["simulate", "calibrate", "check", "run", "analyze", "report"]
    out = capsys.readouterr().out
    assert "the table" in out
    assert str(tmp_path / "report.html") in out
    with pytest.raises(WavefieldError, match="stopped in `wavefield run"):
        wavefield.commands.demo.run_demo(tmp_path, lambda words: int(words[0] == "run"))


def test_examples_of_helps_run_as_they_are_written(folder, tmp_path, monkeypatch, capsys):
    """Other examples are run by the fixture `folder`, or take minutes."""
    for name in ("cube.zarr", "waves.zarr", "experiment.yaml", "rig.yaml", "verdict.json"):
        (tmp_path / name).symlink_to(folder / name)
    for name in ("cam1", "cam2", "cam3"):
        shutil.copytree(folder / name, tmp_path / "run07" / name)
    monkeypatch.chdir(tmp_path)
    for words in ("init", "status", "verify", "rig convert", "explain"):
        for example in examples_of(words)[:2]:
            if "cal.xml" not in example and "campaign.yaml" not in example:
                assert main(["-q", *words.split(), *example]) == 0, f"{words} {example}"
    assert main(["-q", "export", *examples_of("export")[0]]) == 0
    assert (tmp_path / "cube.nc").exists()
    assert (
        main(["-q", "catalog", "add", *examples_of("catalog add")[0]]) == 1
    )  # what init wrote is incomplete
    assert "frame_rate is empty; fill it in" in capsys.readouterr().err


def test_the_papers_figures_are_on_one_page(folder, tmp_path, without_pixels):
    page, cube = tmp_path / "paper.html", str(folder / "cube.zarr")
    with without_pixels():
        assert main(["-q", "paper", cube, "--rest", cube, "-o", str(page)]) == 0  # any will do as one at rest
    text = page.read_text(encoding="utf-8")
    for anchor in ("surface-and-velocity", "still-water", "pairs-of-cameras-against-one-another", "numbers"):
        assert f'<section id="{anchor}">' in text
    assert text.count("<img ") >= 13
    for words in ("epipolar error (eps_y), cam", "z of still water, rms", "0.34 to 0.37 px"):
        assert words in text
    # each row of the numbers has one
    rows = re.findall(
        r'<th scope="row">([^<]*)</th><td[^>]*>[^<]*</td><td[^>]*>([^<]*)</td>', text.split('id="numbers"')[1]
    )
    assert len(rows) == 3
    assert all(re.match(r"[\d.]+", here) for _, here in rows), rows
